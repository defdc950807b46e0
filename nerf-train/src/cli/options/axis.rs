//! World axes.

use clap::ValueEnum;
use glam::Vec3;

/// A world axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum UpAxis {
    /// +X.
    X,
    /// +Y.
    Y,
    /// +Z.
    Z,
    /// −X.
    #[value(name = "-x")]
    NegX,
    /// −Y.
    #[value(name = "-y")]
    NegY,
    /// −Z.
    #[value(name = "-z")]
    NegZ,
}

impl UpAxis {
    pub fn direction(self) -> Vec3 {
        match self {
            Self::X => Vec3::X,
            Self::Y => Vec3::Y,
            Self::Z => Vec3::Z,
            Self::NegX => Vec3::NEG_X,
            Self::NegY => Vec3::NEG_Y,
            Self::NegZ => Vec3::NEG_Z,
        }
    }
}

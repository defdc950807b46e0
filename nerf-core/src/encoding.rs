//! Sinusoidal positional encoding.

use serde::{Deserialize, Serialize};

/// Most levels an encoding may have.
pub const MAX_LEVELS: u8 = 16;

/// The factor `s` in `sin(2^k s x)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum AngleScale {
    /// `s = 1`: the original authors' code and nerf-pytorch.
    One,
    /// `s = π`: the formula of the paper, and this project's own.
    Pi,
}

/// Which encoding a network was trained with.
///
/// `[identity,] then per level k: sin(2^k s x) for all inputs, cos(2^k s x) for all inputs`
///
/// # Source
/// Mildenhall et al. 2020, eq. 4, in the order of the authors' code.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Encoding {
    /// Number of inputs: 3 for a position or a direction, 2 for a point of an image.
    pub inputs: u8,
    /// Number of levels, `k` in `0..levels`, at most [`MAX_LEVELS`].
    pub levels: u8,
    /// The factor `s`.
    pub scale: AngleScale,
    /// Whether the inputs themselves come first.
    pub identity: bool,
}

impl Encoding {
    /// Number of encoded values.
    ///
    /// ```
    /// use nerf_core::encoding::{AngleScale, Encoding};
    /// let position = Encoding { inputs: 3, levels: 10, scale: AngleScale::Pi, identity: true };
    /// assert_eq!(position.outputs(), 63);
    /// ```
    pub const fn outputs(&self) -> usize {
        self.inputs as usize * (self.identity as usize + 2 * self.levels as usize)
    }
}

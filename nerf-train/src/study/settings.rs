//! One way to render a frame: every knob at one value.

use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::plan::Quality;
use nerf_core::simd::Tier;

/// Whose weights the network has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Precision {
    /// The blob's own, rounded to f16.
    Rounded,
    /// The f32 ones they were rounded from.
    Unrounded,
}

/// Every knob at one value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// The shortcuts that a caller asks for.
    pub quality: Quality,
    /// Kernel tier.
    pub tier: Tier,
    /// Which of the laboratory's variants of the blob; 0 is the blob itself.
    pub variant: usize,
    /// Whose weights.
    pub precision: Precision,
    /// Sides of the rendered picture in quarters of the view's own; what is smaller is enlarged again.
    pub quarters: u32,
    /// Rays a pixel.
    pub rays: u16,
}

impl Settings {
    /// The exact rendering: every sample inside the scene box, behind the occupancy grid only where the blob says
    /// that it is part of the model; no cuts, the exact encoding, f32 on the fastest f32 tier.
    pub fn exact(blob: &Blob<'_>) -> Self {
        Self { quality: Quality::exact(blob), ..Self::base() }
    }

    /// What the renderer does when nobody asks for anything, on the fastest f32 tier.
    pub fn base() -> Self {
        Self {
            quality: Quality::default(),
            tier: Tier::detect(),
            variant: 0,
            precision: Precision::Rounded,
            quarters: 4,
            rays: 1,
        }
    }

    /// Whether a frame takes so long that it is rendered on the timing views only: it asks the network
    /// everywhere, or on the scalar tier.
    pub fn is_slow(&self, has_occupancy: bool) -> bool {
        self.tier == Tier::Scalar || !(has_occupancy && self.quality.occupancy)
    }
}

/// The name of a maths backend.
pub fn math_name(math: MathBackend) -> &'static str {
    match math {
        MathBackend::Polynomial => "polynomial",
        MathBackend::Libm => "libm",
        MathBackend::Micromath => "micromath",
        MathBackend::Recurrence => "recurrence",
        _ => "other",
    }
}

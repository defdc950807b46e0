//! One way to render a frame: every knob at one value.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::math::MathBackend;
use nerf_core::plan::Quality;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Precision {
    /// The blob's own, rounded to f16.
    Rounded,
    /// The f32 ones they were rounded from.
    Unrounded,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    pub quality: Quality,
    pub kernel: Kernel,
    /// Which of the bench's variants of the blob; 0 is the blob itself.
    pub variant: usize,
    pub precision: Precision,
    /// Sides of the rendered picture in quarters of the view's own; what is smaller is enlarged again.
    pub quarters: u32,
    pub rays: u16,
}

impl Settings {
    /// The exact rendering: every sample inside the scene box, behind the occupancy grid only where the blob says
    /// that it is part of the model; no cuts, the exact encoding, f32 with the fastest instructions.
    pub fn exact(blob: &Blob<'_>) -> Self {
        Self { quality: Quality::exact(blob), ..Self::base() }
    }

    /// What the renderer does when nobody asks for anything, in f32 with the fastest instructions.
    pub fn base() -> Self {
        Self {
            quality: Quality::default(),
            kernel: Kernel::detect(),
            variant: 0,
            precision: Precision::Rounded,
            quarters: 4,
            rays: 1,
        }
    }

    /// Whether a frame takes so long that it is rendered on the timing views only: it asks the network
    /// everywhere, or with weights read in place by portable instructions.
    pub fn is_slow(&self, has_occupancy: bool) -> bool {
        self.kernel == Kernel::IN_PLACE || !(has_occupancy && self.quality.occupancy)
    }
}

pub fn math_name(math: MathBackend) -> &'static str {
    match math {
        MathBackend::Polynomial => "polynomial",
        MathBackend::Libm => "libm",
        MathBackend::Micromath => "micromath",
        MathBackend::Recurrence => "recurrence",
        _ => "other",
    }
}

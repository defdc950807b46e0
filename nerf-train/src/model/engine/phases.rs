//! Time that each phase of training takes.

use std::ops::AddAssign;
use std::time::{Duration, Instant};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Generation of rays, and of their samples in occupied cells.
    March,
    /// Encoding of positions: interpolation of table entries.
    Encode,
    Forward,
    /// Volume rendering (weights of samples, pixels); the loss, and its gradients with respect to weights and pixels.
    Composite,
    Backward,
    /// Addition of each sample's gradient to the gradients of the table entries that the sample reads.
    Scatter,
    Adam,
    Occupancy,
}

impl Phase {
    /// All phases, in the order of a step.
    pub const ALL: [Self; 8] = [
        Self::March,
        Self::Encode,
        Self::Forward,
        Self::Composite,
        Self::Backward,
        Self::Scatter,
        Self::Adam,
        Self::Occupancy,
    ];

    pub const fn name(self) -> &'static str {
        match self {
            Self::March => "march",
            Self::Encode => "encode",
            Self::Forward => "layers forward",
            Self::Composite => "composite",
            Self::Backward => "layers backward",
            Self::Scatter => "scatter",
            Self::Adam => "Adam",
            Self::Occupancy => "occupancy",
        }
    }
}

/// Time of each [`Phase`], summed over threads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct Phases([Duration; Phase::ALL.len()]);

impl Phases {
    pub fn of(&self, phase: Phase) -> Duration {
        self.0[phase as usize]
    }

    pub fn add(&mut self, phase: Phase, time: Duration) {
        self.0[phase as usize] += time;
    }

    /// Adds the time since `since` to a phase; returns the present time.
    pub fn lap(&mut self, phase: Phase, since: Instant) -> Instant {
        let now = Instant::now();
        self.add(phase, now - since);
        now
    }
}

impl AddAssign for Phases {
    fn add_assign(&mut self, other: Self) {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a += b);
    }
}

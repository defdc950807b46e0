//! Rendering of one frame, in the caller's memory: rays are marched, the network is evaluated at their samples, and the
//! results are composited to pixels.
//!
//! A tile's rays are marched front to back (`march`). The active rays' next samples in occupied cells form a block, and
//! trunk and density head are evaluated for the whole block. Usually a block holds one sample of each ray: a ray whose
//! transmittance is still above the threshold has its next sample in a later block. Samples that need a colour are
//! collected until they fill a block for the colour branch. With deferred shading, the trunk's output `h` is composited
//! along the ray instead, and the colour branch is evaluated once per ray after the march. Pixels and work do not
//! depend on the size of tile or batch. A 2D field has no rays: its pixels are evaluated block by block (`picture`).

mod counters;
mod error;
mod explain;
mod field;
mod frame;
#[cfg(feature = "instances")]
mod instances;
mod march;
mod pace;
mod picture;
mod pixel;
mod renderer;
mod stages;
mod worker;

#[cfg(test)]
pub(crate) mod tests;

pub use counters::Counters;
#[cfg(feature = "instances")]
pub use error::InstanceProblem;
pub use error::RenderError;
pub use explain::{Explanation, Shares, Stage, Switch};
#[cfg(feature = "instances")]
pub use instances::Instance;
pub use pace::Pace;
pub use picture::MAX_RENDER_SIDE;
pub use pixel::{Limit, RaySegment, Rect, Target};
pub use renderer::Renderer;
pub use worker::{TILE_SIDE, Worker};

#[cfg(all(feature = "std", not(target_os = "none")))]
pub(crate) use {march::CoarseOccupancy, renderer::Prepared};

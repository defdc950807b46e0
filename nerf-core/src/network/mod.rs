//! Architecture and evaluation of the network. `PE(x)` is the encoded position, `PE(d)` the encoded direction.
//!
//! ```text
//! PE(x) ─► trunk: dense+ReLU … (a layer may take [h, PE(x)]) ─► h ─┬─► dense ─► raw_sigma
//!                                                                  └─► [h, PE(d)] ─► dense+ReLU … ─► dense ─► rgb
//! ```

mod architecture;
#[cfg(feature = "normals")]
mod gradient;
mod view;
mod weights;

#[cfg(test)]
mod tests;

pub(crate) use architecture::PER_RAY_BUILT;
#[cfg(all(test, feature = "grid"))]
pub(crate) use architecture::check_grid;
pub use architecture::{
    Architecture, ArchitectureError, DensityActivation, EXPONENTIAL_LIMIT, Layer, Layers, MAX_COLOUR,
    MAX_LAYERS, MAX_TRUNK, MAX_WIDTH, Role, Shading, TrunkLayer,
};
#[cfg(all(feature = "normals", not(feature = "train")))]
pub(crate) use gradient::GradientScratch;
#[cfg(all(feature = "normals", feature = "train"))]
pub use gradient::GradientScratch;
#[cfg(not(feature = "train"))]
pub(crate) use view::{Network, Scratch};
#[cfg(feature = "train")]
pub use view::{Network, Scratch};
#[cfg(not(feature = "train"))]
pub(crate) use weights::{Weights, unpack};
#[cfg(feature = "train")]
pub use weights::{Weights, unpack};

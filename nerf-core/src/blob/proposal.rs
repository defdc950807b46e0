//! The proposal network: a coarse network whose weights say where on a ray the scene's network is evaluated.

use crate::encoding::SinusoidalEncoding;
use crate::network::{Architecture, DensityActivation, MAX_TRUNK, Shading, TrunkLayer};
use serde::{Deserialize, Serialize, Serializer};

/// A network with densities only: encoding, trunk and density head, over the scene box.
///
/// # Source
/// Mildenhall et al. 2020, section 5.2: the coarse network, of which rendering uses only the weights
/// along the ray. Its colours are not in the file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Proposal<'a> {
    /// Encoding of the position; it may differ from the scene's own.
    pub position: SinusoidalEncoding,
    /// The trunk, in order; the first layer takes `PE(x)` and has no skip.
    pub trunk: heapless::Vec<TrunkLayer, MAX_TRUNK>,
    /// Activation of the density head.
    pub density: DensityActivation,
    /// Samples per ray at which the proposal is evaluated, one in each of equal bins of `near..far`.
    pub samples: u16,
    /// The parameters as little-endian f16, in the order of [`Architecture::layers`]: trunk, density head.
    #[serde(serialize_with = "as_bytes")]
    pub weights: &'a [u8],
}

impl Proposal<'_> {
    /// The shape as a scene's architecture. Its rgb head has no parameters in [`Proposal::weights`], which end after
    /// [`Architecture::density_parameters`].
    pub fn architecture(&self) -> Architecture {
        Architecture {
            position: self.position.into(),
            direction: None,
            trunk: self.trunk.clone(),
            density: Some(self.density),
            colour: heapless::Vec::new(),
            shading: Shading::PerSample,
        }
    }
}

/// Serialises all bytes in one call instead of one call per byte; the bytes written are the same.
pub(super) fn as_bytes<S: Serializer>(bytes: &&[u8], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_bytes(bytes)
}

//! Networks that were trained elsewhere, from files in nerf-pytorch's names.
//!
//! ```text
//! .npz, .safetensors ─► Tensors ─► layers, columns permuted ─► Model + parameters ─► fold ─► blob
//!                        names       Settings: what the            engine::Model
//!                                    file cannot say
//! ```
//!
//! | tensor | shape | becomes |
//! | --- | --- | --- |
//! | `pts_linears.0.weight` | `[W, E]` | first trunk layer; `E`, width of PE(x), tells its levels |
//! | `pts_linears.i.weight` | `[W, W]`, or `[W, E + W]` | trunk layer, or the one that takes `[PE(x), h]` |
//! | `alpha_linear.weight` | `[1, W]` | density head |
//! | `feature_linear.weight` | `[W, W]` | linear, so it is folded into what follows it |
//! | `views_linears.0.weight` | `[V, W + D]` | first colour layer; `D`, width of PE(d), tells its levels |
//! | `rgb_linear.weight` | `[3, V]` | rgb |
//! | `output_linear.weight` | `[4, W]` | without view directions: rgb, then sigma, in place of all the four above |
//!
//! Of a coarse network (`--coarse`) the same is read, and what leads to its densities becomes the scene's proposal.
//!
//! Each has a `.bias` as long as its weight has rows. What stands in front of the names, such as `module.` or
//! `network_fine.`, is passed over.
//!
//! # Source
//! The names and the order of columns are those of github.com/yenchenlin/nerf-pytorch (`run_nerf_helpers.py`),
//! which copies the original authors' TensorFlow code.

mod error;
mod network;
mod order;
mod settings;
mod tensors;

pub use error::{Fault, ImportError};
pub use network::{Imported, network};
pub use order::{Identity, Order};
pub use settings::{AngleFactor, RawDensity, Settings};
pub use tensors::{Tensor, Tensors};

//! What can be wrong with a network from elsewhere.

use crate::data::DatasetError;
use crate::model::export::ExportError;
use nerf_core::network::ArchitectureError;
use std::path::PathBuf;

/// A network that cannot be imported: which file, which tensor or setting, what was expected and found.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// A file that cannot be read, or an array of it.
    #[error(transparent)]
    File(#[from] DatasetError),
    /// Something is wrong with the tensors of a file.
    #[error("{}: {fault}", file.display())]
    Checkpoint {
        /// The checkpoint.
        file: PathBuf,
        /// What is wrong.
        fault: Fault,
    },
    /// The array of an occupancy grid is none.
    #[error("{}: occupancy grid: expected {expected}, found {found}", file.display())]
    Occupancy {
        /// The `.npy` file.
        file: PathBuf,
        /// What would be one.
        expected: String,
        /// What it is.
        found: String,
    },
    /// A setting out of its range.
    #[error("{field}: expected {expected}, found {found}")]
    Setting {
        /// The flag, and its name in the TOML file.
        field: &'static str,
        /// The range.
        expected: String,
        /// The value.
        found: String,
    },
    /// The format refuses the network.
    #[error(transparent)]
    Export(#[from] ExportError),
}

/// What is wrong with the tensors of a file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Fault {
    /// Neither of the two formats.
    #[error("expected a .npz or .safetensors file, found {found}")]
    Format {
        /// The file's ending, or what the unpacker says.
        found: String,
    },
    /// No tensor of a name that belongs to a network.
    #[error("expected tensors named as nerf-pytorch does (pts_linears.0.weight, …), found {found}")]
    NoNetwork {
        /// Some of the names there are.
        found: String,
    },
    /// More than one network, and none of them is called fine.
    #[error("expected one network, found {}: choose one with --prefix", found.join(", "))]
    SeveralNetworks {
        /// What stands in front of the names.
        found: Vec<String>,
    },
    /// More tensors than the largest network has.
    #[error("expected at most {most} tensors of one network, found {found}")]
    TooMany {
        /// The limit.
        most: usize,
        /// How many there are.
        found: usize,
    },
    /// A tensor that must be there is not.
    #[error("{tensor}: expected shape {expected}, found no such tensor")]
    Missing {
        /// Its name.
        tensor: String,
        /// The shape it would have.
        expected: String,
    },
    /// A tensor that no network of this kind has.
    #[error("{tensor}: expected no such tensor, found one of shape {found:?}")]
    Unexpected {
        /// Its name.
        tensor: String,
        /// Its shape.
        found: Vec<usize>,
    },
    /// A name that is there twice.
    #[error("{tensor}: expected one tensor of this name, found two")]
    Duplicate {
        /// The name.
        tensor: String,
    },
    /// A tensor of another shape.
    #[error("{tensor}: expected shape {expected}, found {found:?}")]
    Shape {
        /// Its name.
        tensor: String,
        /// The shapes that would do.
        expected: String,
        /// Its shape.
        found: Vec<usize>,
    },
    /// A tensor of another type of number.
    #[error("{tensor}: expected dtype {expected}, found {found}")]
    Dtype {
        /// Its name.
        tensor: String,
        /// The types that would do.
        expected: &'static str,
        /// Its type.
        found: String,
    },
    /// A parameter that is not finite in f32.
    #[error("{tensor}: expected finite numbers, found {found} at index {index}")]
    NotFinite {
        /// Its tensor.
        tensor: String,
        /// Its place in the tensor, C order.
        index: usize,
        /// Its value.
        found: f32,
    },
    /// More layers than the format holds.
    #[error("{layers}: expected at most {most} layers, found {found}")]
    Depth {
        /// `pts_linears` or `views_linears`.
        layers: &'static str,
        /// The limit of the format.
        most: usize,
        /// How many there are.
        found: usize,
    },
    /// The width of an encoded input, which is no encoding's, or not the one that the settings say.
    #[error("{tensor}: expected {expected} columns of encoded {field}, found {found}")]
    Encoded {
        /// The tensor that takes it.
        tensor: String,
        /// `position` or `direction`.
        field: &'static str,
        /// The widths that would do.
        expected: String,
        /// The width it has.
        found: usize,
    },
    /// The network is outside the format's caps.
    #[error("{0}")]
    Architecture(ArchitectureError),
}

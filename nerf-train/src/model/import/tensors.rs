//! Named tensors out of an untrusted file.

use super::error::{Fault, ImportError};
use crate::data::DatasetError;
use crate::data::layouts::npz::Archive;
use crate::system::input::read_limited;
use half::{bf16, f16};
use nerf_core::network::{MAX_COLOUR, MAX_TRUNK};
use safetensors::{Dtype, SafeTensors};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Names of the layers; what stands in front of them is a prefix.
const LAYERS: [&str; 6] =
    ["pts_linears.", "views_linears.", "feature_linear.", "alpha_linear.", "rgb_linear.", "output_linear."];
/// Weights and biases of the largest network, and a few for a message that names what is too much.
const MAX_TENSORS: usize = 2 * (MAX_TRUNK + MAX_COLOUR + 4) + 16;
/// Largest array that is unpacked, bytes: 30 times the largest layer in f64.
const MAX_ARRAY_BYTES: u64 = 1 << 26;
/// Largest `.safetensors` file, bytes; it is read whole.
const MAX_FILE_BYTES: u64 = 1 << 30;
/// Names that a message lists.
const LISTED: usize = 5;

/// A tensor in C order.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Its sides, outermost first.
    pub shape: Vec<usize>,
    /// Its elements, all finite.
    pub values: Vec<f32>,
}

/// The tensors of one network by their names without prefix.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensors {
    /// The file they come from.
    pub file: PathBuf,
    /// What stood in front of the names.
    pub prefix: String,
    /// Prefixes of other networks in the file, which are left out.
    pub others: Vec<String>,
    /// By name.
    pub tensors: BTreeMap<String, Tensor>,
}

/// What a file offers before anything of it is unpacked.
trait Source {
    fn names(&mut self) -> Result<Vec<String>, ImportError>;
    fn tensor(&mut self, name: &str) -> Result<(Vec<usize>, Vec<f32>), ImportError>;
}

impl Tensors {
    /// Reads the network whose names begin with `prefix`; if that is `None`, the file's only one, or its fine one.
    ///
    /// # Errors
    /// [`ImportError`] on a file that is damaged, holds no such network, or numbers that are not finite floats.
    pub fn read(file: &Path, prefix: Option<&str>) -> Result<Self, ImportError> {
        Self::read_where(file, prefix, |prefix| prefix.contains("fine"))
    }

    /// The same of a coarse network: without `prefix`, the file's only one, or its only one that is not fine.
    ///
    /// # Errors
    /// As [`Tensors::read`].
    pub fn read_coarse(file: &Path, prefix: Option<&str>) -> Result<Self, ImportError> {
        Self::read_where(file, prefix, |prefix| !prefix.contains("fine"))
    }

    fn read_where(file: &Path, prefix: Option<&str>, wanted: fn(&str) -> bool) -> Result<Self, ImportError> {
        let fail = |fault| ImportError::Checkpoint { file: file.into(), fault };
        let ending = file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        match ending.as_str() {
            "npz" => Self::of(file, (prefix, wanted), &mut Npz(Archive::open(file, MAX_ARRAY_BYTES)?)),
            "safetensors" => {
                let io = |source| DatasetError::io(file, source);
                let bytes = read_limited(file, MAX_FILE_BYTES).map_err(io)?;
                let tensors = SafeTensors::deserialize(&bytes)
                    .map_err(|error| fail(Fault::Format { found: format!("a damaged one ({error})") }))?;
                Self::of(file, (prefix, wanted), &mut Safe { file, tensors })
            }
            "" => Err(fail(Fault::Format { found: "a name without ending".into() })),
            other => Err(fail(Fault::Format { found: format!("a name that ends in .{other}") })),
        }
    }

    fn of(
        file: &Path,
        (prefix, wanted): (Option<&str>, fn(&str) -> bool),
        source: &mut dyn Source,
    ) -> Result<Self, ImportError> {
        let fail = |fault| ImportError::Checkpoint { file: file.into(), fault };
        let mut names = source.names()?;
        names.sort_unstable();
        let (prefix, others) = choose(&names, prefix, wanted).map_err(fail)?;
        let own = names.iter().filter(|name| prefix_of(name).is_none_or(|own| own == prefix));
        let named: Vec<(&str, &str)> =
            own.filter_map(|name| Some((name.as_str(), name.strip_prefix(&prefix)?))).collect();
        if named.len() > MAX_TENSORS {
            return Err(fail(Fault::TooMany { most: MAX_TENSORS, found: named.len() }));
        }
        let mut tensors = BTreeMap::new();
        for (whole, name) in named {
            let (shape, values) = source.tensor(whole)?;
            if let Some(index) = values.iter().position(|value| !value.is_finite()) {
                let (tensor, found) = (name.to_owned(), values[index]);
                return Err(fail(Fault::NotFinite { tensor, index, found }));
            }
            if tensors.insert(name.to_owned(), Tensor { shape, values }).is_some() {
                return Err(fail(Fault::Duplicate { tensor: name.to_owned() }));
            }
        }
        Ok(Self { file: file.into(), prefix, others, tensors })
    }
}

/// What stands in front of a layer's name; `None` if no layer is named.
fn prefix_of(name: &str) -> Option<&str> {
    let begins_a_part = |at: &usize| *at == 0 || name[..*at].ends_with('.');
    let places = LAYERS.iter().flat_map(|layer| name.match_indices(layer)).map(|(at, _)| at);
    places.filter(begins_a_part).min().map(|at| &name[..at])
}

/// What stands in front of the names of the network that is asked for, or else `wanted`, and of the others.
fn choose(
    names: &[String],
    asked: Option<&str>,
    wanted: fn(&str) -> bool,
) -> Result<(String, Vec<String>), Fault> {
    let found: BTreeSet<&str> = names.iter().filter_map(|name| prefix_of(name)).collect();
    let fitting: Vec<&str> = found.iter().copied().filter(|prefix| wanted(prefix)).collect();
    let chosen = match (asked, &fitting[..]) {
        (Some(asked), _) => found.get(asked).copied(),
        (None, _) if found.len() <= 1 => found.first().copied(),
        (None, [only]) => Some(*only),
        (None, _) => {
            return Err(Fault::SeveralNetworks { found: found.iter().map(|p| format!("`{p}`")).collect() });
        }
    };
    let chosen = chosen.ok_or_else(|| Fault::NoNetwork { found: listed(names) })?;
    let others = found.iter().filter(|&&prefix| prefix != chosen).map(|&prefix| prefix.to_owned());
    Ok((chosen.to_owned(), others.collect()))
}

fn listed(names: &[String]) -> String {
    let shown = names.iter().take(LISTED).map(String::as_str).collect::<Vec<_>>().join(", ");
    match names.len() {
        0 => "none".into(),
        n if n > LISTED => format!("{shown} and {} more", n - LISTED),
        _ => format!("only {shown}"),
    }
}

struct Npz(Archive);

impl Source for Npz {
    fn names(&mut self) -> Result<Vec<String>, ImportError> {
        Ok(self.0.names()?)
    }

    fn tensor(&mut self, name: &str) -> Result<(Vec<usize>, Vec<f32>), ImportError> {
        let array = self.0.array(name)?;
        let numbers = array.numbers().filter(|_| array.is_float());
        let numbers = numbers.ok_or_else(|| self.0.dtype_error(name, "f2, f4 or f8", &array))?;
        Ok((array.shape, numbers.into_iter().map(|value| value as f32).collect()))
    }
}

struct Safe<'d> {
    file: &'d Path,
    tensors: SafeTensors<'d>,
}

impl Source for Safe<'_> {
    fn names(&mut self) -> Result<Vec<String>, ImportError> {
        Ok(self.tensors.names().into_iter().map(str::to_owned).collect())
    }

    fn tensor(&mut self, name: &str) -> Result<(Vec<usize>, Vec<f32>), ImportError> {
        let fail = |fault| ImportError::Checkpoint { file: self.file.into(), fault };
        let view = self
            .tensors
            .tensor(name)
            .map_err(|error| fail(Fault::Format { found: format!("a damaged one ({name}: {error})") }))?;
        let values = floats(view.dtype(), view.data()).ok_or_else(|| {
            let found = format!("{:?}", view.dtype());
            fail(Fault::Dtype { tensor: name.into(), expected: "F16, BF16, F32 or F64", found })
        })?;
        Ok((view.shape().to_vec(), values))
    }
}

/// Little-endian floats; `None` if they are of another type.
fn floats(dtype: Dtype, bytes: &[u8]) -> Option<Vec<f32>> {
    fn each<const N: usize>(bytes: &[u8], value: impl Fn([u8; N]) -> f32) -> Vec<f32> {
        bytes.as_chunks::<N>().0.iter().map(|&chunk| value(chunk)).collect()
    }
    Some(match dtype {
        Dtype::F16 => each(bytes, |b| f16::from_le_bytes(b).to_f32()),
        Dtype::BF16 => each(bytes, |b| bf16::from_le_bytes(b).to_f32()),
        Dtype::F32 => each(bytes, f32::from_le_bytes),
        Dtype::F64 => each(bytes, |b| f64::from_le_bytes(b) as f32),
        _ => return None,
    })
}

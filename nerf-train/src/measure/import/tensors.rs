//! Named tensors from an untrusted file.

use super::refused;
use crate::data::DatasetError;
use crate::data::layouts::npz::Archive;
use crate::system::input::read_limited;
use half::{bf16, f16};
use nerf_core::network::{MAX_COLOUR, MAX_TRUNK};
use safetensors::{Dtype, SafeTensors};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Beginnings of layer names. In a tensor's name, the text before the layer's name is the network's prefix.
const LAYERS: [&str; 6] =
    ["pts_linears.", "views_linears.", "feature_linear.", "alpha_linear.", "rgb_linear.", "output_linear."];
/// Largest accepted number of tensors: 16 more than a network can have, so that an error can name a surplus tensor.
const MAX_TENSORS: usize = 2 * (MAX_TRUNK + MAX_COLOUR + 4) + 16;
/// Largest size of an unpacked array, bytes: 30 times the largest layer in f64.
const MAX_ARRAY_BYTES: u64 = 1 << 26;
/// Largest size of a `.safetensors` file, bytes; the file is read whole.
const MAX_FILE_BYTES: u64 = 1 << 30;
const LISTED: usize = 5;

/// A tensor in row-major order; its values are finite.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    /// Dimensions, outermost first.
    pub shape: Vec<usize>,
    pub(super) values: Vec<f32>,
}

/// Tensors of one network, by their names without the network's prefix.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensors {
    pub(super) file: PathBuf,
    pub prefix: String,
    /// Prefixes of the other networks in the file. These networks are not read.
    pub others: Vec<String>,
    pub(super) tensors: BTreeMap<String, Tensor>,
}

/// Open file whose tensors are not unpacked yet.
enum Source<'d> {
    Npz(Archive),
    Safe(SafeTensors<'d>),
}

impl Tensors {
    /// Reads the network whose tensor names begin with `prefix`. `None`: the file's only network, or the only one with
    /// "fine" in its prefix. Fails if there is no such network.
    pub fn read(file: &Path, prefix: Option<&str>) -> anyhow::Result<Self> {
        Self::read_where(file, prefix, |prefix| prefix.contains("fine"))
    }

    /// Reads the coarse network, whose tensor names begin with `prefix`. `None`: the file's only network, or the only
    /// one without "fine" in its prefix. Fails if there is no such network.
    pub fn read_coarse(file: &Path, prefix: Option<&str>) -> anyhow::Result<Self> {
        Self::read_where(file, prefix, |prefix| !prefix.contains("fine"))
    }

    fn read_where(file: &Path, prefix: Option<&str>, wanted: fn(&str) -> bool) -> anyhow::Result<Self> {
        let name = file.display();
        let bytes: Vec<u8>;
        let mut source = match file.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase() {
            npz if npz == "npz" => Source::Npz(Archive::open(file, Some(MAX_ARRAY_BYTES))?),
            safe if safe == "safetensors" => {
                bytes = read_limited(file, MAX_FILE_BYTES).map_err(|io| DatasetError::io(file, io))?;
                Source::Safe(SafeTensors::deserialize(&bytes).map_err(|error| damaged(file, &error))?)
            }
            other => {
                let found =
                    if other.is_empty() { "no ending" } else { &format!("a name that ends in .{other}") };
                return Err(refused(name, "a .npz or .safetensors file", found));
            }
        };
        let mut names = source.names()?;
        names.sort_unstable();
        let (prefix, others) = choose(file, &names, prefix, wanted)?;
        let own = names.iter().filter(|name| prefix_of(name).is_none_or(|own| own == prefix));
        let named: Vec<(&str, &str)> =
            own.filter_map(|name| Some((name.as_str(), name.strip_prefix(&prefix)?))).collect();
        if named.len() > MAX_TENSORS {
            let expected = format!("at most {MAX_TENSORS} tensors of one network");
            return Err(refused(name, expected, named.len().to_string()));
        }
        let mut read = Self { file: file.into(), prefix, others, tensors: BTreeMap::new() };
        for (whole, name) in named {
            let tensor = source.tensor(file, whole)?;
            if let Some(index) = tensor.values.iter().position(|value| !value.is_finite()) {
                let found = format!("{} at index {index}", tensor.values[index]);
                return Err(read.refused(name, "finite numbers", found));
            }
            if read.tensors.insert(name.to_owned(), tensor).is_some() {
                return Err(read.refused(name, "one tensor of this name", "two"));
            }
        }
        Ok(read)
    }

    /// Returns an error about the tensor named `tensor`, with what was expected and what was found.
    pub(super) fn refused(&self, tensor: &str, expected: impl Display, found: impl Display) -> anyhow::Error {
        refused(format!("{}: {tensor}", self.file.display()), expected, found)
    }
}

fn damaged(file: &Path, error: &dyn std::error::Error) -> anyhow::Error {
    let found = format!("a damaged one ({error})");
    refused(file.display(), "a .npz or .safetensors file", found)
}

/// Returns the text before the layer's name in a tensor's `name`; `None` if `name` contains no layer's name.
fn prefix_of(name: &str) -> Option<&str> {
    let begins_a_part = |at: &usize| *at == 0 || name[..*at].ends_with('.');
    let places = LAYERS.iter().flat_map(|layer| name.match_indices(layer)).map(|(at, _)| at);
    places.filter(begins_a_part).min().map(|at| &name[..at])
}

/// Returns the prefix of the network to read, and the prefixes of the file's other networks. `asked`: prefix to choose;
/// `None`: the file's only prefix, or the only one that `wanted` accepts. Fails if there is no such prefix.
fn choose(
    file: &Path,
    names: &[String],
    asked: Option<&str>,
    wanted: fn(&str) -> bool,
) -> anyhow::Result<(String, Vec<String>)> {
    let found: BTreeSet<&str> = names.iter().filter_map(|name| prefix_of(name)).collect();
    let fitting: Vec<&str> = found.iter().copied().filter(|prefix| wanted(prefix)).collect();
    let chosen = match (asked, &fitting[..]) {
        (Some(asked), _) => found.get(asked).copied(),
        (None, _) if found.len() <= 1 => found.first().copied(),
        (None, [only]) => Some(*only),
        (None, _) => {
            let found: Vec<String> = found.iter().map(|prefix| format!("`{prefix}`")).collect();
            let found = format!("{}: choose one with --prefix", found.join(", "));
            return Err(refused(file.display(), "one network", found));
        }
    };
    let chosen = chosen.ok_or_else(|| {
        let expected = "tensors named as nerf-pytorch does (pts_linears.0.weight, …)";
        refused(file.display(), expected, listed(names))
    })?;
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

impl Source<'_> {
    fn names(&mut self) -> anyhow::Result<Vec<String>> {
        match self {
            Self::Npz(archive) => Ok(archive.names()?),
            Self::Safe(tensors) => Ok(tensors.names().into_iter().map(str::to_owned).collect()),
        }
    }

    fn tensor(&mut self, file: &Path, name: &str) -> anyhow::Result<Tensor> {
        match self {
            Self::Npz(archive) => {
                let array = archive.array(name)?;
                let numbers = array.numbers().filter(|_| array.is_float());
                let numbers = numbers.ok_or_else(|| archive.dtype_error(name, "f2, f4 or f8", &array))?;
                let values = numbers.into_iter().map(|value| value as f32).collect();
                Ok(Tensor { shape: array.shape, values })
            }
            Self::Safe(tensors) => {
                let view = tensors.tensor(name).map_err(|error| damaged(file, &error))?;
                let values = floats(view.dtype(), view.data()).ok_or_else(|| {
                    let place = format!("{}: {name}", file.display());
                    let found = format!("{:?}", view.dtype());
                    refused(place, "dtype F16, BF16, F32 or F64", found)
                })?;
                Ok(Tensor { shape: view.shape().to_vec(), values })
            }
        }
    }
}

/// Decodes little-endian floating-point values; `None` if `dtype` is not F16, BF16, F32 or F64.
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

//! Small checkpoints on disk, in nerf-pytorch's names.

use half::{bf16, f16};
use safetensors::Dtype;
use safetensors::tensor::{TensorView, serialize};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

/// Shape and elements by name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checkpoint(pub BTreeMap<String, (Vec<usize>, Vec<f64>)>);

/// What a network of nerf-pytorch is made of.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Widths of the trunk's layers.
    pub trunk: Vec<usize>,
    /// `skips`: the encoded position is put in front of the output of these layers.
    pub skips: Vec<usize>,
    /// Columns of the encoded position.
    pub position: usize,
    /// Columns of the encoded direction; `None` without view directions.
    pub direction: Option<usize>,
    /// Widths of the colour branch.
    pub views: Vec<usize>,
}

impl Shape {
    /// Three layers of 12, 8 and 10, skip behind the first, 2 and 1 levels, colour 6.
    pub fn small() -> Self {
        Self {
            trunk: vec![12, 8, 10],
            skips: vec![0],
            position: 3 + 6 * 2,
            direction: Some(3 + 6),
            views: vec![6],
        }
    }

    /// A network of this shape; the same for the same seed. Elements fit f16 and bf16 exactly.
    pub fn checkpoint(&self, seed: u64) -> Checkpoint {
        let mut made = Checkpoint::default();
        let mut state = seed.wrapping_mul(2) + 1;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            // Multiples of 1/64 in [-1, 1).
            ((state >> 57) as f64 - 64.0) / 64.0
        };
        let mut linear = |name: String, outputs: usize, inputs: usize| {
            // A power of two: the elements stay short, and what flows through stays of one size.
            let scale = (0.5 * (inputs as f64).log2()).floor().exp2().recip();
            let mut weight: Vec<f64> = (0..outputs * inputs).map(|_| scale * next()).collect();
            // The row of density: something is seen at many points.
            let row = (outputs - 1) * inputs;
            if name == "alpha_linear" || name == "output_linear" {
                weight[row..].iter_mut().for_each(|weight| *weight = weight.abs());
            }
            made.0.insert(format!("{name}.weight"), (vec![outputs, inputs], weight));
            let mut bias: Vec<f64> = (0..outputs).map(|_| next()).collect();
            if name == "alpha_linear" || name == "output_linear" {
                bias[outputs - 1] = bias[outputs - 1].abs();
            }
            made.0.insert(format!("{name}.bias"), (vec![outputs], bias));
        };
        let mut inputs = self.position;
        for (i, &width) in self.trunk.iter().enumerate() {
            linear(format!("pts_linears.{i}"), width, inputs);
            inputs = width + if self.skips.contains(&i) { self.position } else { 0 };
        }
        let width = self.trunk[self.trunk.len() - 1];
        if let Some(direction) = self.direction {
            linear("alpha_linear".into(), 1, width);
            linear("feature_linear".into(), width, width);
            let mut inputs = width + direction;
            for (i, &hidden) in self.views.iter().enumerate() {
                linear(format!("views_linears.{i}"), hidden, inputs);
                inputs = hidden;
            }
            linear("rgb_linear".into(), 3, inputs);
        } else {
            linear("output_linear".into(), 4, width);
        }
        made
    }
}

impl Checkpoint {
    /// The same with `prefix` in front of every name.
    pub fn prefixed(&self, prefix: &str) -> Self {
        Self(self.0.iter().map(|(name, tensor)| (format!("{prefix}{name}"), tensor.clone())).collect())
    }

    /// Writes an archive of `<f2`, `<f4`, `<f8` or `<i4` arrays.
    pub fn npz(&self, path: &Path, dtype: &str) -> PathBuf {
        self.npz_twice(path, dtype, None)
    }

    /// The same, with one array in it twice.
    pub fn npz_twice(&self, path: &Path, dtype: &str, twice: Option<&str>) -> PathBuf {
        let mut writer = zip::ZipWriter::new(std::fs::File::create(path).expect("create"));
        let again = twice.map(|name| (name, &self.0[name]));
        let mut all: Vec<_> = self.0.iter().map(|(name, tensor)| (name.as_str(), tensor)).collect();
        all.extend(again);
        for (name, (shape, values)) in all {
            writer.start_file(format!("{name}.npy"), zip::write::FileOptions::default()).expect("entry");
            writer.write_all(&npy(dtype, shape, values)).expect("write");
        }
        writer.finish().expect("finish");
        path.into()
    }

    /// Writes a `.safetensors` file of `dtype`.
    pub fn safetensors(&self, path: &Path, dtype: Dtype) -> PathBuf {
        let bytes = |values: &[f64]| -> Vec<u8> {
            match dtype {
                Dtype::F16 => values.iter().flat_map(|&v| f16::from_f64(v).to_le_bytes()).collect(),
                Dtype::BF16 => values.iter().flat_map(|&v| bf16::from_f64(v).to_le_bytes()).collect(),
                Dtype::F64 => values.iter().flat_map(|v| v.to_le_bytes()).collect(),
                Dtype::I32 => values.iter().flat_map(|&v| (v as i32).to_le_bytes()).collect(),
                _ => values.iter().flat_map(|&v| (v as f32).to_le_bytes()).collect(),
            }
        };
        let data: Vec<_> = self.0.iter().map(|(name, (shape, v))| (name, shape, bytes(v))).collect();
        let views = data.iter().map(|(name, shape, bytes)| {
            (name.as_str(), TensorView::new(dtype, (*shape).clone(), bytes).expect("a view"))
        });
        std::fs::write(path, serialize(views, None).expect("a file")).expect("written");
        path.into()
    }
}

/// A `.npy` file.
pub fn npy(dtype: &str, shape: &[usize], values: &[f64]) -> Vec<u8> {
    let sides: Vec<String> = shape.iter().map(|side| format!("{side},")).collect();
    let header =
        format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': ({}), }}\n", sides.join(" "));
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.into_bytes());
    for &value in values {
        match dtype {
            "<f2" => bytes.extend(f16::from_f64(value).to_le_bytes()),
            "<f8" => bytes.extend(value.to_le_bytes()),
            "<i4" => bytes.extend((value as i32).to_le_bytes()),
            "|b1" | "|u1" => bytes.push(value as u8),
            _ => bytes.extend((value as f32).to_le_bytes()),
        }
    }
    bytes
}

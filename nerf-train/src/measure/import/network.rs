//! Conversion of named tensors to a model and its parameters.

use super::order::Identity;
use super::settings::{RawDensity, Settings};
use super::tensors::{Tensor, Tensors};
use crate::model::engine::Model;
use anyhow::Context;
use nerf_core::encoding::SinusoidalEncoding;
use nerf_core::network::{
    Architecture, DensityActivation, MAX_COLOUR, MAX_TRUNK, MAX_WIDTH, Shading, TrunkLayer,
};
use std::collections::BTreeSet;
use std::iter::once;

/// Encoding of the direction (`None`: colour does not depend on it), and widths of the hidden colour layers.
type ColourBranch = (Option<SinusoidalEncoding>, heapless::Vec<u16, MAX_COLOUR>);

/// Imported network in this project's order of layers and channels. The linear feature layer is still separate.
#[derive(Clone, Debug)]
pub struct Imported {
    pub model: Model,
    /// Parameters in the order of `model`'s layers.
    pub parameters: Vec<f32>,
    /// Names of tensors that belong to the network but are not used.
    pub unused: Vec<String>,
}

impl Imported {
    /// Returns the parameters of the exported network. The feature layer is folded into the layer after it, in f64.
    pub fn folded(&self) -> Vec<f32> {
        self.model.fold((&self.parameters).into()).into_owned()
    }
}

pub fn network(tensors: &Tensors, settings: &Settings) -> anyhow::Result<Imported> {
    let left = tensors.tensors.keys().map(String::as_str).collect();
    let mut reader = Reader { tensors, settings, left, parameters: Vec::new() };
    let (architecture, feature, unused) = reader.architecture()?;
    let model = Model { feature, ..Model::plain(architecture) };
    Ok(Imported { model, parameters: reader.parameters, unused })
}

/// Reader of a network's layers, in the order of a [`Model`]'s parameters.
struct Reader<'t> {
    tensors: &'t Tensors,
    settings: &'t Settings,
    /// Names of the tensors that have not been read yet.
    left: BTreeSet<&'t str>,
    parameters: Vec<f32>,
}

/// Linear layer `y = W x + b`, `W` row-major `[outputs][inputs]`.
#[derive(Clone, Copy)]
struct Linear<'t> {
    weight: &'t [f32],
    bias: &'t [f32],
    inputs: usize,
    outputs: usize,
}

impl<'t> Reader<'t> {
    /// Reads the whole network. Returns its architecture, whether it has a feature layer, and unused tensors' names.
    fn architecture(&mut self) -> anyhow::Result<(Architecture, bool, Vec<String>)> {
        let (position, trunk) = self.trunk()?;
        let width = trunk.last().map_or(0, |layer| usize::from(layer.width));
        let has = |layer| self.tensors.tensors.contains_key(layer);
        let directed = !has("output_linear.weight");
        let (direction, colour) = if directed { self.colour_branch(width)? } else { self.output(width)? };
        // nerf-pytorch creates this layer even for a network without view directions, which does not use it.
        let idle = |name: &&&str| !directed && name.starts_with("views_linears.0.");
        let unused: Vec<&str> = self.left.iter().filter(idle).copied().collect();
        unused.iter().for_each(|name| {
            self.left.remove(name);
        });
        if let Some(&tensor) = self.left.first() {
            let found = format!("one of shape {:?}", self.tensors.tensors[tensor].shape);
            return Err(self.tensors.refused(tensor, "no such tensor", found));
        }
        let density = Some(match self.settings.density {
            RawDensity::Relu => DensityActivation::Relu,
            RawDensity::Softplus | RawDensity::ShiftedSoftplus => DensityActivation::ShiftedSoftplus,
        });
        let (position, direction) = (position.into(), direction.map(Into::into));
        let architecture =
            Architecture { position, direction, trunk, density, colour, shading: Shading::PerSample };
        let file = &self.tensors.file;
        architecture.check().with_context(|| file.display().to_string())?;
        Ok((architecture, directed, unused.into_iter().map(str::to_owned).collect()))
    }

    fn trunk(&mut self) -> anyhow::Result<(SinusoidalEncoding, heapless::Vec<TrunkLayer, MAX_TRUNK>)> {
        let depth = self.count("pts_linears", MAX_TRUNK)?;
        let mut trunk = heapless::Vec::new();
        let first = self.linear("pts_linears.0", "[width, encoded position]", |_, _| true)?;
        let encoded = first.inputs;
        let (position, columns) = self.encoding("position", "pts_linears.0.weight", encoded)?;
        let mut width = first.outputs;
        self.put(first, first.rows(), &columns);
        // Cannot overflow: `count` limits the depth to the capacity.
        let mut push = |layer: Linear<'_>, skip| trunk.push(TrunkLayer { width: layer.outputs as u16, skip });
        let _ = push(first, false);
        for i in 1..depth {
            let expected =
                format!("[width, {width}] or, where [PE(x), h] enters, [width, {}]", encoded + width);
            let fits = |_, inputs| inputs == width || inputs == encoded + width;
            let layer = self.linear(&format!("pts_linears.{i}"), &expected, fits)?;
            let skip = layer.inputs != width;
            // Columns are [PE(x), h] in the file, and [h, PE(x)] in this project.
            let of_h = if skip { encoded..encoded + width } else { 0..width };
            let of_position = if skip { &columns[..] } else { &[] };
            let permuted: Vec<usize> = of_h.chain(of_position.iter().copied()).collect();
            self.put(layer, layer.rows(), &permuted);
            let _ = push(layer, skip);
            width = layer.outputs;
        }
        Ok((position, trunk))
    }

    /// Reads density, feature, colour and rgb layers of a network with view directions. `width`: outputs of the trunk.
    fn colour_branch(&mut self, width: usize) -> anyhow::Result<ColourBranch> {
        let straight: Vec<usize> = (0..MAX_WIDTH).collect();
        let density = self.exactly("alpha_linear", &[1], width)?;
        self.put_density(density, 0, &straight[..width]);
        let feature = self.exactly("feature_linear", &[width], width)?;
        self.put(feature, feature.rows(), &straight[..width]);
        let hidden = self.count("views_linears", MAX_COLOUR)?;
        let expected = format!("[width, {width} + encoded direction]");
        let first = self.linear("views_linears.0", &expected, |_, inputs| inputs >= width)?;
        let (direction, of_direction) = match first.inputs - width {
            0 => (None, Vec::new()),
            encoded => {
                let (encoding, columns) = self.encoding("direction", "views_linears.0.weight", encoded)?;
                (Some(encoding), columns)
            }
        };
        let columns: Vec<usize> =
            (0..width).chain(of_direction.iter().map(|column| width + column)).collect();
        self.put(first, first.rows(), &columns);
        let mut colour: heapless::Vec<u16, MAX_COLOUR> = once(first.outputs as u16).collect();
        let mut inputs = first.outputs;
        for i in 1..hidden {
            let layer =
                self.linear(&format!("views_linears.{i}"), &format!("[width, {inputs}]"), |_, n| {
                    n == inputs
                })?;
            self.put(layer, layer.rows(), &straight[..inputs]);
            // Cannot overflow: `count` limits the number of layers to the capacity.
            let _ = colour.push(layer.outputs as u16);
            inputs = layer.outputs;
        }
        let rgb = self.exactly("rgb_linear", &[3], inputs)?;
        self.put(rgb, rgb.rows(), &straight[..inputs]);
        Ok((direction, colour))
    }

    /// Reads the output layer of a network without view directions. Its rows are r, g, b, sigma, and perhaps a fifth,
    /// which is ignored. `width`: outputs of the trunk.
    fn output(&mut self, width: usize) -> anyhow::Result<ColourBranch> {
        let straight: Vec<usize> = (0..width).collect();
        let output = self.exactly("output_linear", &[4, 5], width)?;
        self.put_density(output, 3, &straight);
        self.put(output, 0..3, &straight);
        Ok((None, heapless::Vec::new()))
    }

    /// Counts the layers named `{layers}.0`, `{layers}.1`, …: the largest index plus one. Fails if it is above `most`.
    fn count(&self, layers: &'static str, most: usize) -> anyhow::Result<usize> {
        let index = |name: &String| -> Option<usize> {
            name.strip_prefix(layers)?.strip_prefix('.')?.split('.').next()?.parse().ok()
        };
        let found =
            self.tensors.tensors.keys().filter_map(index).max().map_or(0, |last| last.saturating_add(1));
        match found > most {
            true => Err(self.tensors.refused(layers, format!("at most {most} layers"), found.to_string())),
            false => Ok(found),
        }
    }

    /// Reads the layer named `layer`, whose weight must have `inputs` columns and one of `outputs` as number of rows.
    fn exactly(&mut self, layer: &str, outputs: &[usize], inputs: usize) -> anyhow::Result<Linear<'t>> {
        let rows = outputs.iter().map(usize::to_string).collect::<Vec<_>>().join(" or ");
        let expected = format!("[{rows}, {inputs}]");
        self.linear(layer, &expected, |rows, found| outputs.contains(&rows) && found == inputs)
    }

    /// Reads the layer `layer`. `fits(rows, columns)`: whether the weight's shape is right; `expected`: right shape.
    fn linear(
        &mut self,
        layer: &str,
        expected: &str,
        fits: impl Fn(usize, usize) -> bool,
    ) -> anyhow::Result<Linear<'t>> {
        let (name, weight) = self.tensor(layer, "weight", expected)?;
        let tensors = self.tensors;
        let shape = |tensor: String, expected: &str, found: &[usize]| {
            tensors.refused(&tensor, format!("shape {expected}"), format!("{found:?}"))
        };
        let (outputs, inputs) = match weight.shape[..] {
            [outputs, inputs] if fits(outputs, inputs) => (outputs, inputs),
            _ => return Err(shape(name, expected, &weight.shape)),
        };
        if !(1..=MAX_WIDTH).contains(&outputs) {
            return Err(shape(name, &format!("1 to {MAX_WIDTH} rows"), &weight.shape));
        }
        let expected = format!("[{outputs}]");
        let (name, bias) = self.tensor(layer, "bias", &expected)?;
        if bias.shape != [outputs] {
            return Err(shape(name, &expected, &bias.shape));
        }
        Ok(Linear { weight: &weight.values, bias: &bias.values, inputs, outputs })
    }

    fn tensor(&mut self, layer: &str, part: &str, expected: &str) -> anyhow::Result<(String, &'t Tensor)> {
        let tensor = format!("{layer}.{part}");
        self.left.remove(tensor.as_str());
        match self.tensors.tensors.get(&tensor) {
            Some(found) => Ok((tensor, found)),
            None => Err(self.tensors.refused(&tensor, format!("shape {expected}"), "no such tensor")),
        }
    }

    /// Returns the encoding with `found` channels and, for each channel in this project's order, its column in the
    /// file. `field`: "position" or "direction". `tensor`: name of the weight, for errors.
    fn encoding(
        &self,
        field: &'static str,
        tensor: &str,
        found: usize,
    ) -> anyhow::Result<(SinusoidalEncoding, Vec<usize>)> {
        let settings = self.settings;
        let fail = |expected: String| {
            let expected = format!("{expected} columns of encoded {field}");
            Err(self.tensors.refused(tensor, expected, found.to_string()))
        };
        // With three inputs, a level adds six values, and the raw inputs add three.
        let own = found % 6;
        let identity = match (own, settings.identity) {
            (3, None) => Identity::First,
            (3, Some(given @ (Identity::First | Identity::Last))) => given,
            (0, None | Some(Identity::None)) => Identity::None,
            (_, None) => return fail("6 for each level, and 3 more with the inputs themselves,".into()),
            (_, Some(Identity::None)) => return fail("6 for each level (identity none)".into()),
            (_, Some(_)) => return fail("3 and 6 for each level (identity first or last)".into()),
        };
        let levels = match field {
            "position" => settings.position_levels,
            _ => settings.direction_levels,
        };
        if let Some((levels, columns)) = levels.map(|levels| (levels, own + 6 * usize::from(levels)))
            && columns != found
        {
            return fail(format!("{columns} ({levels} levels)"));
        }
        let encoding = SinusoidalEncoding {
            inputs: 3,
            levels: u8::try_from((found - own) / 6).unwrap_or(u8::MAX),
            scale: settings.angle_scale.scale(),
            identity: own > 0,
        };
        Ok((encoding, settings.order.columns(&encoding, identity)))
    }

    /// Appends the weights of `rows`, with columns in the order of `columns`, and then their biases to the parameters.
    fn put(&mut self, layer: Linear<'_>, rows: std::ops::Range<usize>, columns: &[usize]) {
        for row in rows.clone() {
            let row = &layer.weight[row * layer.inputs..][..layer.inputs];
            self.parameters.extend(columns.iter().map(|&column| row[column]));
        }
        self.parameters.extend_from_slice(&layer.bias[rows]);
    }

    /// Appends row `row` of `layer` as density head, with columns in the order of `columns`, and adapts the bias to the
    /// model's density activation.
    fn put_density(&mut self, layer: Linear<'_>, row: usize, columns: &[usize]) {
        self.put(layer, row..row + 1, columns);
        if self.settings.density == RawDensity::Softplus
            && let Some(bias) = self.parameters.last_mut()
        {
            // The model has softplus(raw − 1): softplus(raw) = softplus((raw + 1) − 1).
            *bias += 1.0;
        }
    }
}

impl Linear<'_> {
    fn rows(&self) -> std::ops::Range<usize> {
        0..self.outputs
    }
}

//! A network at work: weights where they lie, samples in blocks.

use super::architecture::{Architecture, DensityActivation, Layer, Layers, Role};
use crate::encoding::encode_block;
use crate::kernels::{Gemm, HalfInit, Init, Op, Tier, f16_at, gemm, gemm_f16};
use crate::math::lanes::Lanes;
use crate::math::{Math, MathBackend, with_math};
use core::marker::PhantomData;

/// Where the parameters lie.
#[derive(Clone, Copy, Debug)]
pub enum Weights<'a> {
    /// Little-endian f16, read in place: no memory but the activations.
    InPlace(&'a [u8]),
    /// f32, for the vector tiers.
    Prepared(&'a [f32]),
}

/// A network that can be evaluated: shape, parameters, tier and maths backend.
#[derive(Clone, Debug)]
pub struct Network<'a> {
    architecture: Architecture,
    layers: Layers,
    weights: Weights<'a>,
    tier: Tier,
}

/// Memory for one block of samples, `[channel][stride]` each.
#[derive(Debug)]
pub struct Scratch<'w> {
    /// Samples of a block.
    pub stride: usize,
    /// Encoded inputs, `[encoded][stride]`.
    pub encoded: &'w mut [f32],
    /// Activations, `[width][stride]`.
    pub front: &'w mut [f32],
    /// Activations, `[width][stride]`.
    pub back: &'w mut [f32],
}

/// The two matrices a layer's weights may be cut into.
#[derive(Clone, Copy, PartialEq)]
enum Part {
    Main,
    Extra,
}

/// What a layer's sum starts from.
#[derive(Clone, Copy, PartialEq)]
enum Start {
    Bias,
    Output,
}

impl<'a> Network<'a> {
    /// A network over parameters that fit its architecture.
    ///
    /// `None` if the architecture breaks a cap or the parameters are too few.
    pub fn new(architecture: &Architecture, weights: Weights<'a>, tier: Tier) -> Option<Self> {
        architecture.check().ok()?;
        let have = match weights {
            Weights::InPlace(bytes) => bytes.len() / 2,
            Weights::Prepared(parameters) => parameters.len(),
        };
        (have >= architecture.parameters()).then(|| Self {
            layers: architecture.layers(),
            architecture: architecture.clone(),
            weights,
            tier,
        })
    }

    /// Its shape.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// The tier its products run on.
    pub fn tier(&self) -> Tier {
        self.tier
    }

    /// Whether [`Scratch::stride`] must be a multiple of 16: only weights read in place take any.
    pub fn whole_blocks(&self) -> bool {
        matches!(self.weights, Weights::Prepared(_))
    }

    /// Rows of [`Scratch::encoded`].
    pub fn encoded_rows(&self) -> usize {
        let direction = self.architecture.direction.map_or(0, |direction| direction.outputs());
        self.architecture.position.outputs().max(direction)
    }

    /// Rows of [`Scratch::front`] and [`Scratch::back`].
    pub fn activation_rows(&self) -> usize {
        self.layers.iter().map(|layer| layer.outputs).max().unwrap_or(0)
    }

    /// Rows of `h`, what [`Network::trunk`] leaves in [`Scratch::front`].
    pub fn trunk_rows(&self) -> usize {
        self.architecture.trunk.last().map_or(0, |layer| usize::from(layer.width))
    }

    /// Outputs of the layer where the direction joins; 0 without view dependence.
    pub fn direction_rows(&self) -> usize {
        self.direction_layer().map_or(0, |layer| layer.outputs)
    }

    /// The layer that takes `[h, PE(d)]`.
    fn direction_layer(&self) -> Option<&Layer> {
        self.architecture.direction?;
        self.layers.iter().find(|layer| matches!(layer.role, Role::Colour(0) | Role::Rgb))
    }

    /// Multiply-adds per ray of [`Network::direction`].
    pub fn direction_macs(&self) -> usize {
        self.direction_layer().map_or(0, |layer| layer.extra * layer.outputs)
    }

    /// The direction's share of the colour branch, once per ray: `bias + W PE(d)`.
    ///
    /// `dirs`: `[3][stride]`, unit; `out`: `[direction_rows][stride]`.
    pub fn direction(&self, math: MathBackend, scratch: &mut Scratch<'_>, dirs: &[f32], out: &mut [f32]) {
        if let (Some(encoding), Some(layer)) = (&self.architecture.direction, self.direction_layer()) {
            encode_block(self.tier, math, encoding, scratch.stride, dirs, scratch.encoded);
            self.dense(layer, Part::Extra, scratch.stride, scratch.encoded, out, Start::Bias, false);
        }
    }

    /// Encodes a block of positions and runs the trunk; `h` is then in [`Scratch::front`].
    ///
    /// `positions`: `[inputs][stride]`, inside the scene box.
    ///
    /// # Panics
    /// If a slice is shorter than its rows times [`Scratch::stride`], or if the weights are prepared and
    /// the stride is no multiple of 16 ([`Network::whole_blocks`]). So do the three methods beside it.
    pub fn trunk(&self, math: MathBackend, scratch: &mut Scratch<'_>, positions: &[f32]) {
        let stride = scratch.stride;
        encode_block(self.tier, math, &self.architecture.position, stride, positions, scratch.encoded);
        for layer in &self.layers {
            let Role::Trunk(index) = layer.role else { break };
            let (from, to) = (&*scratch.front, &mut *scratch.back);
            let from = if index == 0 { &*scratch.encoded } else { from };
            if layer.extra == 0 {
                self.dense(layer, Part::Main, stride, from, to, Start::Bias, true);
            } else {
                self.dense(layer, Part::Main, stride, from, to, Start::Bias, false);
                self.dense(layer, Part::Extra, stride, scratch.encoded, to, Start::Output, true);
            }
            core::mem::swap(&mut scratch.front, &mut scratch.back);
        }
    }

    /// sigma of the block whose `h` is in [`Scratch::front`]; `sigma`: `[stride]`, 1/world unit.
    pub fn density(&self, math: MathBackend, scratch: &Scratch<'_>, sigma: &mut [f32]) {
        let layer = self.layers.iter().find(|layer| layer.role == Role::Density);
        if let (Some(layer), Some(activation)) = (layer, self.architecture.density) {
            let stride = scratch.stride;
            self.dense(layer, Part::Main, stride, scratch.front, sigma, Start::Bias, false);
            let values = &mut sigma[..stride];
            with_math!(math, M => self.tier.run_columns(stride, Density::<M> { activation, values, math: PhantomData }));
        }
    }

    /// Colours of the block whose `h` is in [`Scratch::front`], which is used up.
    ///
    /// `direction`: fills `[direction_rows][stride]` with what [`Network::direction`] gave for each
    /// sample's ray; not called without view dependence. `rgb`: `[3][stride]`.
    pub fn colour(
        &self,
        math: MathBackend,
        scratch: &mut Scratch<'_>,
        direction: impl FnOnce(&mut [f32]),
        rgb: &mut [f32],
    ) {
        let stride = scratch.stride;
        let mut direction = self.architecture.direction.map(|_| direction);
        for layer in &self.layers {
            let hidden = matches!(layer.role, Role::Colour(_));
            if !hidden && layer.role != Role::Rgb {
                continue;
            }
            let to = if hidden { &mut *scratch.back } else { &mut *rgb };
            let start = match direction.take() {
                Some(fill) => {
                    fill(&mut to[..layer.outputs * stride]);
                    Start::Output
                }
                None => Start::Bias,
            };
            self.dense(layer, Part::Main, stride, scratch.front, to, start, hidden);
            if hidden {
                core::mem::swap(&mut scratch.front, &mut scratch.back);
            }
        }
        let values = &mut rgb[..3 * stride];
        with_math!(math, M => self.tier.run_columns(stride, Sigmoid::<M> { values, math: PhantomData }));
    }

    /// `to = act(start + W_part from)`.
    #[allow(clippy::too_many_arguments, reason = "one product, called from this file only")]
    fn dense(
        &self,
        layer: &Layer,
        part: Part,
        stride: usize,
        from: &[f32],
        to: &mut [f32],
        start: Start,
        relu: bool,
    ) {
        let (offset, k) = match part {
            Part::Main => (layer.weights, layer.main),
            Part::Extra => (layer.weights + layer.main, layer.extra),
        };
        let (m, n, a_row) = (layer.outputs, stride, layer.inputs());
        let g = Gemm { m, n, k, a_row, a_col: 1, b_row: stride, c_row: stride };
        match self.weights {
            Weights::Prepared(parameters) => {
                let init = match start {
                    Start::Bias => Init::Bias(&parameters[layer.bias..]),
                    Start::Output => Init::Accumulate,
                };
                gemm(self.tier, g, &parameters[offset..], from, to, init, relu);
            }
            Weights::InPlace(bytes) => {
                let init = match start {
                    Start::Bias => HalfInit::Bias(&bytes[2 * layer.bias..]),
                    Start::Output => HalfInit::Accumulate,
                };
                gemm_f16(g, &bytes[2 * offset..], from, to, init, relu);
            }
        }
    }
}

/// Unpacks little-endian f16 parameters; `parameters` is as long as `bytes` has pairs, or shorter.
pub fn unpack(bytes: &[u8], parameters: &mut [f32]) {
    for (i, parameter) in parameters.iter_mut().enumerate() {
        *parameter = f16_at(bytes, i);
    }
}

struct Sigmoid<'a, M> {
    values: &'a mut [f32],
    math: PhantomData<M>,
}

impl<M: Math> Op for Sigmoid<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        for values in self.values.chunks_exact_mut(V::COUNT) {
            M::sigmoid(V::load(values)).store(values);
        }
    }
}

struct Density<'a, M> {
    activation: DensityActivation,
    values: &'a mut [f32],
    math: PhantomData<M>,
}

impl<M: Math> Op for Density<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        for values in self.values.chunks_exact_mut(V::COUNT) {
            let raw = V::load(values);
            let sigma = match self.activation {
                DensityActivation::Relu => V::splat(0.0).max_of(raw),
                DensityActivation::ShiftedSoftplus => M::softplus(raw.sub(V::splat(1.0))),
            };
            sigma.store(values);
        }
    }
}

//! Evaluation of a network over blocks of samples.
//!
//! This file is longer than 400 lines, since trunk, density head and colour branch share one block's memory.

use super::architecture::{
    Architecture, DensityActivation, EXPONENTIAL_LIMIT, Layer, Layers, PER_RAY_BUILT, Role, colour_macs,
    density_macs,
};
use super::weights::Weights;
use crate::encoding::{
    DirectionEncoding, GridTables, PositionEncoding, encode_block, encode_harmonics_block,
};
use crate::math::{Math, MathBackend, with_math};
use crate::matrix::{
    Gemm, Init, Kernel, PairedInput, PairedOutput, Storage, dense_bf16, gemm, gemm_f16, pair_rows, pairs,
    unpair,
};
use crate::memory::{at, head_mut, tail};
use crate::simd::{Isa, Lanes, MAX_LANES, Op, VECTORS};
use core::marker::PhantomData;

/// A network that can be evaluated: architecture, parameters, grid tables and instruction set.
#[derive(Clone, Debug)]
pub struct Network<'a> {
    pub(super) architecture: Architecture,
    pub(super) layers: Layers,
    weights: Weights<'a>,
    pub(super) tables: GridTables<'a>,
    pub(super) isa: Isa,
}

/// Memory for evaluating one block of samples; each slice is `[channel][stride]`.
#[derive(Debug)]
pub struct Scratch<'w> {
    /// Length of a row: number of samples in a block, including padding columns.
    pub stride: usize,
    /// Encoded positions or directions; [`Network::encoded_rows`] rows.
    pub encoded: &'w mut [f32],
    /// Outputs of the layer just evaluated, [`Network::activation_rows`] rows; swapped with `back` after each layer.
    pub front: &'w mut [f32],
    /// Memory for the outputs of the next layer, [`Network::activation_rows`] rows.
    pub back: &'w mut [f32],
}

impl<'a> Network<'a> {
    /// Makes a network without a grid from its architecture and parameters.
    ///
    /// `None` if the architecture exceeds a limit or has a grid (use [`Network::with_grid`]), if parameters are too
    /// few, or if a build without vector instructions ([`VECTORS`]) gets other weights than [`Weights::InPlace`].
    #[cfg(feature = "train")]
    pub fn new(architecture: &Architecture, weights: Weights<'a>, isa: Isa) -> Option<Self> {
        Self::with_grid(architecture, weights, GridTables::NONE, isa)
    }

    /// Makes a network from its architecture, its parameters and the tables of its grid. `tables`:
    /// [`GridTables::NONE`] if the position encoding is not a grid.
    ///
    /// `None` if the architecture exceeds a limit, if there are too few parameters or table values, or if a build
    /// without vector instructions ([`VECTORS`]) gets other weights than [`Weights::InPlace`].
    #[cfg(feature = "train")]
    pub fn with_grid(
        architecture: &Architecture,
        weights: Weights<'a>,
        tables: GridTables<'a>,
        isa: Isa,
    ) -> Option<Self> {
        architecture.check().ok()?;
        Self::of_layers(architecture, architecture.layers(), weights, tables, isa)
    }

    /// Makes a network from an architecture that is known to be valid. `None` if there are too few parameters or table
    /// values, or if a build without vector instructions ([`VECTORS`]) gets other weights than [`Weights::InPlace`].
    ///
    /// `layers`: all of [`Architecture::layers`], or only trunk and density head. Without the colour layers,
    /// [`Network::colour`] must not be called.
    pub(crate) fn of_layers(
        architecture: &Architecture,
        layers: Layers,
        weights: Weights<'a>,
        tables: GridTables<'a>,
        isa: Isa,
    ) -> Option<Self> {
        if architecture.position.grid().is_some_and(|grid| !grid.fits(&tables)) {
            return None;
        }
        let have = match weights {
            Weights::InPlace(bytes) => bytes.len() / 2,
            _ if !VECTORS => return None,
            Weights::Prepared(parameters) | Weights::Transposed(parameters) | Weights::Paired(parameters) => {
                parameters.len()
            }
        };
        let needed = layers.last().map_or(0, |layer| layer.bias + layer.outputs);
        (have >= needed).then(|| Self { architecture: architecture.clone(), layers, weights, tables, isa })
    }

    /// The network's shape: encodings, layers, activations.
    pub fn architecture(&self) -> &Architecture {
        &self.architecture
    }

    /// The instruction set and the storage of weights that the network is evaluated with.
    pub fn kernel(&self) -> Kernel {
        let storage = match self.weights() {
            Weights::InPlace(_) => Storage::F16,
            Weights::Prepared(_) | Weights::Transposed(_) => Storage::F32,
            Weights::Paired(_) => Storage::Bf16,
        };
        Kernel::new(self.isa, storage)
    }

    pub(crate) fn isa(&self) -> Isa {
        self.isa
    }

    /// The network's parameters. In a build without vector instructions ([`VECTORS`]) the result is always
    /// [`Weights::InPlace`], so that the compiler removes the code for other formats.
    #[inline(always)]
    pub(super) fn weights(&self) -> Weights<'a> {
        match self.weights {
            weights if VECTORS => weights,
            Weights::InPlace(bytes) => Weights::InPlace(bytes),
            _ => Weights::InPlace(&[]),
        }
    }

    /// Whether [`Scratch::stride`] must be a multiple of `padded(1)` ([`Network::padded`]). Any stride is valid in builds
    /// without vector instructions, and for portable instructions with [`Weights::InPlace`].
    pub fn whole_blocks(&self) -> bool {
        VECTORS && (self.isa != Isa::Portable || !matches!(self.weights, Weights::InPlace(_)))
    }

    /// Returns the [`Scratch::stride`] with which a block of `n` samples takes the least time: `n` if any stride is
    /// valid, else a multiple of 8 or 16 that is at least `n`.
    pub fn padded(&self, n: usize) -> usize {
        match self.weights() {
            _ if !self.whole_blocks() => n,
            Weights::Paired(_) => n.next_multiple_of(MAX_LANES),
            _ => self.isa.padded(n),
        }
    }

    /// Number of rows of [`Scratch::encoded`]: outputs of the position or the direction encoding, whichever has more.
    pub fn encoded_rows(&self) -> usize {
        let direction = self.architecture.direction.map_or(0, |direction| direction.outputs());
        self.architecture.position.outputs().max(direction)
    }

    /// Number of rows of [`Scratch::front`] and [`Scratch::back`]: outputs of the widest layer, or
    /// [`Network::trunk_rows`] if larger.
    pub fn activation_rows(&self) -> usize {
        self.layers.iter().map(|layer| layer.outputs).max().unwrap_or(0).max(self.trunk_rows())
    }

    /// Number of rows of the trunk's output `h`, which [`Network::trunk`] leaves in [`Scratch::front`]: the outputs
    /// of the last trunk layer, or the encoded position if the trunk is empty.
    pub fn trunk_rows(&self) -> usize {
        self.architecture.h_rows()
    }

    /// Number of outputs of the layer that takes the encoded direction; 0 without view dependence.
    pub fn direction_rows(&self) -> usize {
        self.direction_layer().map_or(0, |layer| layer.outputs)
    }

    /// The layer whose inputs are trunk output and encoded direction, `[h, PE(d)]`; `None` without view dependence.
    fn direction_layer(&self) -> Option<&Layer> {
        self.architecture.direction?;
        self.layers.iter().find(|layer| matches!(layer.role, Role::Colour(0) | Role::Rgb))
    }

    /// Multiply-adds of one density evaluation ([`Architecture::density_macs`]).
    pub(crate) fn density_macs(&self) -> usize {
        density_macs(&self.layers)
    }

    /// Multiply-adds of one colour evaluation, without those of [`Network::direction`].
    pub(crate) fn colour_macs_without_direction(&self) -> usize {
        colour_macs(&self.layers) - self.direction_macs()
    }

    /// Multiply-adds of one gradient of the density ([`Architecture::gradient_macs`]).
    #[cfg(feature = "normals")]
    pub(crate) fn gradient_macs(&self) -> usize {
        super::architecture::gradient_macs(&self.layers)
    }

    /// Multiply-adds of [`Network::direction`] for one ray; 0 without view dependence.
    pub fn direction_macs(&self) -> usize {
        self.direction_layer().map_or(0, |layer| layer.extra * layer.outputs)
    }

    /// Evaluates, for a block of ray directions, the part of the colour branch that depends on the direction alone.
    /// Writes `b + W_d PE(d)` to `out`: `b` is the bias of the layer that takes `[h, PE(d)]`, and `W_d` are the columns
    /// of the layer's weights that multiply `PE(d)`.
    ///
    /// `encoded`: [`Scratch::encoded`], which is overwritten; `dirs`: `[3][stride]`, unit length; `out`:
    /// `[direction_rows][stride]`.
    pub fn direction(
        &self,
        math: MathBackend,
        stride: usize,
        encoded: &mut [f32],
        dirs: &[f32],
        out: &mut [f32],
    ) {
        if let (Some(encoding), Some(layer)) = (&self.architecture.direction, self.direction_layer()) {
            self.encode_direction(math, encoding, stride, dirs, encoded);
            self.dense(layer, [None, Some(&*encoded)], stride, out, false, false);
        }
    }

    /// Encodes a block of positions and evaluates the trunk; leaves the trunk's output `h` in [`Scratch::front`].
    ///
    /// `positions`: `[inputs][stride]`, inside the scene box.
    ///
    /// # Panics
    /// If a slice is shorter than its rows times [`Scratch::stride`], or if [`Network::whole_blocks`] is true and the
    /// stride is no multiple of `padded(1)`. With [`Weights::InPlace`], a slice that is too short causes a
    /// panic only with debug assertions. `direction`, `density` and `colour` panic under the same conditions.
    pub fn trunk(&self, math: MathBackend, scratch: &mut Scratch<'_>, positions: &[f32]) {
        self.trunk_with(math, scratch, positions, |_, _| {});
    }

    /// Encodes a block of positions and evaluates the trunk; leaves the trunk's output `h` in [`Scratch::front`].
    ///
    /// `each`: function that is called after every trunk layer, with the layer and the outputs of the layer's ReLU.
    #[inline]
    pub(super) fn trunk_with(
        &self,
        math: MathBackend,
        scratch: &mut Scratch<'_>,
        positions: &[f32],
        mut each: impl FnMut(&Layer, &[f32]),
    ) {
        let encoded = self.architecture.position.outputs();
        if PER_RAY_BUILT && self.architecture.trunk.is_empty() {
            self.encode_position(math, scratch.stride, positions, scratch.front);
            return self.take_rows(encoded, scratch.stride, scratch.front);
        }
        self.encode_position(math, scratch.stride, positions, scratch.encoded);
        self.take_rows(encoded, scratch.stride, scratch.encoded);
        for layer in &self.layers {
            let Role::Trunk(index) = layer.role else { break };
            let (from, to) = (&*scratch.front, &mut *scratch.back);
            let from = if index == 0 { &*scratch.encoded } else { from };
            let extra = (layer.extra > 0).then_some(&*scratch.encoded);
            self.dense(layer, [Some(from), extra], scratch.stride, to, false, true);
            each(layer, to);
            core::mem::swap(&mut scratch.front, &mut scratch.back);
        }
    }

    /// Computes the densities of the block whose trunk output `h` is in [`Scratch::front`]. `sigma`: `[stride]`, set to
    /// the densities, 1/world unit. Does nothing in a 2D field, which has no density.
    pub fn density(&self, math: MathBackend, scratch: &Scratch<'_>, sigma: &mut [f32]) {
        let layer = self.layers.iter().find(|layer| layer.role == Role::Density);
        if let (Some(layer), Some(activation)) = (layer, self.architecture.density) {
            let stride = scratch.stride;
            self.dense(layer, [Some(&*scratch.front), None], stride, sigma, false, false);
            let values = head_mut(sigma, stride);
            with_math!(math, M => self.isa.run_columns(stride, Density::<M> { activation, values, math: PhantomData }));
        }
    }

    /// Adds `weight` times the trunk's output `h` of sample `column` to `sums`, which has one sum per row of `h`. Reads
    /// `h` from [`Scratch::front`].
    #[inline]
    pub(crate) fn add_h(&self, scratch: &Scratch<'_>, column: usize, weight: f32, sums: &mut [f32]) {
        let rows = scratch.front.chunks_exact(scratch.stride.max(1));
        if let Weights::Paired(_) = self.weights() {
            for (sums, row) in sums.chunks_mut(2).zip(rows) {
                for (sum, h) in sums.iter_mut().zip(unpair(at(row, column))) {
                    *sum += weight * h;
                }
            }
            return;
        }
        for (sum, row) in sums.iter_mut().zip(rows) {
            *sum += weight * at(row, column);
        }
    }

    /// Converts the trunk's output `h` in [`Scratch::front`], in place, to the input format of the colour branch
    /// ([`Network::take_rows`]). The caller must have written `h` as f32.
    pub(crate) fn take_h(&self, scratch: &mut Scratch<'_>) {
        self.take_rows(self.trunk_rows(), scratch.stride, scratch.front);
    }

    /// Computes the colours of the block whose trunk output `h` is in [`Scratch::front`], and overwrites `h`.
    ///
    /// `direction(encoded, out)`: a function that fills `out`, `[direction_rows][stride]`, with the result of
    /// [`Network::direction`] for each sample's ray. `encoded` is [`Scratch::encoded`], which the function may
    /// overwrite. The function is called only if colour depends on direction. `rgb`: `[3][stride]`, set to the colours.
    pub fn colour(
        &self,
        math: MathBackend,
        scratch: &mut Scratch<'_>,
        direction: impl FnOnce(&mut [f32], &mut [f32]),
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
            let direction = direction.take();
            let accumulate = direction.is_some();
            if let Some(fill) = direction {
                fill(scratch.encoded, head_mut(to, layer.outputs * stride));
            }
            self.dense(layer, [Some(&*scratch.front), None], stride, to, accumulate, hidden);
            if hidden {
                core::mem::swap(&mut scratch.front, &mut scratch.back);
            }
        }
        self.activate_rgb(math, stride, rgb);
    }

    fn activate_rgb(&self, math: MathBackend, stride: usize, rgb: &mut [f32]) {
        let values = head_mut(rgb, 3 * stride);
        with_math!(math, M => self.isa.run_columns(stride, Sigmoid::<M> { values, math: PhantomData }));
    }

    /// Computes the colour of a block's first sample from the trunk's output `h` in [`Scratch::front`]; overwrites `h`.
    /// The result is bit-identical to [`Network::colour`]. Each SIMD vector holds several outputs of a layer for the
    /// one sample, instead of one output for several samples.
    ///
    /// Requires [`Weights::Transposed`] and a colour branch with hidden layers, each of a width that is a multiple of
    /// [`Isa::columns`]. Otherwise does nothing and returns `false`.
    ///
    /// `dirs`, `rgb`: `[3][stride]`. The first column of `rgb` is the result; the other columns are unspecified.
    pub(crate) fn colour_of_one(
        &self,
        math: MathBackend,
        scratch: &mut Scratch<'_>,
        dirs: &[f32],
        rgb: &mut [f32],
    ) -> bool {
        let Weights::Transposed(parameters) = self.weights() else { return false };
        let (isa, stride) = (self.isa, scratch.stride);
        let hidden = || self.layers.iter().filter(|layer| matches!(layer.role, Role::Colour(_)));
        let Some(to_rgb) = self.layers.iter().find(|layer| layer.role == Role::Rgb) else { return false };
        // The direction needs a hidden layer, and hidden layers must fill whole vectors.
        if hidden().count() == 0 || hidden().any(|layer| !isa.fills(layer.outputs)) {
            return false;
        }
        if let Some(encoding) = &self.architecture.direction {
            self.encode_direction(math, encoding, stride, dirs, scratch.encoded);
        }
        // Stride between successive inputs of a layer, values.
        let mut apart = stride;
        for layer in hidden() {
            let (m, to) = (layer.outputs, head_mut(scratch.back, layer.outputs));
            to.copy_from_slice(&parameters[layer.bias..][..m]);
            // Direction first, then the previous layer's outputs: the order in which `colour` sums.
            let of_direction = (layer.main, layer.extra, &*scratch.encoded, stride);
            for (first, k, from, a_col) in [of_direction, (0, layer.main, &*scratch.front, apart)] {
                let g = Gemm { m: 1, n: m, k, a_row: 0, a_col, b_row: m, c_row: m };
                let weights = &parameters[layer.weights + first * m..];
                gemm(isa, g, from, weights, to, Init::Accumulate, first == 0);
            }
            core::mem::swap(&mut scratch.front, &mut scratch.back);
            apart = 1;
        }
        // Lane 0 of the product is the colour. The other lanes are not used: lane j sums the inputs from the j-th on.
        let (k, n) = (to_rgb.main, isa.columns());
        let g = Gemm { m: 3, n, k, a_row: k, a_col: 1, b_row: 1, c_row: stride };
        let bias = Init::Bias(&parameters[to_rgb.bias..]);
        gemm(isa, g, &parameters[to_rgb.weights..], scratch.front, rgb, bias, false);
        self.activate_rgb(math, stride, rgb);
        true
    }

    /// Encodes a block of positions, `[inputs][stride]`, and writes f32 values to `out`, `[outputs][stride]`.
    pub(super) fn encode_position(
        &self,
        math: MathBackend,
        stride: usize,
        positions: &[f32],
        out: &mut [f32],
    ) {
        match &self.architecture.position {
            PositionEncoding::Sinusoidal(encoding) => {
                encode_block(self.isa, math, encoding, stride, positions, out);
            }
            PositionEncoding::Grid(grid) => grid.encode(&self.tables, self.isa, stride, positions, out),
        }
    }

    /// Encodes a block of directions `dirs`, `[3][stride]`. Writes f32 to `out`, `[outputs][stride]`, or pairs of bf16
    /// if weights are [`Weights::Paired`] ([`Network::take_rows`]).
    fn encode_direction(
        &self,
        math: MathBackend,
        encoding: &DirectionEncoding,
        stride: usize,
        dirs: &[f32],
        out: &mut [f32],
    ) {
        match encoding {
            DirectionEncoding::Sinusoidal(encoding) => {
                encode_block(self.isa, math, encoding, stride, dirs, out);
            }
            DirectionEncoding::SphericalHarmonics { degree } => {
                encode_harmonics_block(self.isa, *degree, stride, dirs, out);
            }
        }
        self.take_rows(encoding.outputs(), stride, out);
    }

    /// Converts `rows` rows of f32 to the input format of the matrix products, in place. If weights are
    /// [`Weights::Paired`], packs rows `2q` and `2q + 1` as pairs of bf16 into row `q`; otherwise does nothing.
    fn take_rows(&self, rows: usize, stride: usize, values: &mut [f32]) {
        if let Weights::Paired(_) = self.weights() {
            pair_rows(values, rows, stride);
        }
    }

    /// Evaluates a layer: `to = act(init + W [main, extra])`. `init` is the content of `to` if `accumulate`, else the
    /// bias. `act` is ReLU if `hidden`, else the identity. If `hidden`, outputs are written in the input format of the
    /// next layer.
    ///
    /// `inputs`: the main inputs and the appended inputs (`extra`), each `[rows][stride]`, or `[pairs][stride]` with
    /// [`Weights::Paired`]. A `None` adds nothing to the sum.
    fn dense(
        &self,
        layer: &Layer,
        inputs: [Option<&[f32]>; 2],
        stride: usize,
        to: &mut [f32],
        accumulate: bool,
        hidden: bool,
    ) {
        let (m, n) = (layer.outputs, stride);
        let transposed =
            matches!(self.weights(), Weights::Transposed(_)) && matches!(layer.role, Role::Colour(_));
        let (a_row, a_col) = if transposed { (1, m) } else { (layer.inputs(), 1) };
        let mut accumulate = accumulate;
        let last_part = if inputs[1].is_some() { 1 } else { 0 };
        let parts = [(0, layer.main), (layer.main, layer.extra)].into_iter().zip(inputs);
        for (i, ((offset, k), from)) in parts.enumerate() {
            let Some(from) = from else { continue };
            let g = Gemm { m, n, k, a_row, a_col, b_row: stride, c_row: stride };
            let (offset, last) = (layer.weights + offset * a_col, i == last_part);
            match self.weights() {
                Weights::Prepared(parameters) | Weights::Transposed(parameters) => {
                    let init = Init::bias_unless(accumulate, &parameters[layer.bias..]);
                    gemm(self.isa, g, &parameters[offset..], from, to, init, hidden && last);
                }
                Weights::InPlace(bytes) => {
                    let init = Init::bias_unless(accumulate, tail(bytes, 2 * layer.bias));
                    gemm_f16(self.isa, g, tail(bytes, 2 * offset), from, to, init, hidden && last);
                }
                // Main and extra inputs go into one product, so that no intermediate sum is rounded.
                Weights::Paired(words) => {
                    return self.dense_paired(words, layer, inputs, stride, to, accumulate, hidden);
                }
            }
            accumulate = true;
        }
    }

    /// Evaluates a layer as [`Network::dense`] does. Inputs and weights are pairs of bf16; `words`: the parameters of
    /// the network ([`Weights::Paired`]).
    #[allow(clippy::too_many_arguments, reason = "as the method it is half of")]
    fn dense_paired(
        &self,
        words: &[f32],
        layer: &Layer,
        inputs: [Option<&[f32]>; 2],
        stride: usize,
        to: &mut [f32],
        accumulate: bool,
        hidden: bool,
    ) {
        let (main, extra) = (pairs(layer.main), pairs(layer.extra));
        let part = |offset: usize, pairs: usize, inputs: Option<_>| PairedInput {
            weights: &words[layer.weights + offset..],
            row: main + extra,
            pairs: if inputs.is_some() { pairs } else { 0 },
            inputs: inputs.unwrap_or_default(),
        };
        let parts = [part(0, main, inputs[0]), part(main, extra, inputs[1])];
        let output = if hidden { PairedOutput::Pairs } else { PairedOutput::Floats };
        let init = Init::bias_unless(accumulate, &words[layer.bias..]);
        dense_bf16(self.isa, parts, layer.outputs, stride, init, to, hidden, output);
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
                // The maximum of 0 and −0 may be −0; adding 0 makes it 0.
                DensityActivation::Relu => V::splat(0.0).max_of(raw).add(V::splat(0.0)),
                DensityActivation::ShiftedSoftplus => M::softplus(raw.sub(V::splat(1.0))),
                // A NaN in `raw` stays a NaN.
                DensityActivation::Exponential => M::exp(V::splat(EXPONENTIAL_LIMIT).min_of(raw)),
            };
            sigma.store(values);
        }
    }
}

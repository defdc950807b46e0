//! The dense layers of a grid field: `Y = act(X Wᵀ)`. Inputs `X` and outputs `Y` are `[samples][channels]`.
//!
//! Only the density head has a bias, which is not trained. The colour branch needs none, as the spherical harmonics
//! include a constant. A hidden layer on learned features needs no bias either (as in tiny-cuda-nn).

use crate::model::engine::graph::padded;
use crate::model::engine::{Dense, Model, Part};
use nerf_core::matrix::{Gemm, Init, gemm};
use nerf_core::simd::Isa;

/// Weights of a layer for either its main or its extra inputs, laid out for products with rows of samples.
#[derive(Clone, Debug, Default)]
pub(super) struct Product {
    pub inputs: usize,
    pub outputs: usize,
    /// Weights of the forward pass, `[inputs][padded outputs]`.
    forward: Vec<f32>,
    /// Weights of the backward pass, `[outputs][padded inputs]`.
    backward: Vec<f32>,
}

impl Product {
    fn new(inputs: usize, outputs: usize) -> Self {
        let (forward, backward) = (inputs * padded(outputs), outputs * padded(inputs));
        Self { inputs, outputs, forward: vec![0.0; forward], backward: vec![0.0; backward] }
    }

    /// Copies columns `first..first + inputs` of `weights`, `[outputs][row]`. `row`: number of main plus extra inputs.
    fn load(&mut self, weights: &[f32], row: usize, first: usize) {
        let (across, back) = (padded(self.outputs), padded(self.inputs));
        for (output, weights) in weights.chunks_exact(row).take(self.outputs).enumerate() {
            for (input, &weight) in weights[first..first + self.inputs].iter().enumerate() {
                self.forward[input * across + output] = weight;
                self.backward[output * back + input] = weight;
            }
        }
    }

    /// Computes `y = act(init + x Wᵀ)`, `[rows][padded outputs]`. `act`: ReLU if `relu`, else the identity; `init`: 0
    /// or the old `y`; `x`: `[rows][x_row]`.
    #[allow(clippy::too_many_arguments, reason = "a product's")]
    pub fn forward(
        &self,
        isa: Isa,
        rows: usize,
        x: &[f32],
        x_row: usize,
        y: &mut [f32],
        init: Init<'_>,
        relu: bool,
    ) {
        let n = padded(self.outputs);
        let g = Gemm { m: rows, n, k: self.inputs, a_row: x_row, a_col: 1, b_row: n, c_row: n };
        gemm(isa, g, x, &self.forward, y, init, relu);
    }

    /// Computes the inputs' gradient `dx = init + dy W`, `[rows][padded inputs]`. `dy`: the outputs' gradient,
    /// `[rows][padded outputs]`; `init`: 0 or the old `dx`.
    pub fn backward(&self, isa: Isa, rows: usize, dy: &[f32], dx: &mut [f32], init: Init<'_>) {
        let n = padded(self.inputs);
        let g =
            Gemm { m: rows, n, k: self.outputs, a_row: padded(self.outputs), a_col: 1, b_row: n, c_row: n };
        gemm(isa, g, dy, &self.backward, dx, init, false);
    }

    /// Adds the weights' gradient, `xᵀ dy`, to `sum`, `[inputs][padded outputs]`. `x`: `[rows][x_row]`.
    pub fn add_gradient(&self, isa: Isa, rows: usize, x: &[f32], x_row: usize, dy: &[f32], sum: &mut [f32]) {
        let n = padded(self.outputs);
        let g = Gemm { m: self.inputs, n, k: rows, a_row: 1, a_col: x_row, b_row: n, c_row: n };
        gemm(isa, g, x, dy, sum, Init::Accumulate, false);
    }

    fn sum_len(&self) -> usize {
        self.inputs * padded(self.outputs)
    }
}

#[derive(Clone, Debug)]
pub(super) struct Layer {
    dense: Dense,
    /// Weights of the main inputs, which are an earlier layer's outputs or the encoded position.
    pub main: Product,
    /// Weights of the extra inputs, which are the encoded direction; `None` in a layer without extra inputs.
    pub extra: Option<Product>,
}

#[derive(Clone, Debug)]
pub(super) struct Layers {
    pub trunk: Vec<Layer>,
    /// Density head; `None` in a 2D field.
    pub density: Option<Layer>,
    pub colour: Vec<Layer>,
    pub bias: f32,
    parameters: usize,
}

impl Layers {
    pub fn new(model: &Model) -> Self {
        let (mut trunk, mut density, mut colour) = (Vec::new(), None, Vec::new());
        let mut parameters = 0;
        for dense in model.layers() {
            parameters = dense.weights + dense.parameters();
            let extra = (dense.extra > 0).then(|| Product::new(dense.extra, dense.outputs));
            let layer = Layer { dense, main: Product::new(dense.main, dense.outputs), extra };
            match dense.part {
                Part::Trunk(_) => trunk.push(layer),
                Part::Density => density = Some(layer),
                Part::Feature | Part::Colour(_) | Part::Rgb => colour.push(layer),
            }
        }
        Self { trunk, density, colour, bias: 0.0, parameters }
    }

    pub fn first_of_colour(&self) -> usize {
        self.trunk.len() + usize::from(self.density.is_some())
    }

    /// Returns the number of features that the density head and the colour branch read.
    pub fn features(&self) -> usize {
        self.colour[0].main.inputs
    }

    /// Returns the number of parameters of all layers, without the tables' values.
    pub fn parameters(&self) -> usize {
        self.parameters
    }

    pub fn load(&mut self, parameters: &[f32]) {
        self.bias = self.density.as_ref().map_or(0.0, |density| parameters[density.dense.bias]);
        let all = self.trunk.iter_mut().chain(&mut self.density).chain(&mut self.colour);
        for Layer { dense, main, extra } in all {
            let weights = &parameters[dense.weights..dense.bias];
            main.load(weights, dense.inputs(), 0);
            if let Some(extra) = extra {
                extra.load(weights, dense.inputs(), dense.main);
            }
        }
    }

    fn all(&self) -> impl Iterator<Item = &Layer> {
        self.trunk.iter().chain(&self.density).chain(&self.colour)
    }
}

/// Sums of gradients with respect to the layers' weights; for each layer `[inputs][padded outputs]`.
#[derive(Clone, Debug, Default)]
pub(super) struct LayerSums {
    /// Sums for the weights of main inputs, layer after layer: trunk, density, colour.
    pub main: Vec<Vec<f32>>,
    pub extra: Vec<Vec<f32>>,
}

impl LayerSums {
    pub fn new(layers: &Layers) -> Self {
        let zeros = |product: Option<&Product>| vec![0.0; product.map_or(0, Product::sum_len)];
        Self {
            main: layers.all().map(|layer| zeros(Some(&layer.main))).collect(),
            extra: layers.all().map(|layer| zeros(layer.extra.as_ref())).collect(),
        }
    }

    pub fn clear(&mut self) {
        self.main.iter_mut().chain(&mut self.extra).for_each(|sum| sum.fill(0.0));
    }

    /// Writes the total of all `sums`, added in order, to `gradient`, which is in the parameters' order; biases get 0.
    pub fn reduce<'s>(layers: &Layers, sums: impl Iterator<Item = &'s Self> + Clone, gradient: &mut [f32]) {
        gradient.fill(0.0);
        for (l, Layer { dense, main, extra }) in layers.all().enumerate() {
            let parts = [(Some(main), 0, 0), (extra.as_ref(), dense.main, 1)];
            for (product, first, part) in parts {
                let Some(product) = product else { continue };
                let mut total = vec![0.0; product.sum_len()];
                for sum in sums.clone() {
                    let sum = if part == 0 { &sum.main[l] } else { &sum.extra[l] };
                    total.iter_mut().zip(sum).for_each(|(total, value)| *total += value);
                }
                for (input, row) in total.chunks_exact(padded(product.outputs)).enumerate() {
                    for (output, &value) in row[..product.outputs].iter().enumerate() {
                        gradient[dense.weights + output * dense.inputs() + first + input] = value;
                    }
                }
            }
        }
    }
}

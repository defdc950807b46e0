//! Parameters as dfdx tensors, one per layer, and Adam with moments that can be saved.
//!
//! dfdx's own `Adam` keeps step and moments private. This module therefore calls Adam's kernel, which is public as
//! `AdamConfig::try_update`, with a step count that starts at 1.

use super::{Adam, Dense, EngineError, GRADIENT_LIMIT, OptimiserState};
use dfdx::tensor::{Cpu, CpuError, Gradients, Storage, Tensor, TensorFromVec};
use dfdx::tensor_ops::{AdamConfig, WeightDecay};
use rayon::prelude::*;

type Values = <Cpu as Storage<f32>>::Vec;

impl From<CpuError> for EngineError {
    fn from(_: CpuError) -> Self {
        // The only other cause of a `CpuError`, a vector of the wrong length, is excluded before dfdx is called.
        Self::OutOfMemory
    }
}

/// Parameters of one layer (`W`, then `b`), with their gradient and their moments.
pub(super) struct Parameter {
    first: usize,
    length: usize,
    value: Tensor<(usize,), f32, Cpu>,
    gradients: Gradients<f32, Cpu>,
    moment1: Values,
    moment2: Values,
}

impl Parameter {
    fn new(device: &Cpu, layer: &Dense, parameters: &[f32]) -> Result<Self, EngineError> {
        let (first, length) = (layer.weights, layer.parameters());
        let value = device.try_tensor_from_vec(parameters[first..][..length].to_vec(), (length,))?;
        let mut gradients = Gradients::leaky();
        gradients.try_alloc_for(&value)?;
        let moment = || Storage::<f32>::try_alloc_len(device, length);
        Ok(Self { first, length, value, gradients, moment1: moment()?, moment2: moment()? })
    }

    /// Returns the gradient with respect to the layer's parameters, for the engine to write.
    pub(super) fn gradient_mut(&mut self) -> Result<&mut [f32], EngineError> {
        Ok(self.gradients.get_or_alloc_mut(&self.value)?.as_mut_slice())
    }

    fn update(&mut self, config: &AdamConfig, step: i32) -> Result<(), EngineError> {
        let gradient = self.gradients.get_or_alloc_mut(&self.value)?;
        Ok(config.try_update(step, &mut self.value, &mut self.moment1, &mut self.moment2, gradient)?)
    }
}

pub(super) struct Optimiser {
    adam: Adam,
    parameters: Vec<Parameter>,
    total: usize,
    steps: i32,
}

impl Optimiser {
    pub(super) fn new(layers: &[Dense], adam: Adam, parameters: &[f32]) -> Result<Self, EngineError> {
        let total = layers.iter().map(Dense::parameters).sum();
        check_values("parameters", parameters, total, |_| true)?;
        let device = Cpu::default();
        let parameters = layers.iter().map(|layer| Parameter::new(&device, layer, parameters));
        Ok(Self { adam, parameters: parameters.collect::<Result<_, _>>()?, total, steps: 0 })
    }

    pub(super) fn next_step(&self) -> u64 {
        self.steps as u64 + 1
    }

    /// Returns the parameters, one entry per layer, in the model's order.
    pub(super) fn parameters_mut(&mut self) -> &mut [Parameter] {
        &mut self.parameters
    }

    /// Does one Adam step at learning rate `rate`, with the gradients stored in the parameters.
    pub(super) fn apply(&mut self, rate: f64) -> Result<(), EngineError> {
        let step = self.steps.checked_add(1).ok_or(EngineError::Steps { found: self.next_step() })?;
        let decay = self.adam.weight_decay;
        let config = AdamConfig {
            lr: rate,
            betas: self.adam.betas,
            eps: self.adam.epsilon,
            weight_decay: (decay != 0.0).then_some(WeightDecay::Decoupled(decay)),
        };
        self.parameters.par_iter_mut().with_max_len(1).try_for_each(|p| p.update(&config, step))?;
        self.steps = step;
        Ok(())
    }

    pub(super) fn copy_into(&self, values: &mut [f32]) {
        for p in &self.parameters {
            p.value.copy_into(&mut values[p.first..][..p.length]);
        }
    }

    pub(super) fn values(&self) -> Vec<f32> {
        let mut values = vec![0.0; self.total];
        self.copy_into(&mut values);
        values
    }

    pub(super) fn state(&self) -> OptimiserState {
        let gather = |of: fn(&Parameter) -> &[f32]| self.parameters.iter().flat_map(of).copied().collect();
        OptimiserState {
            parameters: self.values(),
            moment1: gather(|p| &p.moment1),
            moment2: gather(|p| &p.moment2),
            steps: self.steps as u64,
            ..OptimiserState::default()
        }
    }

    pub(super) fn restore(&mut self, state: &OptimiserState) -> Result<(), EngineError> {
        let steps = i32::try_from(state.steps).map_err(|_| EngineError::Steps { found: state.steps })?;
        check_values("parameters", &state.parameters, self.total, |_| true)?;
        check_values("moment1", &state.moment1, self.total, |_| true)?;
        check_values("moment2", &state.moment2, self.total, |v| v >= 0.0)?;
        for p in &mut self.parameters {
            let range = p.first..p.first + p.length;
            p.value.copy_from(&state.parameters[range.clone()]);
            p.moment1.copy_from_slice(&state.moment1[range.clone()]);
            p.moment2.copy_from_slice(&state.moment2[range]);
        }
        self.steps = steps;
        Ok(())
    }
}

pub(super) fn usable(gradient: &[f32]) -> bool {
    // No early exit, so that the loop vectorises; NaN compares false.
    gradient.iter().fold(true, |ok, g| ok & (g.abs() < GRADIENT_LIMIT))
}

pub(super) fn check_values(
    field: &'static str,
    values: &[f32],
    expected: usize,
    allowed: fn(f32) -> bool,
) -> Result<(), EngineError> {
    if values.len() != expected {
        return Err(EngineError::Parameters { field, expected, found: values.len() });
    }
    match values.iter().position(|&v| !(v.is_finite() && allowed(v))) {
        Some(index) => Err(EngineError::NonFinite { field, index }),
        None => Ok(()),
    }
}

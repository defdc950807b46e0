//! Several fields in one world: the host places each field, and rays are composited through all fields at once.

mod deferred;
mod merge;
#[cfg(test)]
mod tests;

pub(super) use merge::Merge;

use super::field::Field;
use super::{InstanceProblem, RenderError, Renderer};
use crate::plan::Plan;
use crate::space::Placement;

/// A field placed in the caller's world.
#[derive(Clone, Copy, Debug)]
pub struct Instance<'a> {
    /// Renderer made from the field's blob.
    pub renderer: &'a Renderer<'a>,
    /// The field's plan, with distances in the field's units. The plans of all instances must have the same outputs,
    /// effects and batch. The last instance's plan sets the background and the transmittance below which a ray ends.
    /// Each field's own plan sets its colour cut ([`Quality::colour_cut`](crate::plan::Quality::colour_cut)).
    pub plan: &'a Plan<'a>,
    /// Rotation, uniform scale and translation of the field in the world.
    pub placement: Placement,
}

impl<'a> Instance<'a> {
    pub(super) fn field(&self) -> Field<'a> {
        Field { network: self.renderer.network(), plan: self.plan }
    }
}

/// Checks that the instances can be rendered together; for example, outputs, effects and batch size must be equal.
/// Returns the last instance. The error names the first instance that does not fit, or says that the list is empty.
pub(super) fn check<'i, 'f>(instances: &'i [Instance<'f>]) -> Result<&'i Instance<'f>, RenderError> {
    let last = instances.last().ok_or(RenderError::NoInstances)?;
    for (index, Instance { renderer, plan, .. }) in instances.iter().enumerate() {
        let request = |plan: &Plan<'_>| (plan.outputs, plan.effects, plan.batch);
        let problem = if plan.scene != renderer.blob().identity() {
            InstanceProblem::OtherScene
        } else if request(plan) != request(last.plan) {
            InstanceProblem::OtherRequest
        } else if plan.proposal.is_some() {
            InstanceProblem::Proposal
        } else if plan.contraction.is_some() && index + 1 < instances.len() {
            InstanceProblem::Unbounded
        } else {
            continue;
        };
        return Err(RenderError::Instance { index, problem });
    }
    Ok(last)
}

//! Several fields in one world: each stands where a host has placed it, and a ray goes through all of them at once.

mod deferred;
mod merge;
#[cfg(test)]
mod tests;

pub(super) use merge::Merge;

use super::field::Field;
use super::{InstanceProblem, RenderError, Renderer};
use crate::plan::Plan;
use crate::space::Placement;

/// A field that stands somewhere in a host's world.
#[derive(Clone, Copy, Debug)]
pub struct Instance<'a> {
    /// The field.
    pub renderer: &'a Renderer<'a>,
    /// How it is rendered; a range of the plan's is in the field's own units. Outputs, effects and batch are those of all
    /// instances, cuts, maths and background those of the last.
    pub plan: &'a Plan<'a>,
    /// Where it stands.
    pub placement: Placement,
}

impl<'a> Instance<'a> {
    pub(super) fn field(&self) -> Field<'a> {
        Field { network: self.renderer.network(), plan: self.plan }
    }
}

/// The first of what is wrong with them.
pub(super) fn check(instances: &[Instance<'_>]) -> Result<(), RenderError> {
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
    Ok(())
}

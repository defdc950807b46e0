//! Report of a frame: the stages that run, why other stages are off, and each stage's work if counters are given.

use super::Counters;
use super::field::Field;
use crate::blob::Blob;
use crate::camera::Lens;
use crate::names::names;
use crate::network::{Network, Shading};
use crate::plan::{Lattice, Plan, Tone, ToneMap};
use core::fmt;

#[cfg(test)]
mod tests;

names! {
    /// State of a stage in a frame: on, or the reason why the stage is off.
    pub enum Switch {
        /// The stage runs.
        On = "on",
        /// The blob lacks what the stage needs, for example an occupancy grid or a proposal network.
        AbsentInScene = "off: absent in the scene",
        /// No requested effect or output needs the stage.
        NotAskedFor = "off: not asked for",
        /// The build has no code for the stage, since the stage's cargo feature is off.
        NotBuilt = "off: not built in",
        /// The frame's quality settings ([`Quality`](crate::plan::Quality)) switch the stage off.
        SwitchedOff = "off: switched off by the request",
    }
}

impl Switch {
    fn asked(asked: bool) -> Self {
        if asked { Self::On } else { Self::NotAskedFor }
    }

    /// Returns the state of a stage. `built`: whether this build has code for the stage. `asked`: whether a requested
    /// effect or output needs the stage.
    fn built(built: bool, asked: bool) -> Self {
        if built { Self::asked(asked) } else { Self::NotBuilt }
    }

    /// Combines two conditions of a stage: `other` if `self` is on, else `self`, the reason why the stage is off.
    fn and(self, other: Self) -> Self {
        if self == Self::On { other } else { self }
    }
}

/// A stage of a frame: its name, and whether it runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stage {
    /// Name of the stage in the report.
    pub name: &'static str,
    /// State of the stage: on, or the reason why the stage is off.
    pub switch: Switch,
}

/// Report of a frame's stages; [`Display`](fmt::Display) writes a table of one line per stage, without allocating.
#[derive(Clone, Copy, Debug)]
pub struct Explanation<'e> {
    pub(super) plan: &'e Plan<'e>,
    pub(super) blob: &'e Blob<'e>,
    pub(super) network: &'e Network<'e>,
    /// Number of multiply-adds of one evaluation of the proposal network; 0 without a proposal network.
    pub(super) proposal_macs: u64,
    pub(super) workspace: usize,
    pub(super) counters: Option<Counters>,
}

impl Explanation<'_> {
    /// Adds the work of each stage to the report. `counters`: counters of a frame rendered with the reported plan.
    pub fn with_counters(self, counters: Counters) -> Self {
        Self { counters: Some(counters), ..self }
    }

    /// Replaces the reported size of the workspace by `bytes`, for workspaces that hold more than a renderer needs.
    pub fn with_workspace(self, bytes: usize) -> Self {
        Self { workspace: bytes, ..self }
    }

    /// Returns the stages of the report, in the order in which a frame runs them.
    pub fn stages(&self) -> [Stage; 17] {
        let plan = self.plan;
        let cut = |value: f32| if value > 0.0 { Switch::On } else { Switch::SwitchedOff };
        let occupancy = match (plan.occupancy, self.blob.occupancy()) {
            (Some(_), _) => Switch::On,
            (None, Some(_)) => Switch::SwitchedOff,
            (None, None) => Switch::AbsentInScene,
        };
        let proposal = match (plan.proposal, self.blob.proposal()) {
            (Some(_), _) => Switch::On,
            (None, None) => Switch::AbsentInScene,
            (None, Some(_)) if !cfg!(feature = "proposal") => Switch::NotBuilt,
            (None, Some(_)) => Switch::SwitchedOff,
        };
        let colour = Switch::asked(plan.outputs.rgb);
        let directional = self.network.architecture().direction.is_some();
        let view = if directional { Switch::On } else { Switch::AbsentInScene };
        let asked = &plan.effects;
        let lens = Switch::built(cfg!(feature = "depth-of-field"), asked.depth_of_field.is_some());
        [
            ("anti-aliasing", Switch::built(cfg!(feature = "anti-aliasing"), asked.anti_aliasing > 1)),
            ("depth of field", lens),
            ("jitter", Switch::built(cfg!(feature = "jitter"), asked.jitter.is_some())),
            ("occupancy", occupancy),
            ("proposal", proposal),
            ("density", Switch::On),
            ("transmittance cut", cut(plan.transmittance_cut)),
            ("colour", colour),
            ("view dependence", colour.and(view)),
            ("colour cut", Switch::asked(plan.outputs.picks()).and(cut(plan.colour_cut))),
            ("background", colour),
            ("opacity", Switch::asked(plan.outputs.opacity)),
            ("ray_distance", Switch::asked(plan.outputs.ray_distance)),
            ("z_depth", Switch::asked(plan.outputs.z_depth)),
            ("median_distance", Switch::built(cfg!(feature = "median"), plan.outputs.median_distance)),
            ("normals", Switch::built(cfg!(feature = "normals"), plan.outputs.normals)),
            ("tone", Switch::built(cfg!(feature = "tone-map"), asked.tone != Tone::NONE)),
        ]
        .map(|(name, switch)| Stage { name, switch })
    }

    /// Returns the reported workspace size, bytes: the size that the frame needs, or the size set by
    /// [`Explanation::with_workspace`].
    pub fn workspace_bytes(&self) -> usize {
        self.workspace
    }

    fn write_setting(&self, name: &str, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (plan, network) = (self.plan, self.network);
        let (a, asked) = (network.architecture(), &plan.effects);
        match name {
            "occupancy" => plan.occupancy.as_ref().map_or(Ok(()), |occupancy| {
                let ([x, y, z], share) = (occupancy.resolution(), occupancy.occupied_share());
                write!(f, ", {x}x{y}x{z} cells, {:.2} % occupied", 100.0 * share)
            }),
            "proposal" => {
                let (samples, macs) = (plan.proposal.map_or(0, |coarse| coarse.count()), self.proposal_macs);
                write!(f, ", {samples} samples a ray, {macs} multiply-adds an evaluation")
            }
            "density" => {
                write!(f, ", {} multiply-adds an evaluation", a.density_macs())?;
                match a.table_reads() {
                    0 => Ok(()),
                    reads => write!(f, ", {reads} table entries"),
                }
            }
            "transmittance cut" => write!(f, ", a ray ends below {}", plan.transmittance_cut),
            "colour" => {
                let macs = network.colour_macs_without_direction();
                match a.shading {
                    Shading::PerSample => write!(f, ", {macs} multiply-adds an evaluation"),
                    Shading::PerRay => {
                        write!(f, ", once a ray from {} values composited, {macs} multiply-adds", a.h_rows())
                    }
                }
            }
            "view dependence" => write!(f, ", {} multiply-adds a ray", network.direction_macs()),
            "colour cut" => {
                let picked = if (Field { network, plan }).shades_rays() { "composited" } else { "asked" };
                write!(f, ", {picked} where a weight exceeds {}", plan.colour_cut)
            }
            "normals" => {
                let (macs, blur) = (a.gradient_macs(), plan.normal_deviation());
                write!(f, ", {macs} multiply-adds an evaluation, blurred by {blur} world units")
            }
            "background" => write!(f, ", {:?}", plan.background),
            "anti-aliasing" => write!(f, ", {} rays a pixel", asked.anti_aliasing),
            "depth of field" => asked.depth_of_field.map_or(Ok(()), |lens| {
                write!(f, ", aperture radius {}, in focus at {}", lens.aperture_radius, lens.focus_distance)
            }),
            "jitter" => asked.jitter.map_or(Ok(()), |jitter| write!(f, ", seed {}", jitter.seed)),
            "tone" => {
                let Tone { exposure, map, linear } = asked.tone;
                write!(f, ", exposure {exposure:+} stops")?;
                if map != ToneMap::None {
                    write!(f, ", curve {}", map.name())?;
                }
                write!(f, ", {} output", if linear { "linear" } else { "display-encoded" })
            }
            _ => Ok(()),
        }
    }
}

impl fmt::Display for Explanation<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (plan, network) = (self.plan, self.network);
        write!(f, "samples            {} a ray ", plan.samples_per_ray())?;
        match plan.lattice {
            Lattice::March => write!(f, "at most, where it is in the scene box, ")?,
            Lattice::Contracted => {
                write!(f, "from {} to {} behind the middle of an unbounded scene, ", plan.near, plan.far)?
            }
            _ => write!(f, "from {} to {}, ", plan.near, plan.far)?,
        }
        match &plan.proposal {
            Some(coarse) => {
                writeln!(f, "{} drawn from the proposal, {} its own", plan.bins.count(), coarse.count())?;
            }
            None => writeln!(f, "one each {}", plan.bins.delta())?,
        }
        if plan.lattice == Lattice::Extended {
            writeln!(f, "                   and as many more as the scene box needs")?;
        }
        let (t_min, t_max) = plan.range;
        if t_min > 0.0 || t_max < f32::MAX {
            writeln!(f, "range              {t_min} to {t_max} along the ray")?;
        }
        for Stage { name, switch } in self.stages() {
            write!(f, "{name:<18} {}", switch.name())?;
            if switch == Switch::On {
                self.write_setting(name, f)?;
            }
            writeln!(f)?;
        }
        // The camera sets the distortion, and a plan does not know the camera.
        let lens = if Lens::BUILT { "as the camera has it" } else { Switch::NotBuilt.name() };
        writeln!(f, "lens distortion    {lens}")?;
        writeln!(f, "maths              {:?}", plan.math)?;
        writeln!(f, "kernel             {}, {} rays in flight", network.isa().name(), plan.batch.rays)?;
        writeln!(f, "workspace          {} bytes", self.workspace)?;
        let Some(c) = &self.counters else { return Ok(()) };
        let per_ray = |n: u64| n as f32 / c.rays.max(1) as f32;
        let (kept, skipped) = (per_ray(c.samples_kept), per_ray(c.samples_skipped));
        writeln!(f, "rays               {}", c.rays)?;
        writeln!(f, "samples a ray      {kept:.3} kept, {skipped:.3} skipped")?;
        let shares = Shares::new(c, network, self.proposal_macs);
        let asked = [
            ("proposal", shares.proposal, Some(c.proposal_evaluations), plan.proposal.is_some()),
            ("direction", shares.direction, None, true),
            ("density", shares.density, Some(c.density_evaluations), true),
            ("colour", shares.colour, Some(c.colour_evaluations), true),
            ("normals", shares.normals, Some(c.normal_evaluations), plan.outputs.normals),
        ];
        for (name, macs, evaluations, _) in asked.into_iter().filter(|stage| stage.3) {
            write!(f, "{name:<18} {:.2} % of the work", 100.0 * macs as f32 / c.macs.max(1) as f32)?;
            match evaluations {
                Some(evaluations) => writeln!(f, ", {:.3} evaluations a ray", per_ray(evaluations))?,
                None => writeln!(f)?,
            }
        }
        writeln!(f, "work               {} multiply-adds, {:.0} a ray", c.macs, per_ray(c.macs))?;
        match c.invalid_samples {
            0 => Ok(()),
            n => writeln!(f, "invalid samples    {n}"),
        }
    }
}

/// Multiply-adds of a frame, split by stage. The sum of all stages is [`Counters::macs`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shares {
    /// Multiply-adds of the proposal network.
    pub proposal: u64,
    /// Multiply-adds of the part of the colour branch that depends on the direction alone, evaluated once per ray.
    pub direction: u64,
    /// Multiply-adds of trunk and density head.
    pub density: u64,
    /// Multiply-adds of the colour branch without the part that depends on the direction alone.
    pub colour: u64,
    /// Multiply-adds of the density gradients from which normals are computed.
    pub normals: u64,
}

impl Shares {
    /// Splits `counters.macs` by stage; `proposal_macs`: multiply-adds of one evaluation of the proposal network.
    pub(super) fn new(counters: &Counters, network: &Network<'_>, proposal_macs: u64) -> Self {
        let a = network.architecture();
        let per_colour = network.colour_macs_without_direction() as u64;
        let proposal = counters.proposal_evaluations.saturating_mul(proposal_macs);
        let density = counters.density_evaluations.saturating_mul(a.density_macs() as u64);
        let colour = counters.colour_evaluations.saturating_mul(per_colour);
        let normals = counters.normal_evaluations.saturating_mul(a.gradient_macs() as u64);
        let known = [proposal, density, colour, normals].into_iter().fold(0, u64::saturating_add);
        Self { proposal, direction: counters.macs.saturating_sub(known), density, colour, normals }
    }
}

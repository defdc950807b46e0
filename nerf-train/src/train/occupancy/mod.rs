//! Occupancy grid in training: carved from the photographs, then updated from the network's density.

mod free_space;
mod silhouette;

use crate::data::{Background, View};
use crate::model::field::densities;
pub(crate) use free_space::free_cells;
use glam::Vec3;
use nerf_core::blob::StoredOccupancy;
use nerf_core::network::Architecture;
use nerf_core::sampling::{OccupancyGrid, Purpose, uniform};
use nerf_core::simd::Isa;
use nerf_core::space::{Contraction, SceneBox};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use silhouette::Silhouette;
pub use silhouette::is_foreground;

/// Least fraction of candidate cells that an update must leave occupied; else the update is not applied. A field that
/// has lost all density must not empty the grid.
const SMALLEST_SHARE: f64 = 0.02;
/// Divisor that gives the least number of views that must see a cell of the visual hull: the number of views that see
/// the most visible cell, divided by this. The limit excludes space behind the scene, which few cameras see.
const SEEN_SHARE: u32 = 4;
/// Limit on the multiply-adds of a final update with eight points per cell; above the limit, each cell gets one point.
const SETTLE_MACS: usize = 300_000_000_000;
/// Least compositing weight with which a training sample marks its cell as visible.
const MARKED_WEIGHT: f32 = 3e-3;
/// Number of training rays that must have marked cells before unmarked cells are emptied as invisible.
const MARKED_RAYS: u64 = 250_000;
/// Density stored for a cell that was not evaluated yet; the cell stays occupied.
const UNKNOWN: f32 = -1.0;

/// Occupancy grid with one bit per cell, in the layout of the exported file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OccupiedCells {
    min: [f32; 3],
    max: [f32; 3],
    resolution: [u16; 3],
    bits: Vec<u8>,
}

impl OccupiedCells {
    pub fn bounds(&self) -> SceneBox {
        SceneBox { min: Vec3::from(self.min), max: Vec3::from(self.max) }
    }

    pub(crate) fn is_like(&self, other: &Self) -> bool {
        let shape = |cells: &Self| (cells.min, cells.max, cells.resolution, cells.bits.len());
        shape(self) == shape(other)
    }

    pub(crate) fn cells(&self) -> Vec<u32> {
        let lookup = self.lookup();
        let count = self.resolution.iter().map(|&side| u32::from(side)).product();
        (0..count).filter(|&cell| lookup.bit(cell as usize)).collect()
    }

    pub fn resolution(&self) -> [u16; 3] {
        self.resolution
    }

    /// Returns the bits, least significant first in each byte. The cell at `(x, y, z)` has bit `(x ny + y) nz + z`.
    pub fn bits(&self) -> &[u8] {
        &self.bits
    }

    pub fn stored(&self) -> StoredOccupancy<'_> {
        StoredOccupancy { resolution: self.resolution, bits: &self.bits }
    }

    pub fn lookup(&self) -> OccupancyGrid<'_> {
        OccupancyGrid::new(self.bounds(), self.resolution, &self.bits)
    }

    fn cell_size(&self) -> Vec3 {
        let sides = Vec3::from(self.resolution.map(f32::from));
        (Vec3::from(self.max) - Vec3::from(self.min)) / sides
    }

    /// Returns a point in cell `cell`, index `(x ny + y) nz + z`. `u`: coordinates within the cell, 0 to 1.
    fn point(&self, cell: u32, u: [f32; 3]) -> Vec3 {
        let [_, ny, nz] = self.resolution.map(u32::from);
        let index = [cell / (ny * nz), cell / nz % ny, cell % nz];
        let at = Vec3::from_array(std::array::from_fn(|axis| index[axis] as f32 + u[axis]));
        Vec3::from(self.min) + at * self.cell_size()
    }

    /// Creates a grid of `resolution` cells over `bounds`. `live`: index `(x ny + y) nz + z` of each occupied cell.
    /// Panics if a cell is outside of the grid.
    pub fn of(bounds: SceneBox, resolution: [u16; 3], live: impl IntoIterator<Item = u32>) -> Self {
        let (min, max) = (bounds.min.into(), bounds.max.into());
        let mut cells = Self { min, max, resolution, bits: vec![0; StoredOccupancy::bytes(resolution)] };
        live.into_iter().for_each(|cell| cells.set(cell));
        cells
    }

    fn set(&mut self, cell: u32) {
        self.bits[cell as usize / 8] |= 1 << (cell % 8);
    }
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Occupancy {
    live: OccupiedCells,
    /// Indices of the cells that the photographs do not prove empty.
    candidates: Vec<u32>,
    /// Density stored for each cell of `candidates`, 1/world unit.
    density: Vec<f32>,
    refreshes: u64,
    /// One bit per cell: whether a sample of enough weight has marked the cell as visible. Empty before the first mark.
    weighted: Vec<u8>,
    /// Number of training rays in the steps that marked cells.
    marked_rays: u64,
}

impl Occupancy {
    /// Returns the numbers of cells along x, y, z of a box with sides `extent`. `resolution`: along the longest side.
    pub fn sides(extent: Vec3, resolution: u16) -> [u16; 3] {
        let cell = extent.max_element() / f32::from(resolution);
        extent.to_array().map(|side| ((side / cell).round() as u16).clamp(1, resolution))
    }

    /// Creates an occupancy grid with every cell occupied, `resolution` cells along the longest side.
    pub fn full(bounds: SceneBox, resolution: u16) -> Self {
        let sides = Self::sides(bounds.max - bounds.min, resolution);
        let cells = sides.iter().map(|&side| u32::from(side)).product();
        Self::of_candidates(bounds, sides, (0..cells).collect())
    }

    /// Creates the first grid of an unbounded scene. A cell is occupied if two cameras see it: the first camera in the
    /// order of `views` that sees the cell, and another at least `apart` world units from the first. With a single
    /// view, cells are occupied even if the view does not see them. In both cases, cells too near to a camera, free
    /// cells and cells outside of contracted space are empty. `nears`: for each view, the distance from its camera
    /// within which space is empty, world units. `free`: for each cell, whether it is free; an empty slice if unknown.
    pub fn seen(
        bounds: SceneBox,
        resolution: u16,
        views: &[View],
        contraction: &Contraction,
        (nears, apart): (&[f32], f32),
        free: &[bool],
    ) -> Self {
        let full = Self::full(bounds, resolution);
        let seen = |&cell: &u32| {
            let p = contraction.in_world(full.live.point(cell, [0.5; 3]));
            let (mut first, mut enough) = (None, views.len() == 1);
            for (view, &near) in views.iter().zip(nears) {
                let (camera, (width, height)) = (&view.camera, view.size());
                let eye = camera.pose().position;
                // Space near the camera is empty on all sides, also behind it, where the photographer stood.
                if (p - eye).length() < near {
                    return false;
                }
                if enough {
                    continue;
                }
                let inside = |(x, y): &(f32, f32)| {
                    (0.0..=width as f32).contains(x) && (0.0..=height as f32).contains(y)
                };
                if camera.project(p).filter(inside).is_none() {
                    continue;
                }
                enough |= first.is_some_and(|first: Vec3| (first - eye).length() >= apart);
                first = first.or(Some(eye));
            }
            enough
        };
        // The corners of the cube are outside of contracted space, which is a ball.
        let reach = 2.0 * contraction.radius();
        let possible = |&cell: &u32| {
            let inside = (full.live.point(cell, [0.5; 3]) - contraction.centre()).length() < reach;
            inside && !free.get(cell as usize).copied().unwrap_or(false) && seen(&cell)
        };
        let cells: Vec<u32> = full.candidates.par_iter().copied().filter(possible).collect();
        Self::of_candidates(bounds, full.live.resolution, cells)
    }

    /// Returns a grid with cells half as wide, to refine a coarse visual hull. Each candidate cell becomes eight.
    pub fn halved(&self) -> Self {
        let [_, ny, nz] = self.live.resolution.map(u32::from);
        let resolution = self.live.resolution.map(|side| 2 * side);
        let eight = |&cell: &u32| {
            let [x, y, z] = [cell / (ny * nz), cell / nz % ny, cell % nz].map(|at| 2 * at);
            (0..8u32).map(move |i| ((x + (i >> 2)) * 2 * ny + y + (i >> 1 & 1)) * 2 * nz + z + (i & 1))
        };
        let mut cells: Vec<u32> = self.candidates.iter().flat_map(eight).collect();
        cells.sort_unstable();
        Self::of_candidates(self.live.bounds(), resolution, cells)
    }

    fn of_candidates(bounds: SceneBox, resolution: [u16; 3], candidates: Vec<u32>) -> Self {
        let live = OccupiedCells::of(bounds, resolution, candidates.iter().copied());
        let density = vec![UNKNOWN; candidates.len()];
        Self { live, candidates, density, refreshes: 0, weighted: Vec::new(), marked_rays: 0 }
    }

    /// Carves the visual hull: keeps the cells that enough views see completely, and that no view shows as background.
    /// `None` if the photographs do not show what is background. `resolution`: number of cells along the longest side.
    pub fn carve(bounds: SceneBox, resolution: u16, views: &[View], background: Background) -> Option<Self> {
        let silhouettes: Option<Vec<Silhouette>> =
            views.par_iter().map(|view| Silhouette::of(view, background)).collect();
        let silhouettes = silhouettes?;
        let full = Self::full(bounds, resolution);
        let radius = 0.5 * full.live.cell_size().length();
        // Number of views that see a cell; 0 if one of them sees only background there.
        let seen = |&cell: &u32| {
            let centre = full.live.point(cell, [0.5; 3]);
            let mut seen = 0u32;
            for silhouette in &silhouettes {
                match silhouette.shows(centre, radius) {
                    Some(false) => return 0,
                    Some(true) => seen += 1,
                    None => {}
                }
            }
            seen
        };
        let seen: Vec<u32> = full.candidates.par_iter().map(seen).collect();
        let enough = seen.iter().max().map_or(1, |most| most.div_ceil(SEEN_SHARE).max(1));
        let kept = full.candidates.iter().zip(seen).filter(|&(_, seen)| seen >= enough);
        let kept: Vec<u32> = kept.map(|(&cell, _)| cell).collect();
        Some(Self::of_candidates(bounds, full.live.resolution, kept))
    }

    /// Returns a scene box around the candidate cells, with a margin of one cell; `None` without candidates.
    pub fn tight_box(&self) -> Option<SceneBox> {
        let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for &cell in &self.candidates {
            low = low.min(self.live.point(cell, [-1.0; 3]));
            high = high.max(self.live.point(cell, [2.0; 3]));
        }
        let (min, max) = (low.max(Vec3::from(self.live.min)), high.min(Vec3::from(self.live.max)));
        SceneBox::new(min, max).ok()
    }

    /// Whether `self`, from a checkpoint, and the run's grid `other` have the same cells and candidates.
    pub(crate) fn is_like(&self, other: &Self) -> bool {
        let candidates = self.candidates == other.candidates && self.density.len() == other.density.len();
        let marks = self.weighted.is_empty() || self.weighted.len() == self.live.bits.len();
        candidates && marks && self.live.is_like(&other.live) && self.refreshes <= u64::MAX / 2
    }

    pub fn lookup(&self) -> OccupancyGrid<'_> {
        self.live.lookup()
    }

    pub(crate) fn candidates(&self) -> usize {
        self.candidates.len()
    }

    pub(crate) fn live(&self) -> &OccupiedCells {
        &self.live
    }

    pub fn into_live(self) -> OccupiedCells {
        self.live
    }

    /// Marks the cells of samples whose weight is at least `MARKED_WEIGHT` as visible. `samples`: position in the scene
    /// box, and compositing weight; `rays`: number of training rays that the samples belong to.
    pub fn mark(&mut self, rays: usize, samples: impl Iterator<Item = ([f32; 3], f32)>) {
        self.weighted.resize(self.live.bits.len(), 0);
        self.marked_rays += rays as u64;
        let bounds = self.live.bounds();
        let sides = Vec3::from(self.live.resolution.map(f32::from));
        let scale = sides / (bounds.max - bounds.min);
        let [_, ny, nz] = self.live.resolution.map(u32::from);
        for (position, _) in samples.filter(|&(_, weight)| weight >= MARKED_WEIGHT) {
            let at = ((Vec3::from(position) - bounds.min) * scale).clamp(Vec3::ZERO, sides - 1.0);
            let cell = (at.x as u32 * ny + at.y as u32) * nz + at.z as u32;
            self.weighted[cell as usize / 8] |= 1 << (cell % 8);
        }
    }

    /// Empties the cells without a mark. Does nothing before `MARKED_RAYS` training rays have marked cells.
    pub fn drop_unweighted(&mut self) {
        if self.marked_rays >= MARKED_RAYS {
            self.live.bits.iter_mut().zip(&self.weighted).for_each(|(live, weighted)| *live &= weighted);
        }
    }

    /// Evaluates the density in at most `cells` candidate cells, each at one random point; successive calls evaluate
    /// other cells. A cell stores the larger of the new density and `decay` times the stored density. If `drop`,
    /// empties all candidates evaluated so far whose stored density is at most `threshold`, 1/world unit.
    pub fn refresh(&mut self, ask: &DensityQuery<'_>, cells: usize, threshold: f32, decay: f32, drop: bool) {
        let parts = self.candidates.len().div_ceil(cells.max(1)).max(1);
        let part = (self.refreshes % parts as u64) as usize;
        let asked: Vec<usize> = (part..self.candidates.len()).step_by(parts).collect();
        let sigma = self.ask(ask, &asked, |axis, cell| {
            uniform(ask.seed, Purpose::Cell, self.refreshes, 3 * u64::from(cell) + axis)
        });
        for (&i, sigma) in asked.iter().zip(sigma) {
            self.density[i] = sigma.max(self.density[i] * decay);
        }
        self.refreshes += 1;
        if drop {
            self.apply(threshold, SMALLEST_SHARE);
        }
    }

    /// Does the final update before export: evaluates the density at 2 × 2 × 2 points of every candidate cell not known
    /// to be occupied. A cell is occupied if any density is above `threshold`, 1/world unit. If this would take too
    /// long, each cell is evaluated at its centre only, and candidates next to occupied cells are made occupied, too.
    pub fn settle(&mut self, ask: &DensityQuery<'_>, threshold: f32) {
        self.settle_to(ask, threshold, SMALLEST_SHARE);
    }

    /// Returns the occupancy grid of a finished network, with `resolution` cells along the longest side. Works like
    /// [`Self::settle`] with `threshold`, but uses the result even if hardly any cell stays occupied.
    pub fn asked(bounds: SceneBox, resolution: u16, ask: &DensityQuery<'_>, threshold: f32) -> Self {
        let mut occupancy = Self::full(bounds, resolution);
        occupancy.settle_to(ask, threshold, 0.0);
        occupancy
    }

    /// Returns the occupancy grid of a finished network, evaluated as in [`Self::settle`], but only in the cells that
    /// are occupied in `cells`. `threshold`: density above which a cell is occupied, 1/world unit.
    pub fn asked_within(cells: &OccupiedCells, ask: &DensityQuery<'_>, threshold: f32) -> Self {
        let mut occupancy = Self::of_candidates(cells.bounds(), cells.resolution(), cells.cells());
        occupancy.settle_to(ask, threshold, 0.0);
        occupancy
    }

    fn settle_to(&mut self, ask: &DensityQuery<'_>, threshold: f32, smallest_share: f64) {
        let cells = self.candidates.len();
        let macs = ask.architecture.density_macs() * cells;
        let points: &[f32] = if 8 * macs <= SETTLE_MACS { &[0.25, 0.75] } else { &[0.5] };
        let mut open: Vec<usize> = (0..cells).filter(|&i| self.density[i] <= threshold).collect();
        // Unknown cells are treated as evaluated from here on.
        open.iter().for_each(|&i| self.density[i] = self.density[i].max(0.0));
        for corner in 0..points.len().pow(3) {
            let u = |axis: u64| points[(corner >> axis & 1) % points.len()];
            let sigma = self.ask(ask, &open, |axis, _| u(axis));
            for (&i, sigma) in open.iter().zip(sigma) {
                self.density[i] = self.density[i].max(sigma);
            }
            open.retain(|&i| self.density[i] <= threshold);
        }
        self.apply(threshold, smallest_share);
        if points.len() == 1 {
            self.dilate();
        }
    }

    /// Marks each candidate cell that touches an occupied cell as occupied.
    fn dilate(&mut self) {
        let sides = self.live.resolution.map(i64::from);
        let live = self.lookup();
        let near_live = |&cell: &u32| {
            let cell = i64::from(cell);
            let at = [cell / (sides[1] * sides[2]), cell / sides[2] % sides[1], cell % sides[2]];
            (0..27).any(|i| {
                let n = [at[0] + i / 9 - 1, at[1] + i / 3 % 3 - 1, at[2] + i % 3 - 1];
                let inside = (0..3).all(|axis| (0..sides[axis]).contains(&n[axis]));
                inside && live.bit(((n[0] * sides[1] + n[1]) * sides[2] + n[2]) as usize)
            })
        };
        let near: Vec<u32> = self.candidates.par_iter().copied().filter(near_live).collect();
        near.into_iter().for_each(|cell| self.live.set(cell));
    }

    fn ask(&self, ask: &DensityQuery<'_>, which: &[usize], u: impl Fn(u64, u32) -> f32 + Sync) -> Vec<f32> {
        let point = |&i: &usize| {
            let cell = self.candidates[i];
            self.live.point(cell, std::array::from_fn(|axis| u(axis as u64, cell))).to_array()
        };
        let points: Vec<[f32; 3]> = which.par_iter().map(point).collect();
        let mut sigma = densities(ask.isa, ask.architecture, ask.parameters, &self.live.bounds(), &points);
        // Far from the centre, steps are longer, so that a lower density absorbs as much light in one step. Densities
        // are therefore multiplied by the growth of the step.
        if let Some(contraction) = &ask.contraction {
            sigma.iter_mut().zip(points).for_each(|(sigma, p)| *sigma *= contraction.step_growth(p.into()));
        }
        sigma
    }

    /// Sets the candidates' occupancy: occupied if the stored density is above `threshold` (1/world unit) or unknown.
    /// Changes nothing if less than the fraction `smallest_share` of them would be occupied.
    fn apply(&mut self, threshold: f32, smallest_share: f64) {
        let live = |&density: &f32| density == UNKNOWN || density > threshold;
        let count = self.density.iter().filter(|density| live(density)).count();
        if (count as f64) < smallest_share * self.candidates.len() as f64 {
            return;
        }
        self.live.bits.fill(0);
        for (&cell, density) in self.candidates.iter().zip(&self.density) {
            if live(density) {
                self.live.set(cell);
            }
        }
    }
}

#[derive(Clone, Copy, Debug)]
pub struct DensityQuery<'a> {
    pub isa: Isa,
    pub architecture: &'a Architecture,
    pub parameters: &'a [f32],
    pub seed: u64,
    pub contraction: Option<Contraction>,
}

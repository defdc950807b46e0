//! Agreement of two photographs, by patches around sparse points that the two cameras see from similar positions.

use super::grey::{Grey, HALF_PATCH, centred};
use crate::capture::sights::{Sight, Sights};
use crate::data::{SparsePoint, View};
use glam::Vec3;
use rayon::prelude::*;

/// Limits at which two cameras see a point alike: minimum cosine of the angle between their rays (12°), and maximum
/// ratio of their distances from the point.
const ALIKE: (f32, f32) = (0.978_147_6, 1.25);
/// Minimum number of one photograph's points that a second camera must see [alike](ALIKE) for the pair to be compared.
const ENOUGH_POINTS: usize = 30;
/// Minimum number of compared patches of a pair of photographs. Pairs with fewer patches are left out of the check.
const ENOUGH_PATCHES: usize = 15;
/// Approximate maximum number of tests whether two cameras see a point [alike](ALIKE). Above the maximum, only every
/// N-th point of each photograph is tested.
const MAX_QUESTIONS: usize = 400_000_000;
/// Maximum number of points, from each photograph of a pair, around which patches are compared.
const COMPARED_POINTS: usize = 60;
/// Maximum number of compared pairs. If there are more, only every N-th pair is compared.
const MAX_PAIRS: usize = 60_000;
/// Standard deviation of a patch's grey levels (0 to 255) up to which the patch has too little texture to compare.
const MIN_TEXTURE: f32 = 2.0;
/// Normalised cross-correlation below which two patches show different content.
const DIFFERENT: f32 = 0.3;

/// Two photographs that see points from similar positions, and how much their patches around these points differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pair {
    /// Indices of the photographs, the smaller first.
    pub views: [usize; 2],
    /// Fraction of the compared patches that show different things, 0 to 1.
    pub different: f32,
}

impl Pair {
    /// Whether less than 30 % of the compared patches differ. The two photographs then show the same content.
    pub fn agrees(&self) -> bool {
        self.different < 0.3
    }

    /// Whether more than 60 % of the compared patches differ. The two poses then cannot both be right.
    pub fn contradicts(&self) -> bool {
        self.different > 0.6
    }
}

struct Compared<'v> {
    view: &'v View,
    grey: &'v Grey,
    points: Vec<Vec3>,
}

impl Compared<'_> {
    /// Returns this photograph's points that project into `other`'s picture and that both cameras see [alike](ALIKE).
    fn seen_alike(&self, other: &Self) -> Vec<Vec3> {
        let [from, to] = [self, other].map(|of| of.view.camera.pose().position);
        let (width, height) = other.view.size();
        let alike = |point: &&Vec3| {
            let (a, b) = (**point - from, **point - to);
            let (near, far) = (a.length(), b.length());
            a.dot(b) > ALIKE.0 * near * far && near < ALIKE.1 * far && far < ALIKE.1 * near
        };
        let inside = |point: &&Vec3| {
            let at = other.view.camera.project(**point);
            at.is_some_and(|(x, y)| x > 0.0 && y > 0.0 && x < width as f32 && y < height as f32)
        };
        self.points.iter().filter(alike).filter(inside).copied().collect()
    }

    /// Projects `point` to pixels of the grey image, also outside its borders; `None` if the camera cannot project it.
    fn shows(&self, point: Vec3) -> Option<[f32; 2]> {
        let (x, y) = self.view.camera.project(point)?;
        Some([x, y].map(|v| v / self.grey.factor as f32))
    }

    /// Returns the normalised cross-correlation of the patches around `point` in this photograph and in `other`. The
    /// patches show the same square in space, parallel to this photograph's image plane. `None` if this photograph's
    /// patch lacks texture, if either patch leaves its image, or if either camera does not see the point.
    fn correlation(&self, other: &Self, point: Vec3) -> Option<f32> {
        let pose = self.view.camera.pose();
        let mine = self.grey.patch(self.shows(point)?, [1.0, 0.0], [0.0, 1.0])?;
        let depth = (point - pose.position).dot(pose.forward());
        let pixel = depth * self.grey.factor as f32 / self.view.camera.intrinsics().fx;
        let there = other.shows(point)?;
        let step = |axis: Vec3| {
            let reach = HALF_PATCH as f32;
            let end = other.shows(point + reach * pixel * axis)?;
            Some([0, 1].map(|i| (end[i] - there[i]) / reach))
        };
        let theirs = other.grey.patch(there, step(pose.rotation.x_axis)?, step(-pose.rotation.y_axis)?)?;
        let [(mine, texture), (theirs, other_texture)] = [mine, theirs].map(centred);
        let product: f32 = mine.iter().zip(&theirs).map(|(a, b)| a * b).sum();
        (texture > MIN_TEXTURE * (mine.len() as f32).sqrt())
            .then(|| product / (texture * other_texture.max(f32::MIN_POSITIVE)))
    }

    /// Returns the [correlations](Self::correlation) that exist at up to [`COMPARED_POINTS`] evenly spaced `points`.
    fn correlations(&self, other: &Self, points: &[Vec3]) -> Vec<f32> {
        let step = points.len().div_ceil(COMPARED_POINTS).max(1);
        points.iter().step_by(step).filter_map(|&point| self.correlation(other, point)).collect()
    }
}

/// Compares pairs of photographs that see enough points from similar positions: at most [`MAX_PAIRS`] pairs. Leaves out
/// pairs with too few comparable patches. `greys`, `sights`: one entry per view, in the order of `views`.
pub(super) fn compare(views: &[&View], greys: &[Grey], sights: &Sights, points: &[SparsePoint]) -> Vec<Pair> {
    let count = views.len();
    let asked = MAX_QUESTIONS / (count * count).max(1);
    let position = |sight: &Sight| Vec3::from(points[sight.point as usize].position);
    let compared = |view: usize| {
        let sights = &sights.of_views[view];
        let step = sights.len().div_ceil(asked.max(ENOUGH_POINTS)).max(1);
        let points = sights.iter().step_by(step).map(position).collect();
        Compared { view: views[view], grey: &greys[view], points }
    };
    let compared: Vec<Compared<'_>> = (0..count).map(compared).collect();
    let alike = |a: usize, b: usize| compared[a].seen_alike(&compared[b]);
    let enough = |a, b| alike(a, b).len().max(alike(b, a).len()) >= ENOUGH_POINTS;
    let candidates = |a: usize| (a + 1..count).filter(|&b| enough(a, b)).map(|b| [a, b]).collect::<Vec<_>>();
    let candidates = (0..count).into_par_iter().map(candidates).collect::<Vec<_>>().concat();
    let step = candidates.len().div_ceil(MAX_PAIRS).max(1);
    let judged = |&views: &[usize; 2]| {
        let [a, b] = views;
        let mut found = compared[a].correlations(&compared[b], &alike(a, b));
        found.extend(compared[b].correlations(&compared[a], &alike(b, a)));
        let different = found.iter().filter(|&&correlation| correlation < DIFFERENT).count();
        let different = different as f32 / found.len().max(1) as f32;
        (found.len() >= ENOUGH_PATCHES).then_some(Pair { views, different })
    };
    let chosen: Vec<_> = candidates.into_iter().step_by(step).collect();
    chosen.par_iter().filter_map(judged).collect()
}

//! Photographs of the demo scene with tracks of points, as from a reconstruction; folded on request.

use super::{DemoSpec, Hit, render, trace};
use crate::data::{Axes, Background, Dataset, Format, KeyPoint, SparsePoint, View};
use glam::Vec3;
use nerf_core::camera::{Camera, CameraError};
use rayon::prelude::*;
use std::f32::consts::FRAC_PI_2;

/// Number of photographs of a round.
const ROUND: usize = 14;
/// Angle between consecutive photographs of a round, degrees.
const STEP: f32 = 6.0;
/// Side of the photographs, pixels.
const SIZE: u32 = 160;
/// Spacing of a photograph's points, pixels.
const POINT_EVERY: usize = 9;
/// Spacing, in photographs, of those from which points are taken.
const VIEW_EVERY: usize = 3;

/// A photograph: camera in the data set, camera that took it, and azimuth between the two cameras, radians.
struct Shot {
    pose: Camera,
    taken: Camera,
    turn: f32,
}

impl Shot {
    /// Position of a point in this photograph, pixels; `None` if the point is hidden, or was seen at another `turn`.
    fn shows(&self, position: Vec3, turn: f32) -> Option<(f32, f32)> {
        let (x, y) = self.pose.project(position)?;
        let inside = |v: f32| v > 1.0 && v < SIZE as f32 - 1.0;
        let Hit { ray_distance, .. } = trace(&self.taken, x, y).filter(|_| inside(x) && inside(y))?;
        let nearest = (ray_distance - position.distance(self.pose.pose().position)).abs() < 0.01;
        (nearest && turn == self.turn).then_some((x, y))
    }

    /// Points that this photograph shows at every [`POINT_EVERY`]-th pixel and row, in the data set's coordinates.
    fn points(&self) -> Vec<Vec3> {
        let lattice = || (POINT_EVERY..SIZE as usize).step_by(POINT_EVERY).map(|v| v as f32);
        let at = |(x, y)| trace(&self.taken, x, y).map(|hit| self.pose.ray(x, y).at(hit.ray_distance));
        lattice().flat_map(|y| lattice().map(move |x| (x, y))).filter_map(at).collect()
    }
}

/// Two rounds of photographs along one path of 81°, the second interleaved with the first, and the points that they
/// show.
///
/// `folded`: the second round is taken a quarter turn further, but posed like the first, as in a reconstruction of
/// repeated structure. (After half a turn the plinth would look the same.)
pub fn two_rounds(folded: bool) -> Result<Dataset, CameraError> {
    let spec = DemoSpec { size: SIZE, ..DemoSpec::default() };
    let shot = |i: usize| {
        let (round, place) = (i / ROUND, (i % ROUND) as f32);
        let azimuth = (STEP * (place + 0.5 * round as f32)).to_radians();
        let turn = if folded && round > 0 { FRAC_PI_2 } else { 0.0 };
        Ok(Shot { pose: spec.camera(azimuth, 0.4)?, taken: spec.camera(azimuth + turn, 0.4)?, turn })
    };
    let shots = (0..2 * ROUND).map(shot).collect::<Result<Vec<Shot>, CameraError>>()?;
    let view = |(i, shot): (usize, &Shot)| View::new(format!("{i:03}.jpg"), shot.pose, render(&shot.taken));
    let mut train: Vec<View> = shots.iter().enumerate().map(view).collect();
    let mut points = Vec::new();
    for from in shots.iter().step_by(VIEW_EVERY) {
        let tracked = |position: Vec3| {
            let shown = |(i, shot): (usize, &Shot)| Some((i, shot.shows(position, from.turn)?));
            (position, shots.iter().enumerate().filter_map(shown).collect::<Vec<_>>())
        };
        for (position, track) in from.points().into_par_iter().map(tracked).collect::<Vec<_>>() {
            let point = points.len() as u32;
            track.iter().for_each(|&(i, (x, y))| train[i].key_points.push(KeyPoint { x, y, point }));
            let track = track.len().max(1) as u32;
            points.push(SparsePoint { position: position.to_array(), error: 0.5, track });
        }
    }
    Ok(Dataset {
        train,
        background: Background::Alpha,
        points,
        ..Dataset::empty(
            if folded { "demo, folded".into() } else { "demo".into() },
            Format::Demo,
            Axes::Opengl,
        )
    })
}

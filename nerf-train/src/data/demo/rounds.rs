//! Demo data sets with sparse points, like the results of structure from motion. On request, the poses are wrong
//! (folded): photographs of two sides of the scene have poses on the same side.

use super::{DemoSpec, Hit, render, trace};
use crate::data::{Axes, Background, Dataset, Format, KeyPoint, SparsePoint, View};
use glam::Vec3;
use nerf_core::camera::{Camera, CameraError};
use rayon::prelude::*;
use std::f32::consts::FRAC_PI_2;

/// Number of photographs in each of the two rounds. A round is a series of photographs along an arc.
const ROUND: usize = 14;
/// Angle between consecutive photographs of a round, degrees.
const STEP: f32 = 6.0;
/// Side of the photographs, pixels.
const SIZE: u32 = 160;
/// Spacing, in columns and in rows, of the pixels from which sparse points are made.
const POINT_EVERY: usize = 9;
/// Interval between the photographs from which sparse points are made; 1 would use all photographs.
const VIEW_EVERY: usize = 3;

/// One photograph: camera in the data set, camera that took it, and angle between the two around the scene, radians.
struct Shot {
    pose: Camera,
    taken: Camera,
    turn: f32,
}

impl Shot {
    /// Returns the position, pixels, at which this photograph shows a sparse point. `None` if the point is hidden or
    /// outside the picture, or if it was made from a photograph of another [`turn`](Shot::turn).
    fn shows(&self, position: Vec3, turn: f32) -> Option<(f32, f32)> {
        let (x, y) = self.pose.project(position)?;
        let inside = |v: f32| v > 1.0 && v < SIZE as f32 - 1.0;
        let Hit { ray_distance, .. } = trace(&self.taken, x, y).filter(|_| inside(x) && inside(y))?;
        let nearest = (ray_distance - position.distance(self.pose.pose().position)).abs() < 0.01;
        (nearest && turn == self.turn).then_some((x, y))
    }

    /// Returns the points seen at every [`POINT_EVERY`]-th column and row of this photograph, in the data set's world.
    fn points(&self) -> Vec<Vec3> {
        let lattice = || (POINT_EVERY..SIZE as usize).step_by(POINT_EVERY).map(|v| v as f32);
        let at = |(x, y)| trace(&self.taken, x, y).map(|hit| self.pose.ray(x, y).at(hit.ray_distance));
        lattice().flat_map(|y| lattice().map(move |x| (x, y))).filter_map(at).collect()
    }
}

/// Renders a data set of photographs along an arc of 81°, in two rounds whose positions alternate along the arc. If
/// `folded`, the photographs of the second round are taken a quarter turn further around the scene. Their poses stay on
/// the arc of the first round, as in a reconstruction misled by repeated structure.
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

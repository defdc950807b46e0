//! Smooth camera path through keyframes, at constant speed.

use glam::{Mat3, Quat, Vec3};
use nerf_core::camera::Pose;

/// Number of segments between neighbouring keyframes. The path's arc length is the sum of the segments' lengths.
const PIECES: usize = 64;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keyframe {
    pub pose: Pose,
    pub fov_degrees: f32,
}

/// Returns a path of `frames` keyframes from the first of `keys` to the last, evenly spaced by arc length. The path is
/// a Catmull-Rom spline through positions and rotations. A rotation by 90° adds as much arc length as the mean distance
/// between neighbouring `keys`. The logarithm of the focal length is interpolated linearly, without overshoot.
///
/// Returns only the first keyframe if `keys` has one or `frames` is 1. Empty if `keys` is empty or `frames` is 0.
pub fn flight(keys: &[Keyframe], frames: usize) -> Vec<Keyframe> {
    if keys.len() < 2 || frames < 2 {
        return keys.first().copied().into_iter().take(frames).collect();
    }
    let turns = aligned(keys);
    let spans = keys.len() - 1;
    let mean = keys.windows(2).map(|pair| pair[0].pose.position.distance(pair[1].pose.position)).sum::<f32>()
        / spans as f32;
    let radius = mean.max(1e-6) / std::f32::consts::FRAC_PI_2;
    let at = |place: f32| place_at(keys, &turns, place);
    // Arc length up to the end of each segment.
    let mut lengths = vec![0.0f64];
    let mut last = at(0.0);
    for i in 1..=spans * PIECES {
        let next = at(i as f32 / PIECES as f32);
        // This form is precise for small angles, which an arc cosine would round to 0.
        let angle = 2.0 * (next.1 - last.1).length().min((next.1 + last.1).length());
        lengths.push(lengths[i - 1] + f64::from(last.0.distance(next.0) + radius * angle));
        last = next;
    }
    let whole = lengths[lengths.len() - 1];
    let frame = |i: usize| {
        let length = whole * i as f64 / (frames - 1) as f64;
        let piece = lengths.partition_point(|&l| l <= length).clamp(1, lengths.len() - 1);
        let (from, to) = (lengths[piece - 1], lengths[piece]);
        let share = if to > from { ((length - from) / (to - from)) as f32 } else { 0.0 };
        let (position, turn, fov_degrees) = at(((piece - 1) as f32 + share) / PIECES as f32);
        Keyframe { pose: Pose { rotation: Mat3::from_quat(turn), position }, fov_degrees }
    };
    (0..frames).map(frame).collect()
}

/// Returns the rotations of `keys` as quaternions. Each quaternion has the sign, q or −q, that is nearer to the
/// previous quaternion; q and −q are the same rotation.
fn aligned(keys: &[Keyframe]) -> Vec<Quat> {
    let mut turns: Vec<Quat> = Vec::with_capacity(keys.len());
    for key in keys {
        let turn = Quat::from_mat3(&key.pose.rotation);
        turns.push(if turns.last().is_some_and(|last| last.dot(turn) < 0.0) { -turn } else { turn });
    }
    turns
}

/// Returns position, rotation and field of view (degrees) at the fractional index `at`. `turns`: from [`aligned`].
fn place_at(keys: &[Keyframe], turns: &[Quat], at: f32) -> (Vec3, Quat, f32) {
    let first = (at as usize).min(keys.len() - 2);
    let t = at - first as f32;
    // Catmull-Rom weights of the keyframe before the segment, its two ends, and the keyframe after it.
    let weights = [
        0.5 * t * (t * (2.0 - t) - 1.0),
        0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
        0.5 * t * (t * (4.0 - 3.0 * t) + 1.0),
        0.5 * t * t * (t - 1.0),
    ];
    let index = |i: usize| (first + i).saturating_sub(1).min(keys.len() - 1);
    let mut position = Vec3::ZERO;
    let mut turn = Quat::from_xyzw(0.0, 0.0, 0.0, 0.0);
    for (i, weight) in weights.into_iter().enumerate() {
        position += weight * keys[index(i)].pose.position;
        turn += turns[index(i)] * weight;
    }
    let tangent = |key: &Keyframe| (0.5 * key.fov_degrees.to_radians()).tan();
    let (from, to) = (tangent(&keys[first]), tangent(&keys[first + 1]));
    let fov = 2.0 * (from.powf(1.0 - t) * to.powf(t)).atan();
    (position, turn.normalize(), fov.to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(x: f32, y: f32, turn: f32) -> Keyframe {
        let pose = Pose { rotation: Mat3::from_rotation_y(turn), position: Vec3::new(x, y, 0.0) };
        Keyframe { pose, fov_degrees: 40.0 + 10.0 * x }
    }

    #[test]
    fn a_flight_begins_and_ends_at_its_views_and_keeps_its_speed() {
        let keys = [key(0.0, 0.0, 0.0), key(1.0, 0.0, 0.3), key(1.5, 2.0, 1.0), key(4.0, 2.0, -0.4)];
        let flight = flight(&keys, 101);
        assert_eq!(flight.len(), 101);
        for (found, given) in [(flight[0], keys[0]), (flight[100], keys[3])] {
            assert!(found.pose.position.distance(given.pose.position) < 1e-4);
            assert!(found.pose.rotation.abs_diff_eq(given.pose.rotation, 1e-4));
            assert!((found.fov_degrees - given.fov_degrees).abs() < 1e-2);
        }
        // The path passes through every keyframe.
        for key in &keys[1..3] {
            let nearest =
                flight.iter().map(|f| f.pose.position.distance(key.pose.position)).fold(1.0, f32::min);
            assert!(nearest < 0.04, "{nearest}");
        }
        let step = |pair: &[Keyframe]| {
            let [a, b] = [pair[0].pose, pair[1].pose].map(|pose| Quat::from_mat3(&pose.rotation));
            let radius = (1.0 + 4.25f32.sqrt() + 2.5) / 3.0 / std::f32::consts::FRAC_PI_2;
            pair[0].pose.position.distance(pair[1].pose.position) + radius * a.angle_between(b)
        };
        let steps: Vec<f32> = flight.windows(2).map(step).collect();
        let (least, most) = steps.iter().fold((f32::MAX, 0.0f32), |(a, b), &s| (a.min(s), b.max(s)));
        assert!(most / least < 1.1, "{least} {most}");
    }

    #[test]
    fn fields_of_view_never_leave_those_of_their_keyframes() {
        let keys = [(0.0, 5.0), (1.0, 5.0), (2.0, 100.0), (3.0, 100.0)]
            .map(|(x, fov_degrees)| Keyframe { fov_degrees, ..key(x, 0.0, 0.0) });
        let flight = flight(&keys, 60);
        assert!(flight.iter().all(|key| (4.999..100.001).contains(&key.fov_degrees)));
        assert!(flight.windows(2).all(|pair| pair[0].fov_degrees <= pair[1].fov_degrees + 1e-3));
    }

    #[test]
    fn a_slow_turn_is_as_even_as_a_fast_one() {
        let flight = flight(&[key(0.0, 0.0, 0.0), key(0.0, 0.0, 0.01), key(0.0, 0.0, 0.02)], 41);
        let angle = |key: &Keyframe| key.pose.rotation.z_axis.x;
        let steps: Vec<f32> = flight.windows(2).map(|pair| angle(&pair[1]) - angle(&pair[0])).collect();
        assert!(steps.iter().all(|step| (step / 5e-4 - 1.0).abs() < 0.05), "{steps:?}");
    }

    #[test]
    fn few_views_and_frames_are_what_they_are() {
        assert!(flight(&[], 5).is_empty());
        assert_eq!(flight(&[key(1.0, 2.0, 0.5)], 5), [key(1.0, 2.0, 0.5)]);
        assert_eq!(flight(&[key(0.0, 0.0, 0.0), key(1.0, 0.0, 0.0)], 1).len(), 1);
        // With all keyframes at one position, the camera only turns, at constant speed.
        let turned = flight(&[key(0.0, 0.0, 0.0), key(0.0, 0.0, 1.0)], 3);
        let middle = Quat::from_mat3(&turned[1].pose.rotation).angle_between(Quat::IDENTITY);
        assert!((middle - 0.5).abs() < 1e-2, "{middle}");
    }
}

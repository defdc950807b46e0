//! Tests of the smoothness loss's factors and weights.

use super::*;
use crate::model::engine::grid::smoothness::{Triple, triples};

/// Returns a batch of one line, whose pixels are `spacing` focal lengths apart and have the given brightness.
fn line(spacing: f32, brightness: [f32; LINE]) -> Batch {
    let contraction = Contraction::new(&Contraction::cube(Vec3::ZERO, 2.0), 1).expect("a cube");
    let mut batch = Batch { lines: vec![0], smoothness: Some((1.0, contraction)), ..Batch::default() };
    for (k, rgb) in brightness.into_iter().enumerate() {
        let dir = Vec3::new(0.2 + k as f32 * spacing, -0.3, 1.0).normalize();
        batch.rays.push(BatchRay { dir: dir.to_array(), rgb: [rgb; 3], ..BatchRay::default() });
    }
    batch
}

fn residuals(batch: &Batch, distance: impl Fn(Vec3) -> f32) -> Vec<f32> {
    let of = |triple: Triple| {
        let term = |k: usize| triple.factors[k] / distance(batch.rays[triple.first + k].dir.into());
        (0..3).map(term).sum()
    };
    triples(batch, 0..LINE).map(of).collect()
}

#[test]
fn a_plane_has_no_residual_however_it_is_tilted_and_a_sphere_and_an_edge_have_one() {
    for spacing in [0.002, 0.02, 0.2] {
        let batch = line(spacing, [0.5; LINE]);
        let normals = [Vec3::Z, Vec3::new(0.3, 0.1, 0.6), Vec3::new(-0.7, 2.0, 0.9)];
        for normal in normals {
            let flat = residuals(&batch, |dir| 2.0 / normal.dot(dir));
            assert_eq!(flat.len(), 2);
            assert!(flat.iter().all(|r| r.abs() < 1e-4), "{spacing}, {normal}: {flat:?}");
        }
        // The sphere is around the camera: on it all distances are equal.
        let sphere = residuals(&batch, |_| 2.0);
        let edge = residuals(&batch, |dir| if dir.x / dir.z > 0.2 + 1.5 * spacing { 2.0 } else { 3.0 });
        println!("{spacing}: {sphere:?} {edge:?}");
        assert!(spacing < 0.1 || sphere.iter().all(|r| r.abs() > 1e-3), "{spacing}: {sphere:?}");
        assert!(edge.iter().any(|r| r.abs() > 0.1), "{spacing}: {edge:?}");
    }
}

#[test]
fn neighbours_of_another_colour_weigh_less() {
    let weights = |brightness| triples(&line(0.1, brightness), 0..LINE).map(|t| t.weight).collect::<Vec<_>>();
    let (even, edge) = (weights([0.5; LINE]), weights([0.5, 0.5, 0.5, 0.8]));
    assert_eq!(even, [0.25, 0.25]);
    assert!(edge[0] == 0.25 && edge[1] < 0.001, "{edge:?}");
}

//! Rays, boxes and lenses against the oracle.

use crate::table::{Row, Worst, cases};
use glam::Vec3;
use nerf_core::camera::{Camera, Intrinsics, Pose};
use nerf_core::lens::Lens;
use nerf_core::ray::{Ray, SceneBox};
use nerf_tests::oracle;

cases! {
    rays_are_of_unit_length: "|1 - length| over images from 1x1 to 65535x65535" => unit_rays;
    rays_point_where_the_pinhole_says: "angle to the oracle's direction, radians" => pinhole;
    lenses_are_undone: "error of distort(undistort(p)), relative outside of the unit circle" => lenses;
    boxes_are_entered_and_left: "error of t, relative to the numbers it is made of" => boxes;
    hits_and_misses: "share of 100,000 rays, hard ones among them, decided otherwise beyond rounding" => decisions;
}

fn noise(state: &mut u64) -> f64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

fn somewhere(state: &mut u64) -> Vec3 {
    Vec3::from_array([0; 3].map(|_| noise(state) as f32))
}

/// Cameras of every shape that look from somewhere to somewhere else.
fn cameras(state: &mut u64) -> Vec<Camera> {
    let shapes = [(1, 1), (1, 65_535), (65_535, 1), (640, 480), (65_535, 65_535), (3, 2)];
    let camera = |(i, (width, height)): (usize, (u32, u32))| {
        let size = f64::from(width.max(height));
        let focal = (size * [0.05, 0.5, 1.0, 20.0][i % 4]) as f32;
        let pose = Pose::look_at(10.0 * somewhere(state), somewhere(state), Vec3::Y).expect("a pose");
        Camera::new(Intrinsics::centred(width, height, focal), Lens::NONE, pose).expect("a camera")
    };
    shapes.into_iter().cycle().take(48).enumerate().map(camera).collect()
}

fn each_ray(mut see: impl FnMut(&Camera, f32, f32, Ray)) {
    let mut state = 11;
    for camera in cameras(&mut state) {
        let i = *camera.intrinsics();
        for _ in 0..500 {
            let (u, v) = (0.5 + 0.5 * noise(&mut state), 0.5 + 0.5 * noise(&mut state));
            let (x, y) = ((u * f64::from(i.width)) as f32, (v * f64::from(i.height)) as f32);
            see(&camera, x, y, camera.ray(x, y));
        }
        for (x, y) in [(0.0, 0.0), (i.width as f32, 0.0), (i.width as f32, i.height as f32)] {
            see(&camera, x, y, camera.ray(x, y));
        }
    }
}

fn unit_rays() -> Vec<Row> {
    let mut worst = Worst::default();
    each_ray(|camera, x, y, ray| {
        let length = ray.dir.to_array().map(f64::from).iter().map(|d| d * d).sum::<f64>().sqrt();
        worst.see((1.0 - length).abs(), || {
            format!("({x}, {y}) of {}x{}", camera.intrinsics().width, camera.intrinsics().height)
        });
    });
    vec![worst.row("any", "any", 2e-7)]
}

fn pinhole() -> Vec<Row> {
    let mut worst = Worst::default();
    each_ray(|camera, x, y, ray| {
        let (i, rows) = (camera.intrinsics(), camera.pose().to_rows());
        let local = [
            (f64::from(x) - f64::from(i.cx)) / f64::from(i.fx),
            -(f64::from(y) - f64::from(i.cy)) / f64::from(i.fy),
            -1.0,
        ];
        let world = [0, 1, 2].map(|r| (0..3).map(|c| f64::from(rows[r][c]) * local[c]).sum::<f64>());
        let length = world.iter().map(|d| d * d).sum::<f64>().sqrt();
        let off: f64 = (0..3).map(|k| (world[k] / length - f64::from(ray.dir[k])).powi(2)).sum();
        worst.see(off.sqrt(), || format!("({x}, {y}) of {}x{}", i.width, i.height));
    });
    vec![worst.row("any", "any", 5e-7)]
}

fn lenses() -> Vec<Row> {
    let mut worst = Worst::default();
    let mut state = 13;
    let lenses = [
        Lens { k1: 0.1, k2: 0.02, p1: 0.0, p2: 0.0 },
        Lens { k1: -0.2, k2: 0.05, p1: 0.001, p2: -0.002 },
        Lens { k1: 0.5, k2: 0.5, p1: 0.01, p2: 0.01 },
    ];
    for lens in lenses {
        for _ in 0..5_000 {
            let (x, y) = (0.8 * noise(&mut state), 0.8 * noise(&mut state));
            let Some((u, v)) = lens.undistort(x as f32, y as f32) else { continue };
            let (u, v) = (f64::from(u), f64::from(v));
            let [k1, k2, p1, p2] = [lens.k1, lens.k2, lens.p1, lens.p2].map(f64::from);
            let r2 = u * u + v * v;
            let radial = 1.0 + k1 * r2 + k2 * r2 * r2;
            // OpenCV's model.
            let found = [
                u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u),
                v * radial + p1 * (r2 + 2.0 * v * v) + 2.0 * p2 * u * v,
            ];
            let (x, y) = (f64::from(x as f32), f64::from(y as f32));
            let off = (found[0] - x).hypot(found[1] - y) / x.hypot(y).max(1.0);
            worst.see(off, || format!("({x:.4}, {y:.4}) of {lens:?}"));
        }
    }
    // The residual Newton's method stops at, and the rounding of checking it.
    vec![worst.row("any", "any", 1.5e-6)]
}

/// Origins and directions that hurt: on faces, edges and corners, parallel, along diagonals, from inside.
fn hard_rays() -> Vec<Ray> {
    let values = [-1.0f32, 1.0, 0.0, -0.0, 0.5, 1.0f32.next_up(), 1.0f32.next_down(), 4.0, 1e-38, 1e6];
    let dirs = [0.0f32, -0.0, 1.0, -1.0, 1e-30, 1e-7, 0.707_106_77];
    let mut rays = Vec::new();
    for x in values {
        for y in values {
            for (i, dx) in dirs.into_iter().enumerate() {
                for dy in dirs {
                    let z = values[(i + rays.len()) % values.len()];
                    rays.push(Ray { origin: Vec3::new(x, y, z), dir: Vec3::new(dx, dy, -1.0).normalize() });
                }
            }
        }
    }
    let mut state = 17;
    while rays.len() < 100_000 {
        let origin = 3.0 * somewhere(&mut state);
        let dir = (somewhere(&mut state) - origin).normalize();
        rays.push(Ray { origin, dir });
    }
    rays
}

/// What the oracle says, and how far a `t` may be off by rounding alone.
fn truth(ray: &Ray) -> (Option<(f64, f64)>, f64) {
    let (o, d) = (ray.origin.to_array().map(f64::from), ray.dir.to_array().map(f64::from));
    let slope = d.iter().map(|x| x.abs()).filter(|x| *x > 0.0).fold(1.0, f64::min);
    let reach = 1.0 + o.iter().map(|x| x.abs()).fold(0.0, f64::max);
    (oracle::sampling::clip(o, d, [-1.0; 3], [1.0; 3], 0.0, 1e7), reach / slope)
}

fn unit_box() -> SceneBox {
    SceneBox::new(Vec3::NEG_ONE, Vec3::ONE).expect("a box")
}

fn boxes() -> Vec<Row> {
    let mut worst = Worst::default();
    for ray in hard_rays() {
        let (truth, reach) = truth(&ray);
        if let (Some((a, b)), Some((enter, exit))) = (truth, unit_box().clip(&ray, 0.0, 1e7)) {
            let off = (f64::from(enter) - a).abs().max((f64::from(exit) - b).abs());
            worst.see(off / reach, || format!("{ray:?}"));
        }
    }
    vec![worst.row("any", "any", 2e-7)]
}

fn decisions() -> Vec<Row> {
    let (mut wrong, rays) = (0usize, hard_rays());
    let mut at = String::new();
    for ray in &rays {
        let found = unit_box().clip(ray, 0.0, 1e7);
        let (truth, reach) = truth(ray);
        // What is inside for less than rounding, or outside by less, may be decided either way.
        let stay = truth.map_or(0.0, |(a, b)| b - a);
        let sure = match (truth, found) {
            (Some(_), None) => stay > 1e-6 * reach,
            (None, Some((a, b))) => f64::from(b - a) > 1e-6 * reach,
            _ => false,
        };
        if sure {
            wrong += 1;
            at = format!("{ray:?}");
        }
    }
    let row = Worst { error: wrong as f64 / rays.len() as f64, at };
    vec![row.row("any", "any", 0.0)]
}

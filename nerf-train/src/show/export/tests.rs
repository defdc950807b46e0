use super::net::Net;
use super::optical_depth::OpticalDepth;
use super::*;
use glam::Vec3;
use half::f16;
use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::Ray;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::Renderer;
use nerf_core::space::SceneBox;
use std::collections::HashMap;

const BOX: SceneBox = SceneBox { min: Vec3::splat(-1.0), max: Vec3::ONE };

/// Returns the surface net of a solid in a lattice 24 cells across: vertices, triangles, and the side of a cell.
/// `distance`: signed distance from a point to the solid, below 0 inside.
fn net(distance: impl Fn(Vec3) -> f32) -> (Vec<Vec3>, Vec<[u32; 3]>, f32) {
    let lattice = Lattice::new(&BOX, 24).expect("a lattice");
    let mut net = Net::new(&lattice);
    for z in 0..=lattice.cells[2] {
        let inside =
            |p: &[f32; 3]| f16::from_f32((0.5 - distance(Vec3::from(*p)) / lattice.cell).clamp(0.0, 1.0));
        net.slice(z, lattice.slice(z).iter().map(inside).collect()).expect("few vertices");
    }
    (net.positions, net.triangles, lattice.cell)
}

/// Returns the volume of a mesh, above 0 if its triangles face outward. Fails unless each edge is used equally often in
/// both directions, as in a closed surface of consistent orientation.
fn closed_volume(positions: &[Vec3], triangles: &[[u32; 3]]) -> f32 {
    let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
    let mut volume = 0.0;
    for &[a, b, c] in triangles {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            *edges.entry((from.min(to), from.max(to))).or_default() += if from < to { 1 } else { -1 };
        }
        let [a, b, c] = [a, b, c].map(|i| positions[i as usize]);
        volume += a.dot(b.cross(c)) / 6.0;
    }
    assert!(edges.values().all(|&balance| balance == 0), "an open edge");
    volume
}

#[test]
fn a_ball_becomes_a_closed_surface_turned_outward() {
    let (positions, triangles, cell) = net(|p| p.length() - 0.7);
    let expected = 4.0 / 3.0 * std::f32::consts::PI * 0.7f32.powi(3);
    let volume = closed_volume(&positions, &triangles);
    assert!((volume / expected - 1.0).abs() < 0.02, "{volume} {expected}");
    assert!(positions.iter().all(|p| (p.length() - 0.7).abs() < 0.11 * cell));
    // Euler characteristic of a sphere: vertices − edges + faces = 2, with 3/2 edges per triangle.
    assert_eq!(positions.len() - triangles.len() / 2, 2);
}

#[test]
fn a_ring_has_a_hole_and_what_reaches_the_box_is_closed_there() {
    let (positions, triangles, _) = net(|p| Vec3::new(p.truncate().length() - 0.6, p.z, 0.0).length() - 0.25);
    assert!(closed_volume(&positions, &triangles) > 0.0);
    assert_eq!(positions.len() as i64 - triangles.len() as i64 / 2, 0);
    // A solid that fills the box: its surface is that of the box.
    let solid = |p: Vec3| if p.abs().max_element() < 1.001 { -1.0 } else { 1.0 };
    let (positions, triangles, cell) = net(solid);
    let volume = closed_volume(&positions, &triangles);
    assert!((volume - (2.0 + cell).powi(3)).abs() < 0.5, "{volume}");
}

/// Returns the vertices of the visible surface in a lattice 40 cells across. `density`: density at a point of the box
/// −1 to 1. `decay`: as in [`OpticalDepth::new`], number of cells; infinite: no decay.
fn seen(density: impl Fn(Vec3) -> f32, decay: f32) -> Vec<Vec3> {
    let lattice = Lattice::new(&BOX, 40).expect("a lattice");
    let within = |p: Vec3| if p.abs().max_element() > 1.001 { 0.0 } else { density(p) };
    let slice =
        |z| lattice.slice(z).iter().map(|p| f16::from_f32(within(Vec3::from(*p)) * lattice.cell)).collect();
    let densities: Vec<Vec<f16>> = (0..=lattice.cells[2]).map(slice).collect();
    let depths = OpticalDepth::new(&lattice, &densities, decay);
    let mut net = Net::new(&lattice);
    for z in 0..=lattice.cells[2] {
        net.slice(z, depths.levels(z)).expect("few vertices");
    }
    net.positions
}

#[test]
fn of_a_hollow_ball_only_the_outside_is_visible_unless_seen_from_inside_too() {
    let cell = 0.05;
    let shell = |p: Vec3| if (0.6..0.8).contains(&p.length()) { 500.0 } else { 0.0 };
    let near = |p: &Vec3, radius: f32| (p.length() - radius).abs() < 1.5 * cell;
    let outside = seen(shell, f32::INFINITY);
    assert!(!outside.is_empty() && outside.iter().all(|p| near(p, 0.8)));
    let both = seen(shell, 8.0);
    assert!(both.iter().all(|p| near(p, 0.8) || near(p, 0.6)));
    assert!(both.iter().filter(|p| near(p, 0.6)).count() > outside.len() / 3);
}

#[test]
fn soft_matter_has_its_surface_where_opacity_crosses_a_half() {
    // With uniform density, the optical depth from a face along its normal is density times distance.
    let density = 4.0;
    let half = std::f32::consts::LN_2 / density;
    let points = seen(|_| density, f32::INFINITY);
    let of_middle = |p: &&Vec3| p.truncate().abs().max_element() < 0.3 && p.z > 0.0;
    let depths: Vec<f32> = points.iter().filter(of_middle).map(|p| 1.0 - p.z).collect();
    assert!(!depths.is_empty());
    // The third smallest of the 26 sums belongs to a direction at 45 or 54.7 degrees to the normal, not along it.
    for depth in depths {
        assert!((0.5..1.1).contains(&(depth / half)), "{depth} {half}");
    }
    // Opacity stays below 1/2, so there is no surface.
    assert!(seen(|_| 0.2, f32::INFINITY).is_empty());
}

#[test]
fn no_vertex_is_further_than_two_cells_from_where_opacity_crosses_a_half() {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../nerf-core/examples/firmware/grid.nerf");
    let bytes = std::fs::read(file).expect(file);
    let blob = Blob::open(&bytes).expect("a blob");
    let (bounds, kernel) = (blob.scene_box().expect("a scene"), Kernel::detect());
    let quality = Quality { occupancy: true, ..Quality::EXACT };
    let plan = Plan::new(&blob, &quality, Outputs::ALL, Batch::FULL).expect("a plan");
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    let renderer = Renderer::new(blob, kernel, &mut memory).expect("a renderer");
    let field = Field::new(&renderer, &plan);
    let lattice = Lattice::new(&bounds, 64).expect("a lattice");
    let mesh = mesh(&field, &lattice, Surface::Visible, |_| {}).expect("a mesh");
    assert!(mesh.vertices.len() > 1000, "{}", mesh.vertices.len());
    let mut off = vec![f32::INFINITY; mesh.vertices.len()];
    // A vertex may have moved, so the start of its ray is unknown. Starts 2 to 10 cells outside of the vertex are
    // tried.
    for before in (8..=40).map(|quarters| 0.25 * quarters as f32) {
        let ray = |vertex: &Vertex| {
            let (point, normal) = (Vec3::from(vertex.position), Vec3::from(vertex.normal));
            Ray { origin: point + before * lattice.cell * normal, dir: -normal }
        };
        let rays: Vec<Ray> = mesh.vertices.iter().map(ray).collect();
        let steps = (4.0 * (before + 2.0)) as usize;
        let crossings = field.half_way(&rays, (before + 2.0) * lattice.cell, steps).expect("rays");
        for (off, distance) in off.iter_mut().zip(crossings) {
            *off =
                off.min(distance.map_or(f32::INFINITY, |distance| (distance / lattice.cell - before).abs()));
        }
    }
    let worst = off.iter().fold(0.0, |worst: f32, &off| worst.max(off));
    assert!(worst <= 2.0, "{worst}");
    // Except where the field is rough, triangles face the way their vertex normals point.
    let turned = mesh.triangles.iter().filter(|triangle| {
        let [a, b, c] = triangle.map(|i| mesh.vertices[i as usize]);
        let [p, q, r] = [a, b, c].map(|vertex| Vec3::from(vertex.position));
        let normal = Vec3::from(a.normal) + Vec3::from(b.normal) + Vec3::from(c.normal);
        (q - p).cross(r - p).dot(normal) > 0.0
    });
    let share = turned.count() as f32 / mesh.triangles.len() as f32;
    assert!(share > 0.9, "{share}");
}

fn triangle(origin: [f64; 3]) -> Mesh {
    let vertex =
        |x: f32, y: f32| Vertex { position: [x, y, 0.5], normal: [0.0, 0.0, 1.0], rgb: [x, y, 0.25] };
    Mesh {
        origin,
        vertices: vec![vertex(0.0, 0.0), vertex(1.0, 0.0), vertex(0.0, 1.0)],
        triangles: vec![[0, 1, 2]],
    }
}

#[test]
fn files_say_what_the_mesh_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let read = |name: &str| std::fs::read(folder.path().join(name)).expect("a file");
    let far = [500_000.0, 4_000_000.0, 100.0];

    write_ply(&triangle([0.0; 3]), &folder.path().join("near.ply")).expect("written");
    let near = read("near.ply");
    let header = near.windows(11).position(|w| w == b"end_header\n").expect("a header") + 11;
    assert_eq!(near.len(), header + 3 * (24 + 3) + 13);
    assert_eq!(near[header + 27..header + 31], 1.0f32.to_le_bytes());
    assert_eq!(near[header + 27 + 24..header + 27 + 27], [255, 0, 64]);
    write_ply(&triangle(far), &folder.path().join("far.ply")).expect("written");
    let text = String::from_utf8_lossy(&read("far.ply")).into_owned();
    assert!(text.contains("property double x"), "{text}");

    write_obj(&triangle(far), &folder.path().join("far.obj")).expect("written");
    let text = String::from_utf8(read("far.obj")).expect("text");
    assert!(text.contains("v 500001 4000000 100.5 1.0000 0.0000 0.2500\n"), "{text}");
    assert!(text.contains("f 1//1 2//2 3//3\n"), "{text}");

    write_glb(&triangle(far), &folder.path().join("far.glb")).expect("written");
    let glb = read("far.glb");
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().expect("four bytes")) as usize;
    assert_eq!((&glb[..4], word(4), word(8)), (&b"glTF"[..], 2, glb.len()));
    let json: serde_json::Value = serde_json::from_slice(&glb[20..20 + word(12)]).expect("JSON");
    assert_eq!(json["nodes"][0]["translation"], serde_json::json!(far));
    assert_eq!(json["accessors"][0]["max"], serde_json::json!([1.0, 1.0, 0.5]));
    assert_eq!(word(20 + word(12)) + 28 + word(12), glb.len());
}

#[test]
fn points_lie_on_the_surface_and_are_the_same_for_the_same_seed() {
    let mesh = triangle([1.0, 2.0, 3.0]);
    let points = points_of_surface(&mesh, 1000, 7);
    assert_eq!((points.vertices.len(), points.triangles.len(), points.origin), (1000, 0, mesh.origin));
    for Vertex { position: [x, y, z], normal, rgb } in &points.vertices {
        assert!(*x >= 0.0 && *y >= 0.0 && x + y <= 1.0 + 1e-6 && (z - 0.5).abs() < 1e-6);
        assert!((rgb[0] - x).abs() < 1e-5 && (rgb[1] - y).abs() < 1e-5 && (normal[2] - 1.0).abs() < 1e-5);
    }
    let mean = points.vertices.iter().map(|vertex| vertex.position[0]).sum::<f32>() / 1000.0;
    assert!((mean - 1.0 / 3.0).abs() < 0.02, "{mean}");
    assert_eq!(points, points_of_surface(&mesh, 1000, 7));
    assert_ne!(points, points_of_surface(&mesh, 1000, 8));
}

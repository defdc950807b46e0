//! The surface of a field, as a coloured triangle mesh.

use super::field::Field;
use super::lattice::Lattice;
use super::net::{NONE, Net};
use super::optical_depth::{OpticalDepth, level};
use super::{Mesh, Vertex};
use crate::system::memory;
use anyhow::bail;
use glam::Vec3;
use half::f16;
use nerf_core::camera::Ray;

/// Distance from the start of a vertex's inward ray to the vertex, cells.
const BEFORE: f32 = 2.0;
/// Number of samples per cell along a vertex's inward ray.
const SAMPLES: f32 = 4.0;
/// Distance from a vertex to the end of its inward ray, cells. A vertex whose ray meets no surface is left out.
const BEHIND: f32 = 8.0;
/// Largest distance between a vertex and the surface behind the vertex, cells. If the surface is farther away, the
/// vertex moves along its inward ray by the excess, rounded up to a quarter of a cell.
const NEAR: f32 = 1.75;
/// Length over which sums of optical depth fall by a factor of e, cells; used by [`Surface::VisibleFromInside`].
const DECAY: f32 = 8.0;
/// Number of times that each normal is averaged with its neighbours, because normals of single cells are noisy.
const NORMAL_PASSES: usize = 6;
/// Number of vertices whose rays and colours are evaluated together.
const BATCH: usize = 1 << 16;
/// Memory per vertex, with its two triangles, while the mesh is made, bytes.
const BYTES_PER_VERTEX: u64 = 200;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// Surface at which the opacity of rays from outside of the box crosses 1/2.
    Visible,
    /// Surface at which the opacity of rays from any free space crosses 1/2, for a scene that is seen from inside.
    VisibleFromInside,
    /// Isosurface of this density, 1/world unit, visible or not.
    Density(f32),
}

/// Extracts the surface of a field as a mesh. Each vertex has the colour seen from outside, along its inward normal.
///
/// The mesh is a surface net, of densities or of optical depths, with smoothed normals. For a visible surface, a vertex
/// is left out if the opacity along its inward ray stays below 1/2. If the opacity crosses 1/2 far behind a vertex, the
/// vertex moves to about two cells in front of the crossing: closer vertices would make triangles intersect. `each`
/// gets the number of finished slices, summed over three passes. Fails if the box holds no surface.
pub fn mesh(
    field: &Field<'_, '_>,
    lattice: &Lattice,
    surface: Surface,
    mut each: impl FnMut(usize),
) -> anyhow::Result<Mesh> {
    let slices = lattice.cells[2] + 1;
    let mut cells = Vec::with_capacity(slices);
    for z in 0..slices {
        cells.push(lattice.cell_depths(field, z)?);
        each(z + 1);
    }
    let highest = match surface {
        Surface::Density(_) => cells.iter().flatten().fold(0.0, |highest, depth| depth.to_f32().max(highest)),
        _ => 0.0,
    };
    let net = net(lattice, cells, surface, |slice| each(slices + slice))?;
    let what = format!("a mesh of {} vertices", net.positions.len());
    memory::check(what, net.positions.len() as u64, BYTES_PER_VERTEX, "lower --resolution")?;
    let Net { positions, mut normals, triangles, .. } = net;
    smooth(&mut normals, &triangles);
    let mut vertices = Vec::with_capacity(positions.len());
    for (points, normals) in positions.chunks(BATCH).zip(normals.chunks(BATCH)) {
        let inward = |(&position, &normal): (&Vec3, &Vec3)| {
            Some(Place { position, surface: lattice.clamp(position - 0.5 * lattice.cell * normal) })
        };
        let places = match surface {
            Surface::Density(_) => points.iter().zip(normals).map(inward).collect(),
            _ => settled(field, lattice.cell, points, normals)?,
        };
        vertices.extend(coloured(field, &places, normals)?);
        each(2 * slices + slices * vertices.len() / positions.len());
    }
    let mesh = kept(&vertices, &triangles);
    match surface {
        _ if !mesh.triangles.is_empty() => Ok(mesh),
        Surface::Density(threshold) => bail!(
            "--threshold: expected a density that the scene reaches, found {threshold}: its highest in the box is {} a world unit",
            highest / lattice.cell
        ),
        _ => bail!("nothing in the box is opaque: expected another --box, or a --threshold"),
    }
}

/// Makes the net of `surface`. `cells`: [`Lattice::cell_depths`] of slices. `each` gets the number of finished slices.
fn net<'l>(
    lattice: &'l Lattice,
    cells: Vec<Vec<f16>>,
    surface: Surface,
    mut each: impl FnMut(usize),
) -> anyhow::Result<Net<'l>> {
    let mut net = Net::new(lattice);
    let mut take = |z: usize, levels: Vec<f16>| {
        each(z + 1);
        net.slice(z, levels)
    };
    match surface {
        Surface::Density(threshold) => {
            let inside = |depth: &f16| level(depth.to_f32() / (threshold * lattice.cell));
            for (z, cells) in cells.iter().enumerate() {
                take(z, cells.iter().map(inside).collect())?;
            }
        }
        Surface::Visible | Surface::VisibleFromInside => {
            let decay = if surface == Surface::Visible { f32::INFINITY } else { DECAY };
            let depths = OpticalDepth::new(lattice, &cells, decay);
            drop(cells);
            for z in 0..=lattice.cells[2] {
                take(z, depths.levels(z))?;
            }
        }
    }
    Ok(net)
}

/// Averages normals with neighbours' normals [`NORMAL_PASSES`] times; a neighbour counts once per shared triangle.
fn smooth(normals: &mut [Vec3], triangles: &[[u32; 3]]) {
    for _ in 0..NORMAL_PASSES {
        let mut sums = normals.to_vec();
        for triangle in triangles {
            let [a, b, c] = triangle.map(|i| i as usize);
            sums[a] += normals[b] + normals[c];
            sums[b] += normals[c] + normals[a];
            sums[c] += normals[a] + normals[b];
        }
        normals.iter_mut().zip(sums).for_each(|(normal, sum)| *normal = sum.normalize_or(*normal));
    }
}

/// Position of a vertex, and the point on the surface that gives its colour.
#[derive(Clone, Copy)]
struct Place {
    position: Vec3,
    surface: Vec3,
}

/// Moves vertices towards the surface, as in [`mesh`], and returns their positions; `None` for one that is left out.
fn settled(
    field: &Field<'_, '_>,
    cell: f32,
    points: &[Vec3],
    normals: &[Vec3],
) -> anyhow::Result<Vec<Option<Place>>> {
    let ray =
        |(&point, &normal): (&Vec3, &Vec3)| Ray { origin: point + BEFORE * cell * normal, dir: -normal };
    let rays: Vec<Ray> = points.iter().zip(normals).map(ray).collect();
    let length = BEFORE + BEHIND;
    let crossings = field.half_way(&rays, length * cell, (length * SAMPLES) as usize)?;
    let moved = |distance: f32| (4.0 * (distance / cell - BEFORE - NEAR).max(0.0)).ceil() / 4.0;
    let place = |((ray, &point), distance): ((&Ray, &Vec3), Option<f32>)| {
        let distance = distance?;
        Some(Place { position: point + moved(distance) * cell * ray.dir, surface: ray.at(distance) })
    };
    Ok(rays.iter().zip(points).zip(crossings).map(place).collect())
}

/// Returns the vertices at `places`, each with the colour seen along its inward normal. An entry `None` stays `None`.
fn coloured(
    field: &Field<'_, '_>,
    places: &[Option<Place>],
    normals: &[Vec3],
) -> anyhow::Result<Vec<Option<Vertex>>> {
    let points: Vec<[f32; 3]> =
        places.iter().map(|place| place.map_or([0.0; 3], |place| place.surface.into())).collect();
    let dirs: Vec<[f32; 3]> = normals.iter().map(|normal| (-*normal).into()).collect();
    let (_, rgb) = field.seen(&points, &dirs)?;
    let vertex = |((place, &normal), rgb): ((&Option<Place>, &Vec3), [f32; 3])| {
        place.map(|place| Vertex { position: place.position.into(), normal: normal.into(), rgb })
    };
    Ok(places.iter().zip(normals).zip(rgb).map(vertex).collect())
}

/// Returns the mesh of the triangles whose three vertices exist and have different positions.
fn kept(vertices: &[Option<Vertex>], triangles: &[[u32; 3]]) -> Mesh {
    let mut mesh = Mesh::default();
    let mut places = vec![NONE; vertices.len()];
    for triangle in triangles {
        let [Some(a), Some(b), Some(c)] = triangle.map(|i| vertices[i as usize].map(|v| v.position)) else {
            continue;
        };
        if a == b || b == c || c == a {
            continue;
        }
        mesh.triangles.push(triangle.map(|i| {
            let place = &mut places[i as usize];
            if *place == NONE {
                *place = mesh.vertices.len() as u32;
                mesh.vertices.extend(vertices[i as usize]);
            }
            *place
        }));
    }
    mesh
}

//! The surface of a field, as a coloured triangle mesh.

use super::field::Field;
use super::lattice::Lattice;
use super::net::{NONE, Net};
use super::optical_depth::{OpticalDepth, level};
use super::{ExportError, Mesh, Vertex};
use glam::Vec3;
use nerf_core::camera::Ray;
use nerf_core::render::RaySegment;

/// A ray to a vertex starts so many cells in front of it.
const BEFORE: f32 = 2.0;
/// It must meet the surface up to so many cells behind it.
const BEHIND: f32 = 8.0;
/// A vertex further in front of where its ray meets the surface moves, in steps of a quarter of a cell, cells.
const NEAR: f32 = 1.75;
/// Cells over which an optical depth is forgotten in a scene that is seen from inside.
const FREE: f32 = 8.0;
/// Each normal becomes the mean of its own and its neighbours' so many times: those of single cells are noise.
const NORMAL_PASSES: usize = 6;
/// Vertices for which rays are rendered and colours asked at a time.
const BATCH: usize = 1 << 16;

/// Where the surface of a field is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// Where the opacity of rays from outside of the box crosses 1/2.
    Visible,
    /// Where that of rays from any free space does, for a scene that is seen from inside.
    VisibleFromInside,
    /// Where the density is this, 1/world unit, visible or not.
    Density(f32),
}

/// The surface of a field, with colours as seen against the normals.
///
/// A surface net of the lattice's optical depths, or densities; its normals are smoothed. Along the normal of each vertex of a
/// visible surface a ray is rendered: the vertex moves along it as little as brings it within two cells of where the ray's
/// opacity crosses 1/2, so that triangles tangle little, and is left out where the opacity stays below. `each` is told how
/// many slices are done, of three times as many as the lattice has.
///
/// # Errors
/// [`ExportError::Empty`] where no density is above the threshold, [`ExportError::Clear`] where no opacity reaches 1/2,
/// [`ExportError::Vertices`].
pub fn mesh(
    field: &Field<'_, '_>,
    lattice: &Lattice,
    surface: Surface,
    mut each: impl FnMut(usize),
) -> Result<Mesh, ExportError> {
    let slices = lattice.cells[2] + 1;
    let mut densities = Vec::with_capacity(slices);
    for z in 0..slices {
        densities.push(lattice.densities(field, z)?);
        each(z + 1);
    }
    let mut net = Net::new(lattice);
    match surface {
        Surface::Density(threshold) => {
            for (z, densities) in densities.iter().enumerate() {
                net.slice(z, densities.iter().map(|sigma| level(sigma.to_f32() / threshold)).collect())?;
                each(slices + z + 1);
            }
        }
        Surface::Visible | Surface::VisibleFromInside => {
            let memory = if surface == Surface::Visible { f32::INFINITY } else { FREE };
            let depths = OpticalDepth::new(lattice, &densities, memory);
            for z in 0..slices {
                net.slice(z, depths.levels(z))?;
                each(slices + z + 1);
            }
        }
    }
    let Net { positions, mut normals, triangles, .. } = net;
    smooth(&mut normals, &triangles);
    let mut vertices = Vec::with_capacity(positions.len());
    for (points, normals) in positions.chunks(BATCH).zip(normals.chunks(BATCH)) {
        let points = match surface {
            Surface::Density(_) => points.iter().copied().map(Some).collect(),
            _ => settled(field, lattice.cell, points, normals)?,
        };
        vertices.extend(coloured(field, &points, normals)?);
        each(2 * slices + slices * vertices.len() / positions.len());
    }
    let mesh = kept(&vertices, &triangles);
    match surface {
        _ if !mesh.triangles.is_empty() => Ok(mesh),
        Surface::Density(threshold) => {
            let highest = densities.iter().flatten().fold(0.0, |highest, sigma| sigma.to_f32().max(highest));
            Err(ExportError::Empty { threshold, highest })
        }
        _ => Err(ExportError::Clear),
    }
}

/// Smooths normals over the edges of the triangles; an edge counts once for each of its triangles.
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

/// Points within two cells of where the opacity of rays along their normals crosses 1/2; `None` where it stays below.
fn settled(
    field: &Field<'_, '_>,
    cell: f32,
    points: &[Vec3],
    normals: &[Vec3],
) -> Result<Vec<Option<Vec3>>, ExportError> {
    let ray = |(&point, &normal): (&Vec3, &Vec3)| {
        let ray = Ray { origin: point + BEFORE * cell * normal, dir: -normal };
        RaySegment { ray, t_min: 0.0, t_max: (BEFORE + BEHIND) * cell }
    };
    let rays: Vec<RaySegment> = points.iter().zip(normals).map(ray).collect();
    let moved = |distance: f32| (4.0 * (distance / cell - BEFORE - NEAR).max(0.0)).ceil() / 4.0;
    let place = |((&point, &normal), crossing): ((&Vec3, &Vec3), Option<f32>)| {
        crossing.map(|distance| point - moved(distance) * cell * normal)
    };
    Ok(points.iter().zip(normals).zip(field.half_way(&rays)?).map(place).collect())
}

/// Vertices with colours as seen against their normals.
fn coloured(
    field: &Field<'_, '_>,
    points: &[Option<Vec3>],
    normals: &[Vec3],
) -> Result<Vec<Option<Vertex>>, ExportError> {
    let places: Vec<[f32; 3]> = points.iter().map(|point| point.unwrap_or_default().into()).collect();
    let dirs: Vec<[f32; 3]> = normals.iter().map(|normal| (-*normal).into()).collect();
    let (_, rgb) = field.seen(&places, &dirs)?;
    let vertex = |((point, &normal), rgb): ((&Option<Vec3>, &Vec3), [f32; 3])| {
        point.map(|position| Vertex { position: position.into(), normal: normal.into(), rgb })
    };
    Ok(points.iter().zip(normals).zip(rgb).map(vertex).collect())
}

/// The mesh of those triangles all of whose vertices are there, at three places.
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

//! The surface at a density, as triangles.

use super::field::Field;
use super::lattice::Lattice;
use super::light::{Light, level};
use super::{ExportError, Mesh, Vertex};
use glam::Vec3;
use half::f16;
use nerf_core::camera::Ray;
use nerf_core::render::RaySegment;

/// No vertex in this cell.
const NONE: u32 = u32::MAX;
/// The twelve edges of a cube by the bits of their corners (x, y, z).
const EDGES: [(usize, usize); 12] =
    [(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)];
/// Cells in front of a vertex from where it is looked at.
const BEFORE: f32 = 2.0;
/// Cells behind it up to which half of the light must be gone.
const BEHIND: f32 = 8.0;
/// Where that is nearer than this, a vertex stays: it is as exact, and its neighbours are as they are.
const NEAR: f32 = 2.0;
/// In a scene that is seen from inside, light comes from free space of about so many cells.
const FREE: f32 = 8.0;
/// Vertices whose colours are asked for at a time.
const BATCH: usize = 1 << 16;

/// Where the surface of a field is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Surface {
    /// Where half of the light is gone that comes from outside of the box.
    Seen,
    /// The same of light from any free space, for a scene that is seen from inside.
    SeenFromInside,
    /// Where the density is this, 1/world unit, seen or not.
    Density(f32),
}

/// The surface of a field, with colours as from straight ahead.
///
/// One vertex in each cube of the lattice that the surface passes, at the mean of where it crosses the cube's edges, and two
/// triangles across each crossed edge. Of a seen surface each vertex is looked at from straight ahead once more: it moves to
/// where half of the light is gone where that is further behind, and goes where that is nowhere near. `each` is told how many
/// slices are done, of three times as many as the lattice has.
///
/// # Errors
/// [`ExportError::Empty`] where no density is above the threshold, [`ExportError::Clear`] where light gets through everywhere,
/// [`ExportError::Vertices`].
///
/// # Source
/// Gibson 1998, "Constrained elastic surface nets".
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
        Surface::Seen | Surface::SeenFromInside => {
            let memory = if surface == Surface::Seen { f32::INFINITY } else { FREE };
            let light = Light::new(lattice, &densities, memory);
            for z in 0..slices {
                net.slice(z, light.levels(z))?;
                each(slices + z + 1);
            }
        }
    }
    let mut vertices = Vec::with_capacity(net.positions.len());
    for (points, normals) in net.positions.chunks(BATCH).zip(net.normals.chunks(BATCH)) {
        vertices.extend(match surface {
            Surface::Density(_) => {
                coloured(field, &points.iter().copied().map(Some).collect::<Vec<_>>(), normals)?
            }
            _ => coloured(field, &settled(field, lattice.cell, points, normals)?, normals)?,
        });
        each(2 * slices + slices * vertices.len() / net.positions.len());
    }
    let mesh = kept(&vertices, &net.triangles);
    match surface {
        _ if !mesh.triangles.is_empty() => Ok(mesh),
        Surface::Density(threshold) => {
            let highest = densities.iter().flatten().fold(0.0, |highest, sigma| sigma.to_f32().max(highest));
            Err(ExportError::Empty { threshold, highest })
        }
        _ => Err(ExportError::Clear),
    }
}

/// A surface in the making, slice by slice.
pub(super) struct Net<'l> {
    lattice: &'l Lattice,
    /// Levels of the last slice.
    below: Vec<f16>,
    /// Vertices of the cubes of the last layer, and of the one before.
    layers: [Vec<u32>; 2],
    pub(super) positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    pub(super) triangles: Vec<[u32; 3]>,
}

impl<'l> Net<'l> {
    pub(super) fn new(lattice: &'l Lattice) -> Self {
        let cubes = || vec![NONE; lattice.cells[0] * lattice.cells[1]];
        Self {
            lattice,
            below: Vec::new(),
            layers: [cubes(), cubes()],
            positions: Vec::new(),
            normals: Vec::new(),
            triangles: Vec::new(),
        }
    }

    /// Takes the next slice in: vertices of the layer below it, and the faces whose four cubes are then there.
    pub(super) fn slice(&mut self, z: usize, above: Vec<f16>) -> Result<(), ExportError> {
        if z > 0 {
            self.layers.swap(0, 1);
            self.vertices(z - 1, &above)?;
            self.faces(z - 1, &above);
        }
        self.below = above;
        Ok(())
    }

    fn vertices(&mut self, z: usize, above: &[f16]) -> Result<(), ExportError> {
        let [width, height, _] = self.lattice.cells;
        let row = width + 1;
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let at = y * row + x;
            let slice = |slice: &[f16]| [at, at + 1, at + row, at + row + 1].map(|at| slice[at].to_f32());
            let ([a, b, c, d], [e, f, g, h]) = (slice(&self.below), slice(above));
            let values = [a, b, c, d, e, f, g, h];
            let inside = values.iter().filter(|&&value| value > 0.5).count();
            let vertex = &mut self.layers[1][y * width + x];
            *vertex = NONE;
            if inside == 0 || inside == 8 {
                continue;
            }
            *vertex = u32::try_from(self.positions.len())
                .ok()
                .filter(|&i| i != NONE)
                .ok_or(ExportError::Vertices)?;
            self.positions.push(self.lattice.corner([x, y, z]) + self.lattice.cell * crossing(&values));
            self.normals.push(-slope(&values).normalize_or(Vec3::Z));
        }
        Ok(())
    }

    /// Faces across the edges of the lower slice, and across those between the slices.
    fn faces(&mut self, z: usize, above: &[f16]) {
        let [width, height, _] = self.lattice.cells;
        let row = width + 1;
        let inside = |slice: &[f16], x: usize, y: usize| slice[y * row + x].to_f32() > 0.5;
        for (y, x) in (0..=height).flat_map(|y| (0..=width).map(move |x| (y, x))) {
            let here = inside(&self.below, x, y);
            let cube = |layer: usize, dx: usize, dy: usize| self.layers[layer][(y - dy) * width + x - dx];
            let mut faces = [None; 3];
            if z > 0 && x < width && (1..height).contains(&y) && here != inside(&self.below, x + 1, y) {
                faces[0] = Some([cube(0, 0, 1), cube(0, 0, 0), cube(1, 0, 0), cube(1, 0, 1)]);
            }
            if z > 0 && y < height && (1..width).contains(&x) && here != inside(&self.below, x, y + 1) {
                faces[1] = Some([cube(0, 1, 0), cube(1, 1, 0), cube(1, 0, 0), cube(0, 0, 0)]);
            }
            if (1..width).contains(&x) && (1..height).contains(&y) && here != inside(above, x, y) {
                faces[2] = Some([cube(1, 1, 1), cube(1, 0, 1), cube(1, 0, 0), cube(1, 1, 0)]);
            }
            for [a, b, c, d] in faces.into_iter().flatten() {
                // Counter-clockwise about the edge seen from its far end: outward where the near one is inside.
                let turned = if here { [a, b, c, d] } else { [d, c, b, a] };
                let [a, b, c, d] = turned;
                self.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
}

/// Where the surface crosses the edges of a cube, the mean, in shares of its side.
fn crossing(values: &[f32; 8]) -> Vec3 {
    let corner = |i: usize| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
    let crossed = EDGES.iter().filter(|(a, b)| (values[*a] > 0.5) != (values[*b] > 0.5));
    let (sum, count) = crossed.fold((Vec3::ZERO, 0.0), |(sum, count), &(a, b)| {
        let share = (0.5 - values[a]) / (values[b] - values[a]);
        (sum + corner(a).lerp(corner(b), share), count + 1.0)
    });
    sum / count
}

/// How a level rises across a cube, the mean of its edges.
fn slope(v: &[f32; 8]) -> Vec3 {
    let rise = |bit: usize| (0..8).map(|i| if i & bit == 0 { -v[i] } else { v[i] }).sum();
    Vec3::new(rise(1), rise(2), rise(4))
}

/// Points where half of the light is gone that comes along their normals; `None` where more gets through.
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
    let found = field.half_way(&rays)?;
    let place = |(&point, found): (&Vec3, Option<Vec3>)| {
        found.map(|found| if found.distance(point) > NEAR * cell { found } else { point })
    };
    Ok(points.iter().zip(found).map(place).collect())
}

/// Vertices with colours as from straight ahead.
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

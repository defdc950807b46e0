//! Surface net: triangles of the surface where levels at a lattice's corners (0 outside, 1 inside) cross 0.5.

use super::lattice::Lattice;
use anyhow::Context;
use glam::Vec3;
use half::f16;

pub(super) const NONE: u32 = u32::MAX;
/// The twelve edges of a cube as pairs of corner indices; corner (x, y, z), each 0 or 1, has index x + 2 y + 4 z.
const EDGES: [(usize, usize); 12] =
    [(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)];

/// Surface net, built slice by slice. Each cube that the surface crosses has a vertex: the mean of the crossings of its
/// edges. At each crossed edge, two triangles join the vertices of the four cubes around it.
///
/// # Source
/// Gibson 1998, "Constrained elastic surface nets".
pub(super) struct Net<'l> {
    lattice: &'l Lattice,
    /// Levels at the corners of the slice that was added last.
    below: Vec<f16>,
    /// Vertex index of each cube in the two topmost layers so far, lower layer first; [`NONE`]: cube without a vertex.
    layers: [Vec<u32>; 2],
    pub(super) positions: Vec<Vec3>,
    /// Unit normals, outward: opposite to the gradient of the levels in the vertex's cube.
    pub(super) normals: Vec<Vec3>,
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

    /// Adds slice `z`, in ascending order from 0. `above`: levels at the slice's corners. Makes vertices in the cubes
    /// below the slice, and then the faces of each crossed edge whose four cubes now have vertices.
    pub(super) fn slice(&mut self, z: usize, above: Vec<f16>) -> anyhow::Result<()> {
        if z > 0 {
            self.layers.swap(0, 1);
            self.vertices(z - 1, &above)?;
            self.faces(z - 1, &above);
        }
        self.below = above;
        Ok(())
    }

    fn vertices(&mut self, z: usize, above: &[f16]) -> anyhow::Result<()> {
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
            *vertex = u32::try_from(self.positions.len()).ok().filter(|&i| i != NONE).context(
                "--resolution: expected fewer than 2^32 vertices, found more: choose a smaller one",
            )?;
            self.positions.push(self.lattice.corner([x, y, z]) + self.lattice.cell * crossing(&values));
            self.normals.push(-slope(&values).normalize_or(Vec3::Z));
        }
        Ok(())
    }

    /// Adds the faces of crossed edges in slice `z` and from slice `z` to `z + 1`. `above`: levels of slice `z + 1`.
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
                // Counter-clockwise seen from the edge's far end: the face is outward if the near end is inside.
                let turned = if here { [a, b, c, d] } else { [d, c, b, a] };
                let [a, b, c, d] = turned;
                self.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
    }
}

/// Returns the mean of the points where the surface crosses the edges of a cube: position relative to the cube's lower
/// corner, in units of the cube's side. `values`: levels at the corners, with indices as in [`EDGES`].
fn crossing(values: &[f32; 8]) -> Vec3 {
    let corner = |i: usize| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
    let crossed = EDGES.iter().filter(|(a, b)| (values[*a] > 0.5) != (values[*b] > 0.5));
    let (sum, count) = crossed.fold((Vec3::ZERO, 0.0), |(sum, count), &(a, b)| {
        let share = (0.5 - values[a]) / (values[b] - values[a]);
        (sum + corner(a).lerp(corner(b), share), count + 1.0)
    });
    sum / count
}

/// Returns the gradient of a cube's levels `v`, indexed as in [`EDGES`]; only its direction is meaningful.
fn slope(v: &[f32; 8]) -> Vec3 {
    let rise = |bit: usize| (0..8).map(|i| if i & bit == 0 { -v[i] } else { v[i] }).sum();
    Vec3::new(rise(1), rise(2), rise(4))
}

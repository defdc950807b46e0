extern crate std;

use super::*;
#[cfg(feature = "normals")]
use crate::testing::Worse;
use crate::testing::{halve, noise};
use glam::Vec3;
use std::vec;
use std::vec::Vec;

fn isas() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
}

fn grid(features: u8, log2_entries: u8, resolutions: &[[u16; 3]]) -> GridEncoding {
    let inputs = if resolutions[0][2] == 0 { 2 } else { 3 };
    GridEncoding { inputs, features, log2_entries, resolutions: resolutions.iter().copied().collect() }
}

/// Grids with dense, hashed and tiny levels, in 2D and 3D, with 1, 2 and 4 features.
fn grids() -> Vec<GridEncoding> {
    let mut all = vec![
        grid(2, 0, &[[1, 1, 1]]),
        grid(1, 0, &[[1, 1, 1]]),
        grid(1, 0, &[[1, 1, 0]]),
        grid(2, 14, &[[16; 3], [20, 22, 24], [48, 50, 7], [320, 300, 3]]),
        grid(4, 1, &[[1, 1, 0], [2, 3, 0], [100, 7, 0]]),
        grid(2, 4, &[[2; 3]; MAX_GRID_LEVELS]),
        grid(2, 10, &[[MAX_GRID_RESOLUTION; 3], [MAX_GRID_RESOLUTION, 1, 1]]),
    ];
    for features in [1, 2, 4] {
        all.push(grid(features, 8, &[[4, 5, 6], [9, 8, 7], [31, 64, 33]]));
        all.push(grid(features, 8, &[[4, 5, 0], [9, 64, 0]]));
    }
    all
}

/// Quantises `values`, in [−1, 1], to int8. `scale` returns the scale of the level with the given index. Returns the
/// values' bytes, the scales' bytes, and the values that they encode.
fn quantise(
    grid: &GridEncoding,
    values: &[f32],
    scale: impl Fn(usize) -> f32,
) -> (Vec<u8>, Vec<u8>, Vec<f32>) {
    let (mut bytes, mut scales, mut exact) = (vec![], vec![], vec![]);
    for level in grid.levels() {
        let (scale, features) = (scale(level.index), usize::from(grid.features));
        scales.extend(scale.to_le_bytes());
        for value in &values[level.first * features..(level.first + level.entries) * features] {
            let step = (value * 127.0).round() as i8;
            bytes.push(step as u8);
            exact.push(f32::from(step) * scale);
        }
    }
    (bytes, scales, exact)
}

const UNIT: SceneBox = SceneBox { min: Vec3::ZERO, max: Vec3::ONE };

fn bounds_of(grid: &GridEncoding, bounds: &SceneBox) -> Option<SceneBox> {
    (grid.inputs == 3).then_some(*bounds)
}

/// Encodes the block of positions `x`: returns `[outputs][stride]`.
fn encode(isa: Isa, grid: &GridEncoding, values: TableValues<'_>, bounds: &SceneBox, x: &[f32]) -> Vec<f32> {
    let stride = x.len() / usize::from(grid.inputs);
    let mut out = vec![f32::NAN; grid.outputs() * stride];
    let tables = GridTables::new(values, bounds_of(grid, bounds).as_ref());
    encode_grid_block(isa, grid, &tables, stride, x, &mut out);
    out
}

/// Position of the coordinate `x` along one axis of the box, counted in cells: 0 to `cells`.
fn cells_along(bounds: &SceneBox, axis: usize, cells: u32, x: f32) -> f64 {
    let (min, max) = (bounds.min[axis], bounds.max[axis]);
    // The box's side is rounded to f32, as in the kernels.
    let u = (f64::from(x) - f64::from(min)) / f64::from(max - min);
    u.clamp(0.0, 1.0) * f64::from(cells)
}

/// Index of the table entry (counted from the level's first entry) and f64 interpolation weight of each vertex of the
/// cell that contains `x`. Computed from the grid's definition.
fn vertices(grid: &GridEncoding, level: usize, bounds: &SceneBox, x: &[f32]) -> Vec<(usize, f64)> {
    let cells = grid.resolutions[level].map(u32::from);
    let most = 1u64 << grid.log2_entries;
    let count: u64 = cells.iter().map(|&n| u64::from(n) + 1).product();
    let at: Vec<(u64, f64)> = (0..x.len())
        .map(|axis| {
            let g = cells_along(bounds, axis, cells[axis], x[axis]);
            let cell = g.floor().min(f64::from(cells[axis] - 1));
            (cell as u64, g - cell)
        })
        .collect();
    (0..1u64 << x.len())
        .map(|corner| {
            let far = |axis: usize| corner >> axis & 1;
            let weight = (0..x.len()).map(|a| if far(a) == 1 { at[a].1 } else { 1.0 - at[a].1 }).product();
            let v: Vec<u64> = (0..3).map(|a| if a < x.len() { at[a].0 + far(a) } else { 0 }).collect();
            let entry = if count <= most {
                (v[2] * u64::from(cells[1] + 1) + v[1]) * u64::from(cells[0] + 1) + v[0]
            } else {
                let h = ((v[1] * 2_654_435_761) & 0xffff_ffff) ^ ((v[2] * 805_459_861) & 0xffff_ffff);
                ((h ^ h >> 15) & (most - 1)) + v[0]
            };
            (entry as usize, weight)
        })
        .collect()
}

fn first_entry(grid: &GridEncoding, level: usize) -> usize {
    let most = 1usize << grid.log2_entries;
    let entries = |r: &[u16; 3]| {
        let count: usize = r.iter().map(|&n| usize::from(n) + 1).product();
        if count <= most { count } else { most + usize::from(r[0]) }
    };
    grid.resolutions[..level].iter().map(entries).sum()
}

/// Encodes the position `x` in f64. Returns each encoded value with a bound on the error of the f32 kernels, which
/// round the position and the sum.
fn oracle(grid: &GridEncoding, values: &[f32], bounds: &SceneBox, x: &[f32]) -> Vec<(f64, f64)> {
    let (features, ulp) = (usize::from(grid.features), 2f64.powi(-24));
    let mut out = vec![];
    for level in 0..grid.resolutions.len() {
        let first = first_entry(grid, level);
        let around = vertices(grid, level, bounds, x);
        for feature in 0..features {
            let value = |entry: usize| f64::from(values[(first + entry) * features + feature]);
            let all = |f: fn(f64, f64) -> f64| around.iter().map(|&(e, _)| value(e)).reduce(f).unwrap();
            let (least, most) = (all(f64::min), all(f64::max));
            let moved: f64 = (0..x.len())
                .map(|axis| {
                    let cells = u32::from(grid.resolutions[level][axis]);
                    3.0 * ulp * cells_along(bounds, axis, cells, x[axis]) + 3.0 * ulp
                })
                .sum();
            let size = least.abs().max(most.abs());
            // Rounding may move the position into the next cell, of another slope. Hence 2 · size, not most − least.
            let error = moved * 2.0 * size + 12.0 * ulp * size;
            out.push((around.iter().map(|&(e, w)| w * value(e)).sum(), error));
        }
    }
    out
}

/// Points on, next to and away from faces, edges and corners of cells of the first four levels: `[inputs][n]`, `n` a
/// multiple of 64.
fn hard_points(grid: &GridEncoding, bounds: &SceneBox) -> Vec<f32> {
    let inputs = usize::from(grid.inputs);
    let mut points: Vec<Vec<f32>> = vec![];
    let random = noise(3 * 640, 21);
    let place = |axis: usize, u: f32| bounds.min[axis] + u * (bounds.max[axis] - bounds.min[axis]);
    for p in random.chunks(3) {
        points.push((0..inputs).map(|axis| place(axis, 0.5 + 0.5 * p[axis])).collect());
    }
    let special =
        [0.0, -0.0, 1e-45, 1e-40, f32::MIN_POSITIVE, 1.0f32.next_down(), 1.0, 1.0f32.next_up(), -1e-45];
    for (i, &u) in special.iter().enumerate() {
        for &v in &special[i..] {
            points.push((0..inputs).map(|axis| place(axis, [u, v, u][axis])).collect());
            points.push((0..inputs).map(|axis| place(axis, [v, u, 0.4][axis])).collect());
        }
    }
    for resolution in grid.resolutions.iter().take(4) {
        for k in 0..=8u32 {
            let on = |axis: usize, more: i32| {
                let n = u32::from(resolution[axis]);
                let x = place(axis, (k * n / 8) as f32 / n as f32);
                let x = if more < 0 {
                    x.next_down()
                } else if more > 0 {
                    x.next_up()
                } else {
                    x
                };
                x.clamp(bounds.min[axis], bounds.max[axis])
            };
            let inside = |axis: usize| place(axis, 0.37);
            for more in -1..=1 {
                points.push(
                    (0..inputs).map(|axis| if axis == 0 { on(0, more) } else { inside(axis) }).collect(),
                );
                points.push(
                    (0..inputs).map(|axis| if axis < 2 { on(axis, more) } else { inside(axis) }).collect(),
                );
                points.push((0..inputs).map(|axis| on(axis, more)).collect());
            }
        }
    }
    while !points.len().is_multiple_of(64) {
        points.push(points[0].clone());
    }
    (0..inputs).flat_map(|axis| points.iter().map(move |p| p[axis]).collect::<Vec<_>>()).collect()
}

const BOXES: [SceneBox; 4] = [
    UNIT,
    SceneBox { min: Vec3::splat(-1.5), max: Vec3::new(1.5, 1.0, 2.0) },
    SceneBox { min: Vec3::new(-3.0, 2.0, 10.0), max: Vec3::new(-2.0, 3.0, 110.0) },
    SceneBox { min: Vec3::new(0.0, -1.0, 0.0), max: Vec3::new(1.0, 1.0, 1e-6) },
];

fn boxes_of(grid: &GridEncoding) -> &'static [SceneBox] {
    if grid.inputs == 3 { &BOXES } else { &BOXES[..1] }
}

#[test]
fn every_isa_and_storage_is_the_oracle() {
    for grid in grids() {
        crate::network::check_grid(&grid).unwrap();
        let noise = noise(grid.values(), 3);
        let (bytes, values) = halve(&noise);
        every_isa_is_the_oracle(&grid, TableValues::F16(&bytes), &values, true);
        // Products with a power of two are exact: the result is bit-identical to f32 tables.
        let (bytes, scales, values) = quantise(&grid, &noise, |level| 2f32.powi(-4 - level as i32 % 5));
        every_isa_is_the_oracle(&grid, TableValues::Int8 { values: &bytes, scales: &scales }, &values, true);
        let (bytes, scales, values) = quantise(&grid, &noise, |level| 0.37 / (1 + level) as f32);
        every_isa_is_the_oracle(&grid, TableValues::Int8 { values: &bytes, scales: &scales }, &values, false);
    }
}

/// Compares the encoding by the tables `stored`, on every instruction set, with the f64 oracle of `values`. If `exact`,
/// also compares bit for bit with f32 tables.
fn every_isa_is_the_oracle(grid: &GridEncoding, stored: TableValues<'_>, values: &[f32], exact: bool) {
    for bounds in boxes_of(grid) {
        let x = hard_points(grid, bounds);
        let n = x.len() / usize::from(grid.inputs);
        let truth: Vec<_> = (0..n)
            .map(|i| oracle(grid, values, bounds, &x.iter().skip(i).step_by(n).copied().collect::<Vec<_>>()))
            .collect();
        for isa in isas() {
            let all = encode(isa, grid, stored, bounds, &x);
            let full = encode(isa, grid, TableValues::F32(values), bounds, &x);
            let same = all.iter().zip(&full).all(|(a, b)| a.to_bits() == b.to_bits());
            assert!(same || !exact, "{isa:?} {grid:?}");
            for (i, truth) in truth.iter().enumerate() {
                for (channel, &(value, error)) in truth.iter().enumerate() {
                    let found = f64::from(all[channel * n + i]);
                    let point: Vec<_> = x.iter().skip(i).step_by(n).collect();
                    assert!(
                        (found - value).abs() <= error,
                        "{isa:?}, {grid:?}, channel {channel} at {point:?}: {found} is not {value} +- {error:e}"
                    );
                }
            }
        }
    }
}

/// The [`GridCorners`] of a block at one level: `entry`, and the bit patterns of `weight` and of `x`.
type Read = (Vec<u32>, Vec<u32>, Vec<u32>);

fn corners(isa: Isa, grid: &GridEncoding, level: &GridLevel, bounds: &SceneBox, x: &[f32]) -> Read {
    let stride = x.len() / usize::from(grid.inputs);
    let rows = 1 << (grid.inputs - 1);
    let (mut entry, mut weight, mut wx) =
        (vec![0; rows * stride], vec![0.0; rows * stride], vec![0.0; stride]);
    let tables = GridTables::new(TableValues::F32(&[]), bounds_of(grid, bounds).as_ref());
    let mut corners = GridCorners { entry: &mut entry, weight: &mut weight, x: &mut wx };
    grid_corners_block(isa, grid, &tables, level, stride, x, &mut corners);
    let bits = |v: Vec<f32>| v.into_iter().map(f32::to_bits).collect();
    (entry, bits(weight), bits(wx))
}

#[test]
fn corners_are_the_same_with_every_kernel_in_range_and_those_of_the_oracle() {
    for grid in grids() {
        for bounds in boxes_of(&grid) {
            let mut x = hard_points(&grid, bounds);
            let n = x.len() / usize::from(grid.inputs);
            // Positions that are NaN or outside of the box read entries inside the table, too.
            for (i, bad) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e38, -1e38].into_iter().enumerate()
            {
                x[i] = bad;
            }
            for level in grid.levels() {
                let expected = corners(Isa::Portable, &grid, &level, bounds, &x);
                for isa in isas() {
                    assert_eq!(corners(isa, &grid, &level, bounds, &x), expected, "{isa:?}, {grid:?}");
                }
                let (entries, weights, wx) = expected;
                for weight in weights.iter().chain(&wx) {
                    assert!((0.0..=1.0).contains(&f32::from_bits(*weight)));
                }
                for (i, &entry) in entries.iter().enumerate() {
                    let last = (level.first + level.entries - 2) as u32;
                    assert!((level.first as u32..=last).contains(&entry), "{level:?}: {entry}");
                    let lane = i % n;
                    if lane < 5 {
                        continue;
                    }
                    // Rounding may put a point next to a face into the neighbouring cell.
                    let point: Vec<f32> = x.iter().skip(lane).step_by(n).copied().collect();
                    let near_face = (0..point.len()).any(|axis| {
                        let g = cells_along(bounds, axis, level.cells[axis], point[axis]);
                        (g - g.round()).abs() < 1e-2
                    });
                    if !near_face {
                        let around = vertices(&grid, level.index, bounds, &point);
                        assert_eq!(entry as usize - level.first, around[2 * (i / n)].0, "{level:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn the_box_s_faces_are_their_own_vertices() {
    let grid = grid(1, 20, &[[3, 5, 7], [64, 64, 64]]);
    let (bytes, values) = halve(&noise(grid.values(), 5));
    for bounds in BOXES {
        for isa in isas() {
            for corner in 0..8usize {
                let p = [0, 1, 2].map(|a| if corner >> a & 1 == 1 { bounds.max[a] } else { bounds.min[a] });
                let x: Vec<f32> = p.iter().flat_map(|&x| [x; 16]).collect();
                let found = encode(isa, &grid, TableValues::F16(&bytes), &bounds, &x);
                for level in grid.levels() {
                    let v = [0, 1, 2].map(|a| if corner >> a & 1 == 1 { level.cells[a] } else { 0 });
                    let entry = level.first + (level.row(v[1], v[2]) + v[0]) as usize;
                    assert_eq!(
                        found[level.index * 16],
                        values[entry],
                        "{isa:?}, corner {corner}, {bounds:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_sample_does_not_depend_on_those_beside_it() {
    for grid in grids() {
        let (bytes, _) = halve(&noise(grid.values(), 3));
        let inputs = usize::from(grid.inputs);
        let x: Vec<f32> = noise(inputs * 64, 8).iter().map(|x| 0.5 + 0.5 * x).collect();
        for isa in isas() {
            let all = encode(isa, &grid, TableValues::F16(&bytes), &UNIT, &x);
            let strides: &[usize] = if isa == Isa::Portable { &[1, 3, 16] } else { &[16, 48] };
            for &stride in strides {
                let cut: Vec<f32> = x.chunks(64).flat_map(|row| row[64 - stride..].to_vec()).collect();
                let found = encode(isa, &grid, TableValues::F16(&bytes), &UNIT, &cut);
                let expected: Vec<f32> = all.chunks(64).flat_map(|row| row[64 - stride..].to_vec()).collect();
                assert_eq!(found, expected, "{isa:?}, {grid:?}, stride {stride}");
            }
        }
    }
}

#[test]
fn a_face_is_crossed_without_a_step() {
    let grid = grid(2, 9, &[[4, 5, 6], [50, 40, 60]]);
    let (bytes, _) = halve(&noise(grid.values(), 3));
    for isa in isas() {
        for (level, resolution) in grid.resolutions.iter().enumerate() {
            for axis in 0..3 {
                let n = resolution[axis];
                for k in 1..n {
                    let face = f32::from(k) / f32::from(n);
                    let mut x = vec![0.3; 48];
                    x[16 * axis..16 * axis + 3].copy_from_slice(&[face.next_down(), face, face.next_up()]);
                    let found = encode(isa, &grid, TableValues::F16(&bytes), &UNIT, &x);
                    for channel in 2 * level..2 * level + 2 {
                        let [a, b, c, ..] = found[channel * 16..][..16] else { unreachable!() };
                        // Bound: two ulps of the position times the steepest slope, plus the rounding of the sum.
                        let most = f32::from(n) * 2.0 * 3e-7 + 1e-6;
                        assert!((a - b).abs() <= most && (c - b).abs() <= most, "{isa:?}: {a} {b} {c}");
                    }
                }
            }
        }
    }
}

#[test]
fn f16_at_its_edges_is_read_exactly() {
    let edges = [0x0000u16, 0x8000, 0x0001, 0x8001, 0x03ff, 0x0400, 0x7bff, 0xfbff, 0x3c00];
    for features in [1, 2, 4] {
        let grid = grid(features, 12, &[[8, 8, 8]]);
        let bytes: Vec<u8> = (0..grid.values()).flat_map(|i| edges[i % 9].to_le_bytes()).collect();
        // Offset by one byte: no alignment is needed.
        let shifted: Vec<u8> = core::iter::once(7).chain(bytes).collect();
        for isa in isas() {
            for vertex in 0..9 {
                let x: Vec<f32> =
                    [vertex, 8 - vertex, vertex / 2].iter().flat_map(|&v| [v as f32 / 8.0; 16]).collect();
                let found = encode(isa, &grid, TableValues::F16(&shifted[1..]), &UNIT, &x);
                let entry = (vertex / 2 * 9 + 8 - vertex) * 9 + vertex;
                for feature in 0..usize::from(features) {
                    let bits = edges[(entry * usize::from(features) + feature) % 9];
                    let expected = half::f16::from_bits(bits).to_f32();
                    assert_eq!(found[feature * 16], expected, "{isa:?}: {bits:#06x}");
                }
            }
        }
    }
}

#[test]
fn int8_at_its_edges_is_read_exactly_at_every_size_of_scale() {
    let edges = [127i8, -127, -128, 1, -1, 0, 64, -33, 100];
    let scales = [1e-45, 1e-30, 0.1, 1e30, f32::MAX / 128.0];
    for features in [1, 2, 4] {
        let grid = grid(features, 12, &[[8; 3]; 5]);
        // Offset by one byte: no alignment is needed.
        let values: Vec<u8> = (0..=grid.values()).map(|i| edges[(i + 8) % 9] as u8).collect();
        let stored: Vec<u8> =
            core::iter::once(7).chain(scales.iter().flat_map(|scale| scale.to_le_bytes())).collect();
        let tables = TableValues::Int8 { values: &values[1..], scales: &stored[1..] };
        for (isa, vertex) in isas().flat_map(|isa| (0..9).map(move |vertex| (isa, vertex))) {
            let x: Vec<f32> =
                [vertex, 8 - vertex, vertex / 2].iter().flat_map(|&v| [v as f32 / 8.0; 16]).collect();
            let found = encode(isa, &grid, tables, &UNIT, &x);
            for level in grid.levels() {
                let entry = level.first + (vertex / 2 * 9 + 8 - vertex) * 9 + vertex;
                for feature in 0..usize::from(features) {
                    let edge = edges[(entry * usize::from(features) + feature) % 9];
                    let channel = level.index * usize::from(features) + feature;
                    let expected = f32::from(edge) * scales[level.index];
                    assert_eq!(found[channel * 16], expected, "{isa:?}: {edge} of level {}", level.index);
                }
            }
        }
    }
}

#[test]
fn a_level_that_just_fits_is_dense_and_one_more_vertex_is_hashed() {
    // 4 · 4 · 4 vertices are 2^6; 5 · 4 · 4 are more.
    let grid = grid(1, 6, &[[3, 3, 3], [4, 3, 3], [63, 0, 0]]);
    let levels: Vec<_> = grid.levels().collect();
    assert_eq!((levels[0].mask, levels[0].entries, levels[0].first), (None, 64, 0));
    assert_eq!((levels[1].mask, levels[1].entries, levels[1].first), (Some(63), 68, 64));
    assert_eq!((levels[2].mask, levels[2].entries, levels[2].first), (None, 64, 132));
    assert_eq!((grid.entries(), grid.values()), (196, 196));
    // The hash of a row, written a second time from its definition.
    let row = |y: u64, z: u64| {
        let h = ((y * 2_654_435_761) & 0xffff_ffff) ^ ((z * 805_459_861) & 0xffff_ffff);
        ((h ^ h >> 15) & 63) as u32
    };
    for (y, z) in [(0, 0), (1, 0), (0, 1), (3, 3), (16_384, 16_384)] {
        assert_eq!(levels[1].row(y as u32, z as u32), row(y, z));
    }
    assert_eq!((levels[1].row(0, 0), levels[0].row(1, 2)), (0, 36));
}

#[test]
fn tables_that_are_too_short_are_read_within_what_is_there() {
    for grid in grids() {
        let inputs = usize::from(grid.inputs);
        let x: Vec<f32> = noise(inputs * 64, 8).iter().map(|x| 0.5 + 0.5 * x).collect();
        for count in [0, 1, 2, 3, 7, grid.values() / 2] {
            let (bytes, values) = halve(&vec![1.0; count.min(grid.values())]);
            for isa in isas() {
                let half = encode(isa, &grid, TableValues::F16(&bytes), &UNIT, &x);
                let full = encode(isa, &grid, TableValues::F32(&values), &UNIT, &x);
                // Scales of 1 as bytes. If `count` is odd, one scale is missing.
                let scales = &[0, 0, 128, 63].repeat(grid.resolutions.len())[4 * (count % 2)..];
                let ones = vec![1; values.len()];
                let int8 = TableValues::Int8 { values: &ones, scales };
                let enough = values.len() == grid.values() && count % 2 == 0;
                assert_eq!(grid.fits(&GridTables::new(int8, None)), enough, "{grid:?}, {count}");
                let int8 = encode(isa, &grid, int8, &UNIT, &x);
                let mut all = half.iter().chain(&full).chain(&int8);
                assert!(all.all(|v| (-1e-6..=1.00001).contains(v)), "{isa:?}, {count}");
            }
        }
    }
}

fn have_the_same_bits(a: &[f32], b: &[f32]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
}

#[test]
fn what_a_machine_without_vectors_runs_has_the_same_bits() {
    for grid in grids() {
        let values = noise(grid.values(), 3);
        let x: Vec<f32> = noise(64 * usize::from(grid.inputs), 8).iter().map(|x| 0.5 + 0.5 * x).collect();
        let values = TableValues::F32(&values);
        let mut found = vec![0.0; grid.outputs() * 64];
        forward::encode_one_by_one(&grid, &GridTables::new(values, None), 64, &x, &mut found);
        assert!(have_the_same_bits(&found, &encode(Isa::Portable, &grid, values, &UNIT, &x)), "{grid:?}");
    }
}

#[cfg(feature = "normals")]
mod derivative {
    use super::*;

    /// Gradient, with respect to the positions, of the sum of the encoded values weighted by `of`: `[inputs][stride]`.
    fn gradient(
        isa: Isa,
        grid: &GridEncoding,
        bytes: &[u8],
        bounds: &SceneBox,
        x: &[f32],
        of: &[f32],
        blur: f32,
    ) -> Vec<f32> {
        gradient_of(isa, grid, TableValues::F16(bytes), bounds, x, of, blur)
    }

    fn gradient_of(
        isa: Isa,
        grid: &GridEncoding,
        values: TableValues<'_>,
        bounds: &SceneBox,
        x: &[f32],
        of: &[f32],
        blur: f32,
    ) -> Vec<f32> {
        let stride = x.len() / usize::from(grid.inputs);
        let tables = GridTables::new(values, bounds_of(grid, bounds).as_ref());
        let mut out = vec![f32::NAN; x.len()];
        grid.gradient(&tables, isa, stride, x, of, blur, &mut out);
        out
    }

    #[test]
    fn what_a_machine_without_vectors_runs_has_the_same_bits() {
        for grid in grids() {
            let (values, of_encoded) = (noise(grid.values(), 3), noise(64 * grid.outputs(), 5));
            let x: Vec<f32> = noise(64 * usize::from(grid.inputs), 8).iter().map(|x| 0.5 + 0.5 * x).collect();
            let tables = &GridTables::new(TableValues::F32(&values), None);
            let table = crate::simd::Table::new(&values[..], &[]);
            let mut found = vec![0.0; x.len()];
            let (grid, x, of_encoded, of_x) = (&grid, &x[..], &of_encoded[..], &mut found[..]);
            Gradient { grid, tables, table, stride: 64, x, of_encoded, blur: 0.0, of_x }.gradient::<f32, 0>();
            let values = TableValues::F32(&values);
            let expected = gradient_of(Isa::Portable, grid, values, &UNIT, x, of_encoded, 0.0);
            assert!(have_the_same_bits(&found, &expected), "{grid:?}");
        }
    }

    /// Derivative at `x`, with respect to coordinate `axis`, of the sum of the encoded values weighted by `of`.
    /// Computed in f64, inside the cell that contains `x`.
    fn truth(
        grid: &GridEncoding,
        values: &[f32],
        bounds: &SceneBox,
        x: &[f32],
        of: &[f32],
        axis: usize,
    ) -> f64 {
        let features = usize::from(grid.features);
        let mut sum = 0.0;
        for level in 0..grid.resolutions.len() {
            let first = first_entry(grid, level);
            let cells = u32::from(grid.resolutions[level][axis]);
            let scale = f64::from(cells) / f64::from(bounds.max[axis] - bounds.min[axis]);
            // Corners that differ only along `axis` have the same weights along the other axes.
            let g = cells_along(bounds, axis, cells, x[axis]);
            let w = g - g.floor().min(f64::from(cells - 1));
            for (corner, (entry, weight)) in vertices(grid, level, bounds, x).into_iter().enumerate() {
                let far = corner >> axis & 1 == 1;
                let own = if far { w } else { 1.0 - w };
                let others = if own == 0.0 {
                    continue_weight(grid, level, bounds, x, corner, axis)
                } else {
                    weight / own
                };
                for feature in 0..features {
                    let value = f64::from(values[(first + entry) * features + feature]);
                    let of = f64::from(of[level * features + feature]);
                    sum += if far { scale } else { -scale } * others * value * of;
                }
            }
        }
        sum
    }

    /// Product of a corner's interpolation weights along all axes except `axis`.
    fn continue_weight(
        grid: &GridEncoding,
        level: usize,
        bounds: &SceneBox,
        x: &[f32],
        corner: usize,
        axis: usize,
    ) -> f64 {
        (0..x.len())
            .filter(|&a| a != axis)
            .map(|a| {
                let cells = u32::from(grid.resolutions[level][a]);
                let g = cells_along(bounds, a, cells, x[a]);
                let w = g - g.floor().min(f64::from(cells - 1));
                if corner >> a & 1 == 1 { w } else { 1.0 - w }
            })
            .product()
    }

    #[test]
    fn the_gradient_is_the_interpolation_s_own_in_cells_and_on_the_box_s_faces() {
        for grid in grids().into_iter().filter(|grid| grid.resolutions[0][0] < 1000) {
            let (bytes, values) = halve(&noise(grid.values(), 3));
            let of = noise(grid.outputs(), 4);
            let inputs = usize::from(grid.inputs);
            for bounds in boxes_of(&grid) {
                let mut points: Vec<f32> = noise(inputs * 64, 12).iter().map(|x| 0.5 + 0.5 * x).collect();
                // Two opposite corners of the box, in the first and the last cell of each axis.
                for axis in 0..inputs {
                    points[axis * 64] = 0.0;
                    points[axis * 64 + 1] = 1.0;
                }
                let x: Vec<f32> = points
                    .iter()
                    .enumerate()
                    .map(|(i, u)| bounds.min[i / 64] + u * (bounds.max[i / 64] - bounds.min[i / 64]))
                    .collect();
                let of_block: Vec<f32> = of.iter().flat_map(|&of| [of; 64]).collect();
                for isa in isas() {
                    let found = gradient(isa, &grid, &bytes, bounds, &x, &of_block, 0.0);
                    let mut worst = 0.0f64;
                    for i in 0..64 {
                        let point: Vec<f32> = x.iter().skip(i).step_by(64).copied().collect();
                        let near_face = i > 1
                            && grid.resolutions.iter().any(|r| {
                                (0..inputs).any(|axis| {
                                    let g = cells_along(bounds, axis, u32::from(r[axis]), point[axis]);
                                    (g - g.round()).abs() < 1e-3
                                })
                            });
                        if near_face {
                            continue;
                        }
                        for axis in 0..inputs {
                            let side = f64::from(bounds.max[axis] - bounds.min[axis]);
                            let cells = grid.resolutions.iter().map(|r| f64::from(r[axis])).sum::<f64>();
                            let expected = truth(&grid, &values, bounds, &point, &of, axis);
                            let error = (f64::from(found[axis * 64 + i]) - expected).abs();
                            worst = worst.worse(error / (cells / side));
                        }
                    }
                    assert!(worst <= 2e-4, "{isa:?}, {grid:?}, {bounds:?}: {worst:e}");
                }
            }
        }
    }

    #[test]
    fn the_gradient_of_int8_is_that_of_its_values() {
        for grid in grids().into_iter().filter(|grid| grid.resolutions[0][0] < 1000) {
            let inputs = usize::from(grid.inputs);
            let (x, of) = (noise(inputs * 64, 12), noise(grid.outputs() * 64, 4));
            for (scale, blur) in [(0.37, 0.0), (0.37, 0.1), (3e-5, 0.0)] {
                let (bytes, scales, values) =
                    quantise(&grid, &noise(grid.values(), 3), |level| scale / (1 + level) as f32);
                let stored = TableValues::Int8 { values: &bytes, scales: &scales };
                for isa in isas() {
                    let [found, expected] = [stored, TableValues::F32(&values)]
                        .map(|values| gradient_of(isa, &grid, values, &BOXES[1], &x, &of, blur));
                    // The sums over up to 32 levels are rounded in different orders.
                    let largest = expected.iter().fold(0.0f32, |most, g| most.max(g.abs()));
                    let worst =
                        found.iter().zip(&expected).fold(0.0f32, |most, (a, b)| most.worse((a - b).abs()));
                    assert!(
                        largest > 0.0 && worst <= 1e-5 * largest,
                        "{isa:?}, {grid:?}: {worst} of {largest}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_gradient_is_what_differences_say() {
        let grid = grid(2, 8, &[[4, 5, 6], [9, 8, 7]]);
        let (bytes, values) = halve(&noise(grid.values(), 3));
        let of = noise(grid.outputs(), 4);
        let of_block: Vec<f32> = of.iter().flat_map(|&of| [of; 16]).collect();
        let sum = |x: &[f32]| -> f64 {
            let all = oracle(&grid, &values, &UNIT, x);
            all.iter().zip(&of).map(|(&(v, _), &of)| v * f64::from(of)).sum()
        };
        let points = noise(3 * 16, 31);
        let x: Vec<f32> = points.iter().map(|x| 0.5 + 0.5 * x).collect();
        for isa in isas() {
            let found = gradient(isa, &grid, &bytes, &UNIT, &x, &of_block, 0.0);
            for i in 0..16 {
                for axis in 0..3 {
                    let at = |step: f32| {
                        let mut p = [x[i], x[16 + i], x[32 + i]];
                        p[axis] += step;
                        (f64::from(p[axis]), sum(&p))
                    };
                    let ((a, low), (b, high)) = (at(-1e-5), at(1e-5));
                    let expected = (high - low) / (b - a);
                    let found = f64::from(found[axis * 16 + i]);
                    assert!((found - expected).abs() < 2e-3, "{isa:?}: {found}, differences say {expected}");
                }
            }
        }
    }

    #[test]
    fn on_a_face_the_gradient_is_that_of_the_cell_further_on() {
        // Along x the vertices hold 0, 1, 0, 1, 0. Cells have width ¼, so that the slopes are 4 and −4.
        let grid = grid(1, 12, &[[4, 1, 1]]);
        let values: Vec<f32> = (0..grid.values()).map(|i| if i % 5 % 2 == 1 { 1.0 } else { 0.0 }).collect();
        let (bytes, _) = halve(&values);
        let xs = [0.0, 0.25, 0.5, 0.75, 1.0, 0.25f32.next_down(), 0.75f32.next_down(), 0.6];
        let slopes = [4.0, -4.0, 4.0, -4.0, -4.0, 4.0, 4.0, 4.0];
        let x: Vec<f32> = (0..16).map(|i| xs[i % 8]).chain([0.5; 32]).collect();
        for isa in isas() {
            let found = gradient(isa, &grid, &bytes, &UNIT, &x, &[1.0; 16], 0.0);
            for i in 0..16 {
                assert_eq!(
                    [found[i], found[16 + i], found[32 + i]],
                    [slopes[i % 8], 0.0, 0.0],
                    "{isa:?}, {i}"
                );
            }
        }
    }

    #[test]
    fn blur_damps_fine_levels_and_leaves_coarse_ones() {
        let grid = grid(1, 12, &[[1, 1, 1], [12, 12, 12]]);
        let (bytes, _) = halve(&noise(grid.values(), 3));
        let x: Vec<f32> = noise(48, 8).iter().map(|x| 0.5 + 0.5 * x).collect();
        let of = |coarse: f32, fine: f32| [[coarse; 16], [fine; 16]].concat();
        for isa in isas() {
            let by = |of: &[f32], blur| gradient(isa, &grid, &bytes, &UNIT, &x, of, blur);
            // Blur of 1/12. Fine cells are as wide: erf(1/√8) = 0.38292. Coarse cells have width 1: erf(12/√8) = 1.
            for (of, factor) in [(of(0.0, 1.0), 0.382_925), (of(1.0, 0.0), 1.0)] {
                let (sharp, blurred) = (by(&of, 0.0), by(&of, 1.0 / 12.0));
                for (a, b) in sharp.iter().zip(&blurred) {
                    assert!((a * factor - b).abs() <= 1e-5 * a.abs(), "{isa:?}: {a} {b}");
                }
            }
        }
    }
}

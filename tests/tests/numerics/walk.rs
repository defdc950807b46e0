//! The march through the occupancy grid, compared with exact coordinates: through corners, along faces, far from the
//! origin.

use crate::geometry::somewhere;
use crate::table::{Row, Worst, cases};
use glam::Vec3;
use nerf_core::camera::Ray;
use nerf_core::sampling::{Bins, OccupancyGrid};
use nerf_core::space::SceneBox;
use nerf_testing::noise::signed_f64;
use std::cell::Cell;

cases! {
    bins_are_live_where_their_cell_is: "share of bins decided otherwise than by f64 coordinates, beyond rounding" => live;
    no_cell_is_missed: "share of single cells with a bin's middle inside that a walk passes by" => single;
    every_walk_ends: "look-ups a bin, counted" => steps;
}

/// A box divided into grid cells.
struct Cells {
    bounds: SceneBox,
    resolution: [u16; 3],
}

fn occupancies() -> Vec<Cells> {
    let cells = |min, max, resolution| Cells { bounds: SceneBox { min, max }, resolution };
    vec![
        cells(Vec3::NEG_ONE, Vec3::ONE, [16; 3]),
        cells(Vec3::NEG_ONE, Vec3::ONE, [1; 3]),
        cells(Vec3::new(-0.3, 7.0, -10.0), Vec3::new(0.4, 8.1, 3.0), [5, 64, 1]),
        cells(Vec3::splat(-1e6), Vec3::splat(1e6), [64; 3]),
        cells(Vec3::splat(1e6 - 8.0), Vec3::splat(1e6), [8; 3]),
        cells(Vec3::new(1e6 - 2.0, -1e6, 0.0), Vec3::new(1e6, 1e6, 1e-3), [4, 512, 3]),
    ]
}

/// Returns the exact position on the ray, in cells along each axis, and the largest rounding error of the f32 position.
fn place(cells: &Cells, ray: &Ray, t: f32) -> [(f64, f64); 3] {
    std::array::from_fn(|axis| {
        let [min, max] = [cells.bounds.min[axis], cells.bounds.max[axis]].map(f64::from);
        let (o, step) = (f64::from(ray.origin[axis]), f64::from(ray.dir[axis]) * f64::from(t));
        let per_unit = f64::from(cells.resolution[axis]) / (max - min);
        // A product and a sum along the ray; a difference, a quotient of a rounded difference, and a product.
        let off = 2f64.powi(-24) * 1.01 * ((o.abs() + 2.0 * step.abs()) + 5.0 * (max - min));
        ((o + step - min) * per_unit, off * per_unit)
    })
}

/// Returns the cells in which the f32 position may lie, and whether it may lie outside of the box.
fn candidates(cells: &Cells, at: [(f64, f64); 3]) -> (Vec<usize>, bool) {
    let (mut found, mut outside) = (vec![0], false);
    for ((at, off), side) in at.into_iter().zip(cells.resolution) {
        let side = f64::from(side);
        outside |= at - off < 0.0 || at + off > side;
        if at + off < 0.0 || at - off > side {
            return (vec![], true);
        }
        let (low, high) = ((at - off).max(0.0) as usize, (at + off).max(0.0) as usize);
        let last = side as usize - 1;
        let range = low.min(last)..=high.min(last);
        found = found.iter().flat_map(|i| range.clone().map(move |k| i * side as usize + k)).collect();
    }
    (found, outside)
}

/// Returns rays from corner to corner of cells, along faces and edges, parallel to axes, and at random.
fn rays(cells: &Cells) -> Vec<Ray> {
    let mut state = 29;
    let size = (cells.bounds.max - cells.bounds.min) / Vec3::from(cells.resolution.map(f32::from));
    let extent = cells.bounds.max - cells.bounds.min;
    let mut within = || cells.bounds.min + extent * (0.5 + 0.6 * somewhere(&mut state));
    let corner = |p: Vec3| cells.bounds.min + ((p - cells.bounds.min) / size).round() * size;
    let mut rays = Vec::new();
    for i in 0..240 {
        let (from, to) = (within(), within());
        let (from, to) = match i % 4 {
            0 => (from, to),
            1 => (corner(from), corner(to)),
            2 => (from, corner(to)),
            _ => (corner(from), to),
        };
        let mut dir = to - from;
        match i / 4 % 6 {
            // In a face's plane.
            0 => dir[i / 24 % 3] = [0.0, -0.0][i % 2],
            // Along an edge.
            1 => (0..3).filter(|axis| *axis != i / 24 % 3).for_each(|axis| dir[axis] = 0.0),
            // Nearly in a face's plane.
            2 => dir[i / 24 % 3] *= [1e-7, -1e-30][i % 2],
            // Through the corners of a row of cells.
            3 => dir = size * Vec3::new(1.0, if i % 2 == 0 { -1.0 } else { 1.0 }, 1.0),
            _ => {}
        }
        let Some(dir) = dir.try_normalize() else { continue };
        rays.push(Ray { origin: from - dir * if i % 5 == 0 { extent.length() } else { 0.0 }, dir });
    }
    rays
}

/// Calls `see` with every ray, divided into few bins and into many.
fn each_walk(mut see: impl FnMut(&Cells, &Ray, &Bins)) {
    for cells in occupancies() {
        let far = 2.5 * (cells.bounds.max - cells.bounds.min).length();
        for ray in rays(&cells) {
            for count in [61, 700] {
                see(&cells, &ray, &Bins::new(0.0, far, count).expect("bins"));
            }
        }
    }
}

fn bit(bits: &[u8], cell: usize) -> bool {
    bits[cell / 8] >> (cell % 8) & 1 == 1
}

/// Returns the bits of occupancy grids in which all, half, one in fifty and none of the cells are occupied.
fn fillings(cells: &Cells) -> Vec<Vec<u8>> {
    let count: usize = cells.resolution.iter().map(|&side| usize::from(side)).product();
    let mut state = 31;
    let shares = [2.0, 0.0, -0.96, -2.0];
    let filling = |share: &f64| {
        let mut bits = vec![0u8; count.div_ceil(8)];
        (0..count)
            .filter(|_| signed_f64(&mut state) < *share)
            .for_each(|cell| bits[cell / 8] |= 1 << (cell % 8));
        bits
    };
    shares.iter().map(filling).collect()
}

fn live() -> Vec<Row> {
    let (mut wrong, mut bins_seen, mut walked, mut at) = (0u32, 0u32, 0u32, String::new());
    let mut filled: Vec<Vec<u8>> = vec![];
    let mut of = [0u16; 3];
    each_walk(|cells, ray, bins| {
        let middle = |bin| bins.at(bin, 0.5);
        if of != cells.resolution {
            (of, filled) = (cells.resolution, fillings(cells));
        }
        let places = (0..bins.count()).map(|bin| candidates(cells, place(cells, ray, bins.at(bin, 0.5))));
        let places: Vec<_> = places.collect();
        for bits in &filled {
            let occupancy = OccupancyGrid::new(cells.bounds, cells.resolution, bits);
            let mut next = occupancy.first_occupied(ray, bins, 0, bins.count(), middle);
            for (bin, (candidates, outside)) in (0..bins.count()).zip(&places) {
                let found = bin == next;
                let set = candidates.iter().filter(|cell| bit(bits, **cell)).count();
                let may = if found { set > 0 } else { *outside || set < candidates.len() };
                if !may {
                    (wrong, at) =
                        (wrong + 1, format!("bin {bin} of {}, {ray:?}, {:?}", bins.count(), cells.bounds));
                }
                if found {
                    walked += 1;
                    next = occupancy.first_occupied(ray, bins, bin + 1, bins.count(), middle);
                }
                bins_seen += 1;
            }
        }
    });
    assert!(walked > bins_seen / 50, "{walked} of {bins_seen}");
    vec![Worst { error: f64::from(wrong) / f64::from(bins_seen), at }.row("any", "any", 0.0)]
}

fn single() -> Vec<Row> {
    let (mut missed, mut all, mut at) = (0u32, 0u32, String::new());
    each_walk(|cells, ray, bins| {
        let middle = |bin| bins.at(bin, 0.5);
        let count: usize = cells.resolution.iter().map(|&side| usize::from(side)).product();
        let mut bits = vec![0u8; count.div_ceil(8)];
        let mut before = vec![];
        for bin in 0..bins.count() {
            // On a face or an edge all cells that touch it are set: it belongs to one of them.
            let (touched, outside) = candidates(cells, place(cells, ray, bins.at(bin, 0.5)));
            if outside || touched == before {
                continue;
            }
            touched.iter().for_each(|cell| bits[cell / 8] |= 1 << (cell % 8));
            let occupancy = OccupancyGrid::new(cells.bounds, cells.resolution, &bits);
            let found = occupancy.first_occupied(ray, bins, 0, bins.count(), middle);
            all += 1;
            // Not behind it, and not where none of them can be.
            let place = (found <= bin).then(|| candidates(cells, place(cells, ray, bins.at(found, 0.5))).0);
            if !place.is_some_and(|place| place.iter().any(|cell| touched.contains(cell))) {
                (missed, at) = (missed + 1, format!("bin {bin}, found {found}: {ray:?}, {:?}", cells.bounds));
            }
            touched.iter().for_each(|cell| bits[cell / 8] = 0);
            before = touched;
        }
    });
    assert!(all > 10_000, "{all} cells");
    vec![Worst { error: f64::from(missed) / f64::from(all), at }.row("any", "any", 0.0)]
}

/// Counts look-ups per bin, for rays with NaNs and infinities, too: the march through an empty grid must reach its end.
fn steps() -> Vec<Row> {
    let mut worst = Worst::default();
    let odd = [0.0, f32::NAN, f32::INFINITY, f32::MAX, 1e-45, -1e30];
    let strange = (0..odd.len().pow(2)).map(|i| Ray {
        origin: Vec3::new(odd[i % 6], 0.1, odd[i / 6]),
        dir: Vec3::new(odd[i / 6], odd[i % 6], 1.0),
    });
    let strange: Vec<Ray> = strange.collect();
    let mut walk = |cells: &Cells, ray: &Ray, bins: &Bins| {
        let count: usize = cells.resolution.iter().map(|&side| usize::from(side)).product();
        let bits = vec![0u8; count.div_ceil(8)];
        let occupancy = OccupancyGrid::new(cells.bounds, cells.resolution, &bits);
        let asked = Cell::new(0u32);
        let t = |bin| {
            asked.set(asked.get() + 1);
            // An endless walk ends here.
            assert!(asked.get() <= 2 * bins.count(), "{ray:?}, {:?}", cells.bounds);
            bins.at(bin, 0.5)
        };
        assert_eq!(occupancy.first_occupied(ray, bins, 0, bins.count(), t), bins.count());
        worst
            .see(f64::from(asked.get()) / f64::from(bins.count()), || format!("{ray:?}, {:?}", cells.bounds));
    };
    each_walk(&mut walk);
    // Boxes whose cells are too small or too many for their size in f32.
    let cells = |least: f32, most: f32| Cells {
        bounds: SceneBox { min: Vec3::splat(least), max: Vec3::splat(most) },
        resolution: [64; 3],
    };
    let odd_boxes = [cells(0.0, 3e-45), cells(-1.7e38, 1.7e38), cells(1e6, 1e6f32.next_up())];
    for cells in occupancies().iter().chain(&odd_boxes) {
        for ray in &strange {
            walk(cells, ray, &Bins::new(0.0, 1e7, 4096).expect("bins"));
        }
    }
    // Each bin is looked up once, and once more where a cell's last bin is estimated.
    vec![worst.row("any", "any", 2.0)]
}

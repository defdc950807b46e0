//! Errors of learned grids at every level, with every kernel, from f16, f32 and int8 tables.

use crate::table::{Row, Worst, cases, isas};
use nerf_core::Isa;
use nerf_core::encoding::{
    GridEncoding, GridLevel, GridTables, TableValues, encode_grid_block, encode_harmonics_block,
};
use nerf_testing::noise::{next, share, signed};
use nerf_testing::oracle::grid::Grid;
use nerf_testing::oracle::network::f16;

cases! {
    grid_of_sixteen_levels_dense_and_hashed: "error of a value, over what rounding position and sum may do to it" =>
        || grid(3, 2, 10, &[4, 6, 9, 13, 16, 20, 27, 36, 48, 64, 90, 128, 180, 256, 360, 512]);
    grid_of_the_finest_levels: "error of a value, over what rounding position and sum may do to it" =>
        || grid(3, 4, 6, &[1, 4096, 16_384]);
    grid_of_one_feature: "error of a value, over what rounding position and sum may do to it" =>
        || grid(3, 1, 12, &[1, 7, 15, 31]);
    grid_of_two_inputs: "error of a value, over what rounding position and sum may do to it" =>
        || grid(2, 2, 8, &[1, 5, 15, 40, 1000]);
    spherical_harmonics_of_every_direction: "absolute error of Y_l^m below degree 4" => harmonics;
}

/// Returns difficult coordinates in 0..1: cell faces and their neighbours, ±0, subnormals, both ends, and noise.
fn points(inputs: usize, cells: &[u16]) -> Vec<f32> {
    let mut state = 1;
    let ends = [1.0, 1f32.next_down(), 1f32.next_up()];
    let mut all: Vec<f32> = [0.0, -0.0, 1e-45, 1e-40, f32::MIN_POSITIVE].into_iter().chain(ends).collect();
    for &n in cells {
        for k in [0, 1, n / 3, n / 2, n - 1, n] {
            let face = f32::from(k) / f32::from(n);
            all.extend([face, face.next_up(), (face - 6e-8).max(0.0)]);
        }
    }
    let hard = all.len();
    (0..inputs * 64 * 300)
        .map(|i| if i % 3 == 0 { all[i / 3 * 7 % hard] } else { share(&mut state) })
        .collect()
}

fn grid(inputs: u8, features: u8, log2_entries: u8, cells: &[u16]) -> Vec<Row> {
    let resolutions = cells.iter().map(|&n| [n, n, if inputs == 3 { n } else { 0 }]).collect();
    let encoding = GridEncoding { inputs, features, log2_entries, resolutions };
    let mut state = 7;
    let bits: Vec<u16> = (0..encoding.values())
        .map(|_| {
            let bits = next(&mut state);
            // Of every size: exponents from subnormal to 2^2.
            ((bits >> 33) as u16 & 0x83ff) | ((bits >> 50) as u16 % 18) << 10
        })
        .collect();
    let bytes: Vec<u8> = bits.iter().flat_map(|bits| bits.to_le_bytes()).collect();
    let wide: Vec<f32> = bits.iter().map(|&bits| f16(bits) as f32).collect();
    let axes = usize::from(inputs);
    let oracle = |values| Grid {
        features: features.into(),
        log2_entries: log2_entries.into(),
        resolutions: cells.iter().map(|&n| vec![u64::from(n); axes]).collect(),
        values,
    };
    let halves = oracle(bits.iter().map(|&bits| f16(bits)).collect());
    // Every byte, and scales of every size.
    let steps: Vec<u8> = bits.iter().map(|bits| (bits ^ bits >> 8) as u8).collect();
    let scale = |level: usize| 0.7 * 10f32.powi([-2, 30, -30, 0, 3][level % 5]);
    let scales: Vec<u8> = (0..cells.len()).flat_map(|level| scale(level).to_le_bytes()).collect();
    let value = |level: usize, at: usize| f64::from(steps[at].cast_signed()) * f64::from(scale(level));
    let features_of = usize::from(features);
    let of_level = |level: GridLevel| {
        let first = level.first * features_of;
        (first..first + level.entries * features_of).map(move |at| (level.index, at))
    };
    let int8 = oracle(encoding.levels().flat_map(of_level).map(|(level, at)| value(level, at)).collect());
    let stored = [
        (TableValues::F16(&bytes), &halves),
        (TableValues::F32(&wide), &halves),
        (TableValues::Int8 { values: &steps, scales: &scales }, &int8),
    ];
    let kernels: Vec<Isa> = isas().collect();
    let mut worst = stored.map(|_| Worst::default());
    let mut out = vec![0.0; encoding.outputs() * 64];
    for x in points(axes, cells).chunks_exact(64 * axes) {
        let unit = |i: usize| -> Vec<f64> { (0..axes).map(|axis| f64::from(x[64 * axis + i])).collect() };
        for (worst, (values, oracle)) in worst.iter_mut().zip(stored) {
            let truth: Vec<_> = (0..64).map(|i| oracle.encode(&unit(i))).collect();
            for &isa in &kernels {
                encode_grid_block(isa, &encoding, &GridTables::new(values, None), 64, x, &mut out);
                for (row, found) in out.chunks_exact(64).enumerate() {
                    // Rounding moves a position by three half ulps, and with it a value by that share of the
                    // difference of two entries, which is at most twice the largest; then the sum is rounded.
                    let n = f64::from(cells[row / usize::from(features)]);
                    let most = 2f64.powi(-24) * (2.0 * axes as f64 * (3.0 * n + 3.0) + 12.0);
                    for (column, &found) in found.iter().enumerate() {
                        let truth = truth[column][row];
                        let error =
                            (f64::from(found) - truth.value).abs() / (most * truth.largest.max(1e-35));
                        worst.see(error, || format!("{:?}, value {row}, {}", unit(column), isa.name()));
                    }
                }
            }
        }
    }
    let names = ["f16 tables", "f32 tables", "int8 tables"];
    worst.into_iter().zip(names).map(|(worst, name)| worst.row(name, "exact", 1.0)).collect()
}

/// Returns the real spherical harmonics of bands 0 to 3 in Cartesian form, from the table in Sloan 2013, in f64.
fn table([x, y, z]: [f64; 3]) -> [f64; 16] {
    let k = |n: f64| (n / std::f64::consts::PI).sqrt();
    [
        0.5 * k(1.0),
        -0.5 * k(3.0) * y,
        0.5 * k(3.0) * z,
        -0.5 * k(3.0) * x,
        0.5 * k(15.0) * x * y,
        -0.5 * k(15.0) * y * z,
        0.25 * k(5.0) * (3.0 * z * z - 1.0),
        -0.5 * k(15.0) * x * z,
        0.25 * k(15.0) * (x * x - y * y),
        -0.125 * k(70.0) * y * (3.0 * x * x - y * y),
        0.5 * k(105.0) * x * y * z,
        -0.125 * k(42.0) * y * (5.0 * z * z - 1.0),
        0.25 * k(7.0) * z * (5.0 * z * z - 3.0),
        -0.125 * k(42.0) * x * (5.0 * z * z - 1.0),
        0.25 * k(105.0) * z * (x * x - y * y),
        -0.125 * k(70.0) * x * (x * x - 3.0 * y * y),
    ]
}

fn harmonics() -> Vec<Row> {
    let mut worst = Worst::default();
    let mut out = vec![0.0; 16 * 64];
    let mut state = 5;
    for _ in 0..500 {
        let mut x = vec![0.0f32; 192];
        for i in 0..64 {
            let d = glam::Vec3::from([0; 3].map(|_| signed(&mut state)));
            // Axes among them.
            let d = if i % 16 == 0 { glam::Vec3::AXES[i / 16 % 3] } else { d };
            let d = d.try_normalize().unwrap_or(glam::Vec3::NEG_Z);
            (x[i], x[64 + i], x[128 + i]) = (d.x, d.y, d.z);
        }
        for isa in isas() {
            encode_harmonics_block(isa, 4, 64, &x, &mut out);
            for i in 0..64 {
                let d = [0, 1, 2].map(|axis| f64::from(x[64 * axis + i]));
                for (row, truth) in table(d).into_iter().enumerate() {
                    let error = (f64::from(out[64 * row + i]) - truth).abs();
                    worst.see(error, || format!("{d:?}, value {row}, {}", isa.name()));
                }
            }
        }
    }
    vec![worst.row("any", "exact", 5e-7)]
}

//! Checks of the f64 oracle against numbers from elsewhere: worked out by hand, from the CS180 course, and from the
//! original code.

use nerf_testing::error::worse;
use nerf_testing::oracle::encoding::{encode, sin_cos_pi};
use nerf_testing::oracle::gradient::{derivative, gradient};
use nerf_testing::oracle::network::{Dense, Encoding, Network, f16, sigmoid, softplus};
use nerf_testing::oracle::sampling::{clip, inverse_cdf, middles};
use nerf_testing::oracle::volume::composite;
use nerf_testing::tools;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use zip::ZipArchive;

fn close(found: &[f64], expected: &[f64], within: f64) {
    let near = found.iter().zip(expected).all(|(a, b)| (a - b).abs() <= within);
    assert!(found.len() == expected.len() && near, "{found:?}, expected {expected:?}");
}

#[test]
fn angles_of_a_turn_are_exact() {
    let half = 0.5f64.sqrt();
    for turns in [0.0, 1e6, -4096.0, 2f64.powi(40)] {
        let at = |u: f64| sin_cos_pi(2.0 * turns + u);
        assert_eq!([at(0.0), at(0.5), at(1.0), at(1.5)], [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)]);
        if turns.abs() < 1e7 {
            close(&[at(0.25).0, at(0.75).1, at(-0.25).0, at(1.25).1], &[half, -half, -half, -half], 1e-15);
        }
    }
    // 30 degrees, whose number no binary fraction is; 60 degrees.
    close(&[sin_cos_pi(1.0 / 6.0).0, sin_cos_pi(1.0 / 3.0).1], &[0.5, 0.5], 1e-15);
}

#[test]
fn encodings_are_those_of_the_paper() {
    close(&encode(&[0.5], 2, true, false), &[1.0, 0.0, 0.0, -1.0], 1e-15);
    // Two inputs: sin of both, cos of both, level by level, behind the inputs themselves.
    let found = encode(&[0.5, 0.25], 2, true, true);
    let half = 0.5f64.sqrt();
    close(&found, &[0.5, 0.25, 1.0, half, 0.0, half, 0.0, 1.0, -1.0, 0.0], 1e-15);
    // s = 1: sin and cos of 2^k x; sin 1 = 0.8414709848078965.
    close(&encode(&[0.5], 2, false, false)[2..], &[0.841_470_984_807_896_5, 0.540_302_305_868_139_8], 1e-15);
}

#[test]
fn a_network_of_two_units_is_what_paper_and_pencil_say() {
    let dense =
        |w: &[&[f64]], b: &[f64]| Dense { w: w.iter().map(|row| row.to_vec()).collect(), b: b.to_vec() };
    let plain = Encoding { levels: 0, pi: true, identity: true };
    let network = Network {
        position: plain,
        direction: Some(plain),
        // h = ReLU(x + 2y, 1 − z); then [h, x, y, z] → (h₀ + z, −h₁).
        trunk: vec![
            (dense(&[&[1.0, 2.0, 0.0], &[0.0, 0.0, -1.0]], &[0.0, 1.0]), false),
            (dense(&[&[1.0, 0.0, 0.0, 0.0, 1.0], &[0.0, -1.0, 0.0, 0.0, 0.0]], &[0.0, 0.0]), true),
        ],
        density: Some(dense(&[&[3.0, 5.0]], &[-1.0])),
        softplus: false,
        feature: None,
        colour: vec![dense(&[&[1.0, 0.0, 0.0, 0.0, 1.0]], &[0.0])],
        rgb: dense(&[&[1.0], &[0.0], &[-1.0]], &[0.0, 0.0, 0.0]),
    };
    // At (1, 1, ½): h = (3, ½), then (3½, 0); raw density 9½. Colour: ReLU(3½ + d_z) = 4 under d_z = ½.
    let x = [1.0, 1.0, 0.5];
    close(&network.trunk(&x), &[3.5, 0.0], 0.0);
    assert_eq!(network.sigma(&x), 9.5);
    close(
        &network.rgb(&x, &[0.0, 0.0, 0.5]),
        &[1.0 / (1.0 + (-4f64).exp()), 0.5, 1.0 / (1.0 + 4f64.exp())],
        1e-15,
    );
    // At (−1, −1, ½) the first unit is off: raw density −½.
    assert_eq!((network.raw_density(&[-1.0, -1.0, 0.5]), network.sigma(&[-1.0, -1.0, 0.5])), (0.5, 0.5));
    assert_eq!(network.sigma(&[-1.0, -1.0, 0.0]), 0.0);
    close(&[softplus(0.0), softplus(1e4), softplus(-1e4)], &[2f64.ln(), 1e4, 0.0], 1e-15);
    close(&[sigmoid(0.0), sigmoid(1e4), sigmoid(-1e4)], &[0.5, 1.0, 0.0], 1e-15);
}

#[test]
fn numbers_of_16_bits_are_ieee_s() {
    let known = [
        (0x3c00, 1.0),
        (0xc000, -2.0),
        (0x7bff, 65_504.0),
        (0x0400, 2f64.powi(-14)),
        (0x03ff, 1023.0 * 2f64.powi(-24)),
        (0x0001, 2f64.powi(-24)),
        (0x3555, 0.333_251_953_125),
        (0x7c00, f64::INFINITY),
    ];
    assert!(known.iter().all(|&(bits, number)| f16(bits) == number));
    assert!(f16(0x7e00).is_nan() && f16(0x8000) == 0.0);
}

#[test]
fn half_a_wall_in_front_of_a_wall() {
    // ln 2 takes half of the light; a wall takes the rest; behind it there is nothing to see.
    let (sigma, rgb) = ([2f64.ln(), f64::INFINITY, 1.0], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    let pixel = composite(&sigma, &rgb, &[2.5, 3.5, 4.5], &[1.0; 3], [0.0, 0.0, 9.0]);
    close(&pixel.rgb, &[0.5, 0.5, 0.0], 1e-15);
    close(&pixel.weights, &[0.5, 0.5, 0.0], 1e-15);
    close(&[pixel.opacity, pixel.distance_sum, pixel.transmittance], &[1.0, 3.0, 0.0], 1e-15);
    // NaN, nothing times a wall, and no density at all: the background.
    let empty = composite(&[f64::NAN, f64::INFINITY, 0.0], &rgb, &[1.0; 3], &[1.0, 0.0, 1.0], [0.25; 3]);
    close(&empty.rgb, &[0.25; 3], 0.0);
    assert_eq!((empty.opacity, empty.transmittance), (0.0, 1.0));
}

#[test]
fn samples_are_drawn_where_the_weight_is() {
    close(&middles(2.0, 6.0, 4), &[2.5, 3.5, 4.5, 5.5], 0.0);
    // Two bins, the second three times as heavy: a quarter of the samples in the first. 1e-5 more each.
    let found = inverse_cdf(0.0, 2.0, &[0.25, 0.75], 4);
    close(&found, &[0.5, 1.0 + 0.5 / 3.0, 1.5, 1.0 + 2.5 / 3.0], 1e-4);
    close(&inverse_cdf(0.0, 4.0, &[0.0; 4], 4), &[0.5, 1.5, 2.5, 3.5], 1e-12);
    assert!(inverse_cdf(0.0, 4.0, &[0.0, f64::NAN, 1.0, 0.0], 9).iter().all(|t| (2.0..=3.0).contains(t)));
    let unit = ([-1.0; 3], [1.0; 3]);
    assert_eq!(clip([0.0, 0.0, 4.0], [0.0, 0.0, -1.0], unit.0, unit.1, 2.0, 6.0), Some((3.0, 5.0)));
    assert_eq!(clip([1.0, 0.0, 4.0], [0.0, 0.0, -1.0], unit.0, unit.1, 2.0, 6.0), Some((3.0, 5.0)));
    assert_eq!(clip([1.5, 0.0, 4.0], [0.0, 0.0, -1.0], unit.0, unit.1, 2.0, 6.0), None);
}

#[test]
fn derivatives_are_those_of_school() {
    close(
        &[derivative(f64::sin, 1.0, 1e-3), derivative(|x| x * x * x, 2.0, 1e-2)],
        &[1f64.cos(), 12.0],
        1e-11,
    );
    close(&gradient(|x| x[0] * x[1] + x[2].exp(), &[2.0, 3.0, 0.0], 1e-3), &[3.0, 2.0, 1.0], 1e-11);
}

fn archive(file: &Path) -> ZipArchive<BufReader<File>> {
    ZipArchive::new(BufReader::new(File::open(file).expect("a file"))).expect("an archive")
}

fn array(archive: &mut ZipArchive<BufReader<File>>, key: &str) -> Vec<f64> {
    let entry = archive.by_name(&format!("{key}.npy")).expect(key);
    let values: Vec<f32> = npyz::NpyFile::new(entry).expect("an array").into_vec().expect("f32");
    values.into_iter().map(f64::from).collect()
}

#[test]
fn volume_rendering_is_the_course_s_to_four_decimals() {
    let Some(file) = tools::data("golden/cs180_volrender.npz") else { return };
    let mut file = archive(&file);
    let mut get = |key: &str| array(&mut file, key);
    let (sigmas, rgbs, step, expected) =
        (get("sigmas"), get("rgbs"), get("step_size")[0], get("expected_4dp"));
    let t = middles(0.0, 64.0 * step, 64);
    for ray in 0..10 {
        let rgb: Vec<[f64; 3]> =
            rgbs[192 * ray..][..192].chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let pixel = composite(&sigmas[64 * ray..][..64], &rgb, &t, &vec![step; 64], [0.0; 3]);
        for (found, expected) in pixel.rgb.iter().zip(&expected[3 * ray..]) {
            assert_eq!((found * 1e4).round(), (expected * 1e4).round(), "ray {ray}, in units of 1e-4");
        }
    }
}

/// Reads the original authors' network, with nerf-pytorch's names. Its skip layer takes `[PE(x), h]`; the oracle's
/// takes `[h, PE(x)]`.
fn original(file: &Path) -> Network {
    let mut archive = archive(file);
    let mut dense = |name: &str| {
        let (w, b) =
            (array(&mut archive, &format!("{name}.weight")), array(&mut archive, &format!("{name}.bias")));
        Dense { w: w.chunks_exact(w.len() / b.len()).map(<[f64]>::to_vec).collect(), b }
    };
    let trunk = (0..8).map(|i| {
        let mut layer = dense(&format!("pts_linears.{i}"));
        if i == 5 {
            layer.w.iter_mut().for_each(|row| row.rotate_left(63));
        }
        (layer, i == 5)
    });
    Network {
        position: Encoding { levels: 10, pi: false, identity: true },
        direction: Some(Encoding { levels: 4, pi: false, identity: true }),
        trunk: trunk.collect(),
        density: Some(dense("alpha_linear")),
        softplus: false,
        feature: Some(dense("feature_linear")),
        colour: vec![dense("views_linears.0")],
        rgb: dense("rgb_linear"),
    }
}

#[test]
fn the_original_network_says_what_the_original_code_computed() {
    let Some(nets) = tools::data("nets") else { return };
    let text = std::fs::read_to_string(nets.join("tf_reference_samples.json")).expect("the samples");
    let json: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let numbers = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().expect("numbers").iter().map(|x| x.as_f64().expect("a number")).collect()
    };
    let (mut checked, mut worst) = (0, [0.0f64; 2]);
    for name in ["coarse", "fine"] {
        let network = original(&nets.join(format!("lego_200k_{name}.npz")));
        for ray in json["examples"].as_array().expect("rays") {
            let [o, d, view] = ["ray_o", "ray_d", "viewdir_unit"].map(|key| numbers(&ray[key]));
            let (sigmas, rgbs) = (numbers(&ray[format!("{name}_sigma")]), &ray[format!("{name}_rgb")]);
            for (i, z) in numbers(&json["z_vals"]).into_iter().enumerate() {
                // The original code computed the point in f32: one rounding for each operation.
                let point: Vec<f64> =
                    (0..3).map(|c| f64::from(o[c] as f32 + d[c] as f32 * z as f32)).collect();
                let sigma = network.sigma(&point);
                worst[0] = worse(worst[0], (sigma - sigmas[i]).abs() / sigmas[i].max(1.0));
                for (found, expected) in network.rgb(&point, &view).iter().zip(numbers(&rgbs[i])) {
                    worst[1] = worse(worst[1], (found - expected).abs());
                }
                checked += 1;
            }
        }
    }
    println!("sigma within {:.1e} (relative), rgb within {:.1e}", worst[0], worst[1]);
    // What f32 arithmetic of eight layers of 256 errs by.
    assert!(checked == 30 && worst[0] <= 1e-5 && worst[1] <= 1e-5, "{checked} samples, {worst:?}");
}

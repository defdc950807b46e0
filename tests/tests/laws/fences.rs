//! Kernels access only the memory that they are given, with every instruction set: their slices begin or end at a page
//! that cannot be accessed. (`tests/tests/abi/fences.rs` shows that such a page works.)

use nerf_core::blob::Blob;
use nerf_core::encoding::{
    AngleScale, GridEncoding, GridTables, SinusoidalEncoding, TableValues, encode_block, encode_grid_block,
};
use nerf_core::math::MathBackend;
use nerf_core::matrix::{
    Gemm, Init, PairedInput, PairedOutput, dense_bf16, gemm, gemm_f16, pair_rows, pairs, transposed_bf16,
};
use nerf_core::memory::Line;
use nerf_core::network::{Network, Scratch, Weights};
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_core::{Isa, Kernel};
use nerf_testing::fence::{Fenced, Flush};
use nerf_testing::noise::noise;
use nerf_testing::scenes::{Recipe, camera, f16_bits, kernels};

const BACKENDS: [MathBackend; 4] =
    [MathBackend::Polynomial, MathBackend::Libm, MathBackend::Micromath, MathBackend::Recurrence];

/// Returns `n` f16 values, little-endian bytes: powers of two with random signs.
fn halves(n: usize, seed: u32) -> Vec<u8> {
    let bits = |x: f32| if x < 0.0 { 0xb800u16 } else { 0x3400 };
    noise(n, seed).into_iter().flat_map(|x| bits(x).to_le_bytes()).collect()
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|x| x.to_bits()).collect()
}

/// Returns the instruction sets of this machine.
fn isas() -> impl Iterator<Item = Isa> {
    Isa::ALL.into_iter().filter(|isa| isa.available())
}

/// Returns `values` followed by 64 NaNs, which no instruction set may read.
fn roomy(values: &[f32]) -> Vec<f32> {
    [values, &[f32::NAN; 64]].concat()
}

#[test]
fn products_stay_between_the_fences() {
    for (m, n, k) in (1..=13).flat_map(|m| {
        [16, 32, 48, 64, 80, 144].into_iter().flat_map(move |n| [0, 1, 2, 7].map(move |k| (m, n, k)))
    }) {
        for (transposed, gap) in [(false, 0), (true, 0), (false, 3), (true, 5)] {
            // Rows may be further apart than they are long: the last one ends where it ends.
            let (a_row, a_col) = if transposed { (1, m + gap) } else { (k + gap, 1) };
            let g = Gemm { m, n, k, a_row, a_col, b_row: n + gap, c_row: n + gap };
            let reach = |rows: usize, row: usize, last: usize| rows.saturating_sub(1) * row + last;
            let a_length = if k == 0 { 0 } else { (m - 1) * a_row + (k - 1) * a_col + 1 };
            let (a, b) = (noise(a_length, 1), noise(if k == 0 { 0 } else { reach(k, n + gap, n) }, 2));
            let (c, bias) = (noise(reach(m, n + gap, n), 3), noise(m, 4));
            for (isa, relu) in isas().enumerate().map(|(i, isa)| (isa, (i + m + k).is_multiple_of(2))) {
                let expected = [Init::Zero, Init::Bias(&bias), Init::Accumulate].map(|init| {
                    let mut expected = roomy(&c);
                    gemm(isa, g, &roomy(&a), &roomy(&b), &mut expected, init, relu);
                    assert!(expected[c.len()..].iter().all(|x| x.is_nan()), "{isa:?}, {g:?}: beyond C");
                    bits(&expected[..c.len()])
                });
                for flush in Flush::BOTH {
                    let [a, b, bias] = [&a, &b, &bias].map(|values| Fenced::of(values, flush));
                    for (init, expected) in
                        [Init::Zero, Init::Bias(&bias), Init::Accumulate].into_iter().zip(&expected)
                    {
                        let mut found = Fenced::of(&c, flush);
                        gemm(isa, g, &a, &b, &mut found, init, relu);
                        assert!(bits(&found) == *expected, "{isa:?}, {g:?}, {init:?}, {flush:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn products_of_halves_stay_between_the_fences() {
    let sizes = || (1..=5).flat_map(|m| [1, 3, 15, 16, 17, 64].map(move |n| (m, n, m * n % 7)));
    for ((m, n, k), isa) in sizes().flat_map(|size| isas().map(move |isa| (size, isa))) {
        let g = Gemm { m, n, k, a_row: k + 1, a_col: 1, b_row: n + 2, c_row: n };
        let a_length = if k == 0 { 0 } else { (m - 1) * (k + 1) + k };
        let (a, b) = (halves(a_length, 1), noise(if k == 0 { 0 } else { (k - 1) * (n + 2) + n }, 2));
        let (c, bias) = (noise(m * n, 3), halves(m, 4));
        let draw = |init: Init<'_, u8>, a: &[u8], b: &[f32], c: &mut [f32]| {
            gemm_f16(isa, g, a, b, c, init, true);
        };
        for flush in Flush::BOTH {
            // Weights lie in a file at any byte.
            let shifted = Fenced::of(&[&[0u8][..], &a].concat(), flush);
            let (fenced, b_fenced, bias_fenced) =
                (Fenced::of(&a, flush), Fenced::of(&b, flush), Fenced::of(&bias, flush));
            for init in [Init::Zero, Init::Bias(&bias_fenced), Init::Accumulate] {
                let (mut expected, mut found, mut odd) = (c.clone(), Fenced::of(&c, flush), c.clone());
                draw(init, &a, &b, &mut expected);
                draw(init, &fenced, &b_fenced, &mut found);
                draw(init, &shifted[1..], &b_fenced, &mut odd);
                assert!(*found == *expected && odd == expected, "{isa:?}, {g:?}, {init:?}, {flush:?}");
            }
        }
    }
}

#[test]
fn paired_layers_stay_between_the_fences() {
    for (outputs, stride, main, extra) in (1..=13).flat_map(|outputs| {
        [(16, 1, 0), (48, 3, 2), (64, 6, 1), (80, 0, 5)]
            .map(|(stride, main, extra)| (outputs, stride, main, extra))
    }) {
        let row = pairs(main) + pairs(extra) + outputs % 2;
        let inputs = |count: usize, seed| {
            let mut values = noise(count * stride, seed);
            pair_rows(&mut values, count, stride);
            values.truncate(pairs(count) * stride);
            values
        };
        let weights = |count: usize, seed| noise((outputs - 1) * row + pairs(count), seed);
        let (bias, start) = (noise(outputs, 5), noise(outputs * stride, 6));
        let plain = [weights(main, 1), inputs(main, 2), weights(extra, 3), inputs(extra, 4)];
        let layer = |isa, at: [&[f32]; 4], init: Init<'_>, to: &mut [f32], output| {
            let part = |count, weights, inputs| PairedInput { weights, row, pairs: pairs(count), inputs };
            let parts = [part(main, at[0], at[1]), part(extra, at[2], at[3])];
            dense_bf16(isa, parts, outputs, stride, init, to, true, output);
        };
        for isa in [Isa::Portable, Isa::Avx512] {
            for (output, flush) in [PairedOutput::Floats, PairedOutput::Pairs]
                .into_iter()
                .flat_map(|o| Flush::BOTH.map(|f| (o, f)))
            {
                let all = plain.each_ref().map(|values| roomy(values));
                let fenced = plain.each_ref().map(|values| Fenced::of(values, flush));
                let bias = Fenced::of(&bias, flush);
                for init in [Init::Zero, Init::Bias(&bias), Init::Accumulate] {
                    // Sums start from floats also where pairs are written over them.
                    let floats = output == PairedOutput::Floats || matches!(init, Init::Accumulate);
                    let length = if floats { outputs } else { pairs(outputs) } * stride;
                    let (mut expected, mut found) =
                        (roomy(&start[..length]), Fenced::of(&start[..length], flush));
                    layer(isa, all.each_ref().map(|v| &v[..]), init, &mut expected, output);
                    layer(isa, fenced.each_ref().map(|v| &v[..]), init, &mut found, output);
                    assert!(
                        bits(&found) == bits(&expected[..length]),
                        "{isa:?}, {outputs}x{stride}x{main}+{extra}, {init:?}, {output:?}, {flush:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn transposed_paired_weights_stay_between_the_fences() {
    for (outputs, inputs, stride) in (1..=5).flat_map(|outputs| {
        (1..=5).flat_map(move |inputs| [16, 48, 64, 80].map(move |s| (outputs, inputs, s)))
    }) {
        let row = pairs(inputs) + 1;
        let weights = noise((outputs - 1) * row + pairs(inputs), 1);
        let (from, start) = (noise(outputs * stride, 2), noise(inputs * stride, 3));
        for (isa, accumulate) in isas().flat_map(|isa| [(isa, false), (isa, true)]) {
            let sizes = [outputs, inputs];
            let mut expected = roomy(&start);
            transposed_bf16(
                isa,
                &roomy(&weights),
                row,
                sizes,
                stride,
                &roomy(&from),
                &mut expected,
                accumulate,
            );
            for flush in Flush::BOTH {
                let (weights, from) = (Fenced::of(&weights, flush), Fenced::of(&from, flush));
                let mut found = Fenced::of(&start, flush);
                transposed_bf16(isa, &weights, row, sizes, stride, &from, &mut found, accumulate);
                assert!(
                    bits(&found) == bits(&expected[..start.len()]),
                    "{isa:?}, {sizes:?}, {stride}, {flush:?}"
                );
            }
        }
    }
}

#[test]
fn pairs_are_made_between_the_fences() {
    for (rows, stride) in (0..=5).flat_map(|rows| [1, 15, 16, 64].map(move |stride| (rows, stride))) {
        let values = noise(rows * stride, 1);
        let mut expected = roomy(&values);
        pair_rows(&mut expected, rows, stride);
        for flush in Flush::BOTH {
            let mut found = Fenced::of(&values, flush);
            pair_rows(&mut found, rows, stride);
            assert!(bits(&found) == bits(&expected[..values.len()]), "{rows}x{stride}, {flush:?}");
        }
    }
}

#[test]
fn encodings_stay_between_the_fences() {
    let shapes = [(2, 0, true), (2, 3, false), (3, 10, true), (3, 16, false)];
    for (inputs, levels, identity) in shapes {
        for (scale, math) in
            [AngleScale::One, AngleScale::Pi].into_iter().flat_map(|s| BACKENDS.map(|m| (s, m)))
        {
            let encoding = SinusoidalEncoding { inputs, levels, scale, identity };
            for (isa, stride) in isas().flat_map(|isa| [1, 7, 16, 48, 64].map(|stride| (isa, stride))) {
                let x = noise(usize::from(inputs) * stride, 1);
                let blank = vec![-7.0; encoding.outputs() * stride];
                let mut expected = blank.clone();
                encode_block(isa, math, &encoding, stride, &x, &mut expected);
                for flush in Flush::BOTH {
                    let (x, mut found) = (Fenced::of(&x, flush), Fenced::of(&blank, flush));
                    encode_block(isa, math, &encoding, stride, &x, &mut found);
                    assert!(bits(&found) == bits(&expected), "{isa:?}, {encoding:?}, {math:?}, {stride}");
                }
            }
        }
    }
}

#[test]
fn grids_read_no_further_than_their_last_entry() {
    let shapes: [(u8, &[[u16; 3]]); 4] =
        [(0, &[[1, 1, 1]]), (12, &[[2, 2, 2]]), (3, &[[5, 4, 0], [9, 9, 0]]), (4, &[[3, 3, 3], [300, 8, 2]])];
    for ((log2_entries, resolutions), features) in
        shapes.into_iter().flat_map(|shape| [1u8, 2, 4].map(|features| (shape, features)))
    {
        let inputs = if resolutions[0][2] == 0 { 2 } else { 3 };
        let resolutions = resolutions.iter().copied().collect();
        let grid = GridEncoding { inputs, features, log2_entries, resolutions };
        let values: Vec<f32> = noise(grid.values(), 3).iter().map(|x| (x * 64.0).round() / 64.0).collect();
        let bytes: Vec<u8> = values.iter().flat_map(|&x| f16_bits(x).to_le_bytes()).collect();
        let steps: Vec<u8> = values.iter().map(|&x| (x * 64.0) as i8 as u8).collect();
        let scales = (1.0f32 / 64.0).to_le_bytes().repeat(grid.resolutions.len());
        for (isa, stride) in isas().flat_map(|isa| [1, 7, 16, 64].map(|stride| (isa, stride))) {
            // The largest corner of the box is the last entry of a dense level; others are anywhere.
            let mut x: Vec<f32> =
                noise(usize::from(inputs) * stride, 1).iter().map(|x| 0.5 + 0.5 * x).collect();
            x.iter_mut().step_by(stride).for_each(|x| *x = 1.0);
            for flush in Flush::BOTH {
                let (f16, f32) = (Fenced::of(&bytes, flush), Fenced::of(&values, flush));
                let (steps, scales) = (Fenced::of(&steps, flush), Fenced::of(&scales, flush));
                let int8 = TableValues::Int8 { values: &steps, scales: &scales };
                let found = [TableValues::F16(&f16), int8, TableValues::F32(&f32)].map(|values| {
                    let mut found = Fenced::filled(grid.outputs() * stride, f32::NAN, flush);
                    encode_grid_block(isa, &grid, &GridTables::new(values, None), stride, &x, &mut found);
                    bits(&found)
                });
                assert!(
                    found.iter().all(|other| *other == found[0]),
                    "{isa:?}, {grid:?}, {stride}, {flush:?}"
                );
            }
        }
    }
}

/// Returns all results of the Rust renderer for a scene file. The file, the weights and the workspace lie where `flush`
/// says.
fn answers(bytes: &[u8], kernel: Kernel, batch: Batch, flush: Flush) -> Vec<u32> {
    let bytes = Fenced::of(bytes, flush);
    let blob = Blob::open(&bytes).expect("a blob");
    let mut memory = Fenced::of(&vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)], flush);
    let (mut found, all) = (Vec::new(), Outputs { median_distance: true, normals: true, ..Outputs::ALL });
    let renderer = Renderer::new(blob.clone(), kernel, &mut memory).expect("a renderer");
    if blob.picture().is_some() {
        let mut workspace = Fenced::of(&vec![Line::UNINIT; renderer.picture_workspace_lines(batch)], flush);
        let mut put = |_: u32, _: u32, rgb: [f32; 3]| found.extend(rgb.map(f32::to_bits));
        let rect = Rect { x: 1, y: 0, width: 9, height: 10 };
        let drawn =
            renderer.render_picture(MathBackend::Polynomial, batch, [10, 10], rect, &mut workspace, &mut put);
        drawn.expect("a picture");
        return found;
    }
    let plan = Plan::new(&blob, &Quality::default(), all, batch).expect("a plan");
    let mut workspace = Fenced::of(&vec![Line::UNINIT; renderer.workspace_lines(&plan)], flush);
    let mut pixels = vec![[0.0; 10]; 16 * 12];
    let mut put = |x: u32, y: u32, p: &Pixel| {
        let ([r, g, b], [nx, ny, nz]) = (p.rgb, p.normal);
        let distances = [p.ray_distance, p.z_depth, p.median_distance];
        pixels[(y * 16 + x) as usize] =
            [r, g, b, nx, ny, nz, p.opacity, distances[0], distances[1], distances[2]];
    };
    let rect = Rect { x: 3, y: 2, width: 9, height: 7 };
    renderer.render(&plan, &camera(16, 12), rect, &mut workspace, &mut put).expect("a frame");
    let points: Vec<[f32; 3]> = noise(3 * 67, 1).chunks(3).map(|p| [p[0], p[1], p[2]]).collect();
    let (points, dirs) = (Fenced::of(&points, flush), Fenced::of(&[[0.6, 0.0, 0.8]; 67], flush));
    let (mut sigma, mut rgb) = (Fenced::of(&[0.0; 67], flush), Fenced::of(&[[0.0; 3]; 67], flush));
    renderer.query(&plan, &points, &dirs, &mut workspace, &mut sigma, &mut rgb).expect("answers");
    found.extend(pixels.iter().flatten().map(|x| x.to_bits()));
    found.extend(sigma.iter().chain(rgb.iter().flatten()).map(|x| x.to_bits()));
    found
}

#[test]
fn frames_queries_and_pictures_stay_between_the_fences() {
    let odd = Recipe { trunk: (3, 21), skip: true, levels: 5, ..Recipe::PLAIN };
    let single = Recipe { features: 1, ..Recipe::LEARNED };
    let recipes = [
        Recipe::SKIP,
        Recipe::PROPOSAL,
        Recipe::TINY,
        Recipe::PICTURE,
        Recipe::TINY_PICTURE,
        Recipe::LEARNED,
        Recipe::LEARNED_INT8,
        Recipe::DEFERRED,
        Recipe::DEFERRED_LAYER,
        Recipe::CONTRACTED,
        Recipe::LEARNED_PICTURE,
        single,
        odd,
    ];
    for (kernel, recipe) in kernels().flat_map(|kernel| recipes.map(|recipe| (kernel, recipe))) {
        let blob = recipe.blob();
        let mut batches = vec![Batch::FULL, Batch { rays: 17, samples: 64 }];
        if kernel == Kernel::IN_PLACE {
            batches.extend([Batch::SMALLEST, Batch { rays: 5, samples: 7 }]);
        }
        let expected = answers(&blob, kernel, batches[0], Flush::Neither);
        assert!(!expected.is_empty());
        for (batch, flush) in batches.into_iter().flat_map(|batch| Flush::BOTH.map(|flush| (batch, flush))) {
            let found = answers(&blob, kernel, batch, flush);
            assert!(found == expected, "{kernel:?}, {recipe:?}, {batch:?}, {flush:?}");
        }
    }
}

/// Evaluates densities and colours of a block of points with a network. Weights and rows have exactly the required
/// sizes and lie where `flush` says.
fn evaluated(blob: &Blob<'_>, kernel: Kernel, stride: usize, flush: Flush) -> Vec<u32> {
    let math = MathBackend::Polynomial;
    let file = Fenced::of(blob.weights(), flush);
    let mut unpacked = Fenced::filled(blob.architecture().parameters(), f32::NAN, flush);
    let weights = Weights::prepare(blob.architecture(), kernel.storage, &file, &mut unpacked);
    let entries = Fenced::of(blob.tables().map_or(&[][..], |tables| tables.bytes()), flush);
    let scales = blob.tables().and_then(|tables| tables.scales()).map(|scales| Fenced::of(scales, flush));
    let values = match &scales {
        Some(scales) => TableValues::Int8 { values: &entries, scales },
        None => TableValues::F16(&entries),
    };
    let tables = GridTables::new(values, blob.scene_box().as_ref());
    let network = Network::with_grid(blob.architecture(), weights, tables, kernel.isa).expect("a network");
    let rows = |count: usize| Fenced::filled(count * stride, f32::NAN, flush);
    let [mut encoded, mut front, mut back] =
        [network.encoded_rows(), network.activation_rows(), network.activation_rows()].map(rows);
    let mut scratch = Scratch { stride, encoded: &mut encoded, front: &mut front, back: &mut back };
    let [positions, dirs] = [1, 2].map(|seed| Fenced::of(&noise(3 * stride, seed), flush));
    let [mut sigma, mut rgb] = [1, 3].map(rows);
    network.trunk(math, &mut scratch, &positions);
    network.density(math, &scratch, &mut sigma);
    let direction = |encoded: &mut [f32], to: &mut [f32]| network.direction(math, stride, encoded, &dirs, to);
    network.colour(math, &mut scratch, direction, &mut rgb);
    assert!(sigma.iter().chain(rgb.iter()).all(|x| x.is_finite()));
    bits(&[&sigma[..], &rgb[..]].concat())
}

#[test]
fn networks_stay_between_the_fences() {
    for (kernel, recipe) in kernels().flat_map(|kernel| {
        [Recipe::SKIP, Recipe::TINY, Recipe::LEARNED, Recipe::LEARNED_INT8, Recipe::DEFERRED]
            .map(|recipe| (kernel, recipe))
    }) {
        let bytes = recipe.blob();
        let blob = Blob::open(&bytes).expect("a blob");
        for stride in [16, 48, 64] {
            let [at_start, at_end] = Flush::BOTH.map(|flush| evaluated(&blob, kernel, stride, flush));
            assert!(at_start == at_end, "{kernel:?}, {recipe:?}, {stride}");
        }
    }
}

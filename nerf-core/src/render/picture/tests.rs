extern crate std;

use super::*;
use crate::Kernel;
use crate::blob::Blob;
#[cfg(feature = "grid")]
use crate::blob::{Body, StoredTables};
#[cfg(feature = "grid")]
use crate::encoding::{GridEncoding, PositionEncoding};
use crate::network::{Architecture, Role};
use crate::render::{RenderError, Renderer};
#[cfg(feature = "grid")]
use crate::testing::noise;
use crate::testing::{
    Worse, architecture, body, bytes, every_kind, halve, parameters, pi, picture_body, tolerance,
};
use std::string::ToString;
use std::vec;
use std::vec::Vec;

const POLYNOMIAL: MathBackend = MathBackend::Polynomial;

fn kernels() -> impl Iterator<Item = Kernel> {
    Kernel::all()
}

/// Batches with different block sizes. Kernels other than [`Kernel::IN_PLACE`] ignore the block size.
fn batches() -> impl Iterator<Item = Batch> {
    [1, 3, 16, 63, BLOCK].into_iter().map(|samples| Batch { rays: 1, samples })
}

fn full([width, height]: [u32; 2]) -> Rect {
    Rect { x: 0, y: 0, width, height }
}

/// Renders pixels of a 2D field with a workspace of exactly `picture_workspace_lines`. Checks that pixels arrive row by
/// row.
fn draw(
    renderer: &Renderer<'_>,
    math: MathBackend,
    batch: Batch,
    size: [u32; 2],
    rect: Rect,
) -> (Vec<[f32; 3]>, Counters) {
    let mut workspace = vec![Line::UNINIT; renderer.picture_workspace_lines(batch)];
    let mut pixels = vec![];
    let mut put = |x: u32, y: u32, rgb: [f32; 3]| {
        let i = pixels.len() as u32;
        assert_eq!((x, y), (rect.x + i % rect.width, rect.y + i / rect.width), "row by row, once");
        pixels.push(rgb);
    };
    let counters = renderer.render_picture(math, batch, size, rect, &mut workspace, &mut put).unwrap();
    assert_eq!(pixels.len(), (rect.width * rect.height) as usize);
    (pixels, counters)
}

fn whole(renderer: &Renderer<'_>, size: [u32; 2]) -> Vec<[f32; 3]> {
    draw(renderer, POLYNOMIAL, Batch::FULL, size, full(size)).0
}

/// 2D field with a skip layer and a hidden colour layer.
fn layered() -> (Architecture, Vec<u8>) {
    let a = architecture(pi(2, 6), None, &[(40, false), (33, true)], &[17]);
    let (weights, _) = halve(&parameters(&a, 61));
    let bytes = bytes(&picture_body(a.clone(), &weights));
    (a, bytes)
}

/// 2D field with a learned grid, which has dense and hashed levels, and with a hidden colour layer.
#[cfg(feature = "grid")]
fn learned() -> (Architecture, Vec<u8>) {
    let resolutions = [[5, 3, 0], [17, 12, 0], [64, 43, 0]].into_iter().collect();
    let grid = GridEncoding { inputs: 2, features: 4, log2_entries: 7, resolutions };
    let (tables, _) = halve(&noise(grid.values(), 71));
    let a = architecture(PositionEncoding::Grid(grid), None, &[(32, false), (16, false)], &[9]);
    let (weights, _) = halve(&parameters(&a, 72));
    let tables = Some(StoredTables::F16(&tables));
    let bytes = bytes(&Body { tables, ..picture_body(a.clone(), &weights) });
    (a, bytes)
}

/// 2D fields, one for each position encoding of this build.
fn fields() -> Vec<(Architecture, Vec<u8>)> {
    vec![
        layered(),
        #[cfg(feature = "grid")]
        learned(),
    ]
}

/// Makes a renderer of the blob for `kernel` and passes it to `then`.
fn on<T>(bytes: &[u8], kernel: Kernel, then: impl FnOnce(&Renderer<'_>) -> T) -> T {
    let blob = Blob::open(bytes).unwrap();
    let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, kernel)];
    then(&Renderer::new(blob, kernel, &mut memory).unwrap())
}

/// Blob of a 2D field whose raw red, green and blue are 4x − 2, 4y − 2 and x − y. Its only trunk layer copies x and y.
fn gradient() -> Vec<u8> {
    let a = architecture(pi(2, 0), None, &[(2, false)], &[]);
    let trunk = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0];
    let rgb = [4.0, 0.0, 0.0, 4.0, 1.0, -1.0, -2.0, -2.0, 0.0];
    let (weights, _) = halve(&[&trunk[..], &rgb[..]].concat());
    bytes(&picture_body(a, &weights))
}

#[test]
fn a_pixel_is_the_field_at_its_centre() {
    let bytes = gradient();
    let last = MAX_RENDER_SIDE - 2;
    let cases = [
        ([30, 20], full([30, 20])),
        ([7, 211], full([7, 211])),
        ([1, 1], full([1, 1])),
        // A few pixels of the largest image, which has 7e13 pixels.
        ([MAX_RENDER_SIDE; 2], Rect { x: last, y: 0, width: 2, height: 3 }),
    ];
    for (kernel, (size, rect)) in kernels().flat_map(|kernel| cases.map(|case| (kernel, case))) {
        let batch = Batch::FULL;
        let (pixels, _) = on(&bytes, kernel, |renderer| draw(renderer, POLYNOMIAL, batch, size, rect));
        let mut worst = 0.0f64;
        for (i, pixel) in pixels.iter().enumerate() {
            let at = |start: u32, i: u32, side: u32| (f64::from(start + i) + 0.5) / f64::from(side);
            let x = at(rect.x, i as u32 % rect.width, size[0]);
            let y = at(rect.y, i as u32 / rect.width, size[1]);
            for (found, raw) in pixel.iter().zip([4.0 * x - 2.0, 4.0 * y - 2.0, x - y]) {
                worst = worst.worse((f64::from(*found) - 1.0 / (1.0 + (-raw).exp())).abs());
            }
        }
        std::println!("{kernel:?} {size:?}: {worst:e}");
        assert!(worst <= tolerance(kernel, 3e-7), "{kernel:?} {size:?}: {worst:e}");
    }
}

#[test]
fn pixels_depend_on_neither_rectangle_nor_batch() {
    // Rows are longer than a block, so that a row may end inside a block.
    let size = [71, 13];
    let rects = [
        full(size),
        Rect { x: 5, y: 2, width: 1, height: 11 },
        Rect { x: 70, y: 12, width: 1, height: 1 },
        Rect { x: 3, y: 4, width: 66, height: 7 },
    ];
    let fields = fields();
    for (kernel, (_, bytes)) in kernels().flat_map(|kernel| fields.iter().map(move |field| (kernel, field))) {
        on(bytes, kernel, |renderer| {
            let expected = whole(renderer, size);
            assert!(expected.iter().any(|pixel| pixel != &expected[0]), "a flat picture proves nothing");
            for (rect, batch) in rects.into_iter().flat_map(|rect| batches().map(move |batch| (rect, batch)))
            {
                let (found, counters) = draw(renderer, POLYNOMIAL, batch, size, rect);
                for (i, pixel) in found.iter().enumerate() {
                    let (x, y) = (rect.x + i as u32 % rect.width, rect.y + i as u32 / rect.width);
                    let whole = expected[(y * size[0] + x) as usize];
                    assert_eq!(
                        pixel.map(f32::to_bits),
                        whole.map(f32::to_bits),
                        "{kernel:?} {batch:?} {x} {y}"
                    );
                }
                assert_eq!(counters.colour_evaluations, found.len() as u64);
            }
        });
    }
}

#[test]
fn kernels_and_backends_agree_with_the_oracle() {
    let size = [30, 20];
    let rows = [
        (POLYNOMIAL, 1e-6),
        #[cfg(feature = "libm")]
        (MathBackend::Libm, 1e-5),
        #[cfg(feature = "micromath")]
        (MathBackend::Micromath, 0.05),
        (MathBackend::Recurrence, 1e-4),
    ];
    for (_, bytes) in fields() {
        let oracle = on(&bytes, Kernel::IN_PLACE, |renderer| whole(renderer, size));
        for (kernel, (math, limit)) in kernels().flat_map(|kernel| rows.map(|row| (kernel, row))) {
            let batch = Batch::FULL;
            let (found, _) = on(&bytes, kernel, |renderer| draw(renderer, math, batch, size, full(size)));
            let pairs = found.iter().flatten().zip(oracle.iter().flatten());
            let worst = pairs.fold(0.0f32, |worst, (a, b)| worst.worse((a - b).abs()));
            std::println!("{kernel:?} {math:?}: {worst:e}");
            assert!(f64::from(worst) <= tolerance(kernel, limit), "{kernel:?} {math:?}: {worst:e}");
        }
    }
}

#[test]
fn a_pixel_costs_one_evaluation_of_everything_and_nothing_else() {
    for (a, bytes) in fields() {
        let macs: usize = a.layers().iter().map(|layer| layer.macs()).sum();
        for (kernel, batch) in kernels().flat_map(|kernel| batches().map(move |batch| (kernel, batch))) {
            let rect = Rect { x: 1, y: 0, width: 9, height: 11 };
            let (_, counters) =
                on(&bytes, kernel, |renderer| draw(renderer, POLYNOMIAL, batch, [10, 11], rect));
            let expected = Counters { colour_evaluations: 99, macs: 99 * macs as u64, ..Counters::default() };
            assert_eq!(counters, expected);
        }
    }
}

#[test]
fn what_is_no_number_is_black_and_counted() {
    let (a, bytes) = layered();
    let (_, mut broken) = halve(&parameters(&a, 61));
    let rgb = *a.layers().iter().find(|layer| layer.role == Role::Rgb).unwrap();
    broken[rgb.bias + 1] = f32::NAN;
    let blob = Blob::open(&bytes).unwrap();
    for kernel in kernels() {
        let renderer = Renderer::with_parameters(blob.clone(), kernel, &broken, None).unwrap();
        let (found, counters) = draw(&renderer, POLYNOMIAL, Batch::FULL, [9, 8], full([9, 8]));
        assert!(found.iter().all(|pixel| *pixel == [0.0; 3]));
        assert_eq!((counters.invalid_samples, counters.colour_evaluations), (72, 72));
    }
}

/// Returns the error of `render_picture` with a workspace of `lines` lines. Panics if a pixel is written.
fn refused(renderer: &Renderer<'_>, batch: Batch, size: [u32; 2], rect: Rect, lines: usize) -> RenderError {
    let mut workspace = vec![Line::UNINIT; lines];
    let mut put = |_: u32, _: u32, _: [f32; 3]| panic!("nothing is written");
    let result = renderer.render_picture(POLYNOMIAL, batch, size, rect, &mut workspace, &mut put);
    let error = result.unwrap_err();
    assert!(!error.to_string().is_empty());
    error
}

#[test]
fn a_workspace_one_line_short_is_refused() {
    let (_, bytes) = layered();
    for (kernel, batch) in kernels().flat_map(|kernel| batches().map(move |batch| (kernel, batch))) {
        on(&bytes, kernel, |renderer| {
            let expected = renderer.picture_workspace_lines(batch);
            draw(renderer, POLYNOMIAL, batch, [8, 6], full([8, 6]));
            for found in [expected - 1, 0] {
                let error = refused(renderer, batch, [8, 6], full([8, 6]), found);
                assert_eq!(error, RenderError::Memory { expected, found });
            }
        });
    }
}

#[test]
fn sizes_rectangles_and_batches_of_no_picture_are_refused() {
    let (_, bytes) = layered();
    on(&bytes, Kernel::IN_PLACE, |renderer| {
        let batch = Batch::SMALLEST;
        let none = Rect { x: 0, y: 0, width: 0, height: 0 };
        for size in [[0, 6], [8, 0], [MAX_RENDER_SIDE + 1, 1], [1, u32::MAX]] {
            let [width, height] = size;
            assert_eq!(refused(renderer, batch, size, none, 64), RenderError::Size { width, height });
        }
        let full = full([8, 6]);
        for rect in [
            Rect { width: 9, ..full },
            Rect { x: 8, width: 1, ..full },
            Rect { y: u32::MAX, ..full },
            Rect { x: 2, width: u32::MAX, ..full },
        ] {
            let expected = RenderError::Rect { rect, width: 8, height: 6 };
            assert_eq!(refused(renderer, batch, [8, 6], rect, 64), expected);
        }
        for (rays, samples) in [(0, 1), (1, 0), (1, BLOCK + 1), (Batch::MAX_RAYS + 1, 1), (1, usize::MAX)] {
            let found = Batch { rays, samples };
            assert_eq!(refused(renderer, found, [8, 6], full, 64), RenderError::Batch { found });
            // The workspace's size is computed for an invalid batch, too, without a panic.
            renderer.picture_workspace_lines(found);
        }
        let empty = Rect { x: 8, y: 6, width: 0, height: 0 };
        assert_eq!(draw_nothing(renderer, empty), Counters::default());
        assert_eq!(draw_nothing(renderer, Rect { height: 0, ..full }), Counters::default());
    });
}

fn draw_nothing(renderer: &Renderer<'_>, rect: Rect) -> Counters {
    let mut workspace = vec![Line::UNINIT; renderer.picture_workspace_lines(Batch::SMALLEST)];
    let mut put = |_: u32, _: u32, _: [f32; 3]| panic!("nothing is written");
    let batch = Batch::SMALLEST;
    renderer.render_picture(POLYNOMIAL, batch, [8, 6], rect, &mut workspace, &mut put).unwrap()
}

#[test]
fn a_scene_is_no_picture() {
    let (weights, _) = halve(&parameters(&every_kind(), 1));
    let bytes = bytes(&body(every_kind(), None, &weights));
    on(&bytes, Kernel::IN_PLACE, |renderer| {
        let error = refused(renderer, Batch::SMALLEST, [8, 6], full([8, 6]), 4096);
        assert_eq!(error, RenderError::NotAPicture);
        assert_eq!(error.to_string(), "blob: expected a 2D field, found a scene");
    });
}

use super::*;

fn decode(path: &Path) -> image::DynamicImage {
    image::load_from_memory(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn bytes_round_half_up_and_clamp() {
    let half = 0.5 / 255.0;
    let cases = [
        (0.0, 0),
        (half, 1),
        (half - 1e-5, 0),
        (0.5, 128),
        (1.0, 255),
        (-3.0, 0),
        (7.0, 255),
        (f32::NAN, 0),
        (f32::INFINITY, 255),
        (f32::NEG_INFINITY, 0),
    ];
    for (value, byte) in cases {
        assert_eq!(to_u8(value), byte, "{value}");
    }
}

#[test]
fn a_png_gives_back_every_byte() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let rgb = (0..6).map(|i| [i as f32 / 6.0, 0.5, 1.0]).collect();
    let picture = Picture::new(3, 2, rgb).unwrap();
    picture.write_png(&path).unwrap();
    let decoded = decode(&path);
    assert_eq!((decoded.width(), decoded.height()), (3, 2));
    assert_eq!(decoded.color(), image::ColorType::Rgb8);
    assert_eq!(decoded.to_rgb8().into_raw(), picture.to_rgb8());
}

#[test]
fn wrong_lengths_and_sizes_are_refused() {
    let said = |error: anyhow::Error| error.to_string();
    let length = said(Picture::new(3, 2, vec![[0.0; 3]; 5]).unwrap_err());
    assert_eq!(length, "a picture: 3×2 pixels need 6 values, found 5");
    assert!(said(Picture::new(usize::MAX, 2, vec![]).unwrap_err()).contains("found 0"));
    assert!(said(Picture::filled(0, 4, [0.0; 3]).to_png().unwrap_err()).contains("PNG cannot hold"));
    let wrong = Picture { width: 4, height: 4, rgb: vec![[0.0; 3]] };
    assert!(said(wrong.to_png().unwrap_err()).contains("need"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    assert!(write_rgba_png(&path, &[[0.0; 3]], &[], 1, 1).is_err());
    assert!(write_grey16_png(&path, &[0.0], 2, 1, (0.0, 1.0)).is_err());
    assert!(!path.exists());
    assert_eq!(Picture::filled(usize::MAX, 2, [0.0; 3]).rgb.len(), 0);
}

#[test]
fn straight_alpha_over_black_is_the_render_again() {
    let opacity: Vec<f32> = (0..=100).map(|i| i as f32 / 100.0).collect();
    let over_black: Vec<[f32; 3]> = opacity.iter().map(|&o| [0.9 * o, 0.3 * o, o]).collect();
    let rgba = straight_rgba8(&over_black, &opacity);
    for (pixel, rgb) in rgba.chunks_exact(4).zip(&over_black) {
        for c in 0..3 {
            let composed = f32::from(pixel[c]) / 255.0 * f32::from(pixel[3]) / 255.0;
            // Rounding alpha costs half a step of 1/255, and rounding the colour another half.
            assert!((composed - rgb[c]).abs() <= 1.0 / 255.0, "{composed} {rgb:?}");
        }
    }
    assert_eq!(rgba[..4], [0, 0, 0, 0]);
    assert_eq!(rgba[400..], [230, 77, 255, 255]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    write_rgba_png(&path, &over_black, &opacity, 101, 1).unwrap();
    assert_eq!(decode(&path).color(), image::ColorType::Rgba8);
    assert_eq!(decode(&path).to_rgba8().into_raw(), rgba);
}

#[test]
fn grey16_spans_its_range() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let values = [2.0, 4.0, 6.0, 9.0, -1.0, f32::NAN];
    write_grey16_png(&path, &values, 6, 1, (2.0, 6.0)).unwrap();
    let decoded = decode(&path);
    assert_eq!(decoded.color(), image::ColorType::L16);
    assert_eq!(decoded.to_luma16().into_raw(), [0, 32_768, 65_535, 65_535, 0, 0]);
    write_grey16_png(&path, &values, 6, 1, (1.0, 1.0)).unwrap();
    assert_eq!(decode(&path).to_luma16().into_raw(), [0; 6]);
}

#[test]
fn enlarging_repeats_pixels() {
    let picture = Picture::new(2, 1, vec![[0.0; 3], [1.0; 3]]).unwrap();
    let big = picture.enlarged(2);
    assert_eq!((big.width, big.height), (4, 2));
    let row = [[0.0; 3], [0.0; 3], [1.0; 3], [1.0; 3]];
    assert_eq!(big.rgb, [row, row].concat());
    assert_eq!(picture.enlarged_to(5).width, 6);
    assert_eq!(picture.enlarged(0), picture);
}

#[test]
fn pasting_is_cut_off_at_the_edges() {
    let mut canvas = Picture::filled(4, 4, [0.0; 3]);
    canvas.paste(&Picture::filled(3, 3, [1.0; 3]), 2, 3);
    canvas.paste(&Picture::filled(3, 3, [1.0; 3]), 9, 9);
    assert_eq!(canvas.rgb.iter().filter(|rgb| rgb[0] == 1.0).count(), 2);
    assert_eq!(canvas.pixel(2, 3), Some([1.0; 3]));
    assert_eq!(canvas.pixel(4, 3), None);
    assert_eq!(canvas.pixel(0, usize::MAX), None);
}

use super::*;

#[test]
fn the_maps_meet_their_tables_at_the_ends_and_in_the_middle() {
    // First, middle and last entries of matplotlib's tables.
    let cases = [
        (ColourMap::Viridis, 0.0, [0.267, 0.005, 0.329]),
        (ColourMap::Viridis, 0.5, [0.128, 0.567, 0.551]),
        (ColourMap::Viridis, 1.0, [0.993, 0.906, 0.144]),
        (ColourMap::Magma, 0.0, [0.001, 0.000, 0.014]),
        (ColourMap::Magma, 0.5, [0.717, 0.215, 0.475]),
        (ColourMap::Magma, 1.0, [0.987, 0.991, 0.750]),
    ];
    for (map, share, expected) in cases {
        let found = map.colour(share);
        let close = (0..3).all(|c| (found[c] - expected[c]).abs() < 0.021);
        assert!(close, "{map:?} at {share}: {found:?}, table {expected:?}");
    }
}

#[test]
fn lightness_never_falls_and_colours_stay_in_range() {
    for map in [ColourMap::Viridis, ColourMap::Magma] {
        let mut last = -1.0;
        for i in 0..=1_000 {
            let [r, g, b] = map.colour(i as f32 / 1_000.0);
            assert!([r, g, b].iter().all(|v| (0.0..=1.0).contains(v)));
            let linear = |v: f32| v.powf(2.2);
            let luminance = 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
            assert!(luminance > last - 1e-3, "{map:?} at {i}");
            last = luminance;
        }
        assert_eq!(map.colour(f32::NAN), EMPTY);
        assert_eq!(map.colour(f32::INFINITY), map.colour(1.0));
    }
}

#[test]
fn the_range_comes_from_solid_pixels_and_ignores_strays() {
    let mut values: Vec<f32> = (0..1_000).map(|i| 2.0 + i as f32 / 1_000.0).collect();
    let mut opacity = vec![1.0; 1_000];
    (values[10], values[20], values[30]) = (900.0, f32::NAN, f32::INFINITY);
    (values[40], opacity[40]) = (-500.0, 0.1);
    let (low, high) = robust_range(&values, &opacity).unwrap();
    assert!((low - 2.01).abs() < 0.01 && (high - 2.99).abs() < 0.01, "{low} {high}");
    assert_eq!(robust_range(&values, &[0.0; 1_000]), None);
    assert_eq!(robust_range(&[], &[]), None);
    // With only three values, the range covers all of them.
    assert_eq!(robust_range(&[3.0, 1.0, 2.0], &[1.0; 3]), Some((1.0, 3.0)));
}

#[test]
fn empty_pixels_are_grey_and_solid_ones_coloured() {
    let (values, opacity) = ([1.0, 2.0, 5.0, f32::NAN], [1.0, 1.0, 0.5, 1.0]);
    let range = settle_range(&values, &opacity, None);
    let picture = depth_picture(&values, &opacity, (2, 2), range).unwrap();
    assert_eq!(picture.rgb[0], ColourMap::Viridis.colour(0.0));
    assert_eq!(picture.rgb[1], ColourMap::Viridis.colour(1.0));
    assert_eq!(picture.rgb[2..], [EMPTY; 2]);
    assert!(depth_picture(&[1.0; 3], &[1.0; 4], (2, 2), range).is_err());
    assert!(depth_picture(&[1.0; 4], &[1.0; 3], (2, 2), range).is_err());
}

#[test]
fn normals_are_colours_around_grey_and_nothing_is_empty() {
    let normals = [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0]];
    let picture = normal_picture(&normals, &[1.0, 0.6, 1.0, 0.5], 2, 2).unwrap();
    assert_eq!(picture.rgb, [[1.0, 0.5, 0.5], [0.5, 0.0, 0.5], EMPTY, EMPTY]);
    assert!(normal_picture(&normals, &[1.0; 3], 2, 2).is_err());
    assert!(normal_picture(&normals[..3], &[1.0; 4], 2, 2).is_err());
}

#[test]
fn flat_empty_and_extreme_ranges_are_drawn() {
    for value in [0.0, 4.0, -4.0, 1e-40, f32::MAX, f32::MIN, f32::NAN] {
        for range in [None, Some((4.0, 4.0)), Some((5.0, 1.0)), Some((f32::NAN, 1.0))] {
            let page = depth_picture_with_legend(&[value; 6], &[1.0; 6], (3, 2), range, "z_depth").unwrap();
            assert_eq!(page.rgb.len(), page.width * page.height);
            assert!(page.rgb.iter().flatten().all(|v| v.is_finite()), "{value} {range:?}");
        }
    }
    let page = depth_picture_with_legend(&[f32::MIN, f32::MAX], &[1.0; 2], (2, 1), None, "x").unwrap();
    assert!(page.rgb.iter().flatten().all(|v| v.is_finite()));
    let nothing = depth_picture_with_legend(&[], &[], (0, 0), None, "").unwrap();
    assert!(nothing.width > 0);
}

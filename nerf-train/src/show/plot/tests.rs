use super::*;

fn plot_of(points: Vec<(f64, f64)>, marker: Marker) -> LinePlot {
    let mut plot = LinePlot::new("A title & <more>", "time, s", "PSNR, dB");
    plot.series.push(Series { name: "a series".to_owned(), points, marker });
    plot
}

/// Returns the number of pixels whose colour is nearly `colour`.
fn count(picture: &Picture, colour: RGBColor) -> usize {
    let target = [colour.0, colour.1, colour.2].map(|v| f32::from(v) / 255.0);
    let near = |rgb: &&[f32; 3]| (0..3).all(|c| (rgb[c] - target[c]).abs() < 0.02);
    picture.rgb.iter().filter(near).count()
}

#[test]
fn a_plot_shows_its_lines_dots_and_references() {
    let mut plot =
        plot_of((0..50).map(|i| (f64::from(i), f64::from(i * i))).collect(), Marker::LineAndPoints);
    let without = plot.to_picture().unwrap();
    assert!(count(&without, COLOURS[0]) > 2_000);
    plot.references.push(Reference { label: "bar".to_owned(), y: 5_000.0 });
    let with = plot.to_picture().unwrap();
    assert!(count(&with, GREY) > count(&without, GREY) + 300);
    let svg = plot.to_svg().unwrap();
    assert!(svg.contains("PSNR, dB") && svg.contains("time, s") && svg.contains("a series"));
    assert!(svg.contains("A title &amp; &lt;more&gt;") && svg.contains("font-family=\"sans-serif\""));
}

#[test]
fn odd_data_is_drawn_or_left_out() {
    let data = [
        vec![],
        vec![(1.0, 1.0)],
        vec![(0.0, 0.0)],
        vec![(3.0, 7.0); 5],
        vec![(f64::NAN, 1.0), (1.0, f64::INFINITY)],
        vec![(-1.0, -1.0), (0.0, 0.0), (f64::MAX, f64::MIN), (1e-300, 1e300)],
        vec![(1.0, 5e-324), (2.0, 1e-310)],
    ];
    for points in data {
        for marker in [Marker::Line, Marker::Points, Marker::LineAndPoints] {
            for log in [false, true] {
                let mut plot = plot_of(points.clone(), marker);
                plot.log_x = log;
                plot.references =
                    [0.0, -3.0, f64::NAN, 12.0].map(|y| Reference { label: String::new(), y }).to_vec();
                assert_eq!(plot.to_picture().unwrap().rgb.len(), WIDTH * HEIGHT);
                assert!(plot.to_svg().unwrap().trim_end().ends_with("</svg>"));
            }
        }
    }
}

#[test]
fn a_lone_point_of_a_line_is_a_dot_and_the_left_out_are_counted() {
    let empty = plot_of(vec![], Marker::Line).to_picture().unwrap();
    let lone = plot_of(vec![(2.0, 3.0), (f64::NAN, 1.0)], Marker::Line);
    assert!(count(&lone.to_picture().unwrap(), COLOURS[0]) > count(&empty, COLOURS[0]) + 20);
    assert!(lone.to_svg().unwrap().contains("Left out, as not finite: 1 point."));
}

#[test]
fn many_series_and_long_words_do_not_break_the_page() {
    let mut plot = LinePlot::new("word ".repeat(100), "x\0\n".repeat(60), "y ".repeat(200));
    plot.notes = vec!["a note ".repeat(300)];
    for i in 0..60 {
        plot.series.push(Series {
            name: format!("series number {i} with a name that is far too long for a line"),
            points: (0..5).map(|x| (f64::from(x), f64::from(x * i))).collect(),
            marker: Marker::Line,
        });
    }
    plot.to_picture().unwrap();
    let svg = plot.to_svg().unwrap();
    assert!(svg.contains("more") && !svg.contains('\0'));
    LinePlot::default().to_picture().unwrap();
}

#[test]
fn logarithmic_axes_have_ticks_around_their_values() {
    for (values, expected) in [
        (vec![0.0034, 0.021], (0.002..0.05, vec![0.002, 0.005, 0.01, 0.02, 0.05])),
        (vec![3.0], (2.0..5.0, vec![2.0, 5.0])),
        (vec![1e-3, 0.9], (1e-3..2.0, vec![1e-3, 1e-2, 0.1, 1.0])),
    ] {
        assert_eq!(decades(values.iter().copied()), expected);
    }
    for exponent in -15..=15 {
        let (range, ticks) = decades([10f64.powi(exponent)].into_iter());
        assert!(range.start < range.end && ticks.len() >= 2, "{exponent}: {range:?}, {ticks:?}");
    }
    assert_eq!(tick_label(&(0.1 + 0.2)), "0.3");
}

#[test]
fn both_files_are_written_under_the_stem() {
    let folder = tempfile::tempdir().unwrap();
    let plot = plot_of(vec![(0.0, 1.0), (1.0, 2.0)], Marker::Line);
    let [png, svg] = plot.write(folder.path().join("loss_0.1")).unwrap();
    assert!(png.ends_with("loss_0.1.png") && svg.ends_with("loss_0.1.svg"));
    assert_eq!(image::load_from_memory(&std::fs::read(png).unwrap()).unwrap().width(), WIDTH as u32);
    assert!(std::fs::read_to_string(svg).unwrap().starts_with("<svg"));
    assert!(plot.write(folder.path().join("no/such/folder")).is_err());
}

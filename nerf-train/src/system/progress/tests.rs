use super::*;

const fn seconds(count: u64) -> Duration {
    Duration::from_secs(count)
}

fn plain(total: Total) -> Progress {
    Progress::new("train", total, ProgressStyle::Plain)
}

#[test]
fn a_line_says_all_that_is_known() {
    let message = Message {
        rays_per_s: Some(31_400.0),
        train_psnr_db: Some(24.1),
        val_psnr_db: Some(23.874),
        note: "lr 5e-4".to_owned(),
    };
    assert_eq!(
        plain(Total::Steps(5_000)).describe(1_250, seconds(41), &message),
        "25 % · train 1,250/5,000 · 0:41, 2:03 left · 31.4 k rays/s · train 24.10 dB · val 23.87 dB · lr 5e-4"
    );
    assert_eq!(plain(Total::Unknown).describe(7, seconds(3), &Message::default()), "train 7 · 0:03");
    assert_eq!(
        plain(Total::Time(seconds(60))).describe(7, seconds(15), &Message::default()),
        "25 % · train 7 · 0:15, 0:45 left"
    );
}

#[test]
fn of_steps_and_time_the_nearer_end_counts() {
    let both = plain(Total::StepsOrTime(1_000, seconds(100)));
    assert_eq!(both.share(500, seconds(10)), Some(0.5));
    assert_eq!(both.remaining(500, seconds(10)), Some(seconds(10)));
    assert_eq!(both.share(10, seconds(80)), Some(0.8));
    assert_eq!(both.remaining(10, seconds(80)), Some(seconds(20)));
    assert_eq!(both.share(5_000, seconds(800)), Some(1.0));
    assert_eq!(both.remaining(5_000, seconds(800)), Some(seconds(0)));
}

#[test]
fn a_resumed_run_estimates_by_its_own_pace() {
    let progress = plain(Total::Steps(10_000)).resume_at(5_000);
    assert_eq!(progress.share(6_000, seconds(10)), Some(0.6));
    assert_eq!(progress.remaining(6_000, seconds(10)), Some(seconds(40)));
    assert_eq!(progress.remaining(5_000, seconds(10)), None);
}

#[test]
fn odd_totals_show_no_share_beyond_the_whole_and_no_number_that_is_none() {
    let totals = [
        Total::Steps(0),
        Total::Steps(u64::MAX),
        Total::Time(Duration::ZERO),
        Total::Time(Duration::MAX),
        Total::StepsOrTime(0, Duration::MAX),
        Total::Unknown,
    ];
    let odd = Message {
        rays_per_s: Some(f64::NAN),
        train_psnr_db: Some(f64::INFINITY),
        val_psnr_db: Some(f64::NEG_INFINITY),
        note: String::new(),
    };
    for total in totals {
        for position in [0, 1, u64::MAX] {
            for elapsed in [Duration::ZERO, seconds(2), Duration::MAX] {
                let line = plain(total).describe(position, elapsed, &odd);
                let share = line.split_once(" %").map_or(0, |(share, _)| share.parse().expect("a share"));
                assert!((0..=100).contains(&share) && line.contains("train "), "{total:?}: {line}");
                assert!(!line.contains("NaN"), "{total:?}: {line}");
            }
        }
    }
}

#[test]
fn plain_lines_come_seldom() {
    let mut progress = plain(Total::Steps(10));
    progress.update(1, &Message::default());
    let Display::Lines { last: Some(first), .. } = progress.display else { panic!("no line was shown") };
    progress.update(2, &Message::default());
    assert!(matches!(progress.display, Display::Lines { last, .. } if last == Some(first)));
    progress.println("a line");
    progress.finish("done");
}

#[test]
fn a_run_ends_where_its_last_update_was_in_every_style() {
    for style in [ProgressStyle::Auto, ProgressStyle::Plain, ProgressStyle::Json, ProgressStyle::Quiet] {
        let mut progress = Progress::new("render", Total::Steps(3), style);
        (0..=3).for_each(|i| progress.update(i, &Message::default()));
        progress.println("half way");
        assert_eq!(progress.share(3, progress.started.elapsed()), Some(1.0), "{style:?}");
        assert_eq!(matches!(progress.display, Display::Quiet), style == ProgressStyle::Quiet, "{style:?}");
    }
    let hidden = ProgressBar::with_draw_target(Some(1), ProgressDrawTarget::hidden());
    let mut progress = plain(Total::Steps(1));
    progress.display = Display::Bar(hidden);
    progress.update(1, &Message::default());
    progress.println("above the bar");
    let Display::Bar(bar) = &progress.display else { panic!("no bar") };
    assert_eq!(bar.position(), 10_000, "all of the bar");
    progress.finish("done");
}

#[test]
fn numbers_and_times_read_well() {
    assert_eq!([3.0, 99.96, 31_400.0, 2.5e6, 7e9].map(scaled), ["3.00", "100", "31.4 k", "2.50 M", "7.00 G"]);
    assert_eq!([7, 761, 11_109].map(|s| in_words(seconds(s))), ["0:07", "12:41", "3:05:09"]);
}

#[test]
fn events_are_json_with_units_in_their_names() {
    let message = Message { rays_per_s: Some(f64::NAN), note: "\"lr\"\n".to_owned(), ..Message::default() };
    let known = plain(Total::Steps(60)).event(3, seconds(5), &message).line();
    assert!(!known.contains('\n'), "{known}");
    let known: serde_json::Value = serde_json::from_str(&known).unwrap();
    let expected = serde_json::json!({
        "event": "progress", "what": "train", "position": 3, "total": 60, "elapsed_s": 5.0, "left_s": 95.0,
        "rays_per_s": null, "note": "\"lr\"\n",
    });
    assert_eq!(known, expected);
    let unknown = plain(Total::Unknown).event(3, Duration::MAX, &Message::default()).line();
    let unknown: serde_json::Value = serde_json::from_str(&unknown).unwrap();
    assert!(unknown["total"].is_null() && unknown["left_s"].is_null() && unknown.get("note").is_none());
    assert_eq!(Event::Note { text: "a" }.line(), r#"{"event":"note","text":"a"}"#);
}

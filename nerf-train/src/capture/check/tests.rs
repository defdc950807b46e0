use super::Diagnosis;
use super::after::Fitted;
use super::links::Links;
use super::pairs::Pair;
use crate::capture::sights::{Sight, Sights};
use crate::data::demo::two_rounds as rounds;
use crate::data::demo::{DemoSpec, render_truth};
use crate::data::{Dataset, View};
use glam::{Quat, Vec3};
use nerf_core::camera::{Camera, Pose};
use std::sync::OnceLock;

/// Demo capture [`rounds`]: two rounds of cameras along an arc, the second with wrong poses if `folded`. Rendering
/// takes seconds, so each capture is rendered once for all tests.
fn two_rounds(folded: bool) -> Dataset {
    static MADE: [OnceLock<Dataset>; 2] = [const { OnceLock::new() }; 2];
    MADE[usize::from(folded)].get_or_init(|| rounds(folded).expect("a scene")).clone()
}

fn names(range: std::ops::Range<usize>) -> Vec<String> {
    range.map(|i| format!("{i:03}.jpg")).collect()
}

/// Camera of `view` at a wrong pose: the position is turned by 1.3 + `by` radians about the z axis, and raised by 1.
fn displaced(view: &View, by: u32) -> Camera {
    let camera = view.camera;
    let at = Quat::from_rotation_z(1.3 + by as f32) * camera.pose().position + Vec3::Z;
    let pose = Pose::look_at(at, Vec3::new(0.3, -0.2, 0.4), Vec3::Z).expect("a pose");
    Camera::new(*camera.intrinsics(), *camera.lens(), pose).expect("a camera")
}

#[test]
fn a_folded_orbit_falls_into_its_two_sides() {
    let mut data = two_rounds(true);
    let found = Diagnosis::of(&data);
    assert_eq!(found.folded, Some(true), "{:?}", found.facts);
    assert_eq!(found.groups, [names(0..14), names(14..28)], "{:?}", found.findings);
    assert!(found.contradicting.is_empty());
    let [a, b] = found.worst_pair.as_ref().expect("a pair");
    assert!(found.groups[0].contains(a) && found.groups[1].contains(b), "{a} {b}");
    let said = found.findings.join("\n");
    assert!(said.contains("folded") && said.contains("group 2 (14): 014.jpg to 027.jpg"), "{said}");
    assert!(said.contains("--group 1") && !said.contains("hardly any points"), "{said}");
    let missing = found.select(&mut data, Some(3)).expect_err("two groups").to_string();
    assert!(missing.contains("expected 1 to 2") && missing.contains("found 3"), "{missing}");
    assert_eq!(data.train.len(), 28);
    data.val = data.train.split_off(20);
    found.select(&mut data, Some(2)).expect("a group");
    assert_eq!((data.train.len(), data.val.len()), (6, 8));
}

#[test]
fn an_orbit_that_is_not_folded_is_left_alone() {
    let mut data = two_rounds(false);
    let found = Diagnosis::of(&data);
    assert_eq!(
        (found.folded, found.groups.len(), found.contradicting_pairs),
        (Some(false), 0, 0),
        "{}",
        found.facts
    );
    assert!(
        found.compared_pairs > 60 && found.pieces == [28] && found.duplicates.is_empty(),
        "{}",
        found.facts
    );
    let none = found.select(&mut data, Some(1)).expect_err("no groups").to_string();
    assert!(none.contains("no groups in demo"), "{none}");
    found.select(&mut data, None).expect("all");
    assert_eq!(data.train.len(), 28);
    // The azimuths span 81°, which leaves 279°. The tilt of the cameras' mean up direction changes this a little.
    let gap = found.unseen_sector_degrees.expect("an orbit").0;
    assert!((gap - 279.0).abs() < 8.0, "{gap}");
    assert!(found.findings.iter().any(|finding| finding.contains("a sector of 2")), "{:?}", found.findings);
}

#[test]
fn few_photographs_that_contradict_the_rest_are_left_out_by_name() {
    let mut data = two_rounds(false);
    // Photograph 5 gets the picture of another place, photograph 20 a wrong pose.
    data.train[5].pixels =
        render_truth(&DemoSpec { size: 160, ..Default::default() }.camera(2.094, 0.4).expect("a camera"))
            .rgba;
    data.train[20].camera = displaced(&data.train[20], 0);
    let found = Diagnosis::of(&data);
    assert_eq!(found.contradicting, ["005.jpg", "020.jpg"], "{:?}", found.findings);
    assert_eq!((found.folded, found.groups.len()), (Some(false), 0));
    assert!(
        found.findings[0].contains("2 photographs contradict the rest: 005.jpg, 020.jpg"),
        "{:?}",
        found.findings
    );
    data.val = vec![data.train.remove(20)];
    found.select(&mut data, None).expect("most");
    assert_eq!((data.train.len(), data.val.len()), (26, 1));
}

#[test]
fn poses_of_which_a_third_are_random_are_named_as_a_group() {
    let mut data = two_rounds(false);
    for i in (0..27).step_by(3) {
        data.train[i].camera = displaced(&data.train[i], i as u32);
    }
    let found = Diagnosis::of(&data);
    let wrong: Vec<String> = names(0..27).into_iter().step_by(3).collect();
    assert_eq!((found.folded, &found.groups[1]), (Some(false), &wrong), "{:?}", found.findings);
    let said = found.findings.join("\n");
    assert!(
        said.contains("key points of 9 photographs contradict their poses") && said.contains("--group 1"),
        "{said}"
    );
}

#[test]
fn two_captures_in_one_folder_are_two_groups() {
    let (mut data, mut other) = (two_rounds(false), two_rounds(false));
    let (away, points) = (Vec3::X * 50.0, data.points.len() as u32);
    other.points.iter_mut().for_each(|p| p.position = (Vec3::from(p.position) + away).to_array());
    for view in &mut other.train {
        let pose = Pose { position: view.camera.pose().position + away, ..*view.camera.pose() };
        view.camera = Camera::new(*view.camera.intrinsics(), *view.camera.lens(), pose).expect("a camera");
        view.key_points.iter_mut().for_each(|key| key.point += points);
        view.name = format!("other {}", view.name);
    }
    data.points.extend(other.points);
    data.train.extend(other.train);
    let found = Diagnosis::of(&data);
    assert_eq!((found.folded, found.pieces.as_slice()), (Some(false), [28, 28].as_slice()));
    assert_eq!(found.groups[0], names(0..28));
    assert!(found.findings.iter().any(|f| f.contains("two captures")), "{:?}", found.findings);
    assert!(!found.duplicates.is_empty());
}

#[test]
fn without_tracks_nothing_is_judged_before_the_fit() {
    let mut data = two_rounds(true);
    data.train.iter_mut().for_each(|view| view.key_points.clear());
    data.points.clear();
    let found = Diagnosis::of(&data);
    assert_eq!((found.folded, found.groups.len()), (None, 0));
    assert!(found.findings[0].contains("cannot be judged before the fit"), "{:?}", found.findings);
    for count in [3, 1] {
        data.train.truncate(count);
        assert_eq!(Diagnosis::of(&data).photographs, count);
    }
    data.train.clear();
    assert_eq!(Diagnosis::of(&data).photographs, 0);
}

#[test]
fn blurred_photographs_and_duplicates_are_named() {
    let mut data = two_rounds(false);
    data.train[25].pixels = data.train[11].pixels.clone();
    let view = &mut data.train[3];
    let sharp = view.pixels.clone();
    for (i, pixel) in view.pixels.iter_mut().enumerate().filter(|(i, _)| i % 160 >= 9) {
        *pixel =
            std::array::from_fn(|c| (sharp[i - 9..i].iter().map(|p| u32::from(p[c])).sum::<u32>() / 9) as u8);
    }
    let found = Diagnosis::of(&data);
    assert_eq!(found.blurred, ["003.jpg"]);
    assert_eq!(found.duplicates, [["011.jpg".to_owned(), "025.jpg".to_owned()]]);
    let said = found.findings.join("\n");
    assert!(said.contains("1 photograph is blurred") && said.contains("011.jpg and 025.jpg"), "{said}");
}

#[test]
fn bridges_and_pieces_are_those_of_the_graph() {
    // Two triangles joined by one link, and a photograph without links.
    let links = [[0, 1], [1, 2], [0, 2], [2, 3], [3, 4], [4, 5], [3, 5]];
    let mut sights = Sights::default();
    sights.of_views = vec![Vec::new(); 7];
    for (link, views) in links.iter().enumerate() {
        let sight =
            |i: u32| Sight { at: [0.0; 2], point: 100 * link as u32 + i, distance: 1.0, confidence: 1.0 };
        views.iter().for_each(|&view| sights.of_views[view].extend((0..20).map(sight)));
    }
    let found = Links::of(&sights, &[]);
    assert_eq!(found.pieces, [vec![0, 1, 2, 3, 4, 5], vec![6]]);
    assert_eq!(found.bridges, [([2, 3], 3)]);
    let joined = Links::of(&sights, &[Pair { views: [5, 6], different: 0.1 }]);
    assert_eq!(joined.pieces.len(), 1);
}

#[test]
fn training_photographs_far_below_the_rest_are_named() {
    let mut data = two_rounds(false);
    data.train.iter_mut().for_each(|view| view.key_points.clear());
    let diagnosis = Diagnosis::of(&data);
    let db = |i: usize| if i == 4 { 14.0 } else { 27.0 + 0.1 * (i % 5) as f64 };
    let all = names(0..28);
    let scores = |db: &dyn Fn(usize) -> f64| {
        let scores: Vec<_> = all.iter().enumerate().map(|(i, name)| (name.as_str(), db(i))).collect();
        Fitted::of(&diagnosis, &scores, 9000)
    };
    let fitted = scores(&db);
    assert_eq!(fitted.train_far_worse, ["004.jpg"]);
    // The viewing direction jumps from photograph 13 to 14, where the second round begins.
    let groups: Vec<_> = fitted.train_groups.iter().map(|g| (g.first.as_str(), g.photographs)).collect();
    assert_eq!(groups, [("000.jpg", 14), ("014.jpg", 14)]);
    let said = |fitted: &Fitted| fitted.lines().collect::<Vec<_>>().join("\n");
    assert!(said(&fitted).contains("004.jpg 14.0 dB"), "{}", said(&fitted));
    let torn = scores(&|i| if i < 14 { 28.0 } else { 24.0 });
    assert!(said(&torn).contains("014.jpg to 027.jpg are shown 4.0 dB worse"), "{}", said(&torn));
    let low = scores(&|_| 20.5);
    assert!(said(&low).contains("stay at 20.5 dB"), "{}", said(&low));
    assert!(said(&scores(&|_| f64::NAN)).is_empty());
}

//! Findings of a capture check, and cameras coloured by them.

use super::scene::{Request, Scene};
use crate::capture::check::Diagnosis;
use crate::data::pictures::thumbnail::Thumbnail;
use crate::data::{Background, Dataset, View};
use crate::model::config::{Preset, Surroundings};

/// Colours of cameras, by group of photographs with consistent poses; groups after the fourth repeat these colours.
const GROUPS: [[f32; 3]; 4] =
    [[0.13, 0.39, 0.85], [0.90, 0.47, 0.06], [0.15, 0.58, 0.24], [0.55, 0.25, 0.68]];
/// Colour of the cameras whose poses contradict the other photographs.
const CONTRADICTING: [f32; 3] = [0.85, 0.08, 0.12];
const BLURRED: [f32; 3] = [0.62, 0.50, 0.10];
/// Longer side of the thumbnails of the two photographs that contradict each other most, pixels.
const SIDE: usize = 400;

#[derive(Clone, Debug)]
pub struct Findings {
    pub(super) facts: String,
    pub(super) lines: Vec<String>,
    /// Names and thumbnails of the two photographs that contradict each other most; empty if there is no pair.
    pub(super) pair: Vec<(String, Thumbnail)>,
}

/// Creates the scene of all photographs, with cameras coloured by the diagnosis. The held-out views of `dataset` join
/// its training views, which are sorted by name. `range`: near and far planes, world units; `None`: from the data.
pub fn checked(
    dataset: &mut Dataset,
    diagnosis: &Diagnosis,
    range: (Option<f32>, Option<f32>),
) -> anyhow::Result<Scene> {
    let held_out = [std::mem::take(&mut dataset.val), std::mem::take(&mut dataset.test)];
    dataset.train.extend(held_out.into_iter().flatten());
    dataset.train.sort_by(|a, b| a.name.cmp(&b.name));
    let around = match dataset.background {
        Background::Unknown => Surroundings::Unbounded,
        _ => Surroundings::Known,
    };
    let mut config = Preset::Grid.config().around(around);
    (config.sampling.near, config.sampling.far) = range;
    let views = &dataset.train;
    let request =
        Request { views, split: "checked", camera: None, rays: 0, step: 0, up: None, frustum: None };
    let mut scene = Scene::new(dataset, &config, &request)?;
    find(&mut scene, diagnosis, views);
    Ok(scene)
}

/// Colours the cameras by the diagnosis, and stores its findings in the scene. `views`: the checked photographs.
fn find(scene: &mut Scene, diagnosis: &Diagnosis, views: &[View]) {
    for camera in &mut scene.cameras {
        let of = diagnosis.views.iter().find(|view| view.name == camera.name);
        let group = of.and_then(|view| view.group).map(|group| GROUPS[(group - 1) % GROUPS.len()]);
        camera.colour = match () {
            () if diagnosis.contradicting.contains(&camera.name) => Some(CONTRADICTING),
            () if group.is_some() => group,
            () if diagnosis.blurred.contains(&camera.name) => Some(BLURRED),
            () => None,
        };
    }
    let shown = |name: &String| {
        let view = views.iter().find(|view| view.name == *name)?;
        Some((name.clone(), Thumbnail::of(view, SIDE, [1.0; 3])))
    };
    scene.findings = Some(Findings {
        facts: diagnosis.facts.clone(),
        lines: diagnosis.findings.clone(),
        pair: diagnosis.worst_pair.iter().flatten().filter_map(shown).collect(),
    });
}

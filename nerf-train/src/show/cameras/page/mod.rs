//! The interactive 3D page: one HTML file that loads nothing else.
//!
//! The template, style and scripts are files in this folder. This module serialises the scene as JSON for the scripts.

use super::sampling::ShownRay;
use super::scene::{Scene, ShownCamera};
use crate::data::pictures::thumbnail::Thumbnail;
use crate::show::colour_map::ColourMap;
use crate::system::printable::{self, line};
use crate::train::Bounds;
use glam::Vec3;
use serde::Serialize;
use std::borrow::Cow;

const TEMPLATE: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("viewer.js");
const VIEW: &str = include_str!("view.js");
const SELF_TEST: &str = include_str!("selftest.js");

/// Number of quantisation steps from near to far for stored distances. A step is finer than a pixel.
const STEPS: f32 = 65_535.0;
const COLOURS: usize = 64;
const DISTANCE_MAP: ColourMap = ColourMap::Viridis;
const AXES: [(&str, [f32; 3]); 3] =
    [("x", [0.80, 0.12, 0.12]), ("y", [0.10, 0.52, 0.14]), ("z", [0.12, 0.25, 0.85])];

/// Data of the page's script, as JSON; lengths in world units.
#[derive(Serialize)]
struct Data<'s> {
    title: String,
    facts: String,
    alone: bool,
    near: f32,
    far: f32,
    /// Number of quantisation steps of distances: `t = near + (far − near) · stored / steps`.
    steps: f32,
    colour_range: (f32, f32),
    colours: Vec<String>,
    outline: Vec<Vec<[f32; 3]>>,
    centre: [f32; 3],
    ends: &'static str,
    axes: Vec<Axis>,
    axes_length: String,
    up: [f32; 3],
    /// Unit vectors a, b with which (a, b, `up`) is a right-handed frame.
    across: [[f32; 3]; 2],
    /// Direction from the scene to the page's first viewpoint.
    towards: [f32; 3],
    frustum: f32,
    cameras: Vec<CameraData<'s>>,
    rays: Vec<RayData>,
    findings: Vec<Cow<'s, str>>,
    pair: Vec<Shown<'s>>,
}

#[derive(Serialize)]
struct Shown<'s> {
    name: Cow<'s, str>,
    image: String,
}

#[derive(Serialize)]
struct Axis {
    name: &'static str,
    colour: String,
    from: [f32; 3],
    to: [f32; 3],
}

#[derive(Serialize)]
struct CameraData<'s> {
    index: usize,
    name: Cow<'s, str>,
    origin: [f32; 3],
    near: f32,
    /// Vectors from the camera to the picture's corners, clockwise from top left, at distance 1 along the view axis.
    corners: [[f32; 3]; 4],
    image: String,
    rays: Vec<RayData>,
    colour: Option<String>,
}

#[derive(Serialize)]
struct RayData {
    camera: usize,
    dir: [f32; 3],
    live: Vec<u16>,
    culled: Vec<u16>,
}

impl<'s> CameraData<'s> {
    fn of(camera: &'s ShownCamera, bounds: &Bounds) -> anyhow::Result<Self> {
        let origin = camera.camera.pose().position;
        Ok(Self {
            index: camera.index,
            name: line(&camera.name),
            origin: origin.to_array(),
            near: camera.near,
            corners: camera.corners(1.0).map(|corner| (corner - origin).to_array()),
            image: camera.thumbnail.data_uri()?,
            rays: camera.own_rays.iter().map(|ray| RayData::of(ray, bounds)).collect(),
            colour: camera.colour.map(css),
        })
    }
}

fn shown((name, image): &(String, Thumbnail)) -> anyhow::Result<Shown<'_>> {
    Ok(Shown { name: line(name), image: image.data_uri()? })
}

impl RayData {
    fn of(ray: &ShownRay, bounds: &Bounds) -> Self {
        // The cast clamps a value that rounding moves out of the range.
        let stored = |t: &f32| ((t - bounds.near) / (bounds.far - bounds.near) * STEPS).round() as u16;
        Self {
            camera: ray.camera,
            dir: ray.dir.to_array(),
            live: ray.live.iter().map(stored).collect(),
            culled: ray.culled.iter().map(stored).collect(),
        }
    }
}

pub fn page(scene: &Scene) -> anyhow::Result<String> {
    let (side, ahead) = scene.up.any_orthonormal_pair();
    let b = scene.bounds;
    let axis = |(i, (name, colour)): (usize, &(&'static str, [f32; 3]))| {
        let (from, to) = (scene.axes.origin.to_array(), scene.axes.tip(Vec3::AXES[i]).to_array());
        Axis { name, colour: css(*colour), from, to }
    };
    let found = scene.findings.as_ref();
    let facts = found.map_or_else(|| scene.facts(), |found| found.facts.clone());
    let data = Data {
        title: line(&scene.title()).into_owned(),
        facts: line(&facts).into_owned(),
        alone: scene.alone,
        near: b.near,
        far: b.far,
        steps: STEPS,
        colour_range: scene.colour_range(),
        colours: (0..COLOURS).map(|i| css(DISTANCE_MAP.colour(i as f32 / (COLOURS - 1) as f32))).collect(),
        outline: scene.outline().iter().map(|line| line.iter().map(Vec3::to_array).collect()).collect(),
        centre: scene.centre().to_array(),
        ends: scene.ends(),
        axes: AXES.iter().enumerate().map(axis).collect(),
        axes_length: scene.axes.length_in_words(),
        up: scene.up.to_array(),
        across: [side.to_array(), ahead.to_array()],
        towards: scene.towards_viewer(24.0).to_array(),
        frustum: scene.frustum,
        cameras: scene.cameras.iter().map(|camera| CameraData::of(camera, &b)).collect::<Result<_, _>>()?,
        rays: scene.rays.iter().map(|ray| RayData::of(ray, &b)).collect(),
        findings: found.iter().flat_map(|found| &found.lines).map(|finding| line(finding)).collect(),
        pair: found.iter().flat_map(|found| &found.pair).map(shown).collect::<Result<_, _>>()?,
    };
    let json = in_script(&serde_json::to_string(&data)?);
    let parts = [
        ("TITLE", escaped(&data.title)),
        ("FACTS", escaped(&data.facts)),
        ("STYLE", STYLE.to_owned()),
        ("DATA", json),
        ("SCRIPT", [VIEW, SCRIPT, SELF_TEST, "start();\n"].concat()),
    ];
    Ok(filled(TEMPLATE, &parts))
}

/// Returns the template with each `{{NAME}}` replaced by its text in `parts`; inserted text is not searched again.
fn filled(template: &str, parts: &[(&str, String)]) -> String {
    let mut page = String::new();
    for (i, piece) in template.split("{{").enumerate() {
        match piece.split_once("}}") {
            Some((name, rest)) if i > 0 => {
                page.extend(parts.iter().find(|part| part.0 == name).map(|part| part.1.as_str()));
                page += rest;
            }
            _ => page += piece,
        }
    }
    page
}

/// Escapes text for HTML, also for attribute values in quotes.
fn escaped(text: &str) -> String {
    let mut safe = String::new();
    for character in text.chars() {
        match character {
            '&' => safe += "&amp;",
            '<' => safe += "&lt;",
            '>' => safe += "&gt;",
            '"' => safe += "&quot;",
            '\'' => safe += "&#39;",
            _ => safe.push(character),
        }
    }
    safe
}

/// Escapes `<` in JSON, so that no string can close the script element. Outside of strings, JSON has no `<`.
fn in_script(json: &str) -> String {
    printable::json(json).replace('<', "\\u003c")
}

/// Returns a display-encoded colour as `#rrggbb`.
fn css(colour: [f32; 3]) -> String {
    let [r, g, b] = colour.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_text() {
        let name = "</script><img src=x onerror=\"a\" b='c'> & {{DATA}}";
        let parts = [("A", escaped(name)), ("B", in_script(&serde_json::to_string(name).unwrap()))];
        let page = filled("<title>{{A}}</title><script>{{B}}</script>{{C}}.", &parts);
        assert_eq!(page.matches('<').count(), 4, "{page}");
        assert_eq!(page.matches("{{DATA}}").count(), 2, "{page}");
        let json = &page[page.find("<script>").unwrap() + 8..page.rfind("</script>").unwrap()];
        assert_eq!(serde_json::from_str::<String>(json).unwrap(), name);
        assert!(page.ends_with("</script>."));
    }

    #[test]
    fn the_page_asks_for_nothing() {
        for part in [TEMPLATE, STYLE, SCRIPT, VIEW, SELF_TEST] {
            for word in ["http:", "https:", "import ", "fetch(", "XMLHttpRequest", "WebSocket", "@import"] {
                assert!(!part.contains(word), "{word}");
            }
        }
        assert!(TEMPLATE.contains("default-src 'none'"));
    }
}

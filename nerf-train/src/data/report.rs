//! Report on a data set: its contents, and warnings about suspicious properties.

use crate::data::cameras::geometry::bounds;
use crate::data::names::listed;
use crate::data::{Axes, Background, Dataset, Format, LookAt};
use crate::system::printable::line;
use glam::DVec3;
use nerf_core::camera::Camera;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Number of training photographs below which the report contains a warning.
const FEW: usize = 6;

#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct Report {
    pub name: String,
    pub format: Format,
    /// Pose convention in which the data set was read.
    pub axes: Axes,
    pub train: usize,
    pub val: usize,
    pub test: usize,
    pub test_path: usize,
    pub sizes: Vec<SizeCount>,
    /// Smallest and largest of all focal lengths `fx` and `fy`, pixels.
    pub focal: [f32; 2],
    /// Point that the cameras look at; `None` with one camera or parallel axes.
    pub look_at: Option<LookAt>,
    /// Distance at which rays should begin, world units; `None` if it is not known.
    pub near: Option<f32>,
    /// Distance at which rays should end, world units; `None` if it is not known.
    pub far: Option<f32>,
    /// Smallest and largest corner of the proposed scene box, world units.
    pub scene_box: Option<[[f32; 3]; 2]>,
    pub background: Background,
    pub points: usize,
    /// Number of distinct cameras, by intrinsics and lens.
    pub cameras: usize,
    /// Origin of all coordinates in this report, in the world of the data set's files.
    pub origin: [f64; 3],
    pub notes: Vec<String>,
    /// Warnings from reading the data set, then warnings of this report.
    pub warnings: Vec<String>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SizeCount {
    pub width: u32,
    pub height: u32,
    pub count: usize,
}

impl Report {
    pub fn of(dataset: &Dataset) -> Self {
        let cameras: Vec<Camera> = dataset.cameras().copied().collect();
        let look_at = LookAt::of(&cameras);
        let bounds = bounds(&cameras, look_at.as_ref(), dataset);
        let mut sizes = BTreeMap::new();
        let mut focal = [f32::INFINITY, 0.0f32];
        for camera in &cameras {
            let i = camera.intrinsics();
            *sizes.entry((i.width, i.height)).or_insert(0) += 1;
            focal = [focal[0].min(i.fx.min(i.fy)), focal[1].max(i.fx.max(i.fy))];
        }
        let mut warnings = dataset.warnings.clone();
        warnings.extend(look_at.and_then(|look_at| axes_warning(&look_at, &cameras, dataset.axes)));
        warnings.extend(one_place(dataset));
        if dataset.train.len() < FEW {
            warnings.push(format!(
                "photographs to fit: {}; so few leave most of a scene unseen, and what no two of them see is guessed: 30 \
                 to 100 are usual",
                dataset.train.len()
            ));
        }
        if bounds.is_none() {
            warnings.push("the cameras do not tell where the scene is: give --near and --far".into());
        }
        let optics = |camera: &Camera| format!("{:?} {:?}", camera.intrinsics(), camera.lens());
        let size_count = |((width, height), count)| SizeCount { width, height, count };
        Self {
            name: dataset.name.clone(),
            format: dataset.format,
            axes: dataset.axes,
            train: dataset.train.len(),
            val: dataset.val.len(),
            test: dataset.test.len(),
            test_path: dataset.test_path.len(),
            sizes: sizes.into_iter().map(size_count).collect(),
            focal,
            look_at,
            near: bounds.map(|b| b.near).or(dataset.near),
            far: bounds.map(|b| b.far).or(dataset.far),
            scene_box: bounds.map(|b| [b.scene_box.min.into(), b.scene_box.max.into()]),
            background: dataset.background,
            points: dataset.points.len(),
            cameras: cameras.iter().map(optics).collect::<BTreeSet<_>>().len(),
            origin: dataset.origin,
            notes: dataset.notes.clone(),
            warnings,
        }
    }
}

/// Returns a warning that names the views with exactly the same pose as another view; `None` if there are none.
fn one_place(dataset: &Dataset) -> Option<String> {
    let mut seen = HashMap::new();
    let mut twins = Vec::new();
    for view in [&dataset.train, &dataset.val, &dataset.test].into_iter().flatten() {
        let pose =
            view.camera.pose().to_rows().as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<u32>>();
        match seen.get(&pose) {
            Some(first) => twins.push(format!("{} and {first}", view.name)),
            None => drop(seen.insert(pose, view.name.as_str())),
        }
    }
    let (count, names) = (twins.len(), listed(&twins));
    (count > 0).then(|| format!("{count} views have the pose of another: {names}"))
}

/// Returns a warning, with a remedy, if the cameras do not look at a common point. If the axes meet behind the cameras,
/// the remedy is the other pose convention ([`Axes::other`]). Forward-facing captures get no warning.
fn axes_warning(look_at: &LookAt, cameras: &[Camera], axes: Axes) -> Option<String> {
    if look_at.agrees() || look_at.forward_facing() {
        return None;
    }
    let share = 100.0 * look_at.behind;
    let other = LookAt { behind: 1.0 - look_at.behind, ..*look_at };
    if other.agrees() {
        return Some(format!(
            "{share:.0}% of the cameras look away from the point that their axes have in common: unless this \
             is a panorama, its poses are of the other convention; read it with --axes {} (now: {axes})",
            axes.other(),
        ));
    }
    let mut warning = format!(
        "the cameras do not look at a common place: their axes pass it at {:.3} on average, they are {:.3} \
         away, and {share:.0}% have it behind them; --axes {} would not mend that",
        look_at.mean_residual,
        look_at.mean_distance,
        axes.other()
    );
    if inverse_meets(cameras) {
        warning += "; the matrices look like world-to-camera, and inverting them would";
    }
    Some(warning)
}

/// Whether the optical axes would meet near a point if the matrices were read as world-to-camera. The matrices are then
/// probably world-to-camera.
fn inverse_meets(cameras: &[Camera]) -> bool {
    let line = |camera: &Camera| {
        let inverse = camera.pose().rotation.transpose();
        let origin = -(inverse * camera.pose().position);
        (origin.as_dvec3(), (-inverse.z_axis).as_dvec3().normalize_or(DVec3::NEG_Z))
    };
    let lines: Vec<_> = cameras.iter().map(line).collect();
    LookAt::of_lines(&lines).is_some_and(|look_at| {
        look_at.axes_meet() && !look_at.forward_facing() && (look_at.behind <= 0.1 || look_at.behind >= 0.9)
    })
}

impl std::fmt::Display for Report {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(f, "{}: {}, poses read as {}", line(&self.name), self.format, self.axes)?;
        write!(f, "  views       {} train, {} val, {} test", self.train, self.val, self.test)?;
        match self.test_path {
            0 => writeln!(f)?,
            count => writeln!(f, ", {count} poses without pictures")?,
        }
        let sizes: Vec<String> =
            self.sizes.iter().map(|s| format!("{}x{} ({})", s.width, s.height, s.count)).collect();
        let cameras = if self.cameras > 1 { format!(", {} cameras", self.cameras) } else { String::new() };
        writeln!(f, "  pixels      {}{cameras}", sizes.join(", "))?;
        let [low, high] = self.focal;
        match low == high {
            true => writeln!(f, "  focal       {low:.2} px")?,
            false => writeln!(f, "  focal       {low:.2} .. {high:.2} px")?,
        }
        writeln!(f, "  background  {}", self.background)?;
        match &self.look_at {
            Some(l) => {
                writeln!(f, "  look-at     {}, axes pass it at {:.3}", corner(l.point), l.mean_residual)?;
                let (min, mean, max) = (l.min_distance, l.mean_distance, l.max_distance);
                writeln!(f, "  distance    {min:.3} min, {mean:.3} mean, {max:.3} max")?;
            }
            None => writeln!(f, "  look-at     none (one camera, or parallel axes)")?,
        }
        let number = |v: Option<f32>| v.map_or("unknown".into(), |v| format!("{v:.3}"));
        writeln!(f, "  near, far   {}, {}", number(self.near), number(self.far))?;
        if let Some([min, max]) = self.scene_box {
            writeln!(f, "  box         {} .. {}", corner(min), corner(max))?;
        }
        if self.points > 0 {
            writeln!(f, "  points      {}", self.points)?;
        }
        for note in &self.notes {
            writeln!(f, "  note: {}", line(note))?;
        }
        for warning in &self.warnings {
            writeln!(f, "  warning: {}", line(warning))?;
        }
        Ok(())
    }
}

fn corner([x, y, z]: [f32; 3]) -> String {
    format!("({x:.3}, {y:.3}, {z:.3})")
}

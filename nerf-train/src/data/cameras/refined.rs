//! File of refined poses beside the `.nerf` blob `FILE`: `FILE.poses.json`, in the format of transforms.json.

use super::optics_by_name;
use super::pose::pose_of;
use crate::data::{DatasetError, View};
use crate::system::input::{MAX_JSON_BYTES, read_limited};
use nerf_core::camera::{Camera, Pose, Projection};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RefinedPoses {
    frames: Vec<Frame>,
}

/// View in a file of refined poses, with nerfstudio's field names. The pose is in the world of the data set's file.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Frame {
    file_path: String,
    camera_model: String,
    w: u32,
    h: u32,
    fl_x: f32,
    fl_y: f32,
    #[serde(flatten, skip_deserializing)]
    optics: BTreeMap<&'static str, f32>,
    transform_matrix: [[f64; 4]; 4],
}

/// Returns the path of the file with a `.nerf` blob's refined poses: the blob's path with `.poses.json` appended.
pub fn beside(blob: &Path) -> PathBuf {
    let mut name = blob.as_os_str().to_owned();
    name.push(".poses.json");
    name.into()
}

impl RefinedPoses {
    /// Collects pairs of a view and its refined camera. `origin`: origin of the cameras' coordinates, in the world of
    /// the data set's files.
    pub fn of<'v>(views: impl IntoIterator<Item = (&'v View, Camera)>, origin: [f64; 3]) -> Self {
        Self { frames: views.into_iter().map(|(view, camera)| Frame::of(view, &camera, origin)).collect() }
    }

    pub fn to_json(&self) -> String {
        // Serialising plain data to memory cannot fail.
        serde_json::to_string_pretty(self).expect("plain data") + "\n"
    }

    /// Reads the refined poses next to a `.nerf` blob; `None` if their file does not exist.
    pub fn beside(blob: &Path) -> Result<Option<Self>, DatasetError> {
        let file = beside(blob);
        match read_limited(&file, MAX_JSON_BYTES) {
            Ok(bytes) => {
                serde_json::from_slice(&bytes).map(Some).map_err(|error| DatasetError::json(&file, &error))
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(DatasetError::io(&file, error)),
        }
    }

    /// Returns each view's refined camera, with its position relative to `origin`; `None` if the file lacks the view.
    /// Errors name the file of refined poses beside `blob`.
    pub fn cameras<'v>(
        &self,
        blob: &Path,
        views: impl IntoIterator<Item = &'v View>,
        origin: [f64; 3],
    ) -> Result<Vec<Option<Camera>>, DatasetError> {
        let frames: HashMap<&str, &Frame> = self.frames.iter().map(|f| (f.file_path.as_str(), f)).collect();
        let camera = |view: &View| match frames.get(view.name.as_str()) {
            Some(frame) => {
                let camera = view.camera.at(frame.pose(origin)).map(Some);
                camera.map_err(|error| DatasetError::camera(&beside(blob), &view.name, &error))
            }
            None => Ok(None),
        };
        views.into_iter().map(camera).collect()
    }
}

impl Frame {
    fn of(view: &View, camera: &Camera, origin: [f64; 3]) -> Self {
        let i = camera.intrinsics();
        let mut transform_matrix = [[0.0, 0.0, 0.0, 1.0]; 4];
        for ((to, from), origin) in transform_matrix.iter_mut().zip(camera.pose().to_rows()).zip(origin) {
            *to = from.map(f64::from);
            to[3] += origin;
        }
        Self {
            file_path: view.name.clone(),
            camera_model: match camera.lens().projection {
                Projection::Perspective => "OPENCV".into(),
                Projection::Fisheye => "OPENCV_FISHEYE".into(),
            },
            w: i.width,
            h: i.height,
            fl_x: i.fx,
            fl_y: i.fy,
            optics: optics_by_name(camera),
            transform_matrix,
        }
    }

    fn pose(&self, origin: [f64; 3]) -> Pose {
        let [x, y, z, _] = self.transform_matrix;
        pose_of([x, y, z], origin.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;
    use glam::{Mat3, Vec3};

    #[test]
    fn refined_cameras_come_back_from_their_file() {
        let views = &demo::small(3, 1, 8).train;
        let origin = [1e6, -2e6, 0.5];
        let moved = |view: &View| {
            let pose = view.camera.pose();
            let rotation = Mat3::from_rotation_x(0.01) * pose.rotation;
            view.camera.at(Pose { rotation, position: pose.position + Vec3::X }).expect("a camera")
        };
        let folder = tempfile::tempdir().expect("a folder");
        let blob = folder.path().join("a.nerf");
        assert!(RefinedPoses::beside(&blob).expect("no file").is_none());
        let refined = RefinedPoses::of(views[..2].iter().map(|view| (view, moved(view))), origin);
        std::fs::write(beside(&blob), refined.to_json()).expect("a file");
        let read = RefinedPoses::beside(&blob).expect("a file").expect("refined poses");
        let cameras = read.cameras(&blob, views, origin).expect("cameras");
        for (found, view) in cameras[..2].iter().zip(views) {
            let (found, expected) = (found.expect("refined").to_owned(), moved(view));
            assert_eq!(found.pose().rotation, expected.pose().rotation);
            assert!((found.pose().position - expected.pose().position).length() < 1e-6);
        }
        assert!(cameras[2].is_none());
        // A matrix row of five numbers is an error that names the file.
        let broken = refined.to_json().replacen(
            "\"transform_matrix\": [\n        [",
            "\"transform_matrix\": [\n        [9, ",
            1,
        );
        std::fs::write(beside(&blob), broken).expect("a file");
        let error = RefinedPoses::beside(&blob).expect_err("five numbers in a row").to_string();
        assert!(error.contains("a.nerf.poses.json"), "{error}");
    }
}

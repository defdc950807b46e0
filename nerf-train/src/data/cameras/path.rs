//! Camera paths: nerfstudio's `camera_path.json`, and plain lists of camera-to-world matrices.

use crate::data::DatasetError;
use crate::data::cameras::pose::{BOTTOM_ROW, bottom_row_fault, pose_of};
use crate::system::input::{read_limited, without_mark};
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::fmt::Display;
use std::path::Path;

/// Maximum size of the file of a camera path, bytes. This is enough for about 100,000 cameras.
const MAX_PATH_BYTES: u64 = 64 << 20;

#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    /// Cameras in the order of the path; at least one.
    pub cameras: Vec<PathCamera>,
    /// Width and height of the pictures to render, pixels, if the file states them.
    pub size: Option<(u32, u32)>,
    pub fps: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathCamera {
    /// Camera-to-world pose, looking down −Z with +Y up, as in nerfstudio and Blender.
    pub pose: Pose,
    /// Vertical field of view, degrees, if the file states it.
    pub fov_degrees: Option<f32>,
}

#[derive(Deserialize)]
struct Nerfstudio {
    camera_type: Option<String>,
    render_width: Option<f64>,
    render_height: Option<f64>,
    fps: Option<f64>,
    /// Cameras of the path; `None` if the JSON file is no camera path.
    camera_path: Option<Vec<Frame>>,
}

#[derive(Deserialize)]
struct Frame {
    camera_to_world: Matrix,
    fov: Option<f64>,
}

/// A camera-to-world matrix in a file: 12 or 16 numbers in row-major order, or a list of rows.
#[derive(Deserialize)]
#[serde(untagged)]
enum Matrix {
    Flat(Vec<f64>),
    Rows(Vec<Vec<f64>>),
    Other(IgnoredAny),
}

impl Matrix {
    /// Returns the matrix's three or four rows of four numbers; the error text says what was found instead.
    fn rows(&self) -> Result<Vec<[f64; 4]>, String> {
        let rows: Vec<&[f64]> = match self {
            Self::Flat(flat) if matches!(flat.len(), 12 | 16) => flat.chunks(4).collect(),
            Self::Flat(flat) => return Err(format!("{} numbers", flat.len())),
            Self::Rows(rows) => rows.iter().map(Vec::as_slice).collect(),
            Self::Other(_) => return Err("no numbers".to_owned()),
        };
        let whole = |row: &&[f64]| <[f64; 4]>::try_from(*row).ok();
        let found = || format!("{} rows of {} numbers", rows.len(), rows.first().map_or(0, |row| row.len()));
        let of_four: Option<Vec<[f64; 4]>> = rows.iter().map(whole).collect();
        of_four.filter(|rows| matches!(rows.len(), 3 | 4)).ok_or_else(found)
    }
}

struct Place<'a>(&'a Path);

impl Place<'_> {
    fn fault(&self, field: impl Display, expected: &str, found: impl Display) -> DatasetError {
        DatasetError::value(self.0, field, expected, found)
    }

    /// Returns the pose of `matrix`, with its position relative to `origin`. `field`: name of the matrix in errors.
    fn pose(&self, field: &str, matrix: &Matrix, origin: [f64; 3]) -> Result<Pose, DatasetError> {
        let fault = |expected: &str, found: String| self.fault(field, expected, found);
        let rows = matrix
            .rows()
            .map_err(|found| fault("a camera-to-world matrix of 3 or 4 rows of 4 numbers", found))?;
        if let Some(found) = bottom_row_fault(&rows) {
            return Err(fault(BOTTOM_ROW, found));
        }
        let pose = pose_of([rows[0], rows[1], rows[2]], origin.into());
        match Camera::new(Intrinsics::centred(1, 1, 1.0), Lens::NONE, pose) {
            Ok(_) => Ok(pose),
            Err(error) => Err(fault("a rotation and a position", error.to_string())),
        }
    }
}

/// Reads a camera path, with positions relative to `origin`; `None` if the JSON is something else, such as a data set.
pub fn read_path(file: &Path, origin: [f64; 3]) -> Result<Option<CameraPath>, DatasetError> {
    let bytes = read_limited(file, MAX_PATH_BYTES)
        .map_err(|source| DatasetError::Io { path: file.into(), source })?;
    let (text, place) = (without_mark(&bytes), Place(file));
    let path = match text.trim_ascii_start().first() {
        Some(b'[') => list(&place, text, origin)?,
        Some(b'{') => match nerfstudio(&place, text, origin)? {
            Some(path) => path,
            None => return Ok(None),
        },
        _ => return Ok(None),
    };
    if path.cameras.is_empty() {
        return Err(place.fault("camera_path", "at least one camera", "none"));
    }
    Ok(Some(path))
}

fn list(place: &Place<'_>, text: &[u8], origin: [f64; 3]) -> Result<CameraPath, DatasetError> {
    let matrices: Vec<Matrix> = serde_json::from_slice(text)
        .map_err(|error| place.fault("the list", "camera-to-world matrices", error))?;
    let camera = |(i, matrix): (usize, &Matrix)| {
        let pose = place.pose(&format!("[{i}]"), matrix, origin)?;
        Ok(PathCamera { pose, fov_degrees: None })
    };
    let cameras = matrices.iter().enumerate().map(camera).collect::<Result<_, DatasetError>>()?;
    Ok(CameraPath { cameras, size: None, fps: None })
}

fn nerfstudio(place: &Place<'_>, text: &[u8], origin: [f64; 3]) -> Result<Option<CameraPath>, DatasetError> {
    let path: Nerfstudio = serde_json::from_slice(text)
        .map_err(|error| place.fault("camera_path", "nerfstudio's camera path", error))?;
    let Some(frames) = path.camera_path else { return Ok(None) };
    if let Some(found) = path.camera_type.filter(|found| found != "perspective") {
        return Err(place.fault("camera_type", "perspective", found));
    }
    let camera = |(i, frame): (usize, &Frame)| {
        let pose =
            place.pose(&format!("camera_path[{i}].camera_to_world"), &frame.camera_to_world, origin)?;
        if let Some(found) = frame.fov.filter(|fov| !(*fov > 0.0 && *fov < 180.0)) {
            let field = format!("camera_path[{i}].fov");
            return Err(place.fault(field, "a vertical field of view of 0 to 180 degrees", found));
        }
        Ok(PathCamera { pose, fov_degrees: frame.fov.map(|fov| fov as f32) })
    };
    if let Some(found) = path.fps.filter(|fps| !(*fps > 0.0 && fps.is_finite())) {
        return Err(place.fault("fps", "a number above 0", found));
    }
    let side = |pixels: f64| (1.0..=65_535.0).contains(&pixels).then_some(pixels as u32);
    let size = match (path.render_width, path.render_height) {
        (None, None) => None,
        (width, height) => {
            let fault = || {
                let found =
                    [width, height].map(|side| side.map_or("none".to_owned(), |side| side.to_string()));
                place.fault("render_width, render_height", "1 to 65535 pixels each", found.join(", "))
            };
            Some(width.and_then(side).zip(height.and_then(side)).ok_or_else(fault)?)
        }
    };
    let cameras = frames.iter().enumerate().map(camera).collect::<Result<_, DatasetError>>()?;
    Ok(Some(CameraPath { cameras, size, fps: path.fps }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn read(value: &Value) -> Result<Option<CameraPath>, DatasetError> {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("path.json");
        std::fs::write(&file, value.to_string()).expect("written");
        read_path(&file, [10.0, 0.0, 0.0])
    }

    fn flat() -> Value {
        json!([1, 0, 0, 11.0, 0, 1, 0, 2.0, 0, 0, 1, 3.0, 0, 0, 0, 1])
    }

    #[test]
    fn nerfstudios_paths_and_plain_lists_are_read() {
        let path = json!({ "camera_type": "perspective", "render_width": 640.0, "render_height": 360, "fps": 24,
            "seconds": 2, "camera_path": [{ "camera_to_world": flat(), "fov": 50, "aspect": 1.78 }] });
        let path = read(&path).expect("a path").expect("a path");
        assert_eq!((path.size, path.fps), (Some((640, 360)), Some(24.0)));
        assert_eq!(path.cameras[0].fov_degrees, Some(50.0));
        assert_eq!(path.cameras[0].pose.position.to_array(), [1.0, 2.0, 3.0]);
        let nested = json!([[[1, 0, 0, 11], [0, 1, 0, 2], [0, 0, 1, 3]]]);
        for list in [json!([flat()]), nested] {
            let path = read(&list).expect("a path").expect("a path");
            assert_eq!((path.cameras.len(), path.size, path.cameras[0].fov_degrees), (1, None, None));
            assert_eq!(path.cameras[0].pose.position.to_array(), [1.0, 2.0, 3.0]);
        }
        assert_eq!(read(&json!({ "frames": [] })).expect("no path"), None);
    }

    #[test]
    fn what_is_no_path_is_named() {
        let frame = |fov: f64| json!({ "camera_path": [{ "camera_to_world": flat(), "fov": fov }] });
        for (path, words) in [
            (json!([]), vec!["at least one camera"]),
            (json!({ "camera_path": [] }), vec!["camera_path", "at least one camera"]),
            (json!([[1, 2, 3]]), vec!["[0]", "3 or 4 rows of 4", "3 numbers"]),
            (json!([flat(), { "a": 1 }]), vec!["[1]", "no numbers"]),
            (json!([[[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, 4]]]), vec!["[0]", "4 rows of 3"]),
            (json!([[2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0]]), vec!["[0]", "a rotation"]),
            (json!([[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0]]), vec!["[0]", "a rotation"]),
            (json!({ "camera_path": [], "render_width": 8 }), vec!["render_height", "8, none"]),
            (frame(180.0), vec!["camera_path[0].fov", "180"]),
            (
                json!({ "camera_type": "fisheye", "camera_path": [] }),
                vec!["camera_type", "perspective", "fisheye"],
            ),
            (json!([[1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]]), vec!["[0]", "transposed"]),
        ] {
            let message = read(&path).expect_err("no path").to_string();
            assert!(words.iter().all(|word| message.contains(word)), "{message}");
        }
    }
}

//! Camera paths: nerfstudio's `camera_path.json`, and plain lists of camera-to-world matrices.

use crate::data::DatasetError;
use crate::data::cameras::pose::{BOTTOM_ROW, bottom_row_fault};
use crate::data::system::input::{MAX_JSON_BYTES, read_limited, without_mark};
use nerf_core::camera::Pose;
use serde::Deserialize;
use serde_json::Value;
use std::path::Path;

/// Cameras to render one after the other.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    /// In order; at least one.
    pub cameras: Vec<PathCamera>,
    /// Width and height of the pictures, pixels, where the file says.
    pub size: Option<(u32, u32)>,
    /// Frames a second, where the file says.
    pub fps: Option<f64>,
}

/// A camera of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PathCamera {
    /// Camera to world, looking down −Z with +Y up, as nerfstudio and Blender have it.
    pub pose: Pose,
    /// Vertical field of view, degrees, where the file says.
    pub fov_degrees: Option<f32>,
}

#[derive(Deserialize)]
struct Nerfstudio {
    camera_type: Option<String>,
    render_width: Option<f64>,
    render_height: Option<f64>,
    fps: Option<f64>,
    camera_path: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    camera_to_world: Value,
    fov: Option<f64>,
}

/// Where a fault is.
struct Place<'a>(&'a Path);

impl Place<'_> {
    fn fault(&self, field: impl Into<String>, expected: &str, found: impl ToString) -> DatasetError {
        let (file, field) = (self.0.into(), field.into());
        DatasetError::Value { file, field, expected: expected.into(), found: found.to_string() }
    }

    /// A matrix of 3 or 4 rows of 4 numbers, or these in a row, counted from `origin`.
    fn pose(&self, field: &str, value: &Value, origin: [f64; 3]) -> Result<Pose, DatasetError> {
        const EXPECTED: &str = "a camera-to-world matrix of 3 or 4 rows of 4 numbers";
        let numbers = |value: &Value| -> Option<Vec<f64>> {
            value
                .as_array()?
                .iter()
                .map(|number| number.as_f64().filter(|number| number.is_finite()))
                .collect()
        };
        let flat = match value.as_array().is_some_and(|rows| rows.iter().all(Value::is_array)) {
            true => value
                .as_array()
                .into_iter()
                .flatten()
                .map(numbers)
                .collect::<Option<Vec<_>>>()
                .map(|rows| rows.concat()),
            false => numbers(value),
        };
        let found = || self.fault(field, EXPECTED, value.to_string().chars().take(80).collect::<String>());
        let flat = flat.filter(|flat| matches!(flat.len(), 12 | 16)).ok_or_else(found)?;
        let rows: Vec<[f64; 4]> = flat.chunks_exact(4).map(|row| [row[0], row[1], row[2], row[3]]).collect();
        if let Some(found) = bottom_row_fault(&rows) {
            return Err(self.fault(field, BOTTOM_ROW, found));
        }
        let row = |i: usize| {
            let [x, y, z, t] = rows[i];
            [x, y, z, t - origin[i]].map(|number| number as f32)
        };
        Ok(Pose::from_rows([row(0), row(1), row(2)]))
    }
}

/// Reads a path whose positions count from `origin` then; `None` of a file that is another JSON, such as a data set's.
///
/// # Errors
/// [`DatasetError`] on a file that cannot be read, on a path without cameras, and on what is no matrix or angle.
pub fn read_path(file: &Path, origin: [f64; 3]) -> Result<Option<CameraPath>, DatasetError> {
    let bytes = read_limited(file, MAX_JSON_BYTES)
        .map_err(|source| DatasetError::Io { path: file.into(), source })?;
    let Ok(value) = serde_json::from_slice::<Value>(without_mark(&bytes)) else { return Ok(None) };
    let place = Place(file);
    let path = match value {
        Value::Array(matrices) => {
            let camera = |(i, matrix): (usize, &Value)| {
                let pose = place.pose(&format!("[{i}]"), matrix, origin)?;
                Ok(PathCamera { pose, fov_degrees: None })
            };
            let cameras = matrices.iter().enumerate().map(camera).collect::<Result<_, DatasetError>>()?;
            CameraPath { cameras, size: None, fps: None }
        }
        value if value.get("camera_path").is_some() => of_nerfstudio(&place, value, origin)?,
        _ => return Ok(None),
    };
    if path.cameras.is_empty() {
        return Err(place.fault("camera_path", "at least one camera", "none"));
    }
    Ok(Some(path))
}

fn of_nerfstudio(place: &Place<'_>, value: Value, origin: [f64; 3]) -> Result<CameraPath, DatasetError> {
    let fault = |error: serde_json::Error| place.fault("camera_path", "nerfstudio's camera path", error);
    let path: Nerfstudio = serde_json::from_value(value).map_err(fault)?;
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
    let side = |pixels: f64| (1.0..=65_535.0).contains(&pixels).then_some(pixels as u32);
    let size = match (path.render_width, path.render_height) {
        (Some(width), Some(height)) => {
            let size = side(width).zip(side(height));
            let fault = || {
                place.fault("render_width, render_height", "1 to 65535 pixels", format!("{width}, {height}"))
            };
            Some(size.ok_or_else(fault)?)
        }
        _ => None,
    };
    if let Some(found) = path.fps.filter(|fps| !(*fps > 0.0 && fps.is_finite())) {
        return Err(place.fault("fps", "a number above 0", found));
    }
    let cameras = path.camera_path.iter().enumerate().map(camera).collect::<Result<_, DatasetError>>()?;
    Ok(CameraPath { cameras, size, fps: path.fps })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

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
            (json!([[1, 2, 3]]), vec!["[0]", "3 or 4 rows of 4"]),
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

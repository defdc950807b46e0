//! The camera of a frame: pose, size, intrinsics, lens.

use super::{CameraFields, MODELS, NEGLIGIBLE_SHIFT};
use crate::data::DatasetError;
use crate::data::cameras::pose::{BOTTOM_ROW, angle_fault, bottom_row_fault, pose_of};
use crate::data::pictures::file::StatedSize;
use crate::data::pictures::photo::Optics;
use glam::DVec3;
use nerf_core::camera::{Lens, Pose, Projection};
use std::fmt::Display;
use std::path::Path;

pub(super) struct Place<'a> {
    pub(super) file: &'a Path,
    pub(super) view: &'a str,
}

impl Place<'_> {
    pub(super) fn value(&self, field: &str, expected: &str, found: impl Display) -> DatasetError {
        DatasetError::value(self.file, format!("view `{}`, {field}", self.view), expected, found)
    }

    pub(super) fn unsupported(&self, field: &str, expected: &str, found: String) -> DatasetError {
        DatasetError::value(self.file, format!("view `{}`: {field}", self.view), expected, found)
    }

    pub(super) fn pose(&self, matrix: &[Vec<f64>], origin: DVec3) -> Result<Pose, DatasetError> {
        let fits = (3..=4).contains(&matrix.len()) && matrix.iter().all(|row| row.len() == 4);
        if !fits {
            let found: Vec<usize> = matrix.iter().map(Vec::len).collect();
            let found = format!("rows of lengths {found:?}");
            return Err(self.value("transform_matrix", "4 (or 3) rows of 4 numbers", found));
        }
        if let Some(found) = bottom_row_fault(matrix) {
            return Err(self.value("transform_matrix", BOTTOM_ROW, found));
        }
        Ok(pose_of([0, 1, 2].map(|i| std::array::from_fn(|j| matrix[i][j])), origin))
    }

    /// Returns width and height of the picture, pixels; `None` for a side that the json does not state.
    pub(super) fn size(&self, fields: &CameraFields) -> Result<StatedSize, DatasetError> {
        for (name, side) in [("w", fields.w), ("h", fields.h)] {
            if side.is_some_and(|side| !(1.0..=1e6).contains(&side)) {
                return Err(self.value(name, "1 to 1000000 pixels", side.unwrap_or_default()));
            }
        }
        Ok((fields.w, fields.h))
    }

    /// Returns intrinsics and lens for a picture of `w` by `h` pixels; adds remarks to `notes`.
    pub(super) fn optics(
        &self,
        fields: &CameraFields,
        (w, h): (f64, f64),
        notes: &mut Vec<String>,
    ) -> Result<Optics, DatasetError> {
        let focal = |given: Option<f64>, field: &str, side: f64, angle: Option<f64>| match (given, angle) {
            (None, Some(angle)) => match angle_fault(angle) {
                Some(found) => Err(self.value(field, "radians above 0 and below π", found)),
                None => Ok(Some(0.5 * side / (0.5 * angle).tan())),
            },
            (given, _) => Ok(given),
        };
        let focal_x = focal(fields.fl_x, "camera_angle_x", w, fields.camera_angle_x)?;
        let focal_y = focal(fields.fl_y, "camera_angle_y", h, fields.camera_angle_y)?;
        let (Some(fx), Some(fy)) = (focal_x.or(focal_y), focal_y.or(focal_x)) else {
            let (place, expected) = (format!("view `{}`", self.view), "the field `fl_x (or camera_angle_x)`");
            return Err(DatasetError::value(self.file, place, expected, "no such field"));
        };
        let lens = self.lens(fields, (w, h), (fx, fy), notes)?;
        let (cx, cy) = (fields.cx.unwrap_or(0.5 * w), fields.cy.unwrap_or(0.5 * h));
        Ok(Optics { width: w, height: h, fx, fy, cx, cy, lens })
    }

    fn model(&self, fields: &CameraFields) -> Result<Model, DatasetError> {
        const EXPECTED: &str = "OPENCV, PINHOLE, SIMPLE_PINHOLE, SIMPLE_RADIAL, RADIAL, FULL_OPENCV, OPENCV_FISHEYE, \
                                RADIAL_FISHEYE or SIMPLE_RADIAL_FISHEYE";
        let name = fields.camera_model.as_deref().unwrap_or("OPENCV").to_ascii_uppercase();
        match name.as_str() {
            "OPENCV_FISHEYE" | "RADIAL_FISHEYE" | "SIMPLE_RADIAL_FISHEYE" => Ok(Model::Fisheye),
            "FULL_OPENCV" => Ok(Model::Rational),
            name if MODELS.contains(&name) && fields.is_fisheye == Some(true) => Ok(Model::Fisheye),
            name if MODELS.contains(&name) => Ok(Model::Polynomial),
            _ => Err(self.unsupported(
                "camera_model",
                EXPECTED,
                fields.camera_model.clone().unwrap_or_default(),
            )),
        }
    }

    /// Returns the view's lens. In polynomial models, k4 is nerfstudio's coefficient of r^8, which [`Lens`] lacks. If
    /// k4 shifts the farthest corner by at most half a pixel, k4 is ignored, with a note. A larger k4 is an error.
    fn lens(
        &self,
        fields: &CameraFields,
        (w, h): (f64, f64),
        (fx, fy): (f64, f64),
        notes: &mut Vec<String>,
    ) -> Result<Lens, DatasetError> {
        let &CameraFields { k1, k2, k3, k4, k5, k6, p1, p2, .. } = fields;
        let names = ["k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2"];
        let values = [k1, k2, k3, k4, k5, k6, p1, p2].map(|value| value.unwrap_or_default());
        let [k1, k2, k3, k4, k5, k6, p1, p2] = values.map(|value| value as f32);
        let mut named = names.into_iter().zip(values);
        if let Some((name, value)) = named.find(|(_, value)| !(*value as f32).is_finite()) {
            return Err(self.value(name, "a finite number", value));
        }
        let lens = Lens { k1, k2, p1, p2, k3, ..Lens::NONE };
        match self.model(fields)? {
            Model::Fisheye => Ok(Lens { k4, projection: Projection::Fisheye, ..lens }),
            Model::Rational => Ok(Lens { k4, k5, k6, ..lens }),
            Model::Polynomial if k4 == 0.0 => Ok(lens),
            Model::Polynomial => {
                let (cx, cy) = (fields.cx.unwrap_or(0.5 * w), fields.cy.unwrap_or(0.5 * h));
                let (x, y) = (cx.abs().max((w - cx).abs()) / fx, cy.abs().max((h - cy).abs()) / fy);
                let r2 = x * x + y * y;
                let shift = fx.max(fy) * r2.sqrt() * f64::from(k4.abs()) * r2.powi(4);
                if shift.is_nan() || shift > NEGLIGIBLE_SHIFT {
                    let found = format!("k4 = {k4}, which moves a corner by {shift:.1} pixels");
                    let expected =
                        "none (or less than half a pixel of it; that of FULL_OPENCV needs the camera_model)";
                    return Err(self.unsupported("k4", expected, found));
                }
                notes
                    .push(format!("k4 is ignored: it moves no point by more than {NEGLIGIBLE_SHIFT} pixels"));
                Ok(lens)
            }
        }
    }
}

/// Lens model to which the coefficients in a json belong.
enum Model {
    /// Radial distortion by a polynomial, with tangential terms.
    Polynomial,
    /// Radial distortion by a quotient of polynomials, with tangential terms.
    Rational,
    Fisheye,
}

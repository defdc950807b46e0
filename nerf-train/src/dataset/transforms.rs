//! What the `transforms*.json` files of Blender, nerfstudio and instant-ngp have in common.

use super::found::Found;
use super::picture::{self, Picture};
use super::pose::{BOTTOM_ROW, angle_fault, bottom_row_fault};
use super::{Axes, DatasetError, ReadOptions, View, Watch};
use crate::input::{MAX_JSON_BYTES, read_limited, without_mark};
use nerf_core::camera::{Camera, Intrinsics, Pose};
use nerf_core::lens::Lens;
use rayon::prelude::*;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A file: one JSON read three times, so that every error has its own line.
pub(super) struct Transforms {
    pub(super) header: Header,
    /// Frames in the file's order, each with its own camera fields.
    frames: Vec<(Frame, CameraFields)>,
    shared: CameraFields,
}

/// The file's own fields.
#[derive(Deserialize)]
pub(super) struct Header {
    frames: Vec<Frame>,
    pub(super) near: Option<f32>,
    pub(super) far: Option<f32>,
    pub(super) train_filenames: Option<Vec<String>>,
    pub(super) val_filenames: Option<Vec<String>>,
    pub(super) test_filenames: Option<Vec<String>>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
    mask_path: Option<String>,
}

#[derive(Deserialize)]
struct FrameCameras {
    frames: Vec<CameraFields>,
}

/// Camera fields, for the whole file or for one frame.
#[derive(Deserialize)]
struct CameraFields {
    camera_model: Option<String>,
    is_fisheye: Option<bool>,
    camera_angle_x: Option<f64>,
    camera_angle_y: Option<f64>,
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// Models that the radial-tangential lens covers.
const MODELS: &[&str] = &["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE"];

/// Highest radial terms may be dropped where they move no point by more than this, pixels.
const NEGLIGIBLE_SHIFT: f64 = 0.5;

impl Transforms {
    pub(super) fn read(file: &Path) -> Result<Self, DatasetError> {
        let bytes = read_limited(file, MAX_JSON_BYTES).map_err(|source| DatasetError::io(file, source))?;
        let bytes = without_mark(&bytes);
        let json = |error| DatasetError::json(file, &error);
        let mut header: Header = serde_json::from_slice(bytes).map_err(json)?;
        let cameras: FrameCameras = serde_json::from_slice(bytes).map_err(json)?;
        let shared = serde_json::from_slice(bytes).map_err(json)?;
        let frames = std::mem::take(&mut header.frames).into_iter().zip(cameras.frames).collect();
        Ok(Self { header, frames, shared })
    }

    /// Frames it names, with or without a picture.
    pub(super) fn len(&self) -> usize {
        self.frames.len()
    }

    /// All views whose picture exists, in the file's order; what is to be said of the rest goes into `found`.
    pub(super) fn views(
        &self,
        file: &Path,
        options: &ReadOptions,
        watch: &Watch,
        found: &mut Found,
    ) -> Result<Vec<View>, DatasetError> {
        let file_name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let folder = Folder::of(file, options)?;
        let load = |(frame, own): &(Frame, CameraFields)| {
            let loaded = self.view(file, &folder, frame, own);
            watch.count();
            loaded
        };
        let read: Vec<Result<Loaded, DatasetError>> = self.frames.par_iter().map(load).collect();
        let (mut views, mut missing, mut notes) = (Vec::new(), Vec::new(), BTreeMap::new());
        for ((frame, _), loaded) in self.frames.iter().zip(read) {
            match loaded? {
                Loaded::Missing => missing.push(frame.file_path.as_str()),
                Loaded::View { view, alpha, notes: own } => {
                    found.count_alpha(&view, alpha);
                    views.push(view);
                    for note in own {
                        *notes.entry(note).or_insert(0usize) += 1;
                    }
                }
            }
        }
        if !missing.is_empty() {
            found.warnings.push(format!(
                "{file_name}: skipped {} of {} frames, whose picture is missing: {}",
                missing.len(),
                self.frames.len(),
                listed(&missing)
            ));
        }
        if self.frames.iter().any(|(frame, _)| frame.mask_path.is_some()) {
            found.warnings.push(format!("{file_name}: masks (mask_path) are ignored"));
        }
        let notes = notes.iter().map(|(note, count)| format!("{file_name}: {count} views: {note}"));
        found.warnings.extend(notes);
        Ok(views)
    }

    fn view(
        &self,
        file: &Path,
        folder: &Folder<'_>,
        frame: &Frame,
        own: &CameraFields,
    ) -> Result<Loaded, DatasetError> {
        let name = &frame.file_path;
        let at = Place { file, view: name };
        let Some(path) = picture::locate(folder.path, name) else { return Ok(Loaded::Missing) };
        at.check_inside(folder, &path)?;
        let pose = at.pose(&frame.transform_matrix)?;
        let mut picture = picture::decode(&path)?;
        let mut notes = Vec::new();
        let fields = own.over(&self.shared);
        let stated = at.size(&fields)?;
        notes.extend(picture.turn_to(stated));
        let (intrinsics, lens) = at.intrinsics(&fields, stated, &path, &picture, &mut notes)?;
        let camera = Camera::new(intrinsics, lens, folder.axes.to_opengl(pose))
            .map_err(|source| DatasetError::Camera { file: file.into(), view: name.clone(), source })?;
        let Picture { pixels, alpha, .. } = picture;
        Ok(Loaded::View { view: View { name: name.clone(), camera, pixels }, alpha, notes })
    }
}

/// Where pictures are looked for, and how their poses are read.
struct Folder<'a> {
    path: &'a Path,
    /// The same with its links resolved; `None` where pictures may lie anywhere.
    bounds: Option<PathBuf>,
    axes: Axes,
}

impl<'a> Folder<'a> {
    fn of(file: &'a Path, options: &ReadOptions) -> Result<Self, DatasetError> {
        let path = file.parent().filter(|path| !path.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let resolve = || std::fs::canonicalize(path).map_err(|source| DatasetError::io(path, source));
        let bounds = if options.outside_files { None } else { Some(resolve()?) };
        Ok(Self { path, bounds, axes: options.axes.unwrap_or(Axes::Opengl) })
    }
}

/// The first few names, and how many more there are.
pub(super) fn listed(names: &[impl AsRef<str>]) -> String {
    const SHOWN: usize = 8;
    let shown: Vec<&str> = names.iter().take(SHOWN).map(AsRef::as_ref).collect();
    let more = if names.len() > SHOWN { format!(" and {} more", names.len() - SHOWN) } else { String::new() };
    shown.join(", ") + &more
}

enum Loaded {
    Missing,
    View {
        view: View,
        /// Whether the file has an alpha channel.
        alpha: bool,
        notes: Vec<String>,
    },
}

impl CameraFields {
    /// These fields where they are given, `shared` elsewhere.
    fn over(&self, shared: &Self) -> Self {
        Self {
            camera_model: self.camera_model.clone().or(shared.camera_model.clone()),
            is_fisheye: self.is_fisheye.or(shared.is_fisheye),
            camera_angle_x: self.camera_angle_x.or(shared.camera_angle_x),
            camera_angle_y: self.camera_angle_y.or(shared.camera_angle_y),
            fl_x: self.fl_x.or(shared.fl_x),
            fl_y: self.fl_y.or(shared.fl_y),
            cx: self.cx.or(shared.cx),
            cy: self.cy.or(shared.cy),
            w: self.w.or(shared.w),
            h: self.h.or(shared.h),
            k1: self.k1.or(shared.k1),
            k2: self.k2.or(shared.k2),
            k3: self.k3.or(shared.k3),
            k4: self.k4.or(shared.k4),
            p1: self.p1.or(shared.p1),
            p2: self.p2.or(shared.p2),
        }
    }
}

/// Where an error would be.
struct Place<'a> {
    file: &'a Path,
    view: &'a str,
}

impl Place<'_> {
    fn value(&self, field: &str, expected: &str, found: impl ToString) -> DatasetError {
        DatasetError::Value {
            file: self.file.into(),
            field: format!("view `{}`, {field}", self.view),
            expected: expected.into(),
            found: found.to_string(),
        }
    }

    fn unsupported(&self, field: &'static str, expected: &'static str, found: String) -> DatasetError {
        DatasetError::Unsupported {
            file: self.file.into(),
            place: format!("view `{}`", self.view),
            field,
            expected,
            found,
        }
    }

    fn pose(&self, matrix: &[Vec<f64>]) -> Result<Pose, DatasetError> {
        let mut rows = [[0.0f32; 4]; 3];
        let fits = (3..=4).contains(&matrix.len()) && matrix.iter().all(|row| row.len() == 4);
        if !fits {
            let found: Vec<usize> = matrix.iter().map(Vec::len).collect();
            let found = format!("rows of lengths {found:?}");
            return Err(self.value("transform_matrix", "4 (or 3) rows of 4 numbers", found));
        }
        if let Some(found) = bottom_row_fault(matrix) {
            return Err(self.value("transform_matrix", BOTTOM_ROW, found));
        }
        for (row, source) in rows.iter_mut().zip(matrix) {
            for (value, &number) in row.iter_mut().zip(source) {
                *value = number as f32;
            }
        }
        Ok(Pose::from_rows(rows))
    }

    /// Refuses a picture that lies outside of the data folder, whatever leads there.
    fn check_inside(&self, folder: &Folder<'_>, path: &Path) -> Result<(), DatasetError> {
        let Some(bounds) = &folder.bounds else { return Ok(()) };
        let found = std::fs::canonicalize(path).map_err(|source| DatasetError::io(path, source))?;
        if found.starts_with(bounds) {
            return Ok(());
        }
        let (file, view) = (self.file.into(), self.view.to_owned());
        Err(DatasetError::Outside { file, view, folder: bounds.clone(), found })
    }

    /// The picture's width and height as far as the json says them, pixels.
    fn size(&self, fields: &CameraFields) -> Result<(Option<f64>, Option<f64>), DatasetError> {
        for (name, side) in [("w", fields.w), ("h", fields.h)] {
            if side.is_some_and(|side| !(1.0..=1e6).contains(&side)) {
                return Err(self.value(name, "1 to 1000000 pixels", side.unwrap_or_default()));
            }
        }
        Ok((fields.w, fields.h))
    }

    /// Intrinsics for the picture as it is, and what to say about them.
    fn intrinsics(
        &self,
        fields: &CameraFields,
        stated: (Option<f64>, Option<f64>),
        path: &Path,
        picture: &Picture,
        notes: &mut Vec<String>,
    ) -> Result<(Intrinsics, Lens), DatasetError> {
        self.check_model(fields)?;
        let found = (picture.width, picture.height);
        let size = (f64::from(found.0), f64::from(found.1));
        let (w, h) = (stated.0.unwrap_or(size.0), stated.1.unwrap_or(size.1));
        let (sx, sy) = (size.0 / w, size.1 / h);
        if !picture::fits(found, stated) {
            return Err(DatasetError::PictureSize { file: path.into(), expected: (w, h), found });
        }
        if (w, h) != size {
            let (a, b) = found;
            notes.push(format!("pictures are {a}x{b} where the json says {w}x{h}: intrinsics scaled to fit"));
        }
        let from_angle = |field: &str, side: f64, angle: Option<f64>| match angle {
            Some(angle) => match angle_fault(angle) {
                Some(found) => Err(self.value(field, "radians above 0 and below π", found)),
                None => Ok(Some(0.5 * side / (0.5 * angle).tan())),
            },
            None => Ok(None),
        };
        let focal_x = match fields.fl_x {
            None => from_angle("camera_angle_x", w, fields.camera_angle_x)?,
            given => given,
        };
        let focal_y = match fields.fl_y {
            None => from_angle("camera_angle_y", h, fields.camera_angle_y)?,
            given => given,
        };
        let (Some(fx), Some(fy)) = (focal_x.or(focal_y), focal_y.or(focal_x)) else {
            return Err(DatasetError::MissingField {
                file: self.file.into(),
                place: format!("view `{}`", self.view),
                field: "fl_x (or camera_angle_x)",
            });
        };
        let lens = self.lens(fields, (w, h), (fx, fy), notes)?;
        let intrinsics = Intrinsics {
            width: found.0,
            height: found.1,
            fx: (fx * sx) as f32,
            fy: (fy * sy) as f32,
            cx: (fields.cx.unwrap_or(0.5 * w) * sx) as f32,
            cy: (fields.cy.unwrap_or(0.5 * h) * sy) as f32,
        };
        Ok((intrinsics, lens))
    }

    fn check_model(&self, fields: &CameraFields) -> Result<(), DatasetError> {
        const EXPECTED: &str =
            "a perspective camera (OPENCV, PINHOLE, SIMPLE_PINHOLE, SIMPLE_RADIAL, RADIAL)";
        if fields.is_fisheye == Some(true) {
            return Err(self.unsupported("is_fisheye", EXPECTED, "true".into()));
        }
        match &fields.camera_model {
            Some(model) if !MODELS.iter().any(|known| known.eq_ignore_ascii_case(model)) => {
                Err(self.unsupported("camera_model", EXPECTED, model.clone()))
            }
            _ => Ok(()),
        }
    }

    /// k1, k2, p1, p2. The model has no k3 and k4: they are dropped, with a note, where they move
    /// the farthest corner by at most half a pixel, and refused elsewhere.
    fn lens(
        &self,
        fields: &CameraFields,
        (w, h): (f64, f64),
        (fx, fy): (f64, f64),
        notes: &mut Vec<String>,
    ) -> Result<Lens, DatasetError> {
        let [k1, k2, k3, k4, p1, p2] =
            [fields.k1, fields.k2, fields.k3, fields.k4, fields.p1, fields.p2].map(Option::unwrap_or_default);
        for (name, value) in [("k1", k1), ("k2", k2), ("k3", k3), ("k4", k4), ("p1", p1), ("p2", p2)] {
            if !(value as f32).is_finite() {
                return Err(self.value(name, "a finite number", value));
            }
        }
        let (cx, cy) = (fields.cx.unwrap_or(0.5 * w), fields.cy.unwrap_or(0.5 * h));
        let (x, y) = (cx.abs().max((w - cx).abs()) / fx, cy.abs().max((h - cy).abs()) / fy);
        let r2 = x * x + y * y;
        let shift = fx.max(fy) * r2.sqrt() * (k3.abs() * r2.powi(3) + k4.abs() * r2.powi(4));
        if k3 != 0.0 || k4 != 0.0 {
            if shift.is_nan() || shift > NEGLIGIBLE_SHIFT {
                let found = format!("k3 = {k3}, k4 = {k4}, which move a corner by {shift:.1} pixels");
                return Err(self.unsupported("k3, k4", "none (or less than half a pixel of them)", found));
            }
            notes.push(format!(
                "k3 and k4 are ignored: they move no point by more than {NEGLIGIBLE_SHIFT} pixels"
            ));
        }
        Ok(Lens { k1: k1 as f32, k2: k2 as f32, p1: p1 as f32, p2: p2 as f32 })
    }
}

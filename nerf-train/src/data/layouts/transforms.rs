//! What the `transforms*.json` files of Blender, nerfstudio and instant-ngp have in common.

use crate::data::cameras::pose::{BOTTOM_ROW, angle_fault, bottom_row_fault};
use crate::data::layouts::folders::smaller_copy;
use crate::data::layouts::found::Found;
use crate::data::pictures::file::{self, StatedSize};
use crate::data::pictures::photo::{Fence, Loaded, Optics, Photo, Source};
use crate::data::system::input::{MAX_JSON_BYTES, read_limited, without_mark};
use crate::data::{Axes, DatasetError, Downscale, ReadOptions, View, Watch};
use glam::DVec3;
use nerf_core::camera::{Lens, Pose, Projection};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A file: one JSON read three times, so that every error has its own line.
pub(crate) struct Transforms {
    pub(crate) header: Header,
    /// Frames in the file's order, each with its own camera fields.
    frames: Vec<(Frame, CameraFields)>,
    shared: CameraFields,
}

/// The file's own fields.
#[derive(Deserialize)]
pub(crate) struct Header {
    frames: Vec<Frame>,
    pub(crate) near: Option<f32>,
    pub(crate) far: Option<f32>,
    pub(crate) train_filenames: Option<Vec<String>>,
    pub(crate) val_filenames: Option<Vec<String>>,
    pub(crate) test_filenames: Option<Vec<String>>,
    pub(crate) aabb_scale: Option<f64>,
    pub(crate) applied_transform: Option<Vec<Vec<f64>>>,
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
    k5: Option<f64>,
    k6: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// Models whose coefficients are those of a polynomial, or none; with `is_fisheye` of a fisheye.
const MODELS: &[&str] = &["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE"];

/// The highest radial term may be dropped where it moves no point by more than this, pixels.
const NEGLIGIBLE_SHIFT: f64 = 0.5;

impl Transforms {
    pub(crate) fn read(file: &Path) -> Result<Self, DatasetError> {
        let bytes = read_limited(file, MAX_JSON_BYTES).map_err(|source| DatasetError::io(file, source))?;
        let bytes = without_mark(&bytes);
        let json =
            |error| number_fault(file, bytes, &error).unwrap_or_else(|| DatasetError::json(file, &error));
        let mut header: Header = serde_json::from_slice(bytes).map_err(json)?;
        let cameras: FrameCameras = serde_json::from_slice(bytes).map_err(json)?;
        let shared = serde_json::from_slice(bytes).map_err(json)?;
        let frames = std::mem::take(&mut header.frames).into_iter().zip(cameras.frames).collect();
        Ok(Self { header, frames, shared })
    }

    /// Frames it names, with or without a picture.
    pub(crate) fn len(&self) -> usize {
        self.frames.len()
    }

    /// The positions of its cameras, as far as its matrices have them.
    pub(crate) fn positions(&self) -> impl Iterator<Item = [f64; 3]> {
        self.frames.iter().filter_map(|(frame, _)| match frame.transform_matrix.as_slice() {
            [x, y, z, ..] => Some([*x.get(3)?, *y.get(3)?, *z.get(3)?]),
            _ => None,
        })
    }

    /// All views whose picture exists, in the file's order; what is to be said of the rest goes into `found`.
    pub(crate) fn views(
        &self,
        file: &Path,
        options: &ReadOptions,
        (downscale, origin): (Option<Downscale>, DVec3),
        watch: &Watch,
        found: &mut Found,
    ) -> Result<Vec<View>, DatasetError> {
        let file_name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let path = file.parent().filter(|path| !path.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let axes = options.axes.unwrap_or(Axes::Opengl);
        let folder = Folder { path, fence: Fence::around(path, options)?, axes, downscale, origin };
        let source = Source { file, says: "the json" };
        let pictures: Vec<_> =
            self.frames.iter().map(|(frame, _)| file::locate(path, &frame.file_path)).collect();
        let views = source.load_all(self.frames.len(), watch, found, |index| {
            let (frame, own) = &self.frames[index];
            pictures[index]
                .clone()
                .map(|picture| self.view(&source, &folder, frame, own, picture))
                .transpose()
        })?;
        let sizes: BTreeSet<_> = views.iter().map(View::size).collect();
        let shared = self.shared.fl_x.is_some() && self.shared.w.or(self.shared.h).is_none();
        let own = self.frames.iter().all(|(_, own)| own.fl_x.or(own.w).or(own.h).is_some());
        if sizes.len() > 1 && shared && !own {
            found.warnings.push(format!(
                "{file_name}: pictures of {} sizes with one fl_x and no w and h that say which size it is of",
                sizes.len()
            ));
        }
        let without = self.frames.iter().zip(&pictures).filter(|(_, picture)| picture.is_none());
        let missing: Vec<&str> = without.map(|((frame, _), _)| frame.file_path.as_str()).collect();
        if !missing.is_empty() {
            found.warnings.push(format!(
                "{file_name}: skipped {} of {} frames, whose picture is missing: {}",
                missing.len(),
                self.frames.len(),
                listed(&missing)
            ));
        }
        Ok(views)
    }

    fn view(
        &self,
        source: &Source<'_>,
        folder: &Folder<'_>,
        frame: &Frame,
        own: &CameraFields,
        picture: PathBuf,
    ) -> Result<Loaded, DatasetError> {
        let (file, name) = (source.file, &frame.file_path);
        let at = Place { file, view: name };
        folder.fence.check(file, name, &picture)?;
        let pose = at.pose(&frame.transform_matrix, folder.origin)?;
        let fields = own.over(&self.shared);
        let stated = at.size(&fields)?;
        let mask = match &frame.mask_path {
            Some(mask) => {
                let path = file::locate(folder.path, mask).ok_or_else(|| {
                    at.value("mask_path", "the name of a picture", format!("{mask}, which is missing"))
                })?;
                folder.fence.check(file, name, &path)?;
                Some(path)
            }
            None => None,
        };
        // What the factor is of, where the file does not say the size, only the picture tells.
        let factor = match (folder.downscale, stated) {
            (Some(downscale), (Some(w), Some(h))) => downscale.factor((w, h)),
            _ => 1,
        };
        let copy = if factor > 1 { smaller_copy(folder.path, name, factor) } else { None };
        if let Some(copy) = &copy {
            folder.fence.check(file, name, copy)?;
        }
        let reduced = copy.is_some();
        let photo = Photo {
            name,
            path: copy.unwrap_or(picture),
            mask,
            stated,
            downscale: folder.downscale.filter(|_| !reduced),
            reduced,
            pose: folder.axes.to_opengl(pose),
        };
        source.load(photo, |size, notes| at.optics(&fields, size, notes))
    }
}

/// The largest file that is read once more to say which frame has no number, bytes.
const MAX_EXPLAINED_BYTES: usize = 16 << 20;

/// Of a file that does not parse since it has NaN or Infinity, which no JSON has but many write: the frame and field
/// of the first.
fn number_fault(file: &Path, bytes: &[u8], error: &serde_json::Error) -> Option<DatasetError> {
    // A larger one is no list of photographs, and would take many times its size here.
    let text = std::str::from_utf8(bytes).ok().filter(|text| text.len() <= MAX_EXPLAINED_BYTES)?;
    let mut cleared = text.to_owned();
    for word in ["-Infinity", "Infinity", "NaN"] {
        let text = std::mem::take(&mut cleared);
        for (index, part) in text.split(word).enumerate() {
            // Where a value stands, rather than in a name.
            let value = cleared.trim_end().ends_with(['[', ',', ':'])
                && part.trim_start().starts_with([']', ',', '}']);
            match (index, value) {
                (0, _) => {}
                (_, true) => cleared += &format!("\"{NO_NUMBER}\""),
                (_, false) => cleared += word,
            }
            cleared += part;
        }
    }
    let value: serde_json::Value = serde_json::from_str(&cleared).ok()?;
    let frames = value.get("frames")?.as_array()?;
    let place = frames.iter().find_map(|frame| {
        let (field, _) = frame.as_object()?.iter().find(|(_, value)| lacks_number(value))?;
        let name = frame.get("file_path").and_then(serde_json::Value::as_str).unwrap_or("?");
        Some(format!("view `{name}`, {field}"))
    })?;
    Some(DatasetError::Value {
        file: file.into(),
        field: format!("line {}, {place}", error.line()),
        expected: "finite numbers".into(),
        found: "NaN or Infinity".into(),
    })
}

/// What stands for NaN and Infinity where they are looked for.
const NO_NUMBER: &str = "(no number)";

fn lacks_number(value: &serde_json::Value) -> bool {
    value == NO_NUMBER || value.as_array().is_some_and(|values| values.iter().any(lacks_number))
}

/// Where pictures are looked for, and how they and their poses are read.
struct Folder<'a> {
    path: &'a Path,
    fence: Fence,
    axes: Axes,
    downscale: Option<Downscale>,
    /// What positions are counted from.
    origin: DVec3,
}

/// The first few names, and how many more there are.
pub(crate) fn listed(names: &[impl AsRef<str>]) -> String {
    const SHOWN: usize = 8;
    let shown: Vec<&str> = names.iter().take(SHOWN).map(AsRef::as_ref).collect();
    let more = if names.len() > SHOWN { format!(" and {} more", names.len() - SHOWN) } else { String::new() };
    shown.join(", ") + &more
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
            k5: self.k5.or(shared.k5),
            k6: self.k6.or(shared.k6),
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

    fn pose(&self, matrix: &[Vec<f64>], origin: DVec3) -> Result<Pose, DatasetError> {
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
        for ((row, source), origin) in rows.iter_mut().zip(matrix).zip(origin.to_array()) {
            for (value, &number) in row.iter_mut().zip(source) {
                *value = number as f32;
            }
            row[3] = (source[3] - origin) as f32;
        }
        Ok(Pose::from_rows(rows))
    }

    /// The picture's width and height as far as the json says them, pixels.
    fn size(&self, fields: &CameraFields) -> Result<StatedSize, DatasetError> {
        for (name, side) in [("w", fields.w), ("h", fields.h)] {
            if side.is_some_and(|side| !(1.0..=1e6).contains(&side)) {
                return Err(self.value(name, "1 to 1000000 pixels", side.unwrap_or_default()));
            }
        }
        Ok((fields.w, fields.h))
    }

    /// Intrinsics for a picture of `w` by `h` pixels, and what to say about them.
    fn optics(
        &self,
        fields: &CameraFields,
        (w, h): (f64, f64),
        notes: &mut Vec<String>,
    ) -> Result<Optics, DatasetError> {
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
        let (cx, cy) = (fields.cx.unwrap_or(0.5 * w), fields.cy.unwrap_or(0.5 * h));
        Ok(Optics { width: w, height: h, fx, fy, cx, cy, lens })
    }

    /// Which lens the coefficients are of.
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

    /// The lens. Without a name k4 is of eighth order, as in nerfstudio, which no lens here has: it is dropped, with a
    /// note, where it moves the farthest corner by at most half a pixel, and refused elsewhere.
    fn lens(
        &self,
        fields: &CameraFields,
        (w, h): (f64, f64),
        (fx, fy): (f64, f64),
        notes: &mut Vec<String>,
    ) -> Result<Lens, DatasetError> {
        let named = [
            ("k1", fields.k1),
            ("k2", fields.k2),
            ("k3", fields.k3),
            ("k4", fields.k4),
            ("k5", fields.k5),
            ("k6", fields.k6),
            ("p1", fields.p1),
            ("p2", fields.p2),
        ];
        let [k1, k2, k3, k4, k5, k6, p1, p2] = named.map(|(_, value)| value.unwrap_or_default() as f32);
        if let Some((name, Some(value))) =
            named.into_iter().find(|(_, value)| value.is_some_and(|value| !(value as f32).is_finite()))
        {
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

/// What the coefficients of a json are of.
enum Model {
    /// A radial polynomial, and tangential terms.
    Polynomial,
    /// The same with a denominator.
    Rational,
    /// Angles.
    Fisheye,
}

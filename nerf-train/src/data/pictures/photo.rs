//! Loads photographs with their cameras: decodes files in parallel; rotates, reduces and masks the photographs.

use crate::data::pictures::file::{self, Picture, StatedSize};
use crate::data::pictures::found::Found;
use crate::data::pictures::scale::{shrunk, shrunk_mask};
use crate::data::{DatasetError, Downscale, ReadOptions, View, Watch};
use image::DynamicImage;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Intrinsics and lens, for a picture of `width` by `height` pixels.
#[derive(Clone, Debug)]
pub(crate) struct Optics {
    pub(crate) width: f64,
    pub(crate) height: f64,
    pub(crate) fx: f64,
    pub(crate) fy: f64,
    pub(crate) cx: f64,
    pub(crate) cy: f64,
    pub(crate) lens: Lens,
}

impl Optics {
    /// Returns the intrinsics, scaled to a picture of `width` by `height` pixels.
    fn at(&self, width: u32, height: u32) -> Intrinsics {
        let (sx, sy) = (f64::from(width) / self.width, f64::from(height) / self.height);
        Intrinsics {
            width,
            height,
            fx: (self.fx * sx) as f32,
            fy: (self.fy * sy) as f32,
            cx: (self.cx * sx) as f32,
            cy: (self.cy * sy) as f32,
        }
    }
}

/// Photograph to load: its file, and what the data set states about it.
pub(crate) struct Photo<'a> {
    /// Path of the picture's file as the data set writes it.
    pub(crate) name: &'a str,
    pub(crate) path: PathBuf,
    /// Path of the mask. Pixels that are black in the mask are neither trained on nor evaluated.
    pub(crate) mask: Option<PathBuf>,
    pub(crate) stated: StatedSize,
    /// Factor by which the picture is reduced. [`Downscale::By`] divides the size that the data set states,
    /// [`Downscale::Auto`] the size of the picture's file. `None`: the picture keeps the size of its file.
    pub(crate) downscale: Option<Downscale>,
    /// Whether the picture's file is a copy that is known to be smaller than the size that the data set states.
    pub(crate) reduced: bool,
    pub(crate) pose: Pose,
}

pub(crate) struct Loaded {
    pub(crate) view: View,
    /// Whether the picture's file has an alpha channel.
    pub(crate) alpha: bool,
    /// Size before reduction, pixels; `None` if the picture was not reduced.
    pub(crate) larger: Option<(u32, u32)>,
    pub(crate) notes: Vec<String>,
}

#[derive(Clone, Copy)]
pub(crate) struct Source<'a> {
    pub(crate) file: &'a Path,
    /// Name, in notes, of the file that states the poses, such as "the json".
    pub(crate) says: &'static str,
}

impl Source<'_> {
    /// Decodes a photograph and makes its camera. Fails if the picture does not have the stated aspect ratio. `optics`
    /// returns the intrinsics for the stated width and height (the file's if not stated), and adds notes.
    pub(crate) fn load(
        &self,
        photo: Photo<'_>,
        optics: impl FnOnce((f64, f64), &mut Vec<String>) -> Result<Optics, DatasetError>,
    ) -> Result<Loaded, DatasetError> {
        let mut notes = Vec::new();
        let mut decoded = file::decode(&photo.path, photo.stated)?;
        notes.extend(decoded.turn_to(photo.stated, self.says));
        let found = decoded.size();
        let own = (f64::from(found.0), f64::from(found.1));
        let (w, h) = (photo.stated.0.unwrap_or(own.0), photo.stated.1.unwrap_or(own.1));
        if !file::fits(found, photo.stated) {
            return Err(file::other_size(&photo.path, photo.stated, found));
        }
        let optics = optics((w, h), &mut notes)?;
        let (width, height) = photo.downscale.map_or(found, |downscale| {
            // A given factor applies to the size stated with the poses, `Auto` to the size of the picture's file.
            let (w, h) = if downscale == Downscale::Auto { own } else { (w, h) };
            let factor = f64::from(downscale.factor((w, h)));
            let side = |side: f64| (side / factor).round().clamp(1.0, 65_535.0) as u32;
            (side(w), side(h))
        });
        // Pictures are never enlarged. One pixel too many is kept: programs that make smaller copies round differently.
        let larger = found.0 > width + 1 || found.1 > height + 1;
        let (width, height) = if larger { (width.min(found.0), height.min(found.1)) } else { found };
        if (w, h) != own && !photo.reduced {
            let (a, b) = found;
            let says = self.says;
            notes.push(format!("pictures are {a}x{b} where {says} says {w}x{h}: intrinsics scaled to fit"));
        }
        let mask = photo.mask.as_deref().map(|mask| read_mask(mask, found, (width, height))).transpose()?;
        let Picture { width, height, pixels, alpha } = shrunk(decoded.image, width, height);
        let camera = Camera::new(optics.at(width, height), optics.lens, photo.pose)
            .map_err(|error| DatasetError::camera(self.file, photo.name, &error))?;
        let mask = mask.filter(|kept| !kept.iter().all(|&kept| kept));
        let view = View { mask, ..View::new(photo.name.into(), camera, pixels) };
        Ok(Loaded { view, alpha, larger: larger.then_some(found), notes })
    }

    /// Loads `count` photographs in parallel and counts them in `found`. Photographs that are masked out entirely are
    /// not returned. `load`: loads the photograph at an index; `None` leaves it out.
    pub(crate) fn load_all(
        &self,
        count: usize,
        watch: &Watch,
        found: &mut Found,
        load: impl Fn(usize) -> Result<Option<Loaded>, DatasetError> + Sync,
    ) -> Result<Vec<View>, DatasetError> {
        let one = |index: usize| {
            let loaded = load(index);
            watch.count();
            loaded
        };
        let read: Vec<Result<Option<Loaded>, DatasetError>> = (0..count).into_par_iter().map(one).collect();
        let (mut views, mut pixels) = (Vec::new(), 0u64);
        for loaded in read {
            let Some(loaded) = loaded? else { continue };
            pixels += loaded.view.pixel_count();
            if found.count(self.file, &loaded) {
                views.push(loaded.view);
            }
        }
        if views.iter().any(|view| view.mask.is_some()) && pixels > u64::from(u32::MAX) {
            let expected = "at most 2^32 pixels with masks (--downscale makes them fewer)";
            return Err(DatasetError::value(self.file, "masks", expected, pixels));
        }
        Ok(views)
    }
}

/// Reads the mask of a picture of `size` pixels and scales it to `to`: true for pixels that are kept (not black).
fn read_mask(file: &Path, size: (u32, u32), to: (u32, u32)) -> Result<Vec<bool>, DatasetError> {
    let stated = (Some(size.0.into()), Some(size.1.into()));
    let decoded = file::decode(file, stated)?;
    let found = decoded.size();
    if !file::fits(found, stated) {
        return Err(file::other_size(file, stated, found));
    }
    let kept: Vec<bool> = match decoded.image {
        DynamicImage::ImageLuma8(image) => image.into_raw().into_iter().map(|value| value > 0).collect(),
        image => image.into_rgba8().pixels().map(|p| p.0[..3] != [0; 3] && p.0[3] > 0).collect(),
    };
    Ok(shrunk_mask(&kept, found, to))
}

/// The folder that photographs must lie in.
pub(crate) struct Fence {
    /// Path of the folder, links resolved; `None` if pictures may be anywhere.
    bounds: Option<PathBuf>,
}

impl Fence {
    /// Makes the fence around `folder`, without effect if `options` allow pictures outside of it.
    pub(crate) fn around(folder: &Path, options: &ReadOptions) -> Result<Self, DatasetError> {
        let resolve = || std::fs::canonicalize(folder).map_err(|source| DatasetError::io(folder, source));
        Ok(Self { bounds: if options.outside_files { None } else { Some(resolve()?) } })
    }

    /// Returns an error if `path` leads outside the folder; the error names `file` and `view`.
    pub(crate) fn check(&self, file: &Path, view: &str, path: &Path) -> Result<(), DatasetError> {
        let Some(bounds) = &self.bounds else { return Ok(()) };
        let found = std::fs::canonicalize(path).map_err(|source| DatasetError::io(path, source))?;
        if found.starts_with(bounds) {
            return Ok(());
        }
        let fault = format!(
            "view `{view}`: expected a picture inside of {}, found {}; --outside-files reads it all the same",
            bounds.display(),
            found.display()
        );
        Err(DatasetError::fault(file, fault))
    }
}

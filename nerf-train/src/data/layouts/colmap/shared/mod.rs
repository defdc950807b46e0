//! Shared cameras: gives each device one camera (set of intrinsics), and repeats bundle adjustment with these cameras.

mod kept;

use super::{Model, Points};
use crate::data::cameras::bundle::{Bundle, Device, Frame, Observation, Photograph, median};
use crate::data::layouts::folders::Folders;
use crate::data::pictures::exif;
use crate::data::pictures::found::Found;
use crate::data::{DatasetError, ReadOptions, Watch};
use glam::{DQuat, DVec2, DVec3};
use kept::{Adjusted, Shared, turned_origin};
use nerf_core::camera::Projection;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;
use std::time::Instant;

/// Maximum number of photographs in a reconstruction whose cameras are merged. The time of bundle adjustment grows with
/// the cube of their number, and is half a minute at this maximum.
const MAX_PHOTOGRAPHS: usize = 300;
/// Factor on the mean reprojection error above which the adjusted reconstruction is rejected.
const MAX_GROWTH: f64 = 1.25;
/// Difference between fy / fx and 1 below which pixels are taken as square.
const SQUARE: f64 = 0.02;
/// Version of the bundle adjustment, part of the checksum of a file of shared cameras: a new version makes existing files
/// invalid.
const VERSION: u64 = 1;

/// Merges the cameras (sets of intrinsics) of each device and adjusts the reconstruction. Returns true, and adds a note
/// to `found`, if the merged cameras are used.
///
/// Returns false if no device has cameras to merge. Also returns false, with a warning, if the cameras cannot be merged
/// or the adjustment raises the reprojection error too much. `file`: file named in errors.
pub(super) fn settle(
    model: &mut Model,
    points: &mut Points,
    folders: &Folders,
    (options, file): (&ReadOptions, &Path),
    (watch, found): (&Watch, &mut Found),
) -> Result<bool, DatasetError> {
    let Some(devices) = devices(model, folders, options) else { return Ok(false) };
    let count = model.images.len();
    let own = format!("{count} photographs with {} cameras", model.cameras.len());
    let keep_own = |found: &mut Found, why: String| {
        found.warnings.push(format!("{own} keep them: {why}"));
        Ok(false)
    };
    if count > MAX_PHOTOGRAPHS {
        return keep_own(
            found,
            format!(
                "more than {MAX_PHOTOGRAPHS} are not adjusted again here; `nerf-train poses` finds poses with one camera"
            ),
        );
    }
    let Some(task) = Task::of(model, points, &devices, file)? else {
        return keep_own(found, "no points are seen in several of them, or there is no lens for some".into());
    };
    let begun = Instant::now();
    let kept = options.shared_cameras.as_deref();
    let read = kept.map(|kept| Shared::read(kept, task.checksum)).transpose()?.flatten();
    let is_kept = read.is_some();
    let shared = read.map_or_else(|| task.adjusted(), Ok)?;
    let spent = begun.elapsed();
    watch.set_time_aside(spent);
    let [before, after] = shared.reprojection_error_px;
    if after > before * MAX_GROWTH {
        return keep_own(
            found,
            format!(
                "with one for each device the reprojection error is {after:.2} px instead of {before:.2}; photographs of \
                 several devices or zooms want folders of their own"
            ),
        );
    }
    let how = match kept {
        Some(kept) if is_kept => format!("read from {}", kept.display()),
        _ => format!("in {:.1} s", spent.as_secs_f64()),
    };
    if let Some(kept) = kept.filter(|_| !options.to_measure && !is_kept) {
        shared.write(kept)?;
    }
    found.notes.push(format!("{} ({how}; --cameras own keeps them)", shared.in_words()));
    shared.apply(model, points);
    Ok(true)
}

/// Returns each photograph's device index, by picture size and EXIF; `None` if no device has several cameras to merge.
fn devices(model: &Model, folders: &Folders, options: &ReadOptions) -> Option<Vec<usize>> {
    if model.cameras.len() < 2 {
        return None;
    }
    let mut known = Vec::new();
    let mut used: Vec<BTreeMap<u32, usize>> = Vec::new();
    let mut devices = Vec::new();
    for image in &model.images {
        let (width, height) = model.cameras.get(&image.camera)?.size();
        let located = folders.locate(&image.name, options.downscale, (width, height));
        let made_by = located.map(|located| exif::device(&located.path)).unwrap_or_default();
        let device = (made_by, width.min(height).to_bits(), width.max(height).to_bits());
        let index = known.iter().position(|known| *known == device).unwrap_or(known.len());
        if index == known.len() {
            known.push(device);
            used.push(BTreeMap::new());
        }
        *used[index].entry(image.camera).or_default() += 1;
        devices.push(index);
    }
    // A device's cameras are merged if they have fewer than two photographs each on average, or if their pictures
    // differ in width (upright and turned). Other cameras are taken as intentional.
    let several = |used: &BTreeMap<u32, usize>| {
        let photographs: usize = used.values().sum();
        let sizes = used.keys().filter_map(|camera| Some(model.cameras.get(camera)?.size().0.to_bits()));
        let mut sizes: Vec<u64> = sizes.collect();
        sizes.sort_unstable();
        sizes.dedup();
        used.len() > 1 && (2 * used.len() > photographs || sizes.len() == used.len())
    };
    used.iter().any(several).then_some(devices)
}

struct Task<'a> {
    model: &'a Model,
    own: Bundle,
    focals: Vec<f64>,
    numbers: Vec<u64>,
    /// The bundle with one camera for each device, before the adjustment.
    shared: Bundle,
    checksum: u64,
}

impl<'a> Task<'a> {
    /// Prepares the adjustment; `None` if no point is in several photographs, or a pose or lens cannot be adjusted.
    fn of(
        model: &'a Model,
        points: &Points,
        devices: &[usize],
        file: &Path,
    ) -> Result<Option<Self>, DatasetError> {
        let mut own = Bundle { devices: vec![], photographs: vec![], points: vec![], observations: vec![] };
        for image in &model.images {
            let Some(camera) = model.cameras.get(&image.camera) else { return Ok(None) };
            let optics = camera.optics(file, &image.name)?;
            let lens = optics.lens;
            let more = [lens.k3, lens.k4, lens.k5, lens.k6];
            let numbers = image.rotation.iter().chain(&image.translation).chain([&optics.fx, &optics.fy]);
            let turned = image.rotation.iter().any(|v| v.abs() > 1e-9);
            let readable =
                numbers.into_iter().all(|v| v.is_finite()) && optics.fx.min(optics.fy) > 0.0 && turned;
            if lens.projection != Projection::Perspective || more != [0.0; 4] || !readable {
                return Ok(None);
            }
            let [w, x, y, z] = image.rotation;
            own.devices.push(Device {
                focal: optics.fx,
                radial: [lens.k1.into(), lens.k2.into()],
                second_order: camera.parameters() > 4 && lens.k2 != 0.0,
            });
            own.photographs.push(Photograph {
                rotation: DQuat::from_xyzw(x, y, z, w).normalize(),
                translation: DVec3::from(image.translation) + turned_origin(image.rotation, points.origin),
                device: own.photographs.len(),
                frame: Frame {
                    principal: DVec2::new(optics.cx, optics.cy),
                    aspect: optics.fy / optics.fx,
                    tangential: [lens.p1.into(), lens.p2.into()],
                },
            });
        }
        let numbers = observe(&mut own, model, points);
        if own.observations.is_empty() {
            return Ok(None);
        }
        let shared = with_devices(&own, model, devices);
        let focals = own.devices.iter().map(|device| device.focal).collect();
        let checksum = checksum(&own, devices);
        Ok(Some(Self { model, own, focals, numbers, shared, checksum }))
    }

    fn adjusted(&self) -> Result<Shared, DatasetError> {
        let centres = |bundle: &Bundle| bundle.photographs.iter().map(Photograph::centre).collect::<Vec<_>>();
        let anchor = centres(&self.own);
        let mut bundle = self.shared.clone();
        bundle.dolly(&self.focals);
        bundle.adjust(&anchor);
        let moved = centres(&bundle).into_iter().zip(&anchor).zip(self.own.depths());
        let moved: Vec<f64> = moved
            .filter(|(_, depth)| *depth > 0.0)
            .map(|((to, from), depth)| (to - *from).length() / depth)
            .collect();
        let largest = moved.iter().copied().fold(0.0, f64::max);
        let shared = Shared {
            model: self.checksum,
            devices: self.devices(&bundle),
            reprojection_error_px: [mean(&self.own.errors()), mean(&bundle.errors())],
            moved: [median(moved), largest],
            ..self.posed(&bundle)
        };
        // Converts to JSON and back: JSON may lose a number's last digit, and reading the file must give this result.
        let same = serde_json::to_vec(&shared).and_then(|bytes| serde_json::from_slice(&bytes));
        same.map_err(|error| DatasetError::io(Path::new("shared cameras"), error.into()))
    }

    fn devices(&self, bundle: &Bundle) -> Vec<Adjusted> {
        let of_device = |(index, device): (usize, &Device)| {
            let focals = self.focals.iter().zip(&bundle.photographs);
            let focals: Vec<f64> = focals.filter(|(_, p)| p.device == index).map(|(f, _)| *f).collect();
            let least = focals.iter().copied().fold(f64::INFINITY, f64::min);
            let largest = focals.iter().copied().fold(0.0, f64::max);
            let photographs = focals.len();
            Adjusted { photographs, focal_before: [median(focals), least, largest], focal: device.focal }
        };
        bundle.devices.iter().enumerate().map(of_device).collect()
    }

    fn posed(&self, bundle: &Bundle) -> Shared {
        let (mut cameras, mut photographs): (Vec<(u64, u64, [f64; 8])>, _) = (Vec::new(), BTreeMap::new());
        for (image, photograph) in self.model.images.iter().zip(&bundle.photographs) {
            let Device { focal, radial: [k1, k2], .. } = bundle.devices[photograph.device];
            let Frame { principal, aspect, tangential: [p1, p2] } = photograph.frame;
            let (width, height) = self.model.cameras[&image.camera].size();
            let camera = [focal, focal * aspect, principal.x, principal.y, k1, k2, p1, p2];
            let camera = (width as u64, height as u64, camera);
            let index = cameras.iter().position(|known| *known == camera).unwrap_or(cameras.len());
            if index == cameras.len() {
                cameras.push(camera);
            }
            let DQuat { x, y, z, w } = photograph.rotation;
            let posed = (index as u32, [w, x, y, z], photograph.translation.to_array());
            photographs.insert(image.name.clone(), posed);
        }
        let mut errors = vec![(0.0, 0.0); self.numbers.len()];
        for (seen, error) in bundle.observations.iter().zip(bundle.errors()) {
            let (sum, count) = errors[seen.point];
            errors[seen.point] = (sum + error, count + 1.0);
        }
        let points = self.numbers.iter().zip(&bundle.points).zip(errors);
        let points = points.map(|((&number, at), (sum, count))| (number, at.to_array(), sum / count));
        // The error of a point behind a camera is infinite, which JSON cannot hold.
        let points = points.map(|(number, at, error)| (number, at, error.min(1e6))).collect();
        let (devices, zero) = (Vec::new(), [0.0; 2]);
        Shared { model: 0, devices, reprojection_error_px: zero, moved: zero, cameras, photographs, points }
    }
}

/// Adds to `bundle` the points that several photographs show, and their observations. Returns the `POINT3D_ID`s.
fn observe(bundle: &mut Bundle, model: &Model, points: &Points) -> Vec<u64> {
    let places = points.numbers();
    let mut photographs = vec![(usize::MAX, false); points.kept.len()];
    let key_points = || {
        let images = model.images.iter().enumerate();
        let all = images.flat_map(|(i, image)| image.key_points.iter().map(move |key| (i, key)));
        all.filter_map(|(i, (at, number))| Some((i, *places.get(number)? as usize, DVec2::from(*at))))
    };
    for (i, place, _) in key_points() {
        let (first, several) = &mut photographs[place];
        *several |= *first != usize::MAX && *first != i;
        *first = (*first).min(i);
    }
    let (mut numbers, mut index) = (Vec::new(), HashMap::new());
    for (place, (number, point)) in points.kept.iter().enumerate() {
        if photographs[place].1 {
            index.insert(place, numbers.len());
            numbers.push(*number);
            bundle.points.push(point.position.map(f64::from).into());
        }
    }
    let seen = key_points().filter(|(.., at)| at.is_finite());
    let seen = seen.filter_map(|(photograph, place, at)| {
        Some(Observation { photograph, point: *index.get(&place)?, at })
    });
    bundle.observations = seen.collect();
    bundle.observations.sort_by_key(|seen| (seen.point, seen.photograph));
    numbers
}

/// Returns `own` with one camera per device. Focal length and radial distortion are medians over the device's
/// photographs; principal point, fy / fx and tangential distortion are medians over its photographs of equal size.
fn with_devices(own: &Bundle, model: &Model, devices: &[usize]) -> Bundle {
    let mut shared = Bundle { devices: Vec::new(), ..own.clone() };
    let of = |device: usize, what: &dyn Fn(usize) -> f64| {
        median((0..devices.len()).filter(|&i| devices[i] == device).map(what))
    };
    for device in 0..=devices.iter().copied().max().unwrap_or(0) {
        shared.devices.push(Device {
            focal: of(device, &|i| own.devices[i].focal),
            radial: [0, 1].map(|k| of(device, &|i| own.devices[i].radial[k])),
            second_order: (0..devices.len()).any(|i| devices[i] == device && own.devices[i].second_order),
        });
    }
    // Upright and turned photographs have different principal points.
    let size = |i: usize| model.cameras[&model.images[i].camera].size();
    for i in 0..devices.len() {
        let alike = |j: &usize| devices[*j] == devices[i] && size(*j) == size(i);
        let of = |what: &dyn Fn(&Frame) -> f64| {
            median((0..devices.len()).filter(alike).map(|j| what(&own.photographs[j].frame)))
        };
        let aspect = of(&|frame| frame.aspect);
        shared.photographs[i].device = devices[i];
        shared.photographs[i].frame = Frame {
            principal: DVec2::new(of(&|frame| frame.principal.x), of(&|frame| frame.principal.y)),
            aspect: if (aspect - 1.0).abs() < SQUARE { 1.0 } else { aspect },
            tangential: [0, 1].map(|k| of(&|frame| frame.tangential[k])),
        };
    }
    shared
}

fn checksum(own: &Bundle, devices: &[usize]) -> u64 {
    const CRC: crc::Crc<u64> = crc::Crc::<u64>::new(&crc::CRC_64_XZ);
    let mut digest = CRC.digest();
    let mut add = |numbers: &[f64]| numbers.iter().for_each(|v| digest.update(&v.to_le_bytes()));
    add(&[f64::from_bits(VERSION)]);
    for ((photograph, device), own) in own.photographs.iter().zip(&own.devices).zip(devices) {
        let Frame { principal, aspect, tangential } = photograph.frame;
        add(&[*own as f64, device.focal, principal.x, principal.y, aspect]);
        add(&[device.radial, tangential].concat());
        add(&photograph.rotation.to_array());
        add(&photograph.translation.to_array());
    }
    own.points.iter().for_each(|point| add(&point.to_array()));
    for seen in &own.observations {
        add(&[seen.photograph as f64, seen.point as f64, seen.at.x, seen.at.y]);
    }
    digest.finalize()
}

fn mean(errors: &[f64]) -> f64 {
    let finite = || errors.iter().filter(|error| error.is_finite());
    finite().sum::<f64>() / finite().count().max(1) as f64
}

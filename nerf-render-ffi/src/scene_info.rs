//! Description of a scene: bounds, sampling, network, accuracy and training.

use crate::boundary::{Message, Out, by_width, call, versioned};
use crate::open_options::numbers_of;
use crate::scene::Scene;
use crate::status::Status;
use core::ffi::c_char;
use nerf_core::blob::{SceneSampling, StoredTables, Viewpoint};
use nerf_core::network::{MAX_COLOUR, MAX_TRUNK};

/// Kind of content of a scene file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kind {
    /// A scene: density and colour in space.
    Scene = 1,
    /// A 2D field: colour over a plane, rendered by `nerf_render_picture`.
    Picture = 2,
}

/// Number format of the feature tables of a scene's learned grid (multiresolution hash grid).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum TableStorage {
    /// The scene has no learned grid.
    None = 0,
    /// f16: two bytes per value.
    F16 = 1,
    /// 8-bit integers: one byte per value, and one scale factor per level of the grid.
    Int8 = 2,
    /// `NERF_TABLE_STORAGE_INT8`, entropy-coded: `nerf_scene_open` decodes the tables into the scene's memory. A
    /// library without the feature `coded` (microcontrollers) refuses coded tables. For such a library, train with
    /// `--export int8`: the tables are then read directly from the file's bytes.
    Coded = 3,
}

/// Text inside the scene file: UTF-8, `length` bytes, **not** NUL-terminated.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Text {
    /// Address of the first byte; never NULL.
    pub data: *const c_char,
    /// Length, bytes.
    pub length: usize,
}

impl Text {
    fn of(text: &str) -> Self {
        Self { data: text.as_ptr().cast(), length: text.len() }
    }
}

/// Description of a scene. For a 2D field, fields that do not apply are 0, except `occupied_share`, which is 1.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct SceneInfo {
    /// `sizeof(nerf_scene_info)`, set by the caller.
    pub struct_size: usize,
    /// Content of the scene file: a `nerf_kind`.
    pub kind: u32,
    /// The `nerf_kernel` that the scene runs on; never `NERF_KERNEL_AUTO`.
    pub kernel: u32,
    /// Corner of the scene box with the smallest x, y and z, world units. Outside the box density is 0, unless the
    /// scene is unbounded (`contraction_radius` is not 0).
    pub box_min: [f32; 3],
    /// Corner of the scene box with the largest x, y and z, world units.
    pub box_max: [f32; 3],
    /// Distance at which the scene begins on the rays of its training cameras, world units. The mean of
    /// `near_distance` and `far_distance` is a good distance between a camera and the middle of the scene box; other
    /// distances work, too. (The name is not `near`, which is a macro in Windows headers.)
    pub near_distance: f32,
    /// Distance at which the scene ends on the rays of its training cameras, world units.
    pub far_distance: f32,
    /// The scene's own number of samples per ray. If `step` is 0: number of samples between near and far, in equal bins
    /// or placed by a proposal network. If `step` is not 0 and the scene is bounded: number of steps along the diagonal
    /// of the scene box. If the scene is unbounded: number of steps along a ray through the centre of the ball of
    /// radius `contraction_radius`, from the ray's entry into the ball to distance `far_distance` beyond the centre.
    pub samples: u32,
    /// Background colour, which shows where opacity is below 1, display-encoded.
    pub background: [f32; 3],
    /// 1 if colour depends on the viewing direction.
    pub view_dependent: u32,
    /// 1 if the occupancy grid is part of the model and cannot be ignored.
    pub occupancy_required: u32,
    /// Number of cells of the occupancy grid along x, y, z; zeros without an occupancy grid.
    pub occupancy_resolution: [u32; 3],
    /// Fraction of the occupancy grid's cells that are occupied; 1 without an occupancy grid.
    pub occupied_share: f32,
    /// Number of layers of the trunk, which gives the density; only this many entries of `trunk_widths` are used.
    pub trunk_layers: u32,
    /// Number of units in each layer of the trunk.
    pub trunk_widths: [u32; 16],
    /// Number of hidden layers of the colour branch; only this many entries of `colour_widths` are used.
    pub colour_layers: u32,
    /// Number of units in each hidden layer of the colour branch.
    pub colour_widths: [u32; 4],
    /// Mean PSNR over the validation views, dB; NaN if not measured.
    pub psnr_db: f32,
    /// Loss of PSNR, dB, caused by the rounding of weights and tables to the file's formats; measured on validation
    /// views. NaN if not measured.
    pub quantisation_loss_db: f32,
    /// Number of optimiser steps of the training run.
    pub steps: u32,
    /// Number of weights and biases of the network. Tables of a learned grid, and proposal networks, are not counted.
    pub parameters: u64,
    /// Multiply-adds of one density evaluation. For a 2D field: multiply-adds of the layers before the colour branch.
    pub density_macs: u64,
    /// Multiply-adds of one colour evaluation, in addition to the density evaluation at the same sample.
    pub colour_macs: u64,
    /// Seed of the training run.
    pub seed: u64,
    /// Name of the data that the scene was fitted to.
    pub data: Text,
    /// The program and settings that made the scene.
    pub made_by: Text,
    /// Description of how the PSNR was measured: views, background, samples.
    pub psnr_convention: Text,
    /// Width of the image that the 2D field was fitted to, pixels; 0 for a scene.
    pub picture_width: u32,
    /// Height of the image that the 2D field was fitted to, pixels; 0 for a scene.
    pub picture_height: u32,
    /// Number of samples per ray at which the proposal network is evaluated; 0 without a proposal network.
    pub proposal_samples: u32,
    /// Number of points on the Pareto front (PSNR against multiply-adds) from `nerf-train study`; 0 without a front.
    pub front_points: u32,
    /// Multiply-adds of one evaluation of the proposal network; 0 without a proposal network.
    pub proposal_macs: u64,
    /// Distance between samples on a ray through the scene box, world units. 0 if samples lie between near and far, in
    /// equal bins or placed by a proposal network. In an unbounded scene, the distance grows outside the ball of
    /// `contraction_radius`.
    pub step: f32,
    /// Storage of the learned grid's tables: a `nerf_table_storage`.
    pub table_storage: u32,
    /// Radius of a ball around the centre of an unbounded scene's box, world units; 0 if the scene ends at its box.
    /// The box is a cube with sides of 4 radii. All space outside the ball is contracted into the rest of the box.
    pub contraction_radius: f32,
    /// Exponent `p` of the growth of steps outside the ball of `contraction_radius`: 1, 2 or 4; 0 if the scene ends at
    /// its box. Samples are equally spaced in `s`, which is 0 at the ray's point nearest to the ball's centre. The
    /// distance of a sample from this point is `s` radii if `s <= 1`, else `(1 - (s - 1) / p)^-p` radii. If `p` is 1,
    /// samples are uniform in disparity (1 / distance); if `p` is 4, nearly uniform in the logarithm of the distance.
    pub contraction_power: u32,
    /// Storage of the weights: a `nerf_storage`, never `NERF_STORAGE_AUTO`.
    pub storage: u32,
    /// Position of the default viewpoint, world units: a view from `eye` towards `target` shows the photographed
    /// subject. Without a viewpoint in the file, `eye`, `target`, `up` and `arc` are 0; with one, `up` has length 1.
    pub eye: [f32; 3],
    /// Position of the subject of the photographs, world units: the centre of an orbit around the subject.
    pub target: [f32; 3],
    /// Upward direction of the photographs, unit length: the axis of an orbit around the subject.
    pub up: [f32; 3],
    /// Angle, around `up`, of the arc from which most photographs were taken, radians; 2 pi for a full orbit. `eye` is
    /// in the middle of the arc.
    pub arc: f32,
}

// The array lengths above are literals for the C header.
const _: () = assert!(MAX_TRUNK == 16 && MAX_COLOUR == 4);

versioned!(unsafe SceneInfo, "info", by_width(if align_of::<u64>() == 4 { 284 } else { 288 }, 320));

/// Writes the description of a scene to `info`: bounds and viewpoint, cost of an evaluation, training.
///
/// `info`: the caller sets `struct_size`; the other fields are written on success. Fields of a newer header that this
/// library does not know become zero. The texts point into the scene file's bytes.
///
/// # Safety
/// `scene` is NULL or an opened scene; the caller has not freed, moved or overwritten its memory or its file's bytes.
/// `info` is NULL or points to `struct_size` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_scene_describe(scene: *const Scene, info: *mut SceneInfo) -> Status {
    call(Message::NONE, || {
        // SAFETY: `scene` is valid, as this function's `# Safety` requires.
        let scene = unsafe { Scene::of(scene)? };
        // SAFETY: `info` is valid, as this function's `# Safety` requires.
        let out = unsafe { Out::new(info)? };
        out.write(describe(scene));
        Ok(())
    })
}

fn describe(scene: &Scene) -> SceneInfo {
    let renderer = scene.renderer();
    let (blob, architecture) = (renderer.blob(), renderer.blob().architecture());
    let (facts, occupancy, provenance) = (blob.scene(), blob.occupancy(), blob.provenance());
    let contraction = facts.and_then(|facts| facts.contraction());
    let (kernel, storage) = numbers_of(renderer.kernel());
    let nowhere = Viewpoint { eye: [0.0; 3], target: [0.0; 3], up: [0.0; 3], arc: 0.0 };
    let viewpoint = facts.and_then(|facts| facts.viewpoint).unwrap_or(nowhere);
    SceneInfo {
        struct_size: size_of::<SceneInfo>(),
        kind: if facts.is_some() { Kind::Scene } else { Kind::Picture } as u32,
        kernel,
        box_min: facts.map_or([0.0; 3], |facts| facts.min),
        box_max: facts.map_or([0.0; 3], |facts| facts.max),
        near_distance: facts.map_or(0.0, |facts| facts.near),
        far_distance: facts.map_or(0.0, |facts| facts.far),
        samples: facts.map_or(0, |facts| facts.samples().into()),
        background: facts.map_or([0.0; 3], |facts| facts.background),
        view_dependent: architecture.direction.is_some().into(),
        occupancy_required: facts.is_some_and(|facts| facts.occupancy_required).into(),
        occupancy_resolution: occupancy.map_or([0; 3], |occupancy| occupancy.resolution().map(u32::from)),
        occupied_share: occupancy.map_or(1.0, |occupancy| occupancy.occupied_share()),
        trunk_layers: architecture.trunk.len() as u32,
        trunk_widths: core::array::from_fn(|i| architecture.trunk.get(i).map_or(0, |l| l.width.into())),
        colour_layers: architecture.colour.len() as u32,
        colour_widths: core::array::from_fn(|i| architecture.colour.get(i).map_or(0, |&w| w.into())),
        psnr_db: provenance.psnr_db.unwrap_or(f32::NAN),
        quantisation_loss_db: provenance.quantisation_loss_db.unwrap_or(f32::NAN),
        steps: provenance.steps,
        parameters: architecture.parameters() as u64,
        density_macs: architecture.density_macs() as u64,
        colour_macs: architecture.colour_macs() as u64,
        seed: provenance.seed,
        data: Text::of(provenance.data),
        made_by: Text::of(provenance.made_by),
        psnr_convention: Text::of(provenance.psnr_convention),
        picture_width: blob.picture().map_or(0, |picture| picture.width),
        picture_height: blob.picture().map_or(0, |picture| picture.height),
        proposal_samples: blob.proposal().map_or(0, |it| it.samples.into()),
        front_points: blob.front().len() as u32,
        proposal_macs: blob.proposal().map_or(0, |it| it.architecture().density_macs() as u64),
        step: match facts {
            Some(facts) if !matches!(facts.sampling, SceneSampling::Bins(_)) => facts.step(),
            _ => 0.0,
        },
        table_storage: match blob.tables() {
            None => TableStorage::None,
            Some(StoredTables::F16(_)) => TableStorage::F16,
            Some(StoredTables::Int8 { .. }) => TableStorage::Int8,
            Some(StoredTables::Coded { .. }) => TableStorage::Coded,
        } as u32,
        contraction_radius: contraction.map_or(0.0, |contraction| contraction.radius()),
        contraction_power: contraction.map_or(0, |contraction| contraction.power().into()),
        storage,
        eye: viewpoint.eye,
        target: viewpoint.target,
        up: viewpoint.up,
        arc: viewpoint.arc,
    }
}

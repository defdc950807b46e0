#![no_std]
// Docs link to the module `host`, which is not compiled for targets without an operating system.
#![cfg_attr(target_os = "none", allow(rustdoc::broken_intra_doc_links))]
//! Rendering of radiance fields in fixed memory: the crate opens one small file and renders any view of the scene.
//!
//! Programs with an operating system open a `Scene` (feature `std`, module `host`), which owns its bytes and renders on
//! all cores. The rest of the crate needs neither `std` nor `alloc`, can read fp16 weights directly from the file's
//! bytes, and computes in f32 unless the caller chooses bf16 weights. The caller queries the size of a workspace and
//! supplies the memory. A [`Renderer`] is a scene prepared for one [`Kernel`]: an instruction set and a format of
//! weights. A [`Plan`] holds the settings of a frame. A [`Worker`] holds a renderer, a plan and memory for any number
//! of calls. In a microcontroller's build without debug assertions, neither opening a file nor rendering can panic: the
//! linker proves this for `examples/firmware`.
//!
//! # The pipeline
//!
//! The stages are, in order: camera, ray, samples, encoding, trunk, density, compositing weights, colour, pixel. The
//! colour branch is not evaluated for samples of low compositing weight. `docs/architecture.md` draws the pipeline.
//!
//! The modules follow the data flow, and each uses only modules before it in this list. [`memory`], `simd`, `math` and
//! `matrix` are the basis. [`camera`] makes rays, [`space`] bounds the scene, `sampling` places samples on rays,
//! [`encoding`] and [`network`] evaluate samples, [`volume`] composites them. [`blob`] is the file format, [`plan`]
//! decides which parts of a file a frame needs, [`render`] executes the plan, and [`host`] adds files and threads.
//!
//! # Conventions
//!
//! | what | convention |
//! | --- | --- |
//! | world | right-handed; the units are the scene's own |
//! | camera | looks down −Z, +Y up, +X right; a [`Pose`] is camera-to-world (Blender, OpenGL) |
//! | pixels | (0, 0) is top left and its centre is (0.5, 0.5); `fx fy cx cy` in pixels |
//! | [`camera::Ray::dir`] | unit length, so `t`, `near` and `far` are world units **along the ray** |
//! | `ray_distance` | weighted mean of the samples' `t`, world units along the ray |
//! | `z_depth` | `ray_distance` times the cosine between ray and view axis |
//! | `median_distance` | first `t` at which the transmittance is below one half, else the background distance |
//! | `normal` | weighted mean of −∇sigma/\|∇sigma\|, world space, scaled to unit length: points towards lower density |
//! | no surface | if `opacity <=` [`volume::OPACITY_EPSILON`], `ray_distance` and `z_depth` are the background distance, and the normal is 0 |
//! | `sigma` | density, `>= 0`, per world unit |
//! | `alpha` | `−expm1(−sigma delta)`: fraction of the light that one bin absorbs |
//! | `transmittance` | `exp(−Σ sigma delta)` over the bins in front; the sum is a compensated sum (Kahan) |
//! | `weights`, `opacity` | a weight is `transmittance · alpha`; the opacity is the sum of the weights, `<= 1` |
//! | samples | only on the part of a ray inside the scene box, for any camera position |
//! | samples, scene with a fixed step | at equal steps, from the point where the ray enters the box |
//! | samples, scene with n bins | one in each bin. Every bin has the width (far − near) / n, and one bin begins at near. The bins cover all of the ray that is inside the box, also before near and beyond far |
//! | samples, bins only from near to far | in a scene with n bins: with a proposal network, with [`Plan::with_own_bins`], or if the box would need more than 4096 bins |
//! | samples, unbounded scene | from near on, at steps that grow outside the inner ball ([`space::Contraction`]) |
//! | background distance | the same for all pixels of a camera ([`Plan::far_from`]): far or, if larger, the camera's distance from the farthest corner of the box. At most `t_max` of [`Plan::with_range`] |
//! | background distance, bins only from near to far | far |
//! | background distance, unbounded scene | far plus the camera's distance from the middle of the inner ball |
//! | last bin | of finite length; in a scene with a fixed step, the last bin ends where the ray leaves the box |
//! | colour | display-encoded (sRGB, as the training images were), `[0, 1]`, composited in that space |
//! | 2D field (network fitted to an image) | x right, y down, each from 0 to 1 over the image, for any aspect ratio; pixel (x, y) is ((x + ½) / width, (y + ½) / height) |
//! | sinusoidal encoding | the inputs themselves (optional); then, for each level `k`, `sin(2^k s x)` of every input, followed by `cos(2^k s x)` of every input; `s` is π or 1 |
//!
//! No distance is called just "depth", since the word has three meanings: distance along the ray, distance along the
//! view axis, median distance.
//!
//! # Features
//!
//! | feature | default | adds |
//! | --- | --- | --- |
//! | `libm` | yes | `MathBackend::Libm` |
//! | `micromath` | yes | `MathBackend::Micromath`: little code, low accuracy |
//! | `jitter` | yes | [`plan::Jitter`]: samples at random positions in their bins |
//! | `anti-aliasing` | yes | several rays per pixel |
//! | `depth-of-field` | yes | [`plan::ThinLens`]: an aperture of finite size |
//! | `tone-map` | yes | [`plan::Tone`]: exposure, tone curve, linear output |
//! | `lens` | yes | lens distortion ([`Lens`]) |
//! | `median` | yes | the output `median_distance` |
//! | `normals` | yes | the output `normals`, from the gradient of the density: a backward pass through the network |
//! | `proposal` | yes | samples drawn from a coarse proposal network, if the scene has one |
//! | `grid` | yes | learned multiresolution grids ([`encoding::GridEncoding`]), and spherical harmonics |
//! | `coded` | yes | entropy-coded tables of grids, decoded into memory when a scene is opened. Not for firmware, which reads uncoded int8 tables directly from the file's bytes |
//! | `contraction` | yes | unbounded scenes ([`space::Contraction`]) |
//! | `instances` | yes | several fields in one world ([`Worker::of_instances`]); also enables `median` and `normals` |
//! | `std` | yes | [`host`]: scenes that own their bytes; reading of files; rendering on several threads |
//! | `train` | no | for trainers and tests: makes the parts of a renderer public (`simd`, `math`, `matrix`, `sampling`, evaluation of networks and encodings), and adds backward kernels |
//!
//! The project's own polynomials ([`MathBackend::Polynomial`]) are always built in. An effect or output whose feature
//! is off has no code in the build. A request for this effect or output is an error that names the feature.
//!
//! # Example
//!
//! A uniform grey fog in the box `[-1, 1]³`, written, opened and rendered in 2×2 pixels:
//!
//! ```
//! use glam::Vec3;
//! use nerf_core::blob::{self, Body, Content, Provenance, SceneFacts, SceneSampling};
//! use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
//! use nerf_core::network::{Architecture, DensityActivation, TrunkLayer, Shading};
//! use nerf_core::{
//!     Batch, Blob, Camera, Intrinsics, Lens, Line, Outputs, Pixel, Plan, Pose, Quality, Rect, Renderer, Kernel,
//! };
//!
//! // The network: one trunk layer of 4, no view dependence. Parameters in file order are the trunk
//! // (4 × 3 + 4), the density head (4 + 1) and rgb (3 × 4 + 3), all zero but the density's bias:
//! // sigma is 1 and every colour sigmoid(0) = ½.
//! let position = SinusoidalEncoding { inputs: 3, levels: 0, scale: AngleScale::Pi, identity: true }.into();
//! let architecture = Architecture {
//!     position,
//!     direction: None,
//!     trunk: [TrunkLayer { width: 4, skip: false }].into_iter().collect(),
//!     density: Some(DensityActivation::Relu),
//!     colour: [].into_iter().collect(),
//!     shading: Shading::PerSample,
//! };
//! assert_eq!(architecture.parameters(), 36);
//! let mut weights = [0u8; 72];
//! weights[2 * 20..2 * 21].copy_from_slice(&0x3c00u16.to_le_bytes()); // 1 in f16
//!
//! // The file.
//! let body = Body {
//!     architecture,
//!     content: Content::Scene(SceneFacts {
//!         min: [-1.0; 3],
//!         max: [1.0; 3],
//!         near: 2.0,
//!         far: 6.0,
//!         sampling: SceneSampling::Bins(64),
//!         background: [1.0; 3],
//!         occupancy_required: false,
//!         viewpoint: None,
//!     }),
//!     occupancy: None,
//!     front: Default::default(),
//!     proposal: None,
//!     provenance: Provenance {
//!         data: "fog",
//!         made_by: "the crate's documentation",
//!         trained_parameters: 36,
//!         ..Provenance::NONE
//!     },
//!     weights: &weights,
//!     tables: None,
//! };
//! let mut file = [0; 256];
//! let bytes = blob::write(&body, &mut file)?;
//!
//! // Open and plan. Weights are read directly from the file's bytes: no memory is needed.
//! let blob = Blob::open(bytes)?;
//! let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut [])?;
//! let plan = Plan::new(&blob, &Quality::EXACT, Outputs::ALL, Batch::SMALLEST)?;
//!
//! // A camera four units up the Z axis, and workspace of the size that was asked for.
//! let pose = Pose::look_at(Vec3::new(0.0, 0.0, 4.0), Vec3::ZERO, Vec3::Y).ok_or("no pose")?;
//! let camera = Camera::new(Intrinsics::centred(2, 2, 8.0), Lens::NONE, pose)?;
//! let mut workspace = [Line::UNINIT; 64];
//! assert!(renderer.workspace_lines(&plan) <= workspace.len());
//!
//! let mut picture = [[0.0; 3]; 4];
//! let mut put = |x: u32, y: u32, pixel: &Pixel| picture[(2 * y + x) as usize] = pixel.rgb;
//! let counters = renderer.render(&plan, &camera, Rect::full(&camera), &mut workspace, &mut put)?;
//!
//! // Two units of fog of density 1 on white: ½ (1 − e⁻²) + e⁻², a little more for the slanted rays.
//! let fog = (-2.0f32).exp();
//! let expected = 0.5 * (1.0 - fog) + fog;
//! assert!(picture.iter().flatten().all(|c| (c - expected).abs() < 0.005));
//! assert_eq!(counters.rays, 4);
//! assert_eq!(counters.samples_kept + counters.samples_skipped, 4 * 64);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Where to read on
//!
//! `docs/conventions.md` (conventions with their reasons), `docs/architecture.md` (one frame step by step, memory),
//! `docs/blob-format.md` (the file, normative), `docs/numerics.md` (worst errors and their bounds, case by case),
//! `docs/journal/` (measurements and experiments), `docs/kernels.md` (measurements and experiments of the inner loops).

#[cfg(not(all(feature = "contraction", feature = "grid")))]
mod absent;
mod errors;
mod names;

pub mod memory;

#[cfg(feature = "train")]
pub mod simd;
#[cfg(not(feature = "train"))]
mod simd;

#[cfg(feature = "train")]
pub mod math;
#[cfg(not(feature = "train"))]
mod math;

#[cfg(feature = "train")]
pub mod matrix;
#[cfg(not(feature = "train"))]
mod matrix;

pub mod camera;

pub mod space;

#[cfg(feature = "train")]
pub mod sampling;
#[cfg(not(feature = "train"))]
mod sampling;

pub mod encoding;

pub mod network;

pub mod volume;

pub mod blob;

pub mod plan;

pub mod render;

#[cfg(all(feature = "std", not(target_os = "none")))]
pub mod host;

#[cfg(test)]
mod testing;

#[cfg(all(feature = "std", not(target_os = "none")))]
extern crate std;

pub use blob::Blob;
pub use camera::{Camera, Intrinsics, Lens, Pose};
#[cfg(all(feature = "std", not(target_os = "none")))]
pub use host::{Image, Scene};
pub use math::MathBackend;
pub use matrix::{Kernel, Storage};
pub use memory::Line;
pub use plan::{Batch, Choice, Effects, Outputs, Plan, Preset, Quality};
pub use render::{Counters, Rect, Renderer, Target, Worker};
pub use simd::Isa;
pub use volume::Pixel;

//! [`Scene`]: a scene that owns the bytes of its file.

use super::{HostError, Image, Request};
use crate::blob::{Blob, BlobError};
use crate::camera::Camera;
use crate::matrix::Kernel;
use crate::render::{CoarseOccupancy, Prepared, Renderer};
use std::boxed::Box;
use std::path::Path;
use std::vec;

/// A scene that owns the bytes of its file. The type has no lifetime parameter, so that a scene can be stored in
/// any struct and shared between threads.
///
/// ```no_run
/// use glam::Vec3;
/// use nerf_core::{Camera, Intrinsics, Lens, Pose, Scene};
///
/// let scene = Scene::open("lego.nerf")?;
/// let pose = Pose::look_at(Vec3::new(2.0, -3.0, 1.5), Vec3::ZERO, Vec3::Z).ok_or("no pose")?;
/// let camera = Camera::new(Intrinsics::centred(800, 600, 900.0), Lens::NONE, pose)?;
/// let image = scene.render(&camera)?;
/// std::fs::write("lego.ppm", [b"P6 800 600 255\n".as_slice(), &image.rgb8()].concat())?;
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Scene {
    /// Bytes of the scene's file, checked when the scene is opened, and not changed afterwards.
    bytes: Box<[u8]>,
    kernel: Kernel,
    prepared: Prepared<Box<[f32]>, Box<[u8]>>,
    occupied: CoarseOccupancy,
}

const _: () = {
    const fn shared<T: Send + Sync + 'static>() {}
    shared::<Scene>();
};

impl Scene {
    /// Reads a file and opens the scene for rendering with [`Kernel::detect`], this machine's fastest kernel that does
    /// not round weights.
    ///
    /// # Errors
    /// [`HostError::Read`] if the file cannot be read, [`HostError::Open`] if [`Scene::from_bytes`] fails.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, HostError> {
        let path = path.as_ref();
        let bytes = std::fs::read(path).map_err(|source| HostError::Read { path: path.into(), source })?;
        Self::from_bytes(bytes).map_err(|source| HostError::Open { path: path.into(), source })
    }

    /// Opens a scene from its file's bytes, for rendering with [`Kernel::detect`], this machine's fastest kernel that
    /// does not round weights.
    ///
    /// # Errors
    /// [`BlobError`] if the bytes are not a file that this build can open. The error says what was expected and found.
    pub fn from_bytes(bytes: impl Into<Box<[u8]>>) -> Result<Self, BlobError> {
        Self::for_kernel(bytes, Kernel::detect())
    }

    /// Opens a scene from its file's bytes, for rendering with `kernel`, or with [`Kernel::IN_PLACE`] if this machine
    /// or build does not support `kernel`.
    ///
    /// # Errors
    /// [`BlobError`] if the bytes are not a file that this build can open. The error says what was expected and found.
    pub fn for_kernel(bytes: impl Into<Box<[u8]>>, kernel: Kernel) -> Result<Self, BlobError> {
        let bytes = bytes.into();
        let kernel = if kernel.available() { kernel } else { Kernel::IN_PLACE };
        let blob = Blob::open_undecoded(&bytes)?;
        let Prepared { unpacked, decoded } = Prepared::measure(&blob, kernel);
        let unpacked = unpacked.map(|count| vec![0.0; count].into());
        let mut prepared = Prepared { unpacked, decoded: vec![0; decoded].into() };
        prepared.unpack(&blob, kernel)?;
        let occupied = CoarseOccupancy::new(blob.occupancy().as_ref());
        Ok(Self { occupied, kernel, prepared, bytes })
    }

    /// Returns the decoded content of the scene's file.
    pub fn blob(&self) -> Blob<'_> {
        // `for_kernel` has checked the same bytes.
        Blob::decode(&self.bytes).unwrap_or_else(|_| unreachable!("checked bytes decode"))
    }

    /// Returns a renderer that borrows this scene, for callers that manage memory and threads themselves.
    pub fn renderer(&self) -> Renderer<'_> {
        let Prepared { unpacked, decoded } = &self.prepared;
        let prepared =
            Prepared { unpacked: unpacked.each_ref().map(|values| &**values), decoded: &**decoded };
        Renderer::of_prepared(self.blob(), self.kernel, &prepared, self.occupied.clone())
            .unwrap_or_else(|| unreachable!("parameters fit the checked architecture"))
    }

    /// Renders an image with colour, opacity, ray_distance and z_depth at the default quality, on all cores.
    ///
    /// # Errors
    /// [`HostError::Plan`] if the file is a 2D field; [`HostError::Render`] if there is not enough memory.
    pub fn render(&self, camera: &Camera) -> Result<Image, HostError> {
        self.request().render(camera)
    }

    /// Returns a request to render this scene. Settings that the caller does not set are as in [`Scene::render`].
    pub fn request(&self) -> Request<'_> {
        Request::new(self)
    }
}

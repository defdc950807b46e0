//! The target of a render: planes in the caller's memory.

use crate::boundary::{by_width, check_zeros, read_versioned, versioned};
use crate::failure::Failure;
use crate::pixel::{Channel, FormatNumber, PixelFormat, put};
use crate::span::{Pieces, PlaneBytes, Span, check_aligned};
use crate::tile_pixels::TilePixels;
use crate::worker::State;
use core::ffi::c_void;
use nerf_core::render::{Limit, Rect};
use nerf_core::volume::Pixel;

/// A plane of a target: a buffer in the caller's memory with one value or vector per pixel. An output plane receives
/// one output. A plane of limits contains the distances at which rays end. The first pixel is the top left pixel of the
/// **rendered rectangle**, not of the image. For rays and points, a plane has one row.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Plane {
    /// Address of the top left pixel of the rendered rectangle; NULL leaves the plane out.
    pub data: *mut c_void,
    /// Bytes from a pixel to its right neighbour; 0 for the size of a pixel.
    pub pixel_stride: usize,
    /// Bytes from a pixel to the pixel below; negative if rows are stored bottom up; 0 for rows without a gap.
    pub row_stride: isize,
    /// Format of a pixel, a `nerf_format`: RGB or RGBA for `rgb`, VEC3_F32 for `normals`, F32 for every other plane.
    pub format: u32,
    /// Reserved; must be 0.
    pub reserved: u32,
}

/// The target of a render. `limit_ray_distance` and `limit_z_depth` are inputs; every other plane is an output.
///
/// An output plane with `data` NULL is not computed, and takes no memory. Planes may be interleaved as channels of one
/// structure: bytes between pixels are never touched. Output planes must not share a byte (`NERF_STATUS_OVERLAP`).
///
/// A pixel without a surface (opacity 1e-4 or less) gets the distance `far`, which is the smallest of three values. The
/// first is the pixel's limit along its ray. The second is `far_distance` of the options, ignored if 0. The third is an
/// upper bound, computed from the scene's extent, on the distance from the camera to any visible point.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Target {
    /// `sizeof(nerf_target)`.
    pub struct_size: usize,
    /// Colour, display-encoded, or linear light if `options.effects.linear` is 1; composited in the same encoding.
    pub rgb: Plane,
    /// Opacity, in `[0, 1]`.
    pub opacity: Plane,
    /// Mean of the samples' distances along the ray, weighted by the sample weights, world units. Pixels without a
    /// surface (opacity 1e-4 or less) get `far` (see `nerf_target`).
    pub ray_distance: Plane,
    /// Mean of the samples' distances along the view axis, weighted by the sample weights, world units. Pixels without
    /// a surface (opacity 1e-4 or less) get `far` (see `nerf_target`).
    pub z_depth: Plane,
    /// Median distance along the ray, at which transmittance falls below one half, world units. If transmittance stays
    /// above one half, the pixel gets `far` (see `nerf_target`). Needs a `transmittance_cut` of at most 0.5.
    pub median_distance: Plane,
    /// Normal of the surface: mean of -grad(density)/|grad(density)|, weighted by the sample weights; world space, unit
    /// length. 0 where opacity is 1e-4 or less, or where the directions cancel out. Normals take about as much work as
    /// two more samples per ray.
    pub normals: Plane,
    /// Input: distance along each pixel's ray at which the ray ends, world units, for example the distance to a surface
    /// that the host has traced. `data` is NULL for no limits. Infinity or NaN: no limit for this pixel. A limit cuts
    /// the sample interval that contains the limit, so edges are smooth. Samples behind a limit are not evaluated.
    pub limit_ray_distance: Plane,
    /// Input: limits as in `limit_ray_distance`, but measured along the view axis. Only one of the two planes may be
    /// set. A depth buffer's depth `d`, in normalised device coordinates, corresponds to the limit
    /// `p[14] / (d + p[10])`; `p` is the column-major perspective matrix of a camera that looks along -Z.
    pub limit_z_depth: Plane,
}

versioned!(unsafe Target, "target", by_width(164, 264));

/// A checked plane, whose pixels can be accessed without a further check.
#[derive(Clone, Copy)]
pub(crate) struct Surface {
    channel: Channel,
    format: PixelFormat,
    data: *mut u8,
    pixel_stride: usize,
    row_stride: isize,
}

/// Numbers of columns and rows of a plane; `(count, 1)` for rays and points.
type Extent = (usize, usize);

/// A checked target: its output planes, at most one plane of limits, and the position of its rectangle.
pub(crate) struct Canvas {
    surfaces: [Option<Surface>; 6],
    pub limit: Option<Surface>,
    /// Column and row of the rectangle's top left pixel in the image.
    origin: [u32; 2],
}

impl Canvas {
    /// Checks the planes of a target for the rectangle `rect` of an image.
    ///
    /// # Safety
    /// `at` is NULL or readable for `struct_size` bytes. The planes are NULL, or writable while the canvas is used.
    pub unsafe fn of_image(at: *const Target, rect: Rect, worker: &State) -> Result<Self, Failure> {
        let extent = (rect.width as usize, rect.height as usize);
        // SAFETY: the arguments are valid, as this function's `# Safety` requires.
        let mut canvas = unsafe { Self::of_target(at, extent, None, worker)? };
        canvas.origin = [rect.x, rect.y];
        Ok(canvas)
    }

    /// Returns an error if a plane other than colour is given: a 2D field has only colour.
    pub fn check_picture(&self) -> Result<(), Failure> {
        let planes = self.surfaces.iter().chain([&self.limit]).flatten();
        let other = planes.map(|surface| surface.channel).find(|channel| *channel != Channel::Colour);
        other.map_or(Ok(()), |channel| Err(Failure::ScenePlane(channel.name())))
    }

    /// Makes a canvas of the planes that receive the results of `count` points. Returns an error if a plane is invalid,
    /// or overlaps the other plane or an input array. `rgb.data` may be NULL. `read`: name in error messages and memory
    /// of each input array.
    ///
    /// # Safety
    /// The planes are NULL, or writable while the canvas is used.
    pub unsafe fn of_points(
        sigma: &Plane,
        rgb: &Plane,
        count: usize,
        read: &[(&'static str, Pieces)],
        worker: &State,
    ) -> Result<Self, Failure> {
        let mut canvas = Self { surfaces: [None; 6], limit: None, origin: [0; 2] };
        if sigma.data.is_null() && count > 0 {
            return Err(Failure::Null("points.sigma"));
        }
        let mut written = [Pieces::NONE; 2];
        for (k, (channel, plane)) in
            [(Channel::Density, sigma), (Channel::PointColour, rgb)].into_iter().enumerate()
        {
            if plane.is_given(channel)? {
                let (surface, pieces) = check(channel, plane, (count, 1), Some(read), worker)?;
                (canvas.surfaces[k], written[k]) = (Some(surface), pieces);
            }
        }
        written[0].check_apart("points.sigma", written[1], "points.rgb")?;
        Ok(canvas)
    }

    /// Checks all planes of a target of `extent` pixels. Returns an error if a plane is invalid or overlaps an output
    /// plane or an input array. `read`: name in messages and memory of each input array of rays; `None` for an image.
    ///
    /// # Safety
    /// As for [`Canvas::of_image`].
    pub unsafe fn of_target(
        at: *const Target,
        extent: Extent,
        read: Option<&[(&'static str, Pieces)]>,
        worker: &State,
    ) -> Result<Self, Failure> {
        // SAFETY: `at` is valid, as this function's `# Safety` requires.
        let target = unsafe { read_versioned(at)? };
        let planes = [
            (Channel::Colour, &target.rgb),
            (Channel::Opacity, &target.opacity),
            (Channel::RayDistance, &target.ray_distance),
            (Channel::ZDepth, &target.z_depth),
            (Channel::MedianDistance, &target.median_distance),
            (Channel::Normal, &target.normals),
            (Channel::LimitRayDistance, &target.limit_ray_distance),
            (Channel::LimitZDepth, &target.limit_z_depth),
        ];
        let mut canvas = Self { surfaces: [None; 6], limit: None, origin: [0; 2] };
        let mut written = [Span::EMPTY; 6];
        for (k, &(channel, plane)) in planes.iter().enumerate() {
            if !plane.is_given(channel)? {
                continue;
            }
            let (checked, Pieces { span, .. }) = check(channel, plane, extent, read, worker)?;
            match canvas.surfaces.get_mut(k) {
                Some(_) => {
                    for (other, of_other) in canvas.surfaces.iter().zip(&written).take(k) {
                        // Most planes lie apart as a whole.
                        if span.meets(*of_other)
                            && let Some(other) = other
                        {
                            let (bytes, of_other) = (checked.bytes(extent), other.bytes(extent));
                            bytes.check_apart(channel.name(), &of_other, other.channel.name())?;
                        }
                    }
                    (canvas.surfaces[k], written[k]) = (Some(checked), span);
                }
                None if canvas.limit.is_some() => return Err(Failure::TwoLimits),
                None => canvas.limit = Some(checked),
            }
        }
        // A target for 0 rays needs no plane.
        if canvas.surfaces.iter().all(Option::is_none) && extent.0 > 0 {
            return Err(Failure::NoPlane);
        }
        Ok(canvas)
    }

    /// Makes `worker` composite over the background, or over black for RGBA; an error if the options do not suit RGBA.
    pub fn set_up(&self, worker: &mut State) -> Result<(), Failure> {
        let alpha = self.surfaces.iter().flatten().any(|surface| surface.format.has_alpha());
        if alpha {
            worker.settings.check_tone_of_alpha()?;
        }
        worker.fields()?.show_background(!alpha);
        Ok(())
    }

    pub fn has(&self, channel: Channel) -> bool {
        self.surfaces.iter().flatten().any(|surface| surface.channel == channel)
    }

    /// Copies a finished tile, which must lie in the rectangle, into the planes.
    pub fn write(&mut self, tile: Rect, pixels: &TilePixels<'_>) {
        let [left, top] = self.origin;
        for surface in self.surfaces.iter().flatten() {
            for row in 0..tile.height {
                for column in 0..tile.width {
                    let pixel = pixels.get((row * tile.width + column) as usize);
                    let (x, y) = (tile.x - left + column, tile.y - top + row);
                    // SAFETY: the tile lies in the rectangle given to `check`; `of_image` requires writable memory.
                    unsafe {
                        put(surface.at(x as usize, y as usize), surface.format, surface.channel, &pixel)
                    };
                }
            }
        }
    }

    /// Writes the result of ray or point `i` to every output plane of a target with one row.
    #[inline]
    pub fn put(&mut self, i: usize, pixel: &Pixel) {
        for surface in self.surfaces.iter().flatten() {
            // SAFETY: `i` is below the count given to `check`; `of_target` and `of_points` require writable memory.
            unsafe { put(surface.at(i, 0), surface.format, surface.channel, pixel) };
        }
    }
}

impl Plane {
    /// Returns whether the plane is given: whether `data` is not NULL. Returns an error if `reserved` is not 0.
    fn is_given(&self, channel: Channel) -> Result<bool, Failure> {
        check_zeros(channel.name(), &[self.reserved])?;
        Ok(!self.data.is_null())
    }
}

impl Surface {
    /// Reads from this plane the distance at which the ray of pixel (`x`, `y`) ends. The pixel is counted from the top
    /// left pixel of the rendered rectangle. The plane must be `limit_ray_distance` or `limit_z_depth`.
    #[inline]
    pub fn limit(&self, x: u32, y: u32) -> Limit {
        // SAFETY: the pixel lies in the rectangle that `check` was given; `of_image` requires readable memory.
        let t = unsafe { self.at(x as usize, y as usize).cast::<f32>().read() };
        if self.channel == Channel::LimitZDepth { Limit::ZDepth(t) } else { Limit::RayDistance(t) }
    }

    fn bytes(&self, extent: Extent) -> PlaneBytes {
        PlaneBytes::new(self.data as usize, extent, (self.pixel_stride, self.row_stride), self.format.size())
    }

    /// Returns the address of the pixel in column `x` and row `y`.
    /// # Safety
    /// The pixel lies in the extent that was checked.
    #[inline]
    unsafe fn at(&self, x: usize, y: usize) -> *mut u8 {
        // SAFETY: `check` verified that the plane's span holds every pixel of the extent.
        unsafe { self.data.offset(y as isize * self.row_stride).add(x * self.pixel_stride) }
    }
}

/// Checks a plane whose `data` is not NULL. Returns an error if the plane was not requested from the worker, or if
/// format, strides or alignment do not suit the channel. Returns an error if the plane overlaps a scene, the worker or
/// an input array. `read`: name and memory of each input array of rays or points; `None` for an image.
fn check(
    channel: Channel,
    plane: &Plane,
    extent: Extent,
    read: Option<&[(&'static str, Pieces)]>,
    worker: &State,
) -> Result<(Surface, Pieces), Failure> {
    let name = channel.name();
    if read.is_some() && matches!(channel, Channel::LimitRayDistance | Channel::LimitZDepth) {
        return Err(Failure::LimitOfRays(name));
    }
    if !channel.is_in(worker.outputs) {
        return Err(Failure::NotRequested(name));
    }
    let (expected, found) = (channel.formats(), FormatNumber(plane.format));
    let format = channel.format(plane.format).ok_or(Failure::Format { name, expected, found })?;
    let overflow = Failure::Overflow(name);
    let (columns, rows) = (extent.0.saturating_sub(1), extent.1.saturating_sub(1));
    let pixel_stride = if plane.pixel_stride == 0 { format.size() } else { plane.pixel_stride };
    if pixel_stride < format.size() {
        return Err(Failure::Stride { name, expected: format.size(), found: pixel_stride });
    }
    let row = columns.checked_mul(pixel_stride).and_then(|gap| gap.checked_add(format.size()));
    let row = row.ok_or(overflow)?;
    let tight = pixel_stride.checked_mul(columns + 1).and_then(|bytes| isize::try_from(bytes).ok());
    // The row stride of a plane with a single row is ignored.
    let own = if rows == 0 { 0 } else { plane.row_stride };
    let row_stride = if own == 0 { tight.ok_or(overflow)? } else { own };
    if row_stride.unsigned_abs() < row {
        return Err(Failure::Stride { name, expected: row, found: row_stride.unsigned_abs() });
    }
    for value in [plane.data as usize, pixel_stride, row_stride.unsigned_abs()] {
        check_aligned(name, value, format.align())?;
    }
    let down = rows.checked_mul(row_stride.unsigned_abs()).ok_or(overflow)?;
    let empty = extent.0 == 0 || extent.1 == 0;
    let length = if empty { 0 } else { down.checked_add(row).ok_or(overflow)? };
    let below = if row_stride < 0 { down } else { 0 };
    let first = (plane.data as usize).checked_sub(below).ok_or(overflow)?;
    let span = Span::new(name, first as *const c_void, length)?;
    worker.check_apart(name, span)?;
    let data = plane.data.cast::<u8>();
    let pieces = Pieces { span, stride: pixel_stride, size: format.size() };
    for (other, memory) in read.unwrap_or_default() {
        pieces.check_apart(name, *memory, other)?;
    }
    Ok((Surface { channel, format, data, pixel_stride, row_stride }, pieces))
}

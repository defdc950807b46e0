//! Where a picture goes.

use crate::boundary::{Versioned, read_versioned};
use crate::failure::Failure;
use crate::pixel::{Channel, PixelFormat, put};
use crate::scene::Scene;
use crate::span::{Span, check_aligned};
use crate::tile_pixels::TilePixels;
use core::ffi::c_void;
use nerf_core::plan::Outputs;
use nerf_core::render::Rect;

/// One plane of a picture, in the caller's memory; it begins with the **rectangle's** top left pixel.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Plane {
    /// The rectangle's top left pixel; NULL if the plane is not wanted, which then costs nothing.
    pub data: *mut c_void,
    /// From a pixel to its right neighbour, bytes; 0 for the size of a pixel.
    pub pixel_stride: usize,
    /// From a pixel to the one below, bytes; negative where rows go up; 0 for rows without a gap.
    pub row_stride: isize,
    /// A `nerf_format`: RGB or RGBA for `rgb`, VEC3_F32 for `normals`, F32 for the others.
    pub format: u32,
    /// Zero.
    pub reserved: u32,
}

/// Where a picture goes: what is NULL is not computed, and takes no workspace.
///
/// Planes may share memory as channels of one structure; what lies between their pixels is never
/// touched.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Target {
    /// `sizeof(nerf_target)`.
    pub struct_size: usize,
    /// Colour, composited display-encoded unless `options.effects.linear` is 1.
    pub rgb: Plane,
    /// Opacity, in `[0, 1]`.
    pub opacity: Plane,
    /// Mean distance along the ray, world units; `far` where opacity is 1e-4 or less.
    pub ray_distance: Plane,
    /// Mean distance along the view axis, world units; `far` where opacity is 1e-4 or less.
    pub z_depth: Plane,
    /// First distance along the ray at which less than half of the light is left, world units; `far` where
    /// there is none. Needs a `transmittance_cut` of at most 0.5.
    pub median_distance: Plane,
    /// Where the surface faces, the mean of -grad(density)/|grad(density)| along the ray: world space, unit
    /// length, or 0 where opacity is 1e-4 or less or directions cancel. Costs about as much as two more
    /// samples a ray.
    pub normals: Plane,
}

// SAFETY: `repr(C)`, `struct_size` comes first, and numbers and pointers have no invalid bytes.
unsafe impl Versioned for Target {
    const NAME: &'static str = "target";
    const SIZE_V1: usize = core::mem::offset_of!(Self, median_distance);
}

/// A plane that can be written to without a further check.
#[derive(Clone, Copy)]
struct Surface {
    channel: Channel,
    format: PixelFormat,
    data: *mut u8,
    pixel_stride: usize,
    row_stride: isize,
}

/// A checked target for the pixels of one rectangle.
pub(crate) struct Canvas {
    rect: Rect,
    surfaces: [Option<Surface>; 6],
}

impl Canvas {
    /// Checks every plane against the rectangle, the scene and the workspace.
    ///
    /// # Safety
    /// `at` is NULL or points to `struct_size` readable bytes; its planes are NULL or span memory
    /// that is writable while the canvas is used.
    pub unsafe fn new(
        at: *const Target,
        rect: Rect,
        scene: &Scene,
        workspace: Span,
    ) -> Result<Self, Failure> {
        // SAFETY: `at` is as this function's `# Safety` has it.
        let target = unsafe { read_versioned(at)? };
        let planes = [
            (Channel::Colour, target.rgb),
            (Channel::Opacity, target.opacity),
            (Channel::RayDistance, target.ray_distance),
            (Channel::ZDepth, target.z_depth),
            (Channel::MedianDistance, target.median_distance),
            (Channel::Normal, target.normals),
        ];
        let mut surfaces = [None; 6];
        for ((channel, plane), surface) in planes.into_iter().zip(&mut surfaces) {
            let name = channel.name();
            if plane.reserved != 0 {
                return Err(Failure::Reserved(name));
            }
            if !plane.data.is_null() {
                let (checked, span) = check(name, channel, &plane, rect)?;
                scene.check_apart(name, span)?;
                span.check_apart(name, workspace, "the workspace")?;
                *surface = Some(checked);
            }
        }
        if surfaces.iter().all(Option::is_none) { Err(Failure::NoPlane) } else { Ok(Self { rect, surfaces }) }
    }

    /// What the planes ask for.
    pub fn outputs(&self) -> Outputs {
        let [rgb, opacity, ray_distance, z_depth, median_distance, normals] =
            self.surfaces.map(|surface| surface.is_some());
        Outputs { rgb, opacity, ray_distance, z_depth, median_distance, normals }
    }

    /// An error where a plane is wanted that only a scene has.
    pub fn check_colour_only(&self) -> Result<(), Failure> {
        let other = self.surfaces.iter().flatten().find(|surface| surface.channel != Channel::Colour);
        other.map_or(Ok(()), |surface| Err(Failure::ScenePlane(surface.channel.name())))
    }

    /// Whether the colour's background is the caller's business.
    pub fn has_alpha(&self) -> bool {
        self.surfaces.iter().flatten().any(|surface| surface.format.has_alpha())
    }

    /// Writes a finished tile, row by row; it lies in the rectangle.
    pub fn write(&mut self, tile: Rect, pixels: &TilePixels<'_>) {
        for surface in self.surfaces.iter().flatten() {
            for row in 0..tile.height {
                for column in 0..tile.width {
                    let (x, y) = (tile.x - self.rect.x + column, tile.y - self.rect.y + row);
                    let pixel = &pixels.get((row * tile.width + column) as usize);
                    // SAFETY: `check` found that the plane's span holds every pixel of the rectangle
                    // at its alignment; it is writable by the promise of `new`.
                    unsafe {
                        let row = surface.data.offset(y as isize * surface.row_stride);
                        let to = row.add(x as usize * surface.pixel_stride);
                        put(to, surface.format, surface.channel, pixel);
                    }
                }
            }
        }
    }
}

/// Format, strides, alignment and extent of a plane.
fn check(
    name: &'static str,
    channel: Channel,
    plane: &Plane,
    rect: Rect,
) -> Result<(Surface, Span), Failure> {
    let format = channel.format(plane.format).ok_or(Failure::Format { name, found: plane.format })?;
    let overflow = Failure::Overflow(name);
    let (columns, rows) = (rect.width.saturating_sub(1) as usize, rect.height.saturating_sub(1) as usize);
    let pixel_stride = if plane.pixel_stride == 0 { format.size() } else { plane.pixel_stride };
    if pixel_stride < format.size() {
        return Err(Failure::Stride { name, expected: format.size(), found: pixel_stride });
    }
    let row = columns.checked_mul(pixel_stride).and_then(|gap| gap.checked_add(format.size()));
    let row = row.ok_or(overflow)?;
    let tight = pixel_stride.checked_mul(columns + 1).and_then(|bytes| isize::try_from(bytes).ok());
    let row_stride = if plane.row_stride == 0 { tight.ok_or(overflow)? } else { plane.row_stride };
    if row_stride.unsigned_abs() < row {
        return Err(Failure::Stride { name, expected: row, found: row_stride.unsigned_abs() });
    }
    for value in [plane.data as usize, pixel_stride, row_stride.unsigned_abs()] {
        check_aligned(name, value, format.align())?;
    }
    let down = rows.checked_mul(row_stride.unsigned_abs()).ok_or(overflow)?;
    let length =
        if rect.width == 0 || rect.height == 0 { 0 } else { down.checked_add(row).ok_or(overflow)? };
    let below = if row_stride < 0 { down } else { 0 };
    let first = (plane.data as usize).checked_sub(below).ok_or(overflow)?;
    let span = Span::new(name, first as *const c_void, length)?;
    let data = plane.data.cast::<u8>();
    Ok((Surface { channel, format, data, pixel_stride, row_stride }, span))
}

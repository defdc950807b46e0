//! Instances: scenes that the host has placed in its world.

#[cfg(feature = "instances")]
use crate::boundary::read_versioned;
use crate::boundary::{by_width, versioned};
#[cfg(feature = "instances")]
use crate::failure::{Failure, reasons};
use crate::scene::Scene;
#[cfg(feature = "instances")]
use crate::span::check_aligned;
#[cfg(feature = "instances")]
use nerf_core::plan::PlanError;
#[cfg(feature = "instances")]
use nerf_core::space::Placement;

/// A scene that a transform places in the host's world.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Instance {
    /// `sizeof(nerf_instance)`. All instances of an array must have the same `struct_size`: the array's stride, bytes.
    pub struct_size: usize,
    /// Scene that the transform places in the world.
    pub scene: *const Scene,
    /// Transform from the scene's coordinates to the world's: the upper three rows of the 4x4 matrix, row-major. The
    /// transform is a rotation, a uniform scale and a translation; all zeros for the identity. With a column-major
    /// matrix `m`, as in OpenGL and glTF, `to_world[4 * row + column]` is `m[4 * column + row]`.
    pub to_world: [f32; 12],
}

versioned!(unsafe Instance, "instances", by_width(56, 64));

#[cfg(feature = "instances")]
reasons! {
    /// Reason why an instance is refused, other than a bad `to_world`. Messages put `instances[i]` before the reason.
    Problem:
    StructSize { expected: usize, found: usize } => StructSize,
        ".struct_size: expected {expected} (to 4096 with a tail of zeros), found {found}";
    // `struct_size` differs from the first instance's, which is the stride of the array.
    OtherSize { expected: usize, found: usize } => StructSize,
        ".struct_size: expected {expected}, as of the first, found {found}";
    Reserved => Reserved, ": expected zeros in unknown fields";
    NullScene => NullPointer, ".scene: expected an address, found NULL";
    SceneAlignment { expected: usize, found: usize } => Alignment,
        ".scene: expected a multiple of {expected}, found {found:#x}";
    Plan(error: PlanError) => Failure::Plan(*error).status(), ".scene: {error}";
}

#[cfg(feature = "instances")]
impl Instance {
    /// Returns a copy of the instance at `index` of the array that begins at `first`.
    ///
    /// # Safety
    /// `first` is NULL or points to more than `index` instances, each as long as the first one's `struct_size`.
    pub(crate) unsafe fn read(first: *const Self, index: usize) -> Result<Self, Failure> {
        // SAFETY: `first` is valid, as this function's `# Safety` requires.
        let found = unsafe { read_versioned(first) }.map_err(|failure| failure.of_instance(0))?;
        if index == 0 {
            return Ok(found);
        }
        let expected = found.struct_size;
        let step = index.checked_mul(expected).ok_or(Failure::Overflow("instances"))?;
        // SAFETY: the array has more than `index` instances, as this function's `# Safety` requires.
        let at = unsafe { first.byte_add(step) };
        check_aligned("instances", at as usize, align_of::<Self>())?;
        // SAFETY: `at` lies in the array and is aligned (checked above); `struct_size` is the first field.
        let found = unsafe { at.cast::<usize>().read() };
        // If `found` is larger than `expected`, reading `found` bytes could go past the end of the array.
        if found != expected {
            return Err(Failure::Instance { index, problem: Problem::OtherSize { expected, found } });
        }
        // SAFETY: the instance lies in the array, and is as long as the first.
        unsafe { read_versioned(at) }.map_err(|failure| failure.of_instance(index))
    }

    pub(crate) fn placement(&self, index: usize) -> Result<Placement, Failure> {
        if self.to_world == [0.0; 12] {
            return Ok(Placement::IDENTITY);
        }
        let row = |r: usize| core::array::from_fn(|c| self.to_world[4 * r + c]);
        Placement::from_rows([row(0), row(1), row(2)]).map_err(|error| Failure::Placement { index, error })
    }
}

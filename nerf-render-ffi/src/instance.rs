//! Fields that a host has placed in a world of its own.

use crate::boundary::Versioned;
#[cfg(feature = "instances")]
use crate::boundary::read_versioned;
#[cfg(feature = "instances")]
use crate::failure::Failure;
use crate::scene::Scene;
#[cfg(feature = "instances")]
use nerf_core::camera::Placement;

/// A scene that stands somewhere in the host's world.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Instance {
    /// `sizeof(nerf_instance)`: also from one of an array to the next.
    pub struct_size: usize,
    /// The scene.
    pub scene: *const Scene,
    /// Takes the scene's coordinates to the world's: the upper three rows of the 4x4 matrix, row-major, a rotation times
    /// one scale and a translation. All zeros is the identity.
    pub to_world: [f32; 12],
}

// SAFETY: `repr(C)`, `struct_size` comes first, and numbers and pointers have no invalid bytes.
unsafe impl Versioned for Instance {
    const NAME: &'static str = "instances";
}

#[cfg(feature = "instances")]
impl Instance {
    /// The `index`-th of an array, checked.
    ///
    /// # Safety
    /// `first` is NULL or points to more than `index` instances, each of as many bytes as the first says.
    pub(crate) unsafe fn read(first: *const Self, index: usize) -> Result<Self, Failure> {
        // SAFETY: `first` is as this function's `# Safety` has it.
        let mut found = unsafe { read_versioned(first)? };
        if index > 0 {
            let step = index.checked_mul(found.struct_size).ok_or(Failure::Overflow("instances"))?;
            // SAFETY: inside of the array by this function's `# Safety`.
            found = unsafe { read_versioned(first.byte_add(step))? };
        }
        Ok(found)
    }

    pub(crate) fn placement(&self, index: usize) -> Result<Placement, Failure> {
        if self.to_world == [0.0; 12] {
            return Ok(Placement::IDENTITY);
        }
        let row = |r: usize| core::array::from_fn(|c| self.to_world[4 * r + c]);
        Placement::from_rows([row(0), row(1), row(2)]).map_err(|error| Failure::Placement { index, error })
    }
}

//! Options for opening a scene.

use crate::boundary::{by_width, check_zeros, named, number_of, read_or_zeros, versioned};
use crate::failure::Failure;
use nerf_core::Isa;

/// Instruction set of the inner loops.
///
/// With the same kernel and storage, a pixel is bit-identical in every rectangle and on every thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Kernel {
    /// The fastest instruction set of this machine. In a library with the feature `std`, the environment variable
    /// `NERF_KERNEL` can name another: "portable", "avx2", "avx512", "simd128" or "neon". With `NERF_STORAGE_AUTO`, the
    /// variable also selects the storage of the weights: f16 or bf16 if "-f16" or "-bf16" follows the name, else f32.
    Auto = 0,
    /// Portable f32 code without fused multiply-adds; available on every machine.
    Portable = 1,
    /// x86-64 with AVX2, FMA and F16C.
    Avx2 = 2,
    /// x86-64 with AVX-512 F.
    Avx512 = 3,
    /// WebAssembly SIMD: faster than portable code, with bit-identical results. Only in a library built with the target
    /// feature `simd128`.
    Simd128 = 4,
    /// NEON: available on every 64-bit ARM processor.
    Neon = 5,
}

/// Instruction set in `nerf-core` for each [`Kernel`] number; `None` for [`Kernel::Auto`]: the library chooses.
const ISAS: [Option<Isa>; 6] =
    [None, Some(Isa::Portable), Some(Isa::Avx2), Some(Isa::Avx512), Some(Isa::Simd128), Some(Isa::Neon)];

/// Number format of a scene's weights in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Storage {
    /// f32, or f16 in a library built without vector instructions, such as for microcontrollers.
    Auto = 0,
    /// f16, read directly from the scene file's bytes: the weights take no memory besides these bytes.
    F16 = 1,
    /// f32, converted from f16 without rounding when the scene is opened: faster than f16. The tables of a learned grid
    /// are not converted, except that the WebAssembly kernel converts f16 tables to f32.
    F32 = 2,
    /// bf16, for weights and activations: rounded to 8 significant bits. Only with AVX-512 BF16.
    Bf16 = 3,
}

/// Storage in `nerf-core` for each [`Storage`] number; `None` for [`Storage::Auto`]: the library chooses.
const STORAGES: [Option<nerf_core::Storage>; 4] =
    [None, Some(nerf_core::Storage::F16), Some(nerf_core::Storage::F32), Some(nerf_core::Storage::Bf16)];

/// Returns a kernel's instruction set as a `nerf_kernel` number, and its storage as a `nerf_storage` number.
pub(crate) fn numbers_of(kernel: nerf_core::Kernel) -> (u32, u32) {
    (number_of(&ISAS, kernel.isa), number_of(&STORAGES, kernel.storage))
}

/// Options for opening a scene. A NULL pointer to options means options of all zeros.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct OpenOptions {
    /// `sizeof(nerf_open_options)`.
    pub struct_size: usize,
    /// Instruction set of the inner loops: a `nerf_kernel`.
    pub kernel: u32,
    /// Storage of the weights: a `nerf_storage`.
    pub storage: u32,
    /// Reserved; must be zeros.
    pub reserved: [u32; 6],
}

versioned!(unsafe OpenOptions, "options", by_width(36, 40));

/// Returns the instruction set and storage that the options select; an error for an invalid or unsupported choice.
///
/// # Safety
/// `options` is NULL or points to `struct_size` readable bytes.
pub(crate) unsafe fn read_kernel(options: *const OpenOptions) -> Result<nerf_core::Kernel, Failure> {
    // SAFETY: `options` is valid, as this function's `# Safety` requires.
    let options = unsafe { read_or_zeros(options)? };
    check_zeros("options.reserved", &options.reserved)?;
    let isa = match options.kernel {
        0 => None,
        found => Some(named(&ISAS, "options.kernel", "a nerf_kernel", found)?),
    };
    let storage = match options.storage {
        0 => None,
        found => Some(named(&STORAGES, "options.storage", "a nerf_storage", found)?),
    };
    // The environment variable `NERF_KERNEL` is read only if the caller names no instruction set.
    let open = if isa.is_some() { nerf_core::Kernel::detect() } else { automatic()? };
    available(nerf_core::Kernel::new(isa.unwrap_or(open.isa), storage.unwrap_or(open.storage)))
}

fn available(kernel: nerf_core::Kernel) -> Result<nerf_core::Kernel, Failure> {
    if kernel.available() { Ok(kernel) } else { Err(Failure::Kernel(kernel)) }
}

fn automatic() -> Result<nerf_core::Kernel, Failure> {
    #[cfg(feature = "std")]
    if let Some(name) = std::env::var_os("NERF_KERNEL").filter(|name| !name.is_empty()) {
        let kernel = name.to_str().and_then(nerf_core::Kernel::by_name);
        return available(kernel.ok_or(Failure::KernelVariable)?);
    }
    Ok(nerf_core::Kernel::detect())
}

//! The kernel that a scene is rendered with: an instruction set and a memory format of weights.

use crate::names::names;
use crate::simd::{Isa, VECTORS};
use core::fmt;

names! {
    /// Format of a scene's weights in memory while the scene is rendered.
    #[derive(PartialOrd, Ord)]
    #[non_exhaustive]
    pub enum Storage {
        /// f16, read directly from the scene file's bytes. Needs no memory for weights.
        F16 = "f16",
        /// f32, unpacked once from the scene file's f16: products are faster than with `F16`, and have the same values.
        F32 = "f32",
        /// bf16, stored in pairs: weights and activations are rounded to 8 significant bits, and products are summed in
        /// f32. [`Kernel::detect`] never chooses this storage.
        Bf16 = "bf16",
    }
}

impl Storage {
    /// Whether weights are read directly from the scene file's bytes. True for `F16`, and for every storage on targets
    /// without vector instructions ([`VECTORS`]), where only `F16` is available.
    pub(crate) const fn in_place(self) -> bool {
        matches!(self, Self::F16) || !VECTORS
    }
}

/// The instruction set and the storage of weights that a scene is rendered with. Displayed and parsed as a name, for
/// example `avx2` (AVX2, f32 weights) or `avx2-f16` (AVX2, f16 weights).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Kernel {
    /// Instruction set of the inner loops.
    pub isa: Isa,
    /// Format of the weights in memory.
    pub storage: Storage,
}

impl Kernel {
    /// The kernel that every machine supports, and the reference for all others: portable instructions, and f16 weights
    /// read directly from the scene file's bytes.
    pub const IN_PLACE: Self = Self::new(Isa::Portable, Storage::F16);

    /// Makes a kernel. Does not check whether the kernel is [available](Kernel::available).
    pub const fn new(isa: Isa, storage: Storage) -> Self {
        Self { isa, storage }
    }

    /// Returns the fastest kernel of this machine that does not round weights: f32, or f16 without vector instructions.
    pub fn detect() -> Self {
        Self::new(Isa::detect(), if VECTORS { Storage::F32 } else { Storage::F16 })
    }

    /// Returns an iterator over the kernels that this build and this machine support, slowest instruction set first.
    pub fn all() -> impl Iterator<Item = Self> + Clone {
        let pairs = |isa| Storage::ALL.into_iter().map(move |storage| Self::new(isa, storage));
        Isa::ALL.into_iter().flat_map(pairs).filter(|kernel| kernel.available())
    }

    /// Whether this build and this machine support the kernel.
    pub fn available(self) -> bool {
        self.isa.available()
            && match self.storage {
                Storage::F16 => true,
                Storage::F32 => VECTORS,
                Storage::Bf16 => self.isa.multiplies_bf16(),
            }
    }

    /// Whether products round weights and activations to bf16, which has fewer significant bits than the file's f16.
    pub const fn rounds(self) -> bool {
        matches!(self.storage, Storage::Bf16)
    }

    /// Parses a kernel's displayed name, such as `avx2` or `avx2-f16`; `None` if the name is unknown.
    pub fn by_name(name: &str) -> Option<Self> {
        let (isa, storage) = name.split_once('-').unwrap_or((name, Storage::F32.name()));
        let isa = Isa::ALL.into_iter().find(|it| it.name() == isa)?;
        let storage = Storage::ALL.into_iter().find(|it| it.name() == storage)?;
        Some(Self::new(isa, storage))
    }
}

impl fmt::Display for Kernel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.isa.name())?;
        match self.storage {
            Storage::F32 => Ok(()),
            storage => write!(f, "-{}", storage.name()),
        }
    }
}

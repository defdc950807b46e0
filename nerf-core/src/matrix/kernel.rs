//! The storage of weights, and the instructions that multiply them.

use crate::names::names;
use crate::simd::{Isa, VECTORS};
use core::fmt;

names! {
    /// The storage of a scene's weights while it is rendered.
    #[derive(PartialOrd, Ord)]
    #[non_exhaustive]
    pub enum Storage {
        /// f16 as in the file, read in place: no memory of their own.
        F16 = "f16",
        /// Unpacked to f32 once: the same products, faster.
        F32 = "f32",
        /// Pairs of bf16, as are the activations: each rounded to 8 significant bits and summed in f32. Only by name:
        /// [`Kernel::detect`] never chooses what rounds.
        Bf16 = "bf16",
    }
}

impl Storage {
    /// Whether products round weights and activations to fewer bits than the file and f32 have.
    pub const fn rounds(self) -> bool {
        matches!(self, Self::Bf16)
    }

    /// Whether weights are read where they lie in the blob: as f16, or since this target has no [`VECTORS`].
    pub(crate) const fn in_place(self) -> bool {
        matches!(self, Self::F16) || !VECTORS
    }
}

/// The instructions and the storage that a scene is rendered with. Shown and parsed as `avx2` where weights are f32, else as
/// `avx2-f16`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Kernel {
    /// Instruction set.
    pub isa: Isa,
    /// Storage of the weights.
    pub storage: Storage,
}

impl Kernel {
    /// The kernel of every machine: portable instructions, weights read in place. The oracle.
    pub const IN_PLACE: Self = Self::new(Isa::Portable, Storage::F16);

    /// The pair.
    pub const fn new(isa: Isa, storage: Storage) -> Self {
        Self { isa, storage }
    }

    /// The fastest of this machine that does not round: f32, or in place where there are no vectors.
    pub fn detect() -> Self {
        Self::new(Isa::detect(), if VECTORS { Storage::F32 } else { Storage::F16 })
    }

    /// Every pair that this build and this machine have, slowest instructions first.
    pub fn all() -> impl Iterator<Item = Self> + Clone {
        let pairs = |isa| Storage::ALL.into_iter().map(move |storage| Self::new(isa, storage));
        Isa::ALL.into_iter().flat_map(pairs).filter(|kernel| kernel.available())
    }

    /// Whether this build and this machine have it.
    pub fn available(self) -> bool {
        self.isa.available()
            && match self.storage {
                Storage::F16 => true,
                Storage::F32 => VECTORS,
                Storage::Bf16 => self.isa.multiplies_bf16(),
            }
    }

    /// Whether products round: [`Storage::rounds`].
    pub const fn rounds(self) -> bool {
        self.storage.rounds()
    }

    /// The kernel that is shown as `name`.
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

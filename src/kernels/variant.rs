//! Which variant of a kernel runs, chosen once for a target and kept in the plan.

use super::contract::{Contract, Specialisation};
use super::{Storage, TexelRange};

/// What kernels are chosen by, beside their arguments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct KernelTarget {
    /// Kernels shaped for CPU drivers, on which loads cost more than arithmetic.
    pub cpu: bool,
    /// The frame's planes are images instead of buffers.
    pub images: bool,
    /// The output's samples are halves.
    pub output_half: bool,
}

/// Tiles of a workgroup that stages its inputs as floats, as `glsl/shared/staged_products.glsl` has them.
const STAGED_TILES: u32 = 2;
/// Bytes between the places where a texel buffer may begin.
const TEXEL_ALIGNMENT: u64 = 16;

impl KernelTarget {
    /// Whether a kernel that reads these texels is the one for CPU drivers: texels of halves begin, as all, at
    /// multiples of 16 bytes, or are read by address.
    pub(super) fn cpu_with(self, texels: &[TexelRange]) -> bool {
        self.cpu && texels.iter().all(|range| range.offset.is_multiple_of(TEXEL_ALIGNMENT))
    }
}

/// A variant of a kernel, and how its work is cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    /// The compiled variant, with what it needs of a device.
    pub contract: &'static Contract,
    /// What its pipeline is specialised for.
    pub special: Specialisation,
    /// Tiles of the map that a workgroup works on.
    pub tiles_a_group: u32,
}

impl Variant {
    /// One that is specialised for nothing, with a tile for each workgroup.
    pub(super) fn plain(contract: &'static Contract) -> Self {
        Self { contract, special: Specialisation::default(), tiles_a_group: 1 }
    }

    /// One on ordinary cores, specialised for what becomes of its sums: of 64 invocations, each with as many tokens as
    /// it defines, or with shared memory ([`Variant::stages`]).
    pub(super) fn dense(contract: &'static Contract, special: Specialisation) -> Self {
        let tokens = || (contract.define("TX") * contract.define("TY")) as u32;
        let variant = Self { contract, special, tiles_a_group: STAGED_TILES };
        if variant.stages().is_some() { variant } else { Self { tiles_a_group: tokens(), ..variant } }
    }

    /// Output channels of a workgroup that stages inputs and weights as floats (`glsl/shared/staged_products.glsl`).
    pub(super) fn stages(&self) -> Option<u32> {
        (!self.is_on_matrices() && self.contract.has("OUTPUTS")).then(|| self.contract.define("OUTPUTS") as u32)
    }

    /// One on cooperative matrices, cut as `special` says.
    pub(super) fn on_matrices(contract: &'static Contract, special: Specialisation) -> Self {
        Self { contract, special, tiles_a_group: special.tiles.max(1) }
    }

    /// Whether it runs on cooperative matrices.
    pub fn is_on_matrices(&self) -> bool {
        self.contract.needs_matrix()
    }
}

/// One of two variants, by how the maps are stored.
pub(super) fn by_storage(storage: Storage, f32: &'static Contract, f16: &'static Contract) -> &'static Contract {
    match storage {
        Storage::F32 => f32,
        Storage::F16 => f16,
    }
}

//! Kernels of every pixel, predicted and applied at full size.

use super::{ALBEDO_REACH, REACH};
use crate::kernels::accesses::matrix::{OUTPUTS, TOKENS};
use crate::kernels::accesses::{self, Accesses};
use crate::kernels::contracts;
use crate::kernels::pushes::PredictKernelsPush;
use crate::kernels::signals::SignalKind;
use crate::kernels::{
    Access, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, TILE, TexelRange,
    Tiles, Traffic, Variant, View, flags, groups,
};

/// The kernels of every pixel, predicted and applied at full size ([`crate::net::OpKind::PredictKernels`]).
#[derive(Clone, Debug, PartialEq)]
pub struct PredictKernels {
    /// What is predicted from, 32 channels.
    pub hidden: View,
    /// The reliability times the image, and the reliability; 32-bit floats.
    pub taps: View,
    /// Albedo in the first three channels.
    pub albedo: View,
    /// Packed weights ([`crate::plan::pack::Pack::Kernels`]), on matrices [`crate::plan::pack::Pack::KernelsMatrix`].
    pub weights: BufferId,
    /// Whether the radiance is averaged as it is too: the gate is the share of the other mean, times the albedo.
    pub gloss: bool,
    /// Whether the image is of a signal beside the colour: not divided by the albedo, where it is no light.
    pub of_signal: bool,
    /// The mean times the first level's share and the share, the mean albedo and the gate, the other levels' shares;
    /// 32-bit floats.
    pub dst: View,
    /// Tiles of the pixels.
    pub tiles: Tiles,
    /// What it computes with; on matrices it fits them.
    pub arithmetic: Arithmetic,
}

impl PredictKernels {
    /// Whether there is a kernel on matrices for its maps: whole vectors of halves.
    pub fn fits_matrices(&self) -> bool {
        self.hidden.is_vectors_of_halves()
    }

    /// Whether the image was divided by the albedo.
    fn has_albedo(&self, at: &Addresses) -> bool {
        !self.of_signal || at.frame.signal.is_some_and(|signal| signal.kind == SignalKind::Light)
    }

    /// Vectors that are read for so many taps of the image: of the albedo as many, where the radiance is averaged too.
    fn taps_read(&self, taps: u64) -> u64 {
        if self.gloss { 2 * taps } else { taps }
    }

    /// 48 outputs a pixel by two subgroups, and 25 and nine taps.
    fn accesses_on_matrices(&self) -> Accesses {
        let tiles = u64::from(self.tiles.count(self.dst.width, self.dst.height));
        let (rows, outputs) = (OUTPUTS, 48);
        let staged = TOKENS * rows / 8 + 2 * u64::from((TILE + 4) * (TILE + 4)) + rows * outputs / 8;
        let results = TOKENS * outputs / 4;
        Accesses {
            global_loads: tiles * (staged + results),
            global_stores: tiles * TOKENS * 3,
            shared_loads: tiles * ((TOKENS + 2 * outputs) * rows / 8 + results + TOKENS * (self.taps_read(25) + 9)),
            shared_stores: tiles * (staged + results),
        }
    }
}

impl Kernel for PredictKernels {
    fn choose(&self, target: KernelTarget) -> Variant {
        if self.arithmetic == Arithmetic::Matrices {
            return Variant::plain(&contracts::PREDICT_KERNELS_MATRIX);
        }
        let contract = match (target.cpu_with(&self.texels()), self.hidden.storage) {
            (true, _) => &contracts::PREDICT_KERNELS_CPU,
            (false, Storage::F32) => &contracts::PREDICT_KERNELS,
            (false, Storage::F16) => &contracts::PREDICT_KERNELS_FROM_F16,
        };
        // Of 64 invocations, each with so many pixels in a row.
        Variant { tiles_a_group: contract.define("TX") as u32, ..Variant::plain(contract) }
    }

    fn groups(&self, variant: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height).div_ceil(variant.tiles_a_group), 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&PredictKernelsPush {
            hidden: at.view(&self.hidden),
            taps: at.view(&self.taps),
            albedo: at.view(&self.albedo),
            weights: at.of(self.weights),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            height: self.dst.height,
            hidden_stride: self.hidden.stride / 4,
            taps_stride: self.taps.stride / 4,
            albedo_stride: self.albedo.stride / 4,
            dst_stride: self.dst.stride / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width)
                | if self.gloss { flags::GLOSS } else { 0 }
                | if self.has_albedo(at) { 0 } else { flags::NO_ALBEDO },
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.hidden, Access::SAME);
        visit(&mut self.taps, Access::around(1, REACH));
        visit(&mut self.albedo, Access::around(1, if self.gloss { REACH } else { ALBEDO_REACH }));
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        let matrix = match self.arithmetic {
            Arithmetic::Floats => 48 * 32,
            Arithmetic::Matrices => 48 * 32 / 2,
        };
        Traffic::reading([(self.weights, (48 + matrix) * 4)])
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.hidden).into(), (&self.taps).into(), (&self.albedo).into(), self.weights.into()]
    }

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        if variant.is_on_matrices() {
            return Some(self.accesses_on_matrices());
        }
        let contract = variant.contract;
        let pixels = contract.define("TX");
        let tiles = u64::from(self.tiles.count(self.dst.width, self.dst.height));
        let invocations = accesses::tokens(&self.tiles, &self.dst) / pixels;
        let loads = pixels * 8 + 12 * (1 + accesses::row_loads(contract, 32));
        let mut accesses = Accesses::each(invocations, loads, 3 * pixels);
        // Taps beyond the last one are read too.
        let taps = invocations * pixels * (self.taps_read(28) + 12);
        match contract.has("TEXELS") {
            true => accesses.global_loads += taps,
            false => {
                accesses.global_loads += tiles * 2 * 144;
                (accesses.shared_loads, accesses.shared_stores) = (taps, tiles * 2 * 144);
            }
        }
        Some(accesses)
    }
}

//! What kernels of pixels are predicted from.

use super::{HIDDEN_BIASES, HIDDEN_HALVES, HIDDEN_WEIGHTS, MATRIX_ROWS};
use crate::kernels::accesses::matrix::{OUTPUTS, SUBGROUPS, TOKENS};
use crate::kernels::accesses::{self, Accesses};
use crate::kernels::contracts::{self, halves};
use crate::kernels::pushes::KernelInputsPush;
use crate::kernels::{
    Access, Addresses, Arithmetic, BufferId, Footprint, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage,
    TexelRange, Tiles, Traffic, Variant, View, by_storage, groups,
};

/// What kernels of pixels are predicted from, and what they read ([`crate::net::OpKind::KernelInputs`]).
#[derive(Clone, Debug, PartialEq)]
pub struct KernelInputs {
    /// Pixels: what earlier maps add to what is predicted from, 32 channels.
    pub early: View,
    /// Tokens of 2x2 pixels, 32 channels.
    pub tokens: View,
    /// Pixels: albedo in the first three channels.
    pub albedo: View,
    /// Pixels, 32-bit floats: log1p of the exposed colour.
    pub color: View,
    /// Pixels, 32-bit floats: what the network adds to it.
    pub residual: View,
    /// Packed weights ([`crate::plan::pack::Pack::Kernels`]), on matrices [`crate::plan::pack::Pack::KernelsMatrix`].
    pub weights: BufferId,
    /// Pixels: what is predicted from, 32 channels.
    pub dst: View,
    /// Pixels, 32-bit floats: the reliability times the image, and the reliability.
    pub taps: View,
    /// Tiles of the tokens.
    pub tiles: Tiles,
    /// What it computes with; on matrices it fits them.
    pub arithmetic: Arithmetic,
}

impl KernelInputs {
    /// Whether there is a kernel on matrices for its maps: whole vectors of halves.
    pub fn fits_matrices(&self) -> bool {
        self.tokens.is_vectors_of_halves() && self.dst.storage == Storage::F16
    }

    /// Four pixels a token, 32 hidden numbers each.
    fn accesses_on_matrices(&self) -> Accesses {
        let tiles = u64::from(self.tiles.count(self.tokens.width, self.tokens.height));
        let (pixels, rows) = (4 * TOKENS, MATRIX_ROWS as u64);
        // Of a token its channels, of a pixel colour and residual; of these two vectors each. Then every phase's
        // weights.
        let staged = TOKENS * OUTPUTS / 8 + 2 * pixels + SUBGROUPS * rows * OUTPUTS / 8;
        let results = pixels * OUTPUTS / 4;
        Accesses {
            global_loads: tiles * (staged + 3 * results + 3 * pixels),
            global_stores: tiles * (results + pixels),
            shared_loads: tiles * (SUBGROUPS * (TOKENS + OUTPUTS) * rows / 8 + results + pixels),
            shared_stores: tiles * (staged + results + pixels),
        }
    }
}

impl Kernel for KernelInputs {
    fn choose(&self, target: KernelTarget) -> Variant {
        if self.arithmetic == Arithmetic::Matrices {
            return Variant::plain(&contracts::KERNEL_INPUTS_MATRIX);
        }
        Variant::plain(match target.cpu_with(&self.texels()) {
            true => by_storage(self.dst.storage, &contracts::KERNEL_INPUTS_CPU, &halves::KERNEL_INPUTS_CPU),
            false => by_storage(self.dst.storage, &contracts::KERNEL_INPUTS, &halves::KERNEL_INPUTS),
        })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.tokens.width, self.tokens.height), 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.tokens))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&KernelInputsPush {
            early: at.view(&self.early),
            tokens: at.view(&self.tokens),
            albedo: at.view(&self.albedo),
            color: at.view(&self.color),
            residual: at.view(&self.residual),
            weights: at.of(self.weights),
            hidden: at.view(&self.dst),
            taps: at.view(&self.taps),
            tiles: at.tiles(&self.tiles),
            width: self.tokens.width,
            early_stride: self.early.stride / 4,
            tokens_stride: self.tokens.stride / 4,
            albedo_stride: self.albedo.stride / 4,
            color_stride: self.color.stride / 4,
            residual_stride: self.residual.stride / 4,
            hidden_stride: self.dst.stride / 4,
            taps_stride: self.taps.stride / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.tokens.width, self.tokens.height),
            flags: self.tiles.flags(self.tokens.width),
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.early, Access::Read(Footprint::Finer { by: 2 }));
        visit(&mut self.tokens, Access::SAME);
        for map in [&mut self.albedo, &mut self.color, &mut self.residual] {
            visit(map, Access::Read(Footprint::Finer { by: 2 }));
        }
        visit(&mut self.dst, Access::Write(Scale::Double));
        visit(&mut self.taps, Access::Write(Scale::Double));
    }

    fn others(&self) -> Traffic {
        let words = match self.arithmetic {
            Arithmetic::Floats => HIDDEN_WEIGHTS,
            Arithmetic::Matrices => HIDDEN_BIASES + HIDDEN_HALVES,
        };
        Traffic::reading([(self.weights, words as u64 * 4)])
    }

    fn texels(&self) -> Vec<TexelRange> {
        let maps = [&self.early, &self.tokens, &self.albedo, &self.color, &self.residual].map(TexelRange::from);
        maps.into_iter().chain([self.weights.into()]).collect()
    }

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        if variant.is_on_matrices() {
            return Some(self.accesses_on_matrices());
        }
        let tokens = variant.contract.define("TX");
        let invocations = accesses::tokens(&self.tiles, &self.tokens) * 4 / tokens;
        let loads = 1 + tokens * (8 + 8 + 3) + 8 * (2 + accesses::row_loads(variant.contract, 40));
        Some(Accesses::each(invocations, loads, tokens * (8 + 1)))
    }
}

//! A depthwise 3x3 convolution and the pointwise convolution after it as one kernel.

use super::accesses::matrix::{TOKENS, Work};
use super::accesses::{Accesses, Block};
use super::contract::Specialisation;
use super::contracts::{self, halves};
use super::dense::{Linear, TILE_CHANNELS, dense_texels};
use super::maps::Depthwise3x3;
use super::on_matrices::{self, dense_groups, outputs_of};
use super::pushes::Separable3x3Push;
use super::{
    Access, Addresses, Arithmetic, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, TILE, TexelRange, Tiles,
    Traffic, Variant, View, activation_flag, by_storage,
};

/// `pointwise(depthwise(src))`: the depthwise result is not stored, so neither its target nor the source of the
/// pointwise one is touched.
#[derive(Clone, Debug, PartialEq)]
pub struct Separable3x3 {
    /// The first part, with its activation.
    pub depthwise: Depthwise3x3,
    /// The second part, of one source.
    pub pointwise: Linear,
}

impl Separable3x3 {
    /// Whether there is a kernel on matrices for its maps: from whole vectors of halves to a map of halves.
    pub fn fits_matrices(&self) -> bool {
        self.on_matrices().is_some()
    }

    fn on_matrices(&self) -> Option<Specialisation> {
        let (src, dst) = (&self.depthwise.src, &self.pointwise.dst);
        // Every invocation makes some of the depthwise results.
        let tiles = on_matrices::tiles_for(dst.channels);
        let (tokens, outputs) = (tiles * on_matrices::TOKENS, outputs_of(tiles));
        let inputs = on_matrices::staged(src.channels, tokens, outputs, 1, outputs)?;
        let special = Specialisation { tiles, inputs, ..Specialisation::default() };
        (dst.storage == Storage::F16 && on_matrices::can_load([src])).then_some(special)
    }

    fn chosen(&self) -> Option<Specialisation> {
        self.on_matrices().filter(|_| self.pointwise.arithmetic == Arithmetic::Matrices)
    }

    fn accesses_on_matrices(&self, special: Specialisation) -> Accesses {
        let Linear { tiles, dst, .. } = &self.pointwise;
        let inputs = u64::from(self.depthwise.src.channels);
        let columns = u64::from(TILE) * inputs / 4;
        // Three tokens in each of ten rows, nine taps and a bias for every column of tokens and four channels.
        let loads = columns * (3 * u64::from(TILE + 2) + 10);
        let epilogue = self.pointwise.epilogue_loads();
        let work = Work { loads, staged: TOKENS * inputs / 4, taps: 0, rows: inputs, epilogue };
        work.accesses(special, tiles.count(dst.width, dst.height), dst.channels)
    }
}

impl Kernel for Separable3x3 {
    fn choose(&self, target: KernelTarget) -> Variant {
        let inner = activation_flag(self.depthwise.activation);
        let special = Specialisation { inner, epilogue: self.pointwise.epilogue(), ..Specialisation::default() };
        if let Some(cut) = self.chosen() {
            let Linear { tiles, dst, .. } = &self.pointwise;
            let cut = on_matrices::cut_for(cut, tiles.count(dst.width, dst.height), dst.channels);
            let Specialisation { inner, epilogue, .. } = special;
            return Variant::on_matrices(&contracts::SEPARABLE3X3_MATRIX, Specialisation { inner, epilogue, ..cut });
        }
        let of = |f32, f16| by_storage(self.pointwise.dst.storage, f32, f16);
        let contract = match target.cpu_with(&self.texels()) {
            true => of(&contracts::SEPARABLE3X3_CPU, &halves::SEPARABLE3X3_CPU),
            false => of(&contracts::SEPARABLE3X3, &halves::SEPARABLE3X3),
        };
        Variant::dense(contract, special)
    }

    fn groups(&self, variant: &Variant) -> [u32; 3] {
        let Linear { tiles, dst, .. } = &self.pointwise;
        dense_groups(variant, tiles.count(dst.width, dst.height), dst.channels, TILE_CHANNELS)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.pointwise.tiles, &self.pointwise.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.pointwise.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let (src, pointwise) = (&self.depthwise.src, &self.pointwise);
        PushBytes::new(&Separable3x3Push {
            src: at.view(src),
            dst: at.view(&pointwise.dst),
            weights: at.of(pointwise.weights),
            film: pointwise.film.map_or(0, |film| at.of(film)),
            residual: at.view_or_null(pointwise.residual.as_ref()),
            depthwise: at.of(self.depthwise.weights),
            tiles: at.tiles(&pointwise.tiles),
            width: src.width,
            height: src.height,
            src_stride: src.stride / 4,
            src_channels: src.channels / 4,
            dst_stride: pointwise.dst.stride / 4,
            dst_channels: pointwise.dst.channels / 4,
            residual_stride: pointwise.residual.map_or(0, |r| r.stride / 4),
            bias_vectors: pointwise.dst.channels.next_multiple_of(TILE_CHANNELS) / 4,
            first_tile: pointwise.tiles.first(),
            tile_count: pointwise.tiles.count(src.width, src.height),
            flags: pointwise.tiles.flags(src.width),
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.depthwise.src, Access::around(1, 1));
        self.pointwise.residual.iter_mut().for_each(|residual| visit(residual, Access::Residual(Scale::Same)));
        visit(&mut self.pointwise.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        let mut others = self.pointwise.others();
        others.reads.push((self.depthwise.weights, u64::from(self.depthwise.src.channels) * 40));
        others
    }

    fn texels(&self) -> Vec<TexelRange> {
        let pointwise = &self.pointwise;
        let residual = pointwise.residual.as_ref();
        let mut ranges = dense_texels(&self.depthwise.src, pointwise.weights, pointwise.film, residual);
        ranges.push(self.depthwise.weights.into());
        ranges
    }

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        if variant.is_on_matrices() {
            return Some(self.accesses_on_matrices(variant.special));
        }
        let (block, pointwise) = (Block::of(variant.contract), &self.pointwise);
        let per_four_inputs = 10 + (block.x + 2) * (block.y + 2) + block.weight_loads(variant.contract);
        let loads = block.vectors
            + u64::from(self.depthwise.src.channels / 4) * per_four_inputs
            + block.outputs() * pointwise.epilogue_loads();
        let tiles = pointwise.tiles.count(pointwise.dst.width, pointwise.dst.height);
        Some(Accesses::each(block.invocations(tiles, pointwise.dst.channels), loads, block.outputs()))
    }
}

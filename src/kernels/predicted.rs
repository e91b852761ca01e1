//! The head of predicted kernels: every pixel a mean of pixels ([`crate::net::head`]).

use super::contract::Contract;
use super::contracts;
use super::pushes::{ApplyKernelsPush, HalvePush, MixLevelsPush, PredictKernelsPush};
use super::{
    Addresses, BufferId, Kernel, PushBytes, Storage, TexelRange, Tiles, Traffic, Variants, View, flags, groups,
};

/// Packed weights of [`PredictKernels`], in 32-bit floats: biases and the reliability's row, then 40 inputs of 32 hidden
/// numbers for each of a token's pixels, then 32 inputs of 48 outputs.
pub const WEIGHTS: usize = (4 * 32 + 32 + 48) + 4 * 32 * 40 + 48 * 32;
/// Tokens beyond its own whose pixels a pixel's kernel reads.
pub const REACH: u32 = 2;

/// The kernels of every pixel, predicted and applied at full size ([`crate::net::OpKind::PredictKernels`]).
#[derive(Clone, Debug, PartialEq)]
pub struct PredictKernels {
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
    /// Packed weights ([`crate::plan::pack::Pack::Kernels`]).
    pub weights: BufferId,
    /// Pixels, 32-bit floats: the mean times the first level's share and the share, the mean albedo and the gate, the other
    /// levels' shares.
    pub dst: View,
    /// Tokens, 32-bit floats: the mean of reliability times image and that of reliability.
    pub sums: View,
    /// Tiles of the tokens.
    pub tiles: Tiles,
}

impl Kernel for PredictKernels {
    fn contract(&self, variants: Variants) -> &'static Contract {
        match (variants.for_texels(&self.texels()).cpu, self.early.storage) {
            (true, _) => &contracts::PREDICT_KERNELS_CPU,
            (false, Storage::F32) => &contracts::PREDICT_KERNELS,
            (false, Storage::F16) => &contracts::PREDICT_KERNELS_FROM_F16,
        }
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups(self.tiles.count(self.tokens.width, self.tokens.height), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&PredictKernelsPush {
            early: at.view(&self.early),
            tokens: at.view(&self.tokens),
            albedo: at.view(&self.albedo),
            color: at.view(&self.color),
            residual: at.view(&self.residual),
            weights: at.of(self.weights),
            dst: at.view(&self.dst),
            sums: at.view(&self.sums),
            tiles: at.tiles(&self.tiles),
            width: self.tokens.width,
            height: self.tokens.height,
            early_stride: self.early.stride / 4,
            tokens_stride: self.tokens.stride / 4,
            albedo_stride: self.albedo.stride / 4,
            color_stride: self.color.stride / 4,
            residual_stride: self.residual.stride / 4,
            dst_stride: self.dst.stride / 4,
            sums_stride: self.sums.stride / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.tokens.width, self.tokens.height),
            flags: self.tiles.flags(self.tokens.width),
        })
    }

    fn texels(&self) -> Vec<TexelRange> {
        let maps = [&self.early, &self.tokens, &self.albedo, &self.color, &self.residual].map(TexelRange::from);
        maps.into_iter().chain([self.weights.into()]).collect()
    }

    fn traffic(&self) -> Traffic {
        let map = |view: &View| (view.buffer, view.bytes());
        let mut reads = [&self.early, &self.tokens, &self.albedo, &self.color, &self.residual].map(map).to_vec();
        reads.push((self.weights, WEIGHTS as u64 * 4));
        Traffic { reads, writes: vec![map(&self.dst), map(&self.sums)] }
    }
}

/// The mean of 2x2 tokens, in 32-bit floats.
#[derive(Clone, Debug, PartialEq)]
pub struct Halve {
    /// Input.
    pub src: View,
    /// Output, of half the size.
    pub dst: View,
    /// Tiles of the output.
    pub tiles: Tiles,
}

impl Kernel for Halve {
    fn contract(&self, variants: Variants) -> &'static Contract {
        if variants.for_texels(&self.texels()).cpu { &contracts::HALVE_CPU } else { &contracts::HALVE }
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&HalvePush {
            src: at.view(&self.src),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            src_stride: self.src.stride / 4,
            dst_stride: self.dst.stride / 4,
            channels: self.dst.channels / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
            unused: 0,
        })
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.src).into()]
    }

    fn traffic(&self) -> Traffic {
        Traffic { reads: vec![(self.src.buffer, self.src.bytes())], writes: vec![(self.dst.buffer, self.dst.bytes())] }
    }
}

/// Kernels of every token over images ([`crate::net::OpKind::ApplyKernels`]).
#[derive(Clone, Debug, PartialEq)]
pub struct ApplyKernels {
    /// 25 channels of logits.
    pub logits: View,
    /// Of every image three channels times a weight, and the weight; 32-bit floats.
    pub sums: View,
    /// Of every image its mean, and 1, or zeros; 32-bit floats.
    pub dst: View,
    /// Tiles of the map.
    pub tiles: Tiles,
}

impl Kernel for ApplyKernels {
    fn contract(&self, variants: Variants) -> &'static Contract {
        match (variants.for_texels(&self.texels()).cpu, self.logits.storage) {
            (true, _) => &contracts::APPLY_KERNELS_CPU,
            (false, Storage::F32) => &contracts::APPLY_KERNELS,
            (false, Storage::F16) => &contracts::APPLY_KERNELS_FROM_F16,
        }
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&ApplyKernelsPush {
            logits: at.view(&self.logits),
            sums: at.view(&self.sums),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            height: self.dst.height,
            logits_stride: self.logits.stride / 4,
            sums_stride: self.sums.stride / 4,
            dst_stride: self.dst.stride / 4,
            images: self.dst.channels / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
            unused: 0,
        })
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.logits).into(), (&self.sums).into()]
    }

    fn traffic(&self) -> Traffic {
        let reads = [&self.logits, &self.sums].map(|view| (view.buffer, view.bytes())).to_vec();
        Traffic { reads, writes: vec![(self.dst.buffer, self.dst.bytes())] }
    }
}

/// The levels to one picture ([`crate::net::OpKind::MixLevels`]); all maps of 32-bit floats.
#[derive(Clone, Debug, PartialEq)]
pub struct MixLevels {
    /// [`PredictKernels::dst`].
    pub pixels: View,
    /// [`ApplyKernels::dst`] of every level, the finest (2x2 pixels) first: two or four of them.
    pub levels: Vec<View>,
    /// log1p of the exposed colour, and what the network adds to it, where the gate counts.
    pub direct: Option<(View, View)>,
    /// Of every image three channels of exposed radiance and a zero.
    pub dst: View,
    /// Tiles of the pixels.
    pub tiles: Tiles,
}

impl MixLevels {
    /// A level's map; where there are fewer, the last one.
    fn level(&self, at: usize) -> &View {
        self.levels.get(at).or(self.levels.last()).unwrap_or(&self.pixels)
    }

    fn direct_or_pixels(&self) -> [View; 2] {
        self.direct.map_or([self.pixels; 2], |(color, residual)| [color, residual])
    }
}

impl Kernel for MixLevels {
    fn contract(&self, variants: Variants) -> &'static Contract {
        if variants.for_texels(&self.texels()).cpu { &contracts::MIX_LEVELS_CPU } else { &contracts::MIX_LEVELS }
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let [color, residual] = self.direct_or_pixels();
        let level_strides = (0..4).map(|level| (self.level(level).stride / 4) << (8 * level)).sum();
        PushBytes::new(&MixLevelsPush {
            pixels: at.view(&self.pixels),
            level_0: at.view(self.level(0)),
            level_1: at.view(self.level(1)),
            level_2: at.view(self.level(2)),
            level_3: at.view(self.level(3)),
            color: at.view(&color),
            residual: at.view(&residual),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            height: self.dst.height,
            pixels_stride: self.pixels.stride / 4,
            level_strides,
            color_stride: color.stride / 4,
            residual_stride: residual.stride / 4,
            dst_stride: self.dst.stride / 4,
            images: self.dst.channels / 4,
            levels: self.levels.len() as u32,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width) | self.direct.map_or(0, |_| flags::GATED),
        })
    }

    fn texels(&self) -> Vec<TexelRange> {
        let levels = (0..4).map(|level| self.level(level));
        let direct = self.direct_or_pixels();
        [&self.pixels].into_iter().chain(levels).chain(&direct).map(TexelRange::from).collect()
    }

    fn traffic(&self) -> Traffic {
        let direct = self.direct.iter().flat_map(|(color, residual)| [color, residual]);
        let maps = [&self.pixels].into_iter().chain(&self.levels).chain(direct);
        Traffic {
            reads: maps.map(|view| (view.buffer, view.bytes())).collect(),
            writes: vec![(self.dst.buffer, self.dst.bytes())],
        }
    }
}

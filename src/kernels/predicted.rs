//! The head of predicted kernels: every pixel a mean of pixels ([`crate::net::head`]).

use super::contracts::{self, halves};
use super::pushes::{ApplyKernelsPush, HalvePush, KernelInputsPush, MixLevelsPush, PredictKernelsPush};
use super::signals::SignalKind;
use super::{
    Access, Addresses, Arithmetic, BufferId, Footprint, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, TexelRange, Tiles,
    Traffic, Variant, View, by_storage, flags, groups,
};

/// Biases of the hidden numbers by a token's pixels, and the reliability's row: 32-bit floats on matrices too.
const HIDDEN_BIASES: usize = 4 * 32 + 32;
/// Packed weights that [`KernelInputs`] reads, in 32-bit floats: biases and the reliability's row, then 40 inputs of 32
/// hidden numbers for each of a token's pixels.
const HIDDEN_WEIGHTS: usize = HIDDEN_BIASES + 4 * 32 * 40;
/// All of them, with those that [`PredictKernels`] reads: biases, and 32 inputs of 48 outputs.
pub const WEIGHTS: usize = HIDDEN_WEIGHTS + 48 + 48 * 32;
/// Rows of the hidden numbers' matrix on matrices: 32 channels of a token, colour and residual of three channels and a
/// zero each, and once more for what halves leave of these.
pub const MATRIX_ROWS: usize = 48;
/// 32-bit words of the halves that [`KernelInputs`] reads on matrices.
const HIDDEN_HALVES: usize = 4 * 32 * MATRIX_ROWS / 2;
/// Words of all of the form for matrices.
pub const MATRIX_WEIGHTS: usize = HIDDEN_BIASES + 48 + HIDDEN_HALVES + 48 * 32 / 2;
/// How far beyond itself a kernel reads, in tokens of its image.
pub const REACH: u32 = 2;
/// How far a kernel over albedo reads.
pub const ALBEDO_REACH: u32 = 1;

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
        visit(&mut self.early, Access::Read(Footprint::Finer));
        visit(&mut self.tokens, Access::SAME);
        for map in [&mut self.albedo, &mut self.color, &mut self.residual] {
            visit(map, Access::Read(Footprint::Finer));
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
}

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
            flags: self.tiles.flags(self.dst.width),
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.hidden, Access::SAME);
        visit(&mut self.taps, Access::around(1, REACH));
        visit(&mut self.albedo, Access::around(1, ALBEDO_REACH));
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
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(if target.cpu_with(&self.texels()) { &contracts::HALVE_CPU } else { &contracts::HALVE })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
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

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.src, Access::Read(Footprint::Finer));
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.src).into()]
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
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(match (target.cpu_with(&self.texels()), self.logits.storage) {
            (true, _) => &contracts::APPLY_KERNELS_CPU,
            (false, Storage::F32) => &contracts::APPLY_KERNELS,
            (false, Storage::F16) => &contracts::APPLY_KERNELS_FROM_F16,
        })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
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

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.logits, Access::SAME);
        visit(&mut self.sums, Access::around(1, REACH));
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.logits).into(), (&self.sums).into()]
    }
}

/// The levels to one picture ([`crate::net::OpKind::MixLevels`]); all maps of 32-bit floats.
#[derive(Clone, Debug, PartialEq)]
pub struct MixLevels {
    /// [`PredictKernels::dst`].
    pub pixels: View,
    /// [`ApplyKernels::dst`] of every level, the finest (2x2 pixels) first: two or four of them.
    pub levels: Vec<View>,
    /// Whether the picture is a signal beside the colour: not times the albedo, where it is no light.
    pub of_signal: bool,
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
    fn choose(&self, target: KernelTarget) -> Variant {
        let cpu = target.cpu_with(&self.texels());
        Variant::plain(if cpu { &contracts::MIX_LEVELS_CPU } else { &contracts::MIX_LEVELS })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
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
            flags: self.tiles.flags(self.dst.width)
                | self.direct.map_or(0, |_| flags::GATED)
                | if self.of_signal && !at.frame.signal.is_some_and(|signal| signal.kind == SignalKind::Light) {
                    flags::NO_ALBEDO
                } else {
                    0
                },
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.pixels, Access::SAME);
        for level in &mut self.levels {
            // The tokens that hold the pixels, and their neighbours.
            let by = self.dst.width / level.width;
            visit(level, Access::Read(Footprint::Coarser { by, reach: 1 }));
        }
        if let Some((color, residual)) = &mut self.direct {
            visit(color, Access::SAME);
            visit(residual, Access::SAME);
        }
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn texels(&self) -> Vec<TexelRange> {
        let levels = (0..4).map(|level| self.level(level));
        let direct = self.direct_or_pixels();
        [&self.pixels].into_iter().chain(levels).chain(&direct).map(TexelRange::from).collect()
    }
}

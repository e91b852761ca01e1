//! Coarser levels of images: made, filtered by their tokens' kernels, and mixed.

use super::REACH;
use crate::kernels::accesses::{self, Accesses};
use crate::kernels::contracts;
use crate::kernels::pushes::{ApplyKernelsPush, HalvePush, MixLevelsPush};
use crate::kernels::{
    Access, Addresses, Footprint, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, TexelRange, Tiles, Variant,
    View, flags, groups,
};

/// The mean of 2x2 tokens, in 32-bit floats.
#[derive(Clone, Debug, PartialEq)]
pub struct Halve {
    /// Input.
    pub src: View,
    /// Albedo in the first three channels, where the output has one image more than the input, which is one: that of
    /// the radiance that was not divided by the albedo.
    pub albedo: Option<View>,
    /// Output, of half the size.
    pub dst: View,
    /// Tiles of the output.
    pub tiles: Tiles,
}

impl Halve {
    fn albedo_or_src(&self) -> View {
        self.albedo.unwrap_or(self.src)
    }
}

impl Kernel for Halve {
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(match (target.cpu_with(&self.texels()), self.albedo_or_src().storage) {
            (true, _) => &contracts::HALVE_CPU,
            (false, Storage::F32) => &contracts::HALVE,
            (false, Storage::F16) => &contracts::HALVE_BY_F16,
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
        let albedo = self.albedo_or_src();
        PushBytes::new(&HalvePush {
            src: at.view(&self.src),
            albedo: at.view(&albedo),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            src_stride: self.src.stride / 4,
            dst_stride: self.dst.stride / 4,
            channels: self.src.channels / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width) | self.albedo.map_or(0, |_| flags::GLOSS),
            albedo_stride: albedo.stride / 4,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        for map in [Some(&mut self.src), self.albedo.as_mut()].into_iter().flatten() {
            visit(map, Access::Read(Footprint::Finer { by: 2 }));
        }
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.src).into(), (&self.albedo_or_src()).into()]
    }

    fn accesses(&self, _: &Variant) -> Option<Accesses> {
        // Of the image, and where there are two of the albedo.
        let vectors = u64::from(self.dst.channels / 4);
        Some(Accesses::each(accesses::tokens(&self.tiles, &self.dst), 4 * vectors, vectors))
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

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let tiles = u64::from(self.tiles.count(self.dst.width, self.dst.height)) * u64::from(self.dst.channels / 4);
        let mut accesses = Accesses::each(tiles * 64, 7, 1);
        match variant.contract.has("TEXELS") {
            true => accesses.global_loads += tiles * 64 * 28,
            false => {
                accesses.global_loads += tiles * 144;
                (accesses.shared_loads, accesses.shared_stores) = (tiles * 64 * 28, tiles * 144);
            }
        }
        Some(accesses)
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
    /// Whether the levels have two images: by the gate the one that was divided by the albedo, times it, and by the
    /// rest the other.
    pub gloss: bool,
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
                | if self.gloss { flags::GLOSS } else { 0 },
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.pixels, Access::SAME);
        for (i, level) in self.levels.iter_mut().enumerate() {
            // The tokens that hold the pixels, and their neighbours.
            visit(level, Access::Read(Footprint::Coarser { by: 2 << i, reach: 1 }));
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

    fn accesses(&self, _: &Variant) -> Option<Accesses> {
        let (images, levels) = (u64::from(self.dst.channels / 4), self.levels.len() as u64);
        let direct = 2 * u64::from(self.direct.is_some());
        let of_levels = 4 * levels * (1 + u64::from(self.gloss));
        let loads = 2 + images * (1 + of_levels) + direct;
        Some(Accesses::each(accesses::tokens(&self.tiles, &self.dst), loads, images))
    }
}

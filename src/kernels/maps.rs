//! Kernels that go over a map once: depthwise convolution and layer normalisation.

use super::accesses::{self, Accesses};
use super::contract::Specialisation;
use super::contracts::{self, halves};
use super::pushes::{Depthwise3x3Push, LayerNormPush};
use super::{
    Access, Activation, Addresses, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, TILE, TexelRange, Tiles,
    Traffic, Variant, View, activation_flag, by_storage, groups,
};

/// Channels of one workgroup of the depthwise kernel.
const DEPTHWISE_CHANNELS: u32 = 32;

/// `act(depthwise3x3(src) + bias)`, zero padding at the map's borders.
#[derive(Clone, Debug, PartialEq)]
pub struct Depthwise3x3 {
    /// Input.
    pub src: View,
    /// Output, of the same size.
    pub dst: View,
    /// Packed weights: `[bias | 9 taps]`, each of all channels.
    pub weights: BufferId,
    /// Applied to the result.
    pub activation: Activation,
    /// Tiles of the map.
    pub tiles: Tiles,
}

impl Kernel for Depthwise3x3 {
    fn choose(&self, target: KernelTarget) -> Variant {
        let contract = match target.cpu_with(&self.texels()) {
            true => by_storage(self.dst.storage, &contracts::DEPTHWISE3X3_CPU, &halves::DEPTHWISE3X3_CPU),
            false => by_storage(self.dst.storage, &contracts::DEPTHWISE3X3, &halves::DEPTHWISE3X3),
        };
        let special = Specialisation { epilogue: activation_flag(self.activation), ..Specialisation::default() };
        Variant { special, ..Variant::plain(contract) }
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), self.dst.channels.div_ceil(DEPTHWISE_CHANNELS))
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&Depthwise3x3Push {
            src: at.view(&self.src),
            dst: at.view(&self.dst),
            weights: at.of(self.weights),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            height: self.dst.height,
            src_stride: self.src.stride / 4,
            dst_stride: self.dst.stride / 4,
            channels: self.dst.channels / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.src, Access::around(1, 1));
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        Traffic::reading([(self.weights, u64::from(self.dst.channels) * 40)])
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.src).into(), self.weights.into()]
    }

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let [x, y] = ["TX", "TY"].map(|name| variant.contract.define(name));
        let invocations = accesses::tokens(&self.tiles, &self.dst) / (x * y) * u64::from(self.dst.channels / 4);
        Some(Accesses::each(invocations, 10 + (x + 2) * (y + 2), x * y))
    }
}

/// Every token to mean 0 and variance 1 over its channels (eps 1e-5), then gain and bias.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerNorm {
    /// Input. The mean is taken over its channels.
    pub src: View,
    /// Output, of the same size.
    pub dst: View,
    /// Packed `[gain | bias]`.
    pub weights: BufferId,
    /// Tiles of the map.
    pub tiles: Tiles,
}

impl Kernel for LayerNorm {
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(match target.cpu_with(&self.texels()) {
            true => by_storage(self.dst.storage, &contracts::LAYER_NORM_CPU, &halves::LAYER_NORM_CPU),
            false => by_storage(self.dst.storage, &contracts::LAYER_NORM, &halves::LAYER_NORM),
        })
    }

    fn groups(&self, variant: &Variant) -> [u32; 3] {
        // The rows of a tile, but for CPU drivers.
        let rows = if variant.contract.has("TEXELS") { 1 } else { TILE };
        groups(self.tiles.count(self.dst.width, self.dst.height), rows)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&LayerNormPush {
            src: at.view(&self.src),
            dst: at.view(&self.dst),
            weights: at.of(self.weights),
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
        visit(&mut self.src, Access::SAME);
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        Traffic::reading([(self.weights, u64::from(self.dst.channels) * 8)])
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.src).into(), self.weights.into()]
    }

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let tokens = accesses::tokens(&self.tiles, &self.dst);
        let vectors = u64::from(self.src.channels / 4);
        // Eight invocations share a token, but for CPU drivers, and add their parts of two sums.
        let shared = if variant.contract.has("TEXELS") { 0 } else { 2 * 8 * tokens };
        let global = Accesses::each(tokens, 5 * vectors, vectors);
        Some(Accesses { shared_loads: 8 * shared, shared_stores: shared, ..global })
    }
}

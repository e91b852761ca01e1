//! An FFN as one kernel, for matrices: its norm and first Linear, the depthwise convolution, the Linear back and the
//! residual. As two kernels they write and read what lies between, four times as wide as the map: at the network's
//! larger resolutions that is a third of all bytes.

use super::accesses::Accesses;
use super::accesses::matrix::{OUTPUTS, SUBGROUPS, TOKENS};
use super::attention_block::BIAS_ROWS;
use super::contract::Specialisation;
use super::dense::{Linear, TILE_CHANNELS};
use super::on_matrices::{self, DEPTH, MOST_TILES};
use super::pushes::FfnPush;
use super::separable::Separable3x3;
use super::{
    Access, Activation, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, TILE,
    Tiles, Traffic, Variant, View, activation_flag, contracts, groups,
};

/// Hidden channels of a workgroup at a time.
const HIDDEN: u32 = 32;
/// Tokens of a tile and around it, in whole matrices.
const AROUND: u64 = ((TILE + 2) * (TILE + 2)).next_multiple_of(DEPTH) as u64;

/// `x + W act(depthwise(V norm(x) + b)) + c`.
#[derive(Clone, Debug, PartialEq)]
pub struct Ffn {
    /// The map that is changed, of 32 or 64 channels.
    pub x: View,
    /// The result, of as many channels as `x`.
    pub dst: View,
    /// Packed weights of the Linear to the hidden channels, of normed tokens ([`crate::plan::pack::Pack::Halves`]).
    pub expand: BufferId,
    /// Its biases once more ([`crate::plan::pack::Pack::BiasRows`]).
    pub biases: BufferId,
    /// Packed weights of the depthwise convolution.
    pub depthwise: BufferId,
    /// Applied to its results.
    pub activation: Activation,
    /// Packed weights of the Linear back ([`crate::plan::pack::Pack::Halves`]).
    pub contract: BufferId,
    /// Hidden channels, a multiple of 32.
    pub hidden: u32,
    /// Tiles of the map.
    pub tiles: Tiles,
}

impl Ffn {
    /// Two kernels that follow each other as one, but for its biases; `None` where they are something else or no kernel
    /// takes them.
    pub fn joined(expand: &Linear, separable: &Separable3x3) -> Option<Self> {
        let Separable3x3 { depthwise, pointwise } = separable;
        let plain = |linear: &Linear| {
            let nothing_else = linear.film.is_none() && linear.activation == Activation::None;
            linear.arithmetic == Arithmetic::Matrices && nothing_else && linear.src_b.is_none()
        };
        let is_ffn = plain(expand)
            && plain(pointwise)
            && (expand.norm, expand.residual) == (true, None)
            && depthwise.src == expand.dst
            && pointwise.residual == Some(expand.src);
        let ffn = Self {
            x: expand.src,
            dst: pointwise.dst,
            expand: expand.weights,
            biases: BufferId(0),
            depthwise: depthwise.weights,
            activation: depthwise.activation,
            contract: pointwise.weights,
            hidden: expand.dst.channels,
            tiles: pointwise.tiles,
        };
        (is_ffn && ffn.fits_matrices()).then_some(ffn)
    }

    /// Of a workgroup's four subgroups each computes 32 channels for a half or a quarter of its tile. Of more channels
    /// shared memory would hold too little beside the normed tokens.
    fn fits_matrices(&self) -> bool {
        [TILE_CHANNELS, 2 * TILE_CHANNELS].contains(&self.x.channels)
            && self.dst.channels == self.x.channels
            && self.hidden.is_multiple_of(HIDDEN)
            && self.dst.storage == Storage::F16
            && on_matrices::can_load([&self.x])
    }
}

impl Kernel for Ffn {
    fn choose(&self, _: KernelTarget) -> Variant {
        let epilogue = activation_flag(self.activation);
        let special = Specialisation { epilogue, inputs: self.x.channels, ..Specialisation::default() };
        Variant::on_matrices(&contracts::FFN_MATRIX, special)
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
        PushBytes::new(&FfnPush {
            x: at.view(&self.x),
            dst: at.view(&self.dst),
            expand: at.of(self.expand),
            biases: at.of(self.biases),
            depthwise: at.of(self.depthwise),
            weights: at.of(self.contract),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            height: self.dst.height,
            x_stride: self.x.stride / 4,
            dst_stride: self.dst.stride / 4,
            dst_channels: self.dst.channels / 4,
            hidden: self.hidden / 4,
            bias_vectors: self.dst.channels / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.x, Access::around(1, 1));
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        let dense = |inputs: u32, outputs: u32| u64::from(outputs) * (2 * u64::from(inputs) + 4);
        Traffic::reading([
            (self.expand, dense(self.x.channels, self.hidden)),
            (self.biases, 4 * u64::from(BIAS_ROWS * self.hidden)),
            (self.depthwise, 40 * u64::from(self.hidden)),
            (self.contract, dense(self.hidden, self.dst.channels)),
        ])
    }

    /// Of a tile: its normed tokens and those around it, then for every 32 hidden channels of these their sums, the
    /// depthwise results of the tile and their products.
    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let groups: u64 = self.groups(variant).into_iter().map(u64::from).product();
        let (channels, hidden) = (u64::from(self.x.channels), u64::from(self.hidden));
        let normed = u64::from((TILE + 2) * (TILE + 2)) * channels / 8;
        let weights = hidden * channels / 8;
        // Four results of an invocation take six rows of three tokens, nine taps and a bias.
        let runs = TOKENS * hidden / 16;
        let results = TOKENS * channels / 4;
        // Every subgroup loads all weights of the first Linear, and those of its outputs of the one back.
        let inputs = TOKENS * channels / OUTPUTS / u64::from(MOST_TILES);
        let products = SUBGROUPS * hidden / 8 * (channels + OUTPUTS + inputs);
        Some(Accesses {
            global_loads: groups * (normed + 2 * weights + SUBGROUPS * hidden + 10 * runs + 2 * results),
            global_stores: groups * results,
            shared_loads: groups * (AROUND * channels / 8 + products + 18 * runs + results),
            shared_stores: groups * (normed + 2 * weights + (AROUND + TOKENS) * hidden / 8 + results),
        })
    }
}

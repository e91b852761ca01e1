//! The attention of a block as one kernel, for matrices: its norms and Linears, the attention, the projection and the
//! residual. As four kernels they wait for each other, which on small maps takes longer than what they compute.

use super::contract::Specialisation;
use super::dense::{Linear, TILE_CHANNELS};
use super::pushes::AttentionBlockPush;
use super::window_attention::WindowAttention;
use super::{
    Access, Activation, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, Tiles,
    Traffic, Variant, View, contracts, on_matrices,
};

/// Rows of [`crate::plan::pack::Pack::BiasRows`], the most that a device's matrices have.
pub const BIAS_ROWS: u32 = 16;

/// `x + W [attended | rest of x] + bias`, where the first [`AttentionBlock::value_width`] channels of x, normed, attend
/// as [`WindowAttention`] says, with one head.
#[derive(Clone, Debug, PartialEq)]
pub struct AttentionBlock {
    /// The map that is changed.
    pub x: View,
    /// The features' channels that attend.
    pub f: View,
    /// The result, of as many channels as `x`.
    pub dst: View,
    /// Packed weights of queries, keys and values of the normed x ([`crate::plan::pack::Pack::Halves`]).
    pub qkv: BufferId,
    /// The same of queries and keys of the normed features.
    pub qkf: BufferId,
    /// The biases of `qkv` and of `qkf` once more ([`crate::plan::pack::Pack::BiasRows`]).
    pub biases: [BufferId; 2],
    /// Packed bias table ([`crate::plan::pack::Pack::BiasMatrix`]).
    pub table: BufferId,
    /// Packed weights of the projection ([`crate::plan::pack::Pack::Halves`]).
    pub projection: BufferId,
    /// Channels of queries and keys: 8, 16 or 32.
    pub key_width: u32,
    /// Channels that attend: 16, 32 or 64.
    pub value_width: u32,
    /// Windows of the map.
    pub tiles: Tiles,
}

impl AttentionBlock {
    /// Four kernels that follow each other as one, but for its biases; `None` where they are something else or no
    /// kernel takes them.
    pub fn joined(qkv: &Linear, qkf: &Linear, attention: &WindowAttention, projection: &Linear) -> Option<Self> {
        let (key_width, value_width) = (attention.key_width, attention.value_width);
        let (x, dst, f) = (projection.residual?, projection.dst, qkf.src);
        let attending = View { channels: value_width, ..x };
        let rest = View { first: x.first + value_width, channels: x.channels.checked_sub(value_width)?, ..x };
        let plain = |linear: &Linear| {
            let nothing_else = linear.film.is_none() && linear.activation == Activation::None;
            linear.arithmetic == Arithmetic::Matrices && nothing_else
        };
        let is_block = [qkv, qkf, projection].into_iter().all(plain)
            && [qkv, qkf].iter().all(|linear| linear.norm && linear.residual.is_none())
            && (qkv.src, qkv.dst) == (attending, attention.x)
            && (f.channels, qkf.dst) == (value_width, attention.f)
            && (attention.heads, attention.arithmetic) == (1, Arithmetic::Matrices)
            && (projection.src, projection.src_b) == (attention.dst, (rest.channels > 0).then_some(rest));
        let block = Self {
            x,
            f,
            dst,
            qkv: qkv.weights,
            qkf: qkf.weights,
            biases: [BufferId(0); 2],
            table: attention.bias,
            projection: projection.weights,
            key_width,
            value_width,
            tiles: projection.tiles,
        };
        (is_block && block.special().is_some()).then_some(block)
    }

    fn special(&self) -> Option<Specialisation> {
        let fits = on_matrices::can_load([&self.x, &self.f]) && self.dst.storage == Storage::F16;
        on_matrices::attention_block(self.key_width, self.value_width, self.x.channels).filter(|_| fits)
    }

    /// Outputs of the Linears of x and of the features.
    fn outputs(&self) -> [u32; 2] {
        [2 * self.key_width + self.value_width, 2 * self.key_width]
    }
}

impl Kernel for AttentionBlock {
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::on_matrices(&contracts::ATTENTION_BLOCK_MATRIX, self.special().unwrap_or_default())
    }

    fn groups(&self, variant: &Variant) -> [u32; 3] {
        on_matrices::groups_of(variant.special, self.tiles.count(self.dst.width, self.dst.height), self.dst.channels)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst).in_windows())
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&AttentionBlockPush {
            x: at.view(&self.x),
            f: at.view(&self.f),
            x_weights: at.of(self.qkv),
            x_biases: at.of(self.biases[0]),
            f_weights: at.of(self.qkf),
            f_biases: at.of(self.biases[1]),
            bias: at.of(self.table),
            weights: at.of(self.projection),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            x_stride: self.x.stride / 4,
            f_stride: self.f.stride / 4,
            dst_stride: self.dst.stride / 4,
            dst_channels: self.dst.channels / 4,
            bias_vectors: self.dst.channels.next_multiple_of(TILE_CHANNELS) / 4,
            scale: 1.0 / (self.key_width as f32).sqrt(),
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.x, Access::SAME);
        visit(&mut self.f, Access::SAME);
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        let dense = |inputs: u32, outputs: u32| u64::from(outputs) * (2 * u64::from(inputs) + 4);
        let rows = |outputs: u32| 4 * u64::from(BIAS_ROWS * outputs);
        let [of_x, of_f] = self.outputs();
        Traffic::reading([
            (self.qkv, dense(self.value_width, of_x)),
            (self.qkf, dense(self.value_width, of_f)),
            (self.biases[0], rows(of_x)),
            (self.biases[1], rows(of_f)),
            (self.table, 4 * 64 * 64),
            (self.projection, dense(self.x.channels, self.dst.channels)),
        ])
    }
}

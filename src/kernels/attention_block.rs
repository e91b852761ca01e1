//! The attention of a block as one kernel, for matrices: its norms and Linears, the attention, the projection and the
//! residual. As four kernels they wait for each other, which on small maps takes longer than what they compute.

use super::accesses::Accesses;
use super::accesses::matrix::{OUTPUTS, SUBGROUPS, TOKENS};
use super::contract::Specialisation;
use super::dense::{Linear, TILE_CHANNELS};
use super::on_matrices::{self, DEPTH, MOST_TILES, SHARED_BYTES, outputs_of};
use super::pushes::AttentionBlockPush;
use super::window_attention::WindowAttention;
use super::{
    Access, Activation, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, Tiles,
    Traffic, Variant, View, contracts,
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
        self.cut().filter(|_| fits)
    }

    /// How the kernel cuts its work: `inputs` is what the projection stages at a time of the channels that do not
    /// attend.
    fn cut(&self) -> Option<Specialisation> {
        const TOKENS: u32 = on_matrices::TOKENS;
        let (keys, values) = (self.key_width, self.value_width);
        let rest = self.x.channels.checked_sub(values)?;
        // Within a workgroup's outputs a matrix of queries, keys or values crosses no block of weights.
        if ![8, 16, 32].contains(&keys) || ![16, 32, 64].contains(&values) {
            return None;
        }
        let inputs = [48, 32, 16].into_iter().find(|inputs| rest.is_multiple_of(*inputs))?;
        let rows = |channels: u32| TOKENS * (2 * channels + 16);
        let queries_and_keys = 4 * rows(keys.next_multiple_of(DEPTH));
        let scores = TOKENS * (4 * TOKENS + 16);
        let projection = rows(inputs) + 2 * inputs.max(32) * outputs_of(1);
        // A subgroup's sums of half its tokens, 32 bits each, padded.
        let sums = MOST_TILES * TOKENS / 2 * (4 * TILE_CHANNELS + 16);
        let most = [queries_and_keys, scores, projection, sums].into_iter().max()?;
        let fits = most + rows(values) + 4 * TOKENS <= SHARED_BYTES;
        fits.then(|| Specialisation { tiles: 1, inputs, keys, values, ..Specialisation::default() })
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

    /// Of a window and up to 128 outputs each: its norms and Linears, its attention, its projection.
    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let groups: u64 = self.groups(variant).into_iter().map(u64::from).product();
        let (keys, values) = (u64::from(self.key_width), u64::from(self.value_width));
        let channels = u64::from(self.x.channels);
        let padded = keys.next_multiple_of(DEPTH.into());
        let outputs = 4 * padded + values;
        // Every subgroup loads all weights and biases of its queries' Linears; the projection's are staged.
        let weights = SUBGROUPS * outputs * values / 8 + SUBGROUPS * 4 * outputs;
        let scores = TOKENS * TOKENS / 4;
        let results = SUBGROUPS * TOKENS * OUTPUTS / 4;
        let staged_weights = SUBGROUPS * OUTPUTS * channels / 8;
        let rest = TOKENS * (channels - values) / 8;
        Some(Accesses {
            global_loads: groups * (TOKENS * 2 * values / 8 + weights + scores + rest + staged_weights + 2 * results),
            global_stores: groups * results,
            shared_loads: groups
                * (TOKENS * 2 * values / 8
                    + 2 * (TOKENS + SUBGROUPS * TOKENS) * padded / 8
                    + scores
                    + scores / 2
                    + SUBGROUPS * TOKENS * values / 8
                    + TOKENS * values / 4
                    + SUBGROUPS * (TOKENS + OUTPUTS) * channels / 8
                    + results),
            shared_stores: groups
                * (TOKENS * 2 * values / 8
                    + TOKENS * outputs / 8
                    + scores
                    + scores / 2
                    + TOKENS * values / 4
                    + TOKENS * values / 8
                    + rest
                    + staged_weights
                    + results),
        })
    }
}

//! Joint self-attention in windows of 8x8 tokens.

use super::accesses::Accesses;
use super::accesses::matrix::{SUBGROUPS, TOKENS};
use super::contract::Specialisation;
use super::contracts::{self, halves};
use super::on_matrices::{self, DEPTH};
use super::pushes::WindowAttentionPush;
use super::{
    Access, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, TexelRange, Tiles,
    Traffic, Variant, View, by_storage, groups,
};

/// Head by head: `softmax((Q K^T / sqrt(d) + B) * (Qf Kf^T / sqrt(d) + B)) V`, the product element by element.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowAttention {
    /// `[Q | K | V]`, each head-major.
    pub x: View,
    /// `[Qf | Kf]`, each head-major.
    pub f: View,
    /// Packed bias table: 228 values a head, entry `(dy + 7) * 15 + dx + 7`, query minus key position; 3 of padding. On
    /// matrices a value for every query and key of a head, `[64, 64]`.
    pub bias: BufferId,
    /// The attended values, head-major.
    pub dst: View,
    /// Heads.
    pub heads: u32,
    /// Channels of Q and K per head (d), a multiple of four.
    pub key_width: u32,
    /// Channels of V per head, a multiple of four.
    pub value_width: u32,
    /// Windows of the map.
    pub tiles: Tiles,
    /// What it computes with; on matrices it [`WindowAttention::fits_matrices`].
    pub arithmetic: Arithmetic,
}

impl WindowAttention {
    /// Whether there is a kernel on matrices for its maps: whole vectors of halves, and widths that the subgroups'
    /// matrices divide and shared memory holds.
    pub fn fits_matrices(&self) -> bool {
        self.on_matrices().is_some()
    }

    fn on_matrices(&self) -> Option<Specialisation> {
        let (keys, values) = (self.key_width, self.value_width);
        let fits = keys.is_multiple_of(8) && keys <= 32 && values.is_multiple_of(16) && values <= 64;
        let loads = self.dst.storage == Storage::F16 && on_matrices::can_load([&self.x, &self.f]);
        (fits && loads).then(|| Specialisation { keys, values, ..Specialisation::default() })
    }

    fn chosen(&self) -> Option<Specialisation> {
        self.on_matrices().filter(|_| self.arithmetic == Arithmetic::Matrices)
    }

    fn windows(&self) -> u64 {
        u64::from(self.tiles.count(self.dst.width, self.dst.height)) * u64::from(self.heads)
    }

    fn accesses_on_matrices(&self) -> Accesses {
        let (windows, keys, values) = (self.windows(), u64::from(self.key_width), u64::from(self.value_width));
        let padded = keys.next_multiple_of(DEPTH.into());
        // Both factors of both scores once for each subgroup's queries and their bias; then the row of a softmax, and
        // the values.
        let scores = TOKENS * TOKENS / 4;
        Accesses {
            global_loads: windows * (TOKENS * (4 * keys + values) / 8 + scores),
            global_stores: windows * TOKENS * values / 4,
            shared_loads: windows
                * (2 * (TOKENS + SUBGROUPS * TOKENS) * padded / 8
                    + scores
                    + scores / 2
                    + SUBGROUPS * TOKENS * values / 8
                    + TOKENS * values / 4),
            shared_stores: windows * (TOKENS * (4 * padded + values) / 8 + scores + scores / 2 + TOKENS * values / 4),
        }
    }
}

impl Kernel for WindowAttention {
    fn choose(&self, target: KernelTarget) -> Variant {
        if let Some(special) = self.chosen() {
            return Variant { special, ..Variant::plain(&contracts::WINDOW_ATTENTION_MATRIX) };
        }
        let of = |f32, f16| by_storage(self.dst.storage, f32, f16);
        Variant::plain(match (target.cpu_with(&self.texels()), self.key_width, self.value_width) {
            (true, 8, 16) => of(&contracts::WINDOW_ATTENTION_V16_CPU, &halves::WINDOW_ATTENTION_V16_CPU),
            (true, 16, 32) => of(&contracts::WINDOW_ATTENTION_V32_CPU, &halves::WINDOW_ATTENTION_V32_CPU),
            (true, 32, 32) => of(&contracts::WINDOW_ATTENTION_HEADS_CPU, &halves::WINDOW_ATTENTION_HEADS_CPU),
            (true, ..) => of(&contracts::WINDOW_ATTENTION_CPU, &halves::WINDOW_ATTENTION_CPU),
            (false, ..) => of(&contracts::WINDOW_ATTENTION, &halves::WINDOW_ATTENTION),
        })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), self.heads)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst).in_windows())
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&WindowAttentionPush {
            x: at.view(&self.x),
            f: at.view(&self.f),
            bias: at.of(self.bias),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            x_stride: self.x.stride / 4,
            f_stride: self.f.stride / 4,
            dst_stride: self.dst.stride / 4,
            heads: self.heads,
            key_vectors: self.key_width / 4,
            value_vectors: self.value_width / 4,
            scale: 1.0 / (self.key_width as f32).sqrt(),
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.x, Access::SAME);
        visit(&mut self.f, Access::SAME);
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        let bias = if self.chosen().is_some() { 4 * 64 * 64 } else { 900 };
        Traffic::reading([(self.bias, u64::from(self.heads) * bias)])
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.x).into(), (&self.f).into()]
    }

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        if variant.is_on_matrices() {
            return Some(self.accesses_on_matrices());
        }
        let windows = self.windows();
        let (keys, values) = (u64::from(self.key_width / 4), u64::from(self.value_width / 4));
        if variant.contract.has("QUERIES") {
            // Of every query its own and 64 biases; a lane loads one key in eight.
            let queries = variant.contract.define("QUERIES");
            let loads = queries * (2 * keys + 64) + 8 * (2 * keys + values);
            return Some(Accesses::each(windows * 64 / queries, loads, queries * values));
        }
        // 256 invocations make 4x4 scores each, 64 go over a row three times, 16 tasks for each vector of values.
        let (scores, rows, tasks) = (256, 64, 16 * values);
        Some(Accesses {
            global_loads: windows * (scores * (16 * keys + 16) + tasks * 64),
            global_stores: windows * tasks * 4,
            shared_loads: windows * (rows * 128 + tasks * (64 * 4 + 4)),
            shared_stores: windows * (scores * 16 + rows * 65),
        })
    }
}

//! What a dispatch works on, in words that all kernels share.

use crate::kernels::stats::Counted;
use crate::kernels::winograd::Winograd3x3;
use crate::kernels::{Call, View};
use std::fmt;

/// Size of a dispatch's result and its channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Shape {
    /// Tokens (or pixels) in x; before a shuffle where there is one. 1 for vectors.
    pub width: u32,
    /// Tokens (or pixels) in y.
    pub height: u32,
    /// Channels read.
    pub inputs: u32,
    /// Channels written.
    pub outputs: u32,
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&format!("{}x{} {}>{}", self.width, self.height, self.inputs, self.outputs))
    }
}

impl Shape {
    /// The shape of a call.
    pub fn of(call: &Call) -> Self {
        let of = |width, height, inputs, outputs| Self { width, height, inputs, outputs };
        let between = |src: &View, dst: &View| of(dst.width, dst.height, src.channels, dst.channels);
        match call {
            Call::Conv3x3(k) | Call::Winograd3x3(Winograd3x3 { conv: k, .. }) => {
                let (width, height) = k.result_size();
                of(width, height, k.src.channels, k.channels)
            }
            Call::Linear(k) => {
                let inputs = k.src.channels + k.src_b.map_or(0, |b| b.channels);
                of(k.dst.width, k.dst.height, inputs, k.dst.channels)
            }
            Call::Separable3x3(k) => between(&k.depthwise.src, &k.pointwise.dst),
            Call::Depthwise3x3(k) => between(&k.src, &k.dst),
            Call::Unembed(k) => of(k.src.width, k.src.height, k.src.channels, 4 * k.dst.channels),
            Call::PredictKernels(k) => of(k.dst.width, k.dst.height, k.early.channels, k.dst.channels),
            Call::Halve(k) => between(&k.src, &k.dst),
            Call::ApplyKernels(k) => between(&k.logits, &k.dst),
            Call::MixLevels(k) => between(&k.pixels, &k.dst),
            Call::LayerNorm(k) => between(&k.src, &k.dst),
            Call::WindowAttention(k) => of(k.dst.width, k.dst.height, k.x.channels + k.f.channels, k.dst.channels),
            Call::Expand(k) => between(&k.src, &k.dst),
            Call::TokenSum(k) => of(k.real_width, k.real_height, k.src.channels, k.src.channels),
            Call::FilmVector(k) => of(1, 1, k.channels, k.outputs),
            Call::StatsClear(_) => of(1, 1, 0, 1),
            Call::StatsHistogram(k) => of(k.width, k.height, if k.counted == Counted::Depth { 1 } else { 3 }, 1),
            Call::StatsSelect(_) => of(1, 1, 1, 1),
            Call::StatsTiles(k) => of(k.width, k.height, 3, 1),
            Call::StatsKey(k) => of(k.tiles, 1, 1, 2),
            Call::InputColor(k) => of(k.dst.width, k.dst.height, 3, 3),
            Call::InputAux(k) => of(k.dst.width, k.dst.height, 7, 7),
            Call::Output(k) => of(k.width, k.height, 3, 3),
            Call::TileNoise(k) => of(k.frame.width, k.frame.height, 3, 1),
            Call::QuietMap(k) => of(k.size.columns, k.size.rows, 1, 1),
            Call::TileList(k) => of(k.columns, k.rows, 1, 1),
            Call::Fill(k) => of(k.dst.width, k.dst.height, 0, k.dst.channels),
        }
    }
}

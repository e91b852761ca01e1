//! What a network costs: parameters, and FLOPs at a size. Convolutions, linears, attention matmuls and kernels over
//! images, two per multiply-add; no bias, norm or elementwise work.

use super::graph::Graph;
use super::op::{Op, OpKind, Shape, Slice, conv_outputs};
use super::head::{ALBEDO_SIDE, FULL_OUTPUTS, HIDDEN, KERNEL_SIDE};
use std::ops::AddAssign;

/// FLOPs by the form of the operation that does them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Flops {
    /// Dense 3x3 convolutions.
    pub dense: u64,
    /// Linears.
    pub pointwise: u64,
    /// Depthwise 3x3 convolutions.
    pub depthwise: u64,
    /// The matmuls of attention.
    pub attention: u64,
    /// Predicted kernels over images.
    pub kernels: u64,
}

impl Flops {
    /// All forms together.
    pub fn total(&self) -> u64 {
        self.dense + self.pointwise + self.depthwise + self.attention + self.kernels
    }
}

impl AddAssign for Flops {
    fn add_assign(&mut self, other: Flops) {
        self.dense += other.dense;
        self.pointwise += other.pointwise;
        self.depthwise += other.depthwise;
        self.attention += other.attention;
        self.kernels += other.kernels;
    }
}

/// How many numbers the network's weights hold.
pub fn parameters(graph: &Graph) -> u64 {
    graph.tensors().iter().map(|t| t.elements()).sum()
}

/// The work of one frame of `width` x `height` pixels, padded: multiples of [`super::Arch::pad_multiple`].
pub fn flops(graph: &Graph, width: u32, height: u32) -> Flops {
    let mut sum = Flops::default();
    for op in &graph.ops {
        sum += op_flops(graph, op, width, height);
    }
    sum
}

/// The work of one operation of `graph` on a padded frame of `width` x `height` pixels.
pub fn op_flops(graph: &Graph, op: &Op, width: u32, height: u32) -> Flops {
    let tokens = |map: Slice| tokens(graph, map, width, height);
    let none = Flops::default();
    match &op.kind {
        OpKind::Conv3x3 { input, stride, shuffle, output, .. } => {
            let (step, outputs) = (u64::from(stride * stride), u64::from(conv_outputs(*shuffle, *output)));
            Flops { dense: 2 * 9 * tokens(*input) / step * u64::from(input.channels) * outputs, ..none }
        }
        OpKind::Unembed { input, output, .. } => {
            // 16 tokens for each of a token's four pixels.
            Flops { dense: 2 * 4 * 16 * tokens(*input) * u64::from(input.channels * output.channels), ..none }
        }
        OpKind::Linear { weight, output, .. } => {
            let columns = weight.columns.len() as u64;
            Flops { pointwise: 2 * tokens(*output) * columns * u64::from(output.channels), ..none }
        }
        OpKind::Depthwise3x3 { input, .. } => {
            Flops { depthwise: 2 * 9 * tokens(*input) * u64::from(input.channels), ..none }
        }
        OpKind::WindowAttention { heads, key_width, value_width, output, .. } => {
            // Per query 64 keys: one product each for S_X and S_F, one for the values.
            let per_query = 64 * u64::from(heads * (2 * key_width + value_width));
            Flops { attention: 2 * tokens(graph.whole(*output)) * per_query, ..none }
        }
        OpKind::FilmVector { input, output, .. } => {
            let size = u64::from(graph.whole(*input).channels) * u64::from(graph.whole(*output).channels);
            Flops { pointwise: 2 * size, ..none }
        }
        OpKind::KernelInputs { tokens: coarse, output, .. } => {
            let (of_token, of_pixel) = (u64::from(coarse.channels * 4 * HIDDEN), u64::from(6 * HIDDEN + HIDDEN));
            Flops { pointwise: 2 * (tokens(*coarse) * of_token + tokens(*output) * of_pixel), ..none }
        }
        OpKind::PredictKernels { levels, gloss, output, .. } => {
            // Without the reliability, which was needed before.
            let outputs = u64::from(HIDDEN * (FULL_OUTPUTS - 1 + levels.saturating_sub(3)));
            let taps = u64::from(3 * (KERNEL_SIDE * KERNEL_SIDE * (1 + u32::from(*gloss)) + ALBEDO_SIDE * ALBEDO_SIDE));
            Flops { pointwise: 2 * tokens(*output) * outputs, kernels: 2 * tokens(*output) * taps, ..none }
        }
        OpKind::ApplyKernels { logits, sums, .. } => {
            let taps = u64::from(3 * logits.channels * (sums.channels / 4));
            Flops { kernels: 2 * tokens(*sums) * taps, ..none }
        }
        OpKind::LayerNorm { .. } | OpKind::FilmMean { .. } | OpKind::Halve { .. } | OpKind::MixLevels { .. } => none,
    }
}

/// Tokens of a map on a padded frame of `width` x `height` pixels; 1 for a vector.
pub(super) fn tokens(graph: &Graph, map: Slice, width: u32, height: u32) -> u64 {
    match graph.value(map.value).shape {
        Shape::Map { stride, .. } => u64::from(width / stride) * u64::from(height / stride),
        Shape::Vector { .. } => 1,
    }
}

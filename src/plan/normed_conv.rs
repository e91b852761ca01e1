//! A layer normalisation and the convolution after it, as one kernel.

use super::lower::Lowering;
use crate::kernels::normed_conv::NormedConv3x3;
use crate::kernels::{Arithmetic, Call};
use crate::net::op::OpKind;

/// Norm and convolution.
const OPS: usize = 2;

impl Lowering<'_> {
    /// The kernel of the norm that begins at `at`, its FLOPs, and how many operations it swallows. `None` where none
    /// begins there, where another than the convolution reads it, where no kernel takes both, and where lists of tiles
    /// are made: beyond their tiles the convolution would read normed zeros in place of zeros.
    pub(super) fn normed_conv(&mut self, at: usize) -> Option<(Call, u64, usize)> {
        let graph = self.graph;
        if self.options.arithmetic != Arithmetic::Matrices || self.options.converged.is_some() {
            return None;
        }
        let ops = graph.ops.get(at..at + OPS)?;
        let (OpKind::LayerNorm { output, .. }, OpKind::Conv3x3 { input, .. }) = (&ops[0].kind, &ops[1].kind) else {
            return None;
        };
        let reads = graph.ops.iter().flat_map(|op| graph.reads(op)).filter(|slice| slice.value == *output).count();
        if *input != graph.whole(*output) || reads != 1 {
            return None;
        }
        let flops = ops.iter().map(|op| self.flops(op)).sum();
        let (Call::LayerNorm(norm), Call::Conv3x3(conv)) = (self.op(&ops[0]), self.op(&ops[1])) else { return None };
        let joined = NormedConv3x3::joined(norm, conv)?;
        Some((Call::NormedConv3x3(joined), flops, OPS))
    }
}

//! Operations that run as one kernel.

use super::pack::Pack;
use crate::kernels::Call;
use crate::kernels::separable::Separable3x3;
use crate::kernels::winograd::WinogradTile;
use crate::net::graph::Graph;
use crate::net::op::{ConvWeight, OpKind, Shuffle};

/// Whether operation `at` is a depthwise convolution whose whole result the next one, a Linear, reads, and nobody else.
pub(super) fn is_separable(graph: &Graph, at: usize) -> bool {
    let (Some(OpKind::Depthwise3x3 { output, .. }), Some(OpKind::Linear { inputs, .. })) =
        (graph.ops.get(at).map(|op| &op.kind), graph.ops.get(at + 1).map(|op| &op.kind))
    else {
        return false;
    };
    let readers = graph.ops.iter().filter(|op| graph.reads(op).iter().any(|slice| slice.value == *output)).count();
    *inputs == [graph.whole(*output)] && readers == 1 && graph.residual != *output
}

/// The weights of a dense 3x3 convolution, as the kernel that was chosen reads them.
pub(super) fn conv_pack(
    weight: &ConvWeight,
    bias: bool,
    (inputs, outputs): (u32, u32),
    shuffle: Shuffle,
    tile: Option<WinogradTile>,
) -> Pack {
    let (weight, shuffle) = (weight.clone(), shuffle == Shuffle::Shuffle);
    match tile {
        Some(tile) => Pack::Winograd3x3 { weight, bias, inputs, outputs, shuffle, tile },
        None => Pack::Conv3x3 { weight, bias, inputs, outputs, shuffle },
    }
}

/// The kernels of two operations that [`is_separable`], as one.
pub(super) fn fuse(depthwise: Call, pointwise: Call) -> Call {
    match (depthwise, pointwise) {
        (Call::Depthwise3x3(depthwise), Call::Linear(pointwise)) => {
            Call::Separable3x3(Separable3x3 { depthwise, pointwise })
        }
        other => unreachable!("{other:?} is no separable convolution"),
    }
}

//! Costs in the convention of the thesis's tables, so that its numbers can be compared: what the Python tool thop 0.1.1
//! counts on the original PyTorch networks.
//!
//! Against [`super::cost`] it counts, as multiply-adds, 4 per element of a layer norm and 191 per row of a softmax;
//! leaves out the matmuls of attention and the bias tables; and includes what those networks compute in vain.

use super::arch::Decoder;
use super::cost::{self, Flops};
use super::graph::Graph;
use super::op::{Op, OpKind, Slice};

/// A row of the thesis's tables.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TableCosts {
    /// Numbers that the weights hold.
    pub parameters: u64,
    /// FLOPs on one input of 128x128 pixels.
    pub flops: u64,
}

/// The side of the tables' input in pixels.
const SIDE: u32 = 128;

/// Counts `graph` as the tables do.
pub fn table_costs(graph: &Graph) -> TableCosts {
    let mut costs = TableCosts { parameters: cost::parameters(graph), flops: 0 };
    for op in &graph.ops {
        let Flops { dense, pointwise, depthwise, attention: _, kernels: _ } = cost::op_flops(graph, op, SIDE, SIDE);
        costs.flops += dense + pointwise + depthwise + 2 * overhead(graph, op);
        if let OpKind::WindowAttention { heads, key_width, value_width, output, .. } = op.kind {
            costs.parameters -= u64::from(225 * heads);
            // Multi-head blocks, whose keys are as wide as their values, also make a V from F.
            if key_width == value_width {
                let width = u64::from(heads * value_width);
                costs.parameters += width * (width + 1);
                costs.flops += 2 * tokens(graph, graph.whole(output)) * width * width;
            }
        }
    }
    if graph.arch.decoder == Decoder::Symmetric {
        // The last Up still acts on F1, whose result nobody reads any more.
        let up = graph.ops.iter().filter(|op| op.name == "up.0.x");
        costs.flops += up.map(|op| cost::op_flops(graph, op, SIDE, SIDE).total()).sum::<u64>();
    }
    costs
}

/// What thop counts beside the convolutions and linears of an op, in multiply-adds.
fn overhead(graph: &Graph, op: &Op) -> u64 {
    match &op.kind {
        OpKind::LayerNorm { input, .. } | OpKind::FilmMean { input, .. } => {
            4 * tokens(graph, *input) * u64::from(input.channels)
        }
        // A row has 64 entries: 64 exponentials, 63 additions, 64 divisions.
        OpKind::WindowAttention { heads, output, .. } => 191 * tokens(graph, graph.whole(*output)) * u64::from(*heads),
        _ => 0,
    }
}

fn tokens(graph: &Graph, map: Slice) -> u64 {
    cost::tokens(graph, map, SIDE, SIDE)
}

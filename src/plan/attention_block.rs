//! The four operations of a block's attention, as one kernel.

use super::lower::Lowering;
use super::pack::Pack;
use crate::kernels::attention_block::AttentionBlock;
use crate::kernels::{Arithmetic, BufferId, Call};
use crate::net::op::{LinearWeight, OpKind};
use crate::options::AttentionForm;

/// Queries, keys and values; queries and keys of the features; attention; projection.
const OPS: usize = 4;

impl Lowering<'_> {
    /// The kernel of the attention that begins at `at`, its FLOPs, and how many operations it swallows. `None` where
    /// none begins there, where no kernel takes it, and where kernels of their own are asked for.
    pub(super) fn attention_block(&mut self, at: usize) -> Option<(Call, u64, usize)> {
        let graph = self.graph;
        if self.options.arithmetic != Arithmetic::Matrices || self.options.attention != AttentionForm::Joined {
            return None;
        }
        let ops = graph.ops.get(at..at + OPS)?;
        let (OpKind::Linear { weight: of_x, .. }, OpKind::Linear { weight: of_f, .. }) = (&ops[0].kind, &ops[1].kind)
        else {
            return None;
        };
        if !matches!((&ops[2].kind, &ops[3].kind), (OpKind::WindowAttention { .. }, OpKind::Linear { .. })) {
            return None;
        }
        // What lies between is read by these alone.
        let between = || ops[..OPS - 1].iter().map(|op| graph.result(op).value);
        let others = graph.ops.iter().enumerate().filter(|(i, _)| !(at..at + OPS).contains(i)).map(|(_, op)| op);
        if others.flat_map(|op| graph.reads(op)).any(|slice| between().any(|value| value == slice.value)) {
            return None;
        }
        let flops = ops.iter().map(|op| self.flops(op)).sum();
        let calls: Vec<Call> = ops.iter().map(|op| self.op(op)).collect();
        let [Call::Linear(qkv), Call::Linear(qkf), Call::WindowAttention(attention), Call::Linear(projection)] =
            &calls[..]
        else {
            return None;
        };
        let mut block = AttentionBlock::joined(qkv, qkf, attention, projection)?;
        let names = [&ops[0].name, &ops[1].name];
        block.biases = [(names[0], of_x), (names[1], of_f)].map(|(name, weight)| self.bias_rows(name, weight));
        Some((Call::AttentionBlock(block), flops, OPS))
    }

    fn bias_rows(&mut self, name: &str, weight: &LinearWeight) -> BufferId {
        self.pack(&format!("{name}.biases"), Pack::BiasRows(weight.clone()))
    }
}

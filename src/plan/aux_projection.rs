//! The nine operations that project the features, as one kernel.

use super::lower::Lowering;
use crate::kernels::aux_projection::AuxProjection;
use crate::kernels::{Activation, Arithmetic, Call, Tiles};
use crate::net::op::OpKind;

/// Operations of the projection.
const OPS: usize = 9;

impl Lowering<'_> {
    /// The kernel of the projection that begins at `at`, its FLOPs, and how many operations it swallows. `None` where
    /// none begins there, where its maps do not fit, and where lists of tiles are made: it works on two tiles side by
    /// side.
    pub(super) fn aux_projection(&mut self, at: usize) -> Option<(Call, u64, usize)> {
        let graph = self.graph;
        if self.options.arithmetic != Arithmetic::Matrices || self.options.converged.is_some() {
            return None;
        }
        let ops = graph.ops.get(at..at + OPS)?;
        let OpKind::Linear { inputs, .. } = &ops[0].kind else { return None };
        let steps = ops.chunks_exact(3).all(|step| {
            let kinds = (&step[0].kind, &step[1].kind, &step[2].kind);
            matches!(kinds, (OpKind::Linear { .. }, OpKind::Depthwise3x3 { .. }, OpKind::Linear { .. }))
        });
        if *inputs != [graph.whole(graph.aux)] || !steps {
            return None;
        }
        // What lies between is read by these alone.
        let others = || graph.ops.iter().enumerate().filter(|(i, _)| !(at..at + OPS).contains(i)).map(|(_, op)| op);
        let between: Vec<_> = ops[..OPS - 1].iter().flat_map(|op| graph.writes(op)).map(|slice| slice.value).collect();
        let read = others().flat_map(|op| graph.reads(op)).any(|slice| between.contains(&slice.value));
        if read {
            return None;
        }
        let flops = ops.iter().map(|op| self.flops(op)).sum();
        let calls: Vec<Call> = ops.iter().map(|op| self.op(op)).collect();
        let [
            Call::Linear(first),
            Call::Depthwise3x3(d0),
            Call::Linear(o0),
            Call::Linear(p1),
            Call::Depthwise3x3(d1),
            Call::Linear(o1),
            Call::Linear(p2),
            Call::Depthwise3x3(d2),
            Call::Linear(o2),
        ] = &calls[..]
        else {
            return None;
        };
        let dense = [first, o0, p1, o1, p2, o2];
        let fits = dense.iter().all(|linear| linear.arithmetic == Arithmetic::Matrices && linear.film.is_none())
            && [d0, d1, d2].iter().all(|depthwise| depthwise.activation == Activation::LeakyRelu)
            && dense[..5].iter().all(|linear| linear.activation == Activation::None)
            && o2.activation == Activation::LeakyRelu
            && AuxProjection::fits_matrices(&first.src, &o2.dst);
        fits.then(|| {
            let projection = AuxProjection {
                src: first.src,
                dst: o2.dst,
                pointwise: [first, p1, p2].map(|linear| linear.weights),
                depthwise: [d0, d1, d2].map(|depthwise| depthwise.weights),
                out: [o0, o1, o2].map(|linear| linear.weights),
                tiles: Tiles::All,
            };
            (Call::AuxProjection(projection), flops, OPS)
        })
    }
}

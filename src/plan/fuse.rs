//! Operations that run as one kernel: a rule for each such kernel.

use super::pack::Pack;
use super::steps::Steps;
use crate::kernels::attention_block::AttentionBlock;
use crate::kernels::aux_projection::AuxProjection;
use crate::kernels::embedding::{Embedding, Pixels};
use crate::kernels::ffn::Ffn;
use crate::kernels::normed_conv::NormedConv3x3;
use crate::kernels::separable::Separable3x3;
use crate::kernels::{Activation, Arithmetic, BufferId, Call, Tiles};
use crate::net::graph::Graph;
use crate::net::op::{LinearWeight, OpKind, ValueId};
use crate::options::{AttentionForm, FfnForm};

/// Operations of the features' projection: three times a Linear, a depthwise convolution, a Linear.
const PROJECTION_OPS: usize = 9;
/// Operations of a block's attention: queries, keys and values; queries and keys of the features; attention;
/// projection.
const ATTENTION_OPS: usize = 4;
/// Operations of an FFN: a Linear, a depthwise convolution, a Linear.
const FFN_OPS: usize = 3;

impl Steps<'_> {
    /// The kernel of several operations that begin at `at`, by the first rule that has one, and how many they are.
    pub(super) fn fused(&mut self, at: usize) -> Option<(Call, usize)> {
        let rules = [
            Self::aux_projection,
            Self::color_embedding,
            Self::features_embedding,
            Self::attention_block,
            Self::normed_conv,
            Self::ffn,
            Self::separable,
        ];
        rules.into_iter().find_map(|rule| rule(self, at))
    }

    /// The kernel of the projection that begins at `at`, and how many operations it swallows. `None` where
    /// none begins there, where its maps do not fit, and where lists of tiles are made: it works on two tiles side by
    /// side.
    fn aux_projection(&mut self, at: usize) -> Option<(Call, usize)> {
        let graph = self.graph;
        if self.target.arithmetic != Arithmetic::Matrices || self.target.converged.is_some() {
            return None;
        }
        let ops = graph.ops.get(at..at + PROJECTION_OPS)?;
        let OpKind::Linear { inputs, .. } = &ops[0].kind else { return None };
        let steps = ops.chunks_exact(3).all(|step| {
            let kinds = (&step[0].kind, &step[1].kind, &step[2].kind);
            matches!(kinds, (OpKind::Linear { .. }, OpKind::Depthwise3x3 { .. }, OpKind::Linear { .. }))
        });
        if *inputs != [graph.whole(graph.aux)] || !steps || !is_closed(graph, at, PROJECTION_OPS) {
            return None;
        }
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
            (Call::AuxProjection(projection), PROJECTION_OPS)
        })
    }

    /// The kernel of the attention that begins at `at`, and how many operations it swallows. `None` where
    /// none begins there, where no kernel takes it, and where kernels of their own are asked for.
    fn attention_block(&mut self, at: usize) -> Option<(Call, usize)> {
        let graph = self.graph;
        if self.target.arithmetic != Arithmetic::Matrices || self.target.attention != AttentionForm::Joined {
            return None;
        }
        let ops = graph.ops.get(at..at + ATTENTION_OPS)?;
        let (OpKind::Linear { weight: of_x, .. }, OpKind::Linear { weight: of_f, .. }) = (&ops[0].kind, &ops[1].kind)
        else {
            return None;
        };
        let attends = matches!((&ops[2].kind, &ops[3].kind), (OpKind::WindowAttention { .. }, OpKind::Linear { .. }));
        if !attends || !is_closed(graph, at, ATTENTION_OPS) {
            return None;
        }
        let calls: Vec<Call> = ops.iter().map(|op| self.op(op)).collect();
        let [Call::Linear(qkv), Call::Linear(qkf), Call::WindowAttention(attention), Call::Linear(projection)] =
            &calls[..]
        else {
            return None;
        };
        let mut block = AttentionBlock::joined(qkv, qkf, attention, projection)?;
        let names = [&ops[0].name, &ops[1].name];
        let of = [(names[0], of_x), (names[1], of_f)];
        block.biases = of.map(|(name, weight)| self.bias_rows(name, linear_of(weight)));
        Some((Call::AttentionBlock(block), ATTENTION_OPS))
    }

    fn bias_rows(&mut self, name: &str, dense: Pack) -> BufferId {
        self.pack(&format!("{name}.biases"), Pack::BiasRows(Box::new(dense)))
    }

    /// The colour's projection that begins at `at` and its embedding in tokens, with what a head takes of it between
    /// them. `None` where none begins there, where no kernel takes them, and where lists of tiles are made: those of
    /// pixels are others than those of tokens.
    fn color_embedding(&mut self, at: usize) -> Option<(Call, usize)> {
        let graph = self.graph;
        if self.target.arithmetic != Arithmetic::Matrices {
            return None;
        }
        let OpKind::Conv3x3 { input, weight, bias, output: projected, .. } = &graph.ops[at].kind else { return None };
        let early = matches!(graph.ops.get(at + 1)?.kind, OpKind::Linear { .. });
        let ops = 2 + usize::from(early);
        let OpKind::Conv3x3 { input: embedded, .. } = &graph.ops.get(at + ops - 1)?.kind else { return None };
        let mut others = graph.ops.iter().enumerate().filter(|(i, _)| !(at..at + ops).contains(i));
        let read_elsewhere = others.any(|(_, op)| graph.reads(op).iter().any(|slice| slice.value == projected.value));
        if *input != graph.whole(graph.color) || embedded != projected || read_elsewhere {
            return None;
        }
        let (Call::Conv3x3(projection), Call::Conv3x3(embedding)) =
            (self.op(&graph.ops[at]), self.op(&graph.ops[at + ops - 1]))
        else {
            return None;
        };
        let between = match early.then(|| self.op(&graph.ops[at + 1])) {
            None => None,
            Some(Call::Linear(linear)) => Some(linear),
            Some(_) => return None,
        };
        let mut embedding = Embedding::of_projected(&projection, between.as_ref(), &embedding)?;
        let pack = Pack::Conv3x3 {
            weight: weight.clone(),
            bias: *bias,
            inputs: input.channels,
            outputs: projected.channels,
            shuffle: false,
        };
        // With lists too: weights are packed alike for a frame and for one in tiles, which has none.
        let rows = self.bias_rows(&graph.ops[at].name, pack);
        if let Pixels::Projected { biases, .. } = &mut embedding.pixels {
            *biases = rows;
        }
        self.target.converged.is_none().then_some((Call::Embedding(embedding), ops))
    }

    /// The embedding of the features in tokens, with the head's Linear of them that is right before it. By itself too,
    /// where a head makes the features' part again at its end: its sums have another order in a convolution's own
    /// kernel. `None` where they are something else, and where lists of tiles are made: those of pixels are others than
    /// those of tokens.
    fn features_embedding(&mut self, at: usize) -> Option<(Call, usize)> {
        let graph = self.graph;
        let has_head = graph.arch.head.kernels().is_some();
        if self.target.arithmetic != Arithmetic::Matrices || self.target.converged.is_some() || !has_head {
            return None;
        }
        let early = match &graph.ops[at].kind {
            OpKind::Linear { inputs, .. } => Some(inputs),
            _ => None,
        };
        let ops = 1 + usize::from(early.is_some());
        let embedding = graph.ops.get(at + ops - 1)?;
        let OpKind::Conv3x3 { input, .. } = &embedding.kind else { return None };
        if early.is_some_and(|inputs| *inputs != [*input]) {
            return None;
        }
        let linear = match early.map(|_| self.op(&graph.ops[at])) {
            None => None,
            Some(Call::Linear(linear)) => Some(linear),
            Some(_) => return None,
        };
        let Call::Conv3x3(embedding) = self.op(embedding) else { return None };
        Some((Call::Embedding(Embedding::of_stored(linear.as_ref(), &embedding)?), ops))
    }

    /// The norm that begins at `at` and the convolution that alone reads its result. `None` where none begins there,
    /// where no kernel takes both, and where lists of tiles are made: beyond their tiles the convolution would read
    /// normed zeros in place of zeros.
    fn normed_conv(&mut self, at: usize) -> Option<(Call, usize)> {
        let graph = self.graph;
        if self.target.arithmetic != Arithmetic::Matrices || self.target.converged.is_some() {
            return None;
        }
        let [norm, conv] = graph.ops.get(at..at + 2)? else { return None };
        let (OpKind::LayerNorm { output, .. }, OpKind::Conv3x3 { input, .. }) = (&norm.kind, &conv.kind) else {
            return None;
        };
        if *input != graph.whole(*output) || !is_closed(graph, at, 2) {
            return None;
        }
        match (self.op(norm), self.op(conv)) {
            (Call::LayerNorm(norm), Call::Conv3x3(conv)) => {
                Some((Call::NormedConv3x3(NormedConv3x3::joined(norm, conv)?), 2))
            }
            _ => None,
        }
    }

    /// The kernel of the FFN that begins at `at`, and how many operations it swallows. `None` where none begins there,
    /// where no kernel takes it, where kernels of their own are asked for, and where lists of tiles are made: beyond
    /// their tiles hidden channels are zeros in memory, and would be those of zeros.
    fn ffn(&mut self, at: usize) -> Option<(Call, usize)> {
        let graph = self.graph;
        if self.target.arithmetic != Arithmetic::Matrices || self.target.ffn != FfnForm::Joined {
            return None;
        }
        let [expand, depthwise, _] = graph.ops.get(at..at + FFN_OPS)? else { return None };
        let OpKind::Linear { weight, .. } = &expand.kind else { return None };
        if !matches!(depthwise.kind, OpKind::Depthwise3x3 { .. }) || !is_closed(graph, at, FFN_OPS) {
            return None;
        }
        let (Call::Linear(first), Some((Call::Separable3x3(separable), _))) = (self.op(expand), self.separable(at + 1))
        else {
            return None;
        };
        let ffn = Ffn::joined(&first, &separable)?;
        // With lists too: weights are packed alike for a frame and for one in tiles, which has none.
        let biases = self.bias_rows(&expand.name, linear_of(weight));
        self.target.converged.is_none().then_some((Call::Ffn(Ffn { biases, ..ffn }), FFN_OPS))
    }

    /// A depthwise convolution and the Linear that alone reads its result, all of it.
    fn separable(&mut self, at: usize) -> Option<(Call, usize)> {
        let (graph, form) = (self.graph, self.target.separable);
        let [depthwise, pointwise] = graph.ops.get(at..at + 2)? else { return None };
        let (OpKind::Depthwise3x3 { output, .. }, OpKind::Linear { inputs, .. }) = (&depthwise.kind, &pointwise.kind)
        else {
            return None;
        };
        let pays = form.fuses(graph.result(depthwise).channels, graph.result(pointwise).channels);
        if !pays || *inputs != [graph.whole(*output)] || !is_closed(graph, at, 2) {
            return None;
        }
        match (self.op(depthwise), self.op(pointwise)) {
            (Call::Depthwise3x3(depthwise), Call::Linear(pointwise)) => {
                Some((Call::Separable3x3(Separable3x3 { depthwise, pointwise }), 2))
            }
            _ => None,
        }
    }
}

fn linear_of(weight: &LinearWeight) -> Pack {
    Pack::Linear(weight.clone())
}

/// Whether what lies between so many operations from `at` on is read by these alone.
fn is_closed(graph: &Graph, at: usize, ops: usize) -> bool {
    let between: Vec<ValueId> =
        graph.ops[at..at + ops - 1].iter().flat_map(|op| graph.writes(op)).map(|slice| slice.value).collect();
    let others = graph.ops.iter().enumerate().filter(|(i, _)| !(at..at + ops).contains(i)).map(|(_, op)| op);
    let kept = between.contains(&graph.residual);
    !kept && !others.flat_map(|op| graph.reads(op)).any(|slice| between.contains(&slice.value))
}

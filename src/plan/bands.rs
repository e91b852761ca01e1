//! Chains of operations that run band by band: what lies between them exists for some rows of the frame at a time, so
//! that wide maps at full resolution never exist in whole.
//!
//! A band of a chain works on the rows that its part of the result depends on, as on a map of their own: its border is
//! the frame's where it touches it, and elsewhere so far away from the rows that count that its zero padding reaches
//! none of them. So the result has the bits of the whole.

use super::lower::Lowering;
use super::region::restrict_chain;
use super::steps::Step;
use crate::frame::Region;
use crate::kernels::{BufferId, Call, TILE, energy, predicted};
use crate::net::graph::Graph;
use crate::net::op::{Op, OpKind, Shape, ValueId};
use crate::target::Target;
use std::collections::{HashMap, HashSet};

/// Rows of the padded frame that a chain works on, in pixels.
pub(super) struct Band {
    pub top: u32,
    pub bottom: u32,
    /// Buffers of what only the chain touches, as the steps name them.
    locals: Vec<BufferId>,
    /// The band's own in their place.
    pub buffers: HashMap<BufferId, BufferId>,
}

impl Band {
    pub fn height(&self) -> u32 {
        self.bottom - self.top
    }

    pub fn is_local(&self, buffer: BufferId) -> bool {
        self.locals.contains(&buffer)
    }
}

impl Lowering<'_> {
    /// Lowers the step at `at`, or the chain that begins there where it pays. Returns how many steps that were.
    pub(super) fn chain(&mut self, at: usize) -> usize {
        let steps = self.steps;
        let first = steps.steps[at].ops.start;
        let mut chain = Chain::new(self.graph, first, self.options, &self.stored, head_in_bands(self.graph));
        let mut bands = self.bands(&chain);
        // The head reaches far: bands that are nearly the frame save nothing.
        if chain.makes_picture && self.rows(&chain, bands) + chain.above + chain.below >= self.padded.height {
            chain = Chain::new(self.graph, first, self.options, &self.stored, None);
            bands = self.bands(&chain);
        }
        let count = steps.steps[at..].iter().take_while(|step| step.ops.start < chain.at + chain.ops).count();
        let chained = &steps.steps[at..at + count];
        // Lists of active tiles are those of whole maps. What a kernel of several operations leaves beside its result
        // stays, and where others of the chain follow it would be written beyond the band's rows, where it need not be
        // right.
        let before_last = &chained[..count.saturating_sub(1)];
        let leaves_more = before_last.iter().any(|step| step.ops.len() > 1 && step.call.results().len() > 1);
        if bands < 2 || leaves_more || self.options.converged.is_some() {
            self.step(&steps.steps[at]);
            return 1;
        }
        let rows = self.rows(&chain, bands);
        for (number, first) in (0..self.padded.height).step_by(rows as usize).enumerate() {
            let end = (first + rows).min(self.padded.height);
            self.lower_band(&chain, chained, number as u32, (first, end));
        }
        count
    }

    /// Into how many bands a chain is cut; fewer than 2: it is not.
    fn bands(&self, chain: &Chain) -> u32 {
        let widest = chain.widest * self.padded.pixels() / 256;
        let bands = widest.div_ceil(self.options.max_chain_bytes.max(1));
        bands.min(u64::from(self.padded.height / chain.grain)) as u32
    }

    /// The pixel rows of a band.
    fn rows(&self, chain: &Chain, bands: u32) -> u32 {
        (self.padded.height / chain.grain).div_ceil(bands.max(1)) * chain.grain
    }

    /// Lowers a step for the whole frame.
    fn step(&mut self, step: &Step) {
        let op = &self.graph.ops[step.ops.end - 1];
        let call = self.placed(&step.call);
        self.push(&op.name, op.stage, self.flops(step), call);
    }

    /// Lowers the chain for the pixel rows `first..end` of its result.
    fn lower_band(&mut self, chain: &Chain, steps: &[Step], number: u32, (first, end): (u32, u32)) {
        // The picture of the last rows waits for the next band: what is given back there is between two squares.
        let before = if chain.makes_picture { first.saturating_sub(energy::BLOCK / 2) } else { first };
        let top = first.saturating_sub(chain.above);
        let bottom = (end + chain.below).min(self.padded.height);
        let picture = chain.makes_picture.then_some(&self.graph.residual);
        let locals = chain.locals.iter().chain(picture).filter_map(|value| self.steps.values.get(value));
        let locals = locals.copied().collect();
        self.band = Some(Band { top, bottom, locals, buffers: HashMap::new() });
        let placed = |step: &Step| (step.ops.end - 1, self.placed(&step.call), self.flops(step));
        let mut calls: Vec<_> = steps.iter().map(placed).collect();
        self.band = None;
        let stays = |op: usize| {
            let mut written = self.graph.writes(&self.graph.ops[op]).into_iter();
            written.any(|slice| !chain.locals.contains(&slice.value))
        };
        let results: Vec<bool> = calls.iter().map(|(op, ..)| stays(*op)).collect();
        let mut only: Vec<&mut Call> = calls.iter_mut().map(|(_, call, _)| call).collect();
        restrict_chain(&mut only, &results, (top, bottom), (before, end));
        let result = calls.last().and_then(|(_, call, _)| call.result());
        for (op, call, flops) in calls {
            let op = &self.graph.ops[op];
            let Some(grid) = call.grid() else { continue };
            let [count, all] = grid.counts().map(u64::from);
            // FLOPs are those of the whole map; the band's share counts what it computes.
            let whole = all * u64::from(self.padded.height) / u64::from(bottom - top);
            let flops = flops * count / whole.max(1);
            self.push(&format!("{}.band{number}", op.name), op.stage, flops, call);
            if let Some(dispatch) = self.dispatches.last_mut() {
                dispatch.band = Some(number);
            }
        }
        if let Some(picture) = result.filter(|_| chain.makes_picture) {
            let all = Region::all(self.extent);
            self.energy(&format!("output.energy.band{number}"), picture, top, (first, end));
            let end = if end < self.padded.height { end - energy::BLOCK / 2 } else { end };
            let rows = Region { y: before, height: end.min(all.height).saturating_sub(before), ..all };
            self.frame_out(&format!("output.band{number}"), picture, top, rows);
        }
    }
}

/// Consecutive operations of which only the last one's result is read by others, and what is kept for predicted
/// kernels.
struct Chain {
    at: usize,
    ops: usize,
    /// What lies between them.
    locals: Vec<ValueId>,
    /// Bytes of the widest of those, for 256 pixels.
    widest: u64,
    /// Pixel rows, a multiple of `grain`, that a row of the result reaches above itself; that of a picture the half of
    /// a square too that waits for the next band.
    above: u32,
    /// The same below.
    below: u32,
    /// Pixel rows of a tile of the coarsest map touched, of a picture a square of it at least.
    grain: u32,
    /// Whether its result is the network's, to be made a picture band by band too.
    makes_picture: bool,
}

impl Chain {
    /// The longest chain that begins at `at`; a single operation if there is no longer one. `head`: the first operation
    /// of a head that may be one chain to the picture; `stored`: the values that kernels leave in memory.
    fn new(graph: &Graph, at: usize, target: &Target, stored: &HashSet<ValueId>, head: Option<usize>) -> Self {
        let (ops, locals, makes_picture) = (1, Vec::new(), false);
        let mut best = Self { at, ops, locals, widest: 0, above: 0, below: 0, grain: TILE, makes_picture };
        let mut made: Vec<ValueId> = Vec::new();
        let kept = kept_for_kernels(graph);
        let head = head.filter(|_| !target.signals);
        // How far what is made reaches, and the farthest.
        let mut reaches: HashMap<ValueId, u32> = HashMap::new();
        let (mut reach, mut grain) = (0, TILE);
        for (i, op) in graph.ops.iter().enumerate().skip(at) {
            let Some(step) = reach_of(graph, op) else { break };
            // Kernels, and what they are predicted from, are read for every signal. Where memory counts less than
            // dispatches, levels are made of the whole frame. The head's chain is its own: it reaches far.
            let of_kernels = matches!(op.kind, OpKind::PredictKernels { .. } | OpKind::ApplyKernels { .. });
            if target.signals && of_kernels
                || head.is_none() && matches!(op.kind, OpKind::Halve { .. })
                || head.is_some_and(|first| at < first && first <= i)
            {
                break;
            }
            let before = graph.reads(op).into_iter().filter_map(|slice| reaches.get(&slice.value));
            let own = step + before.max().unwrap_or(&0);
            graph.writes(op).into_iter().for_each(|slice| {
                let reach = reaches.entry(slice.value).or_default();
                *reach = own.max(*reach);
            });
            reach = reach.max(own);
            let touched = graph.reads(op).into_iter().chain([graph.result(op)]);
            grain = touched.filter_map(|slice| stride_of(graph, slice.value)).fold(grain, |g, s| g.max(TILE * s));
            let result = graph.result(op).value;
            let closed = made.iter().all(|value| is_read_within(graph, *value, at, i + 1));
            if closed && i > at {
                let bytes = |value: &ValueId| match graph.value(*value).shape {
                    Shape::Map { stride, channels } => {
                        u64::from(channels.next_multiple_of(4)) * target.storage.bytes() * 256
                            / u64::from(stride * stride)
                    }
                    Shape::Vector { .. } => 0,
                };
                let widest = made.iter().filter(|value| stored.contains(value)).map(bytes).max().unwrap_or(0);
                let (ops, locals) = (i + 1 - at, made.clone());
                let makes_picture = head.is_some() && result == graph.residual;
                // A picture gets light back square by square.
                let (grain, waits) = match makes_picture {
                    true => (grain.max(energy::BLOCK), energy::BLOCK / 2),
                    false => (grain, 0),
                };
                let [above, below] = [reach + waits, reach].map(|rows| rows.next_multiple_of(grain));
                best = Self { at, ops, locals, widest, above, below, grain, makes_picture };
            }
            if !kept.contains(&result) {
                made.push(result);
            }
            if let (OpKind::KernelInputs { taps, .. }, Some(_)) = (&op.kind, head) {
                made.push(taps.value);
            }
        }
        best
    }
}

/// Pixels that a token of the result reaches beyond itself; `None` for operations that need more than their
/// neighbourhood.
fn reach_of(graph: &Graph, op: &Op) -> Option<u32> {
    match &op.kind {
        OpKind::Conv3x3 { input, .. } => stride_of(graph, input.value),
        OpKind::Depthwise3x3 { input, .. } => stride_of(graph, input.value),
        OpKind::Unembed { input, .. } => stride_of(graph, input.value).map(|stride| 2 * stride),
        OpKind::Linear { .. } | OpKind::LayerNorm { .. } => Some(0),
        // What kernels read beyond their rows, in whole tiles: of taps, which may stay, all that is written counts.
        OpKind::KernelInputs { tokens, .. } => {
            stride_of(graph, tokens.value).map(|stride| predicted::REACH.next_multiple_of(TILE * stride))
        }
        OpKind::PredictKernels { .. } => Some(0),
        OpKind::Halve { .. } => Some(0),
        OpKind::ApplyKernels { sums, .. } => stride_of(graph, sums.value).map(|stride| predicted::REACH * stride),
        OpKind::MixLevels { levels, .. } => levels.iter().filter_map(|level| stride_of(graph, level.value)).max(),
        OpKind::WindowAttention { .. } | OpKind::FilmMean { .. } | OpKind::FilmVector { .. } => None,
    }
}

/// What is made of maps at full size for predicted kernels, long before these: nothing, where it is made again.
fn kept_for_kernels(graph: &Graph) -> Vec<ValueId> {
    let Some(early) = graph.kept_for_kernels().filter(|_| !is_made_late(graph)) else { return Vec::new() };
    let maker = graph.ops.iter().find(|op| graph.result(op).value == early);
    let before = match maker.map(|op| &op.kind) {
        Some(OpKind::Linear { residual, .. }) => residual.map(|before| before.value),
        _ => None,
    };
    [early].into_iter().chain(before).collect()
}

/// The first operation of the head, where all of it is to run band by band: where nothing is kept for it.
fn head_in_bands(graph: &Graph) -> Option<usize> {
    let tokens = graph.ops.iter().find_map(|op| match &op.kind {
        OpKind::KernelInputs { tokens, .. } => Some(tokens.value),
        _ => None,
    })?;
    let last = graph.ops.iter().rposition(|op| graph.result(op).value == tokens)?;
    is_made_late(graph).then_some(last + 1)
}

/// Whether what is made of maps at full size for predicted kernels is made right before it is read
/// ([`Graph::rematerialized`]).
fn is_made_late(graph: &Graph) -> bool {
    let Some(early) = graph.kept_for_kernels() else { return false };
    graph.ops.windows(2).any(|ops| {
        graph.result(&ops[0]).value == early && matches!(ops[1].kind, OpKind::KernelInputs { .. })
    })
}

fn stride_of(graph: &Graph, value: ValueId) -> Option<u32> {
    match graph.value(value).shape {
        Shape::Map { stride, .. } => Some(stride),
        Shape::Vector { .. } => None,
    }
}

/// Whether a value is whole after one of the operations `from..to`, and read by no others.
fn is_read_within(graph: &Graph, value: ValueId, from: usize, to: usize) -> bool {
    let kept = [graph.color, graph.aux, graph.residual].contains(&value);
    !kept
        && graph
            .ops
            .iter()
            .enumerate()
            .filter(|(i, _)| !(from..to).contains(i))
            .all(|(_, op)| graph.result(op).value != value && graph.reads(op).iter().all(|slice| slice.value != value))
}

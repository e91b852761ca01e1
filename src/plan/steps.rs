//! What runs, before there is a size: which operations run as one kernel, what each computes with, how maps are stored,
//! and the weights that all of that reads. It follows from graph and target alone.

use super::pack::Pack;
use super::packing::Packing;
use super::{Buffer, Place};
use crate::kernels::{BufferId, Call, Storage, View, stats};
use crate::net::graph::Graph;
use crate::net::op::{Shape, Slice, ValueId};
use crate::target::Target;
use std::collections::{HashMap, HashSet};
use std::ops::Range;

/// A kernel that stands for operations of the graph.
pub(super) struct Step {
    /// Which, one after the other.
    pub ops: Range<usize>,
    /// Their kernel. Its maps have neither width nor height, and lie in the buffers of the values that they are.
    pub call: Call,
}

/// How large a buffer will be.
#[derive(Clone, Copy, Debug)]
pub(super) enum Size {
    /// So many bytes.
    Bytes(u64),
    /// A token of so many channels for every square of so many pixels on a side.
    Map { stride: u32, channels: u32 },
    /// What the frame's size makes of it.
    OfFrame,
}

/// How a network's weights are packed for the plans of a target.
pub fn packing(graph: &Graph, target: &Target) -> Packing {
    Steps::new(&graph.folded(target.folds), target, false, Packing::default()).packing
}

/// The same for the network of the turned frame, after what is packed for the frame's own.
pub fn packing_after(own: &Packing, graph: &Graph, target: &Target) -> Packing {
    Steps::new(&graph.folded(target.folds), target, false, Packing::after(own)).packing
}

/// The same for plans of a network's part ([`super::plan_part`]).
pub fn packing_of_part(graph: &Graph, target: &Target) -> Packing {
    Steps::new(&graph.folded(target.folds), target, true, Packing::default()).packing
}

/// The steps of a graph, with the buffers that they name.
pub(super) struct Steps<'a> {
    pub graph: &'a Graph,
    pub target: &'a Target,
    /// Whether the graph is a network's part, whose input and result are maps like all others.
    is_part: bool,
    pub steps: Vec<Step>,
    /// Those of values without bytes yet, which [`Steps::sizes`] tells.
    pub buffers: Vec<Buffer>,
    pub sizes: Vec<Size>,
    pub packing: Packing,
    /// Buffer of every value that has one.
    pub values: HashMap<ValueId, BufferId>,
    packs: HashMap<Pack, BufferId>,
    /// The frame's statistics.
    pub stats: BufferId,
}

impl<'a> Steps<'a> {
    /// The values that a kernel reads or writes: not those between operations that run as one.
    pub fn stored(&self) -> HashSet<ValueId> {
        let maps = self.steps.iter().flat_map(|step| step.call.maps());
        let touched: HashSet<BufferId> = maps.map(|(view, _)| view.buffer).collect();
        self.values.iter().filter(|(_, buffer)| touched.contains(buffer)).map(|(value, _)| *value).collect()
    }

    /// Of a folded graph. What it packs beyond `packing` is added.
    pub fn new(graph: &'a Graph, target: &'a Target, is_part: bool, packing: Packing) -> Self {
        Self::among(Vec::new(), graph, target, is_part, packing)
    }

    /// The same, with buffers that come after those of another network.
    pub fn among(
        buffers: Vec<Buffer>,
        graph: &'a Graph,
        target: &'a Target,
        is_part: bool,
        packing: Packing,
    ) -> Self {
        let mut steps = Self {
            graph,
            target,
            is_part,
            steps: Vec::new(),
            sizes: buffers.iter().map(|buffer| Size::Bytes(buffer.bytes)).collect(),
            stats: BufferId(buffers.len()),
            buffers,
            packing,
            values: HashMap::new(),
            packs: HashMap::new(),
        };
        steps.buffer("stats", Size::Bytes(stats::STATS_FLOATS * 4), Storage::F32);
        for value in [graph.color, graph.aux, graph.residual] {
            steps.value(value);
        }
        let mut at = 0;
        while at < graph.ops.len() {
            let (call, ops) = steps.fused(at).unwrap_or_else(|| (steps.op(&graph.ops[at]), 1));
            steps.steps.push(Step { ops: at..at + ops, call });
            at += ops;
        }
        steps
    }

    pub(super) fn buffer(&mut self, name: &str, size: Size, storage: Storage) -> BufferId {
        let bytes = if let Size::Bytes(bytes) = size { bytes } else { 0 };
        // Placed when all lifetimes are known.
        let place = Place::Arena { block: 0, offset: 0 };
        self.buffers.push(Buffer { name: name.to_owned(), bytes, storage, place });
        self.sizes.push(size);
        BufferId(self.buffers.len() - 1)
    }

    /// The buffer of weights, the same for the same.
    pub(super) fn pack(&mut self, name: &str, pack: Pack) -> BufferId {
        if let Some(&id) = self.packs.get(&pack) {
            return id;
        }
        let id = self.buffer(name, Size::Bytes(pack.bytes()), Storage::F32);
        let offset = self.packing.place(pack.clone());
        self.buffers[id.0].place = Place::Weights { pack: pack.clone(), offset, turned: false };
        self.packs.insert(pack, id);
        id
    }

    /// How a value is stored: the network's maps as the target says, its input and result in full, and so radiance.
    fn storage(&self, id: ValueId) -> Storage {
        let whole = [self.graph.color, self.graph.residual].contains(&id) || self.graph.is_of_kernels(id);
        let full = !self.is_part && whole;
        let is_map = matches!(self.graph.value(id).shape, Shape::Map { .. });
        if is_map && !full { self.target.storage } else { Storage::F32 }
    }

    /// The buffer of a value.
    pub(super) fn value(&mut self, id: ValueId) -> BufferId {
        if let Some(&buffer) = self.values.get(&id) {
            return buffer;
        }
        let value = self.graph.value(id);
        let size = match value.shape {
            Shape::Map { stride, channels } => Size::Map { stride, channels: channels.next_multiple_of(4) },
            Shape::Vector { len } => Size::Bytes(u64::from(len) * 4),
        };
        let buffer = self.buffer(&value.name, size, self.storage(id));
        self.values.insert(id, buffer);
        buffer
    }

    /// All of a map that has a buffer.
    pub(super) fn of_value(&self, id: ValueId) -> View {
        self.view_in(self.values[&id], self.graph.whole(id))
    }

    /// A map's channels, of no size yet.
    pub(super) fn view(&mut self, slice: Slice) -> View {
        let buffer = self.value(slice.value);
        self.view_in(buffer, slice)
    }

    fn view_in(&self, buffer: BufferId, slice: Slice) -> View {
        let channels = match self.graph.value(slice.value).shape {
            Shape::Map { channels, .. } => channels,
            Shape::Vector { len } => len,
        };
        View {
            buffer,
            first: slice.first,
            channels: slice.channels.next_multiple_of(4),
            stride: channels.next_multiple_of(4),
            width: 0,
            height: 0,
            top: 0,
            storage: self.storage(slice.value),
        }
    }

    pub(super) fn whole(&mut self, id: ValueId) -> View {
        let slice = self.graph.whole(id);
        self.view(slice)
    }
}

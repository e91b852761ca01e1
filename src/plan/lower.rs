//! From graph and size to dispatches.

use super::arena::{self, Limits, Request};
use super::bands::Band;
use super::featureless::{self, For};
use super::pack::Pack;
use super::tile::Given;
use super::{Buffer, Dispatch, Place, Plan, features, hazards, converged};
use crate::error::{Error, Result};
use crate::frame::{Extent, Region};
use crate::kernels::stats::Counted;
use crate::kernels::{BufferId, Call, Storage, Tiles, View, frame_io, stats};
use crate::net::cost::op_flops;
use crate::net::graph::Graph;
use crate::net::op::{Op, Shape, Slice, Stage, ValueId};
use crate::target::Target;
use std::collections::HashMap;

/// Pixels on a side that coordinates of tiles (16 bits) and strides (32 bits) hold with room to spare.
const MAX_SIDE: u32 = 1 << 18;

/// Plans one forward pass over a frame of `extent`.
///
/// # Errors
/// [`Error::EmptyFrame`]; [`Error::FrameTooLarge`] where a map exceeds `max_block_bytes` or a side 262144 pixels.
pub fn plan(graph: &Graph, extent: Extent, options: &Target) -> Result<Plan> {
    let planned = of_frame(graph, extent, options, Limits::Each(options.max_block_bytes))?;
    planned.map_err(|bytes| map_too_large(extent, bytes, options))
}

/// The same in an arena that is there, with blocks of so many bytes. A frame's own blocks, or larger ones, hold it.
///
/// # Errors
/// As [`plan`]; [`Error::FrameTooLarge`] where the maps do not fit the blocks.
pub fn plan_in(graph: &Graph, extent: Extent, options: &Target, blocks: &[u64]) -> Result<Plan> {
    let planned = of_frame(graph, extent, options, Limits::Given(blocks, options.max_block_bytes))?;
    planned.map_err(|bytes| {
        let reason = format!(
            "its maps do not fit an arena with blocks of {blocks:?} bytes (there is no room for one of {bytes}): make \
             the arena for this size too (Denoiser::arena_required)"
        );
        Error::FrameTooLarge { width: extent.width, height: extent.height, reason }
    })
}

/// Fails within with the size of a map that no block holds.
fn of_frame(graph: &Graph, extent: Extent, options: &Target, arena: Limits) -> Result<Result<Plan, u64>> {
    let graph = graph.folded(options.folds);
    let mut lowering = Lowering::new(&graph, extent, padded(&graph, extent)?, options);
    lowering.frame_in();
    lowering.ops();
    lowering.signals();
    lowering.frame_out();
    Ok(lowering.finish(&[], arena))
}

/// Plans a graph's operations alone, without the frame around them: the caller fills [`Plan::log_color`] and
/// [`Plan::aux`] and reads [`Plan::residual`], which keep their places throughout.
///
/// # Errors
/// As [`plan`].
pub fn plan_part(graph: &Graph, extent: Extent, options: &Target) -> Result<Plan> {
    let graph = graph.folded(options.folds);
    let mut lowering = Lowering::new(&graph, extent, padded(&graph, extent)?, options);
    lowering.is_part = true;
    let kept = [graph.color, graph.aux, graph.residual].map(|value| lowering.value(value));
    lowering.ops();
    lowering.finish(&kept, Limits::Each(options.max_block_bytes)).map_err(|bytes| map_too_large(extent, bytes, options))
}

/// The size that the network works on.
fn padded(graph: &Graph, extent: Extent) -> Result<Extent> {
    extent.check()?;
    let multiple = graph.arch.pad_multiple();
    if extent.width.max(extent.height) > MAX_SIDE - multiple {
        let reason = format!("sides of more than {} pixels are not supported", MAX_SIDE - multiple);
        return Err(Error::FrameTooLarge { width: extent.width, height: extent.height, reason });
    }
    Ok(Extent::new(extent.width.next_multiple_of(multiple), extent.height.next_multiple_of(multiple)))
}

fn map_too_large(extent: Extent, bytes: u64, options: &Target) -> Error {
    let limit = options.max_block_bytes;
    let reason = format!("one feature map takes {bytes} bytes, and the device allocates at most {limit} at once");
    Error::FrameTooLarge { width: extent.width, height: extent.height, reason }
}

/// A mean that the next kernel finishes: partial sums.
pub(super) struct Partials {
    pub buffer: BufferId,
    pub sums: u64,
    pub tokens: u64,
}

pub(super) struct Lowering<'a> {
    pub graph: &'a Graph,
    pub options: &'a Target,
    pub extent: Extent,
    pub padded: Extent,
    buffers: Vec<Buffer>,
    pub dispatches: Vec<Dispatch>,
    /// The band that operations are lowered for, where a chain of them runs band by band.
    pub band: Option<Band>,
    /// Whether the graph is a network's part, whose input and result are maps like all others.
    is_part: bool,
    /// Buffer of every value that has one.
    values: HashMap<ValueId, BufferId>,
    packs: HashMap<Pack, BufferId>,
    pub partials: HashMap<ValueId, Partials>,
    pub stats: BufferId,
    /// What is known of every tile of the colour.
    pub tile_stats: BufferId,
    weights_bytes: u64,
}

impl<'a> Lowering<'a> {
    fn new(graph: &'a Graph, extent: Extent, padded: Extent, options: &'a Target) -> Self {
        let mut lowering = Self {
            graph,
            options,
            extent,
            padded,
            buffers: Vec::new(),
            dispatches: Vec::new(),
            band: None,
            is_part: false,
            values: HashMap::new(),
            packs: HashMap::new(),
            partials: HashMap::new(),
            stats: BufferId(0),
            tile_stats: BufferId(0),
            weights_bytes: 0,
        };
        lowering.stats = lowering.scratch("stats", stats::STATS_FLOATS * 4, Storage::F32);
        lowering
    }

    pub(super) fn scratch(&mut self, name: &str, bytes: u64, storage: Storage) -> BufferId {
        // Placed when all lifetimes are known.
        let place = Place::Arena { block: 0, offset: 0 };
        self.buffers.push(Buffer { name: name.to_owned(), bytes, storage, place });
        BufferId(self.buffers.len() - 1)
    }

    pub(super) fn pack(&mut self, name: &str, pack: Pack) -> BufferId {
        if let Some(&id) = self.packs.get(&pack) {
            return id;
        }
        let bytes = pack.len() as u64 * 4;
        let place = Place::Weights { pack: pack.clone(), offset: self.weights_bytes };
        self.weights_bytes += bytes.next_multiple_of(256);
        self.buffers.push(Buffer { name: name.to_owned(), bytes, storage: Storage::F32, place });
        let id = BufferId(self.buffers.len() - 1);
        self.packs.insert(pack, id);
        id
    }

    /// How a value is stored: the network's maps as the options say, its input and result in full, and so radiance.
    fn storage(&self, id: ValueId) -> Storage {
        let whole = [self.graph.color, self.graph.residual].contains(&id) || self.graph.is_of_kernels(id);
        let full = !self.is_part && whole;
        let is_map = matches!(self.graph.value(id).shape, Shape::Map { .. });
        if is_map && !full { self.options.storage } else { Storage::F32 }
    }

    /// The buffer of a value; within a band, the band's own where the value lives no longer than that.
    pub(super) fn value(&mut self, id: ValueId) -> BufferId {
        let local = self.band.as_ref().is_some_and(|band| band.is_local(id));
        let known = if local { self.band.as_ref().and_then(|band| band.values.get(&id)) } else { self.values.get(&id) };
        if let Some(&buffer) = known {
            return buffer;
        }
        let value = self.graph.value(id);
        let storage = self.storage(id);
        let bytes = match value.shape {
            Shape::Map { stride, channels } => {
                let height = self.band.as_ref().filter(|_| local).map_or(self.padded.height, Band::height);
                let tokens = u64::from(self.padded.width / stride) * u64::from(height / stride);
                tokens * u64::from(channels.next_multiple_of(4)) * storage.bytes()
            }
            Shape::Vector { len } => u64::from(len) * 4,
        };
        let buffer = self.scratch(&value.name, bytes, storage);
        match self.band.as_mut().filter(|_| local) {
            Some(band) => band.values.insert(id, buffer),
            None => self.values.insert(id, buffer),
        };
        buffer
    }

    /// A map's channels; within a band, the band's rows of it.
    pub(super) fn view(&mut self, slice: Slice) -> View {
        let buffer = self.value(slice.value);
        let (stride, channels) = match self.graph.value(slice.value).shape {
            Shape::Map { stride, channels } => (stride, channels),
            Shape::Vector { len } => (1, len),
        };
        let (top, height) = match &self.band {
            Some(band) if band.is_local(slice.value) => (0, band.height()),
            Some(band) => (band.top, band.height()),
            None => (0, self.padded.height),
        };
        View {
            buffer,
            first: slice.first,
            channels: slice.channels.next_multiple_of(4),
            stride: channels.next_multiple_of(4),
            width: self.padded.width / stride,
            height: height / stride,
            top: top / stride,
            storage: self.storage(slice.value),
        }
    }

    pub(super) fn whole(&mut self, id: ValueId) -> View {
        let slice = self.graph.whole(id);
        self.view(slice)
    }

    pub(super) fn push(&mut self, name: &str, stage: Stage, flops: u64, call: Call) {
        self.dispatches.push(Dispatch::new(name, stage, flops, call, self.options.kernels));
    }

    /// Statistics of the frame, and its maps.
    fn frame_in(&mut self) {
        let Extent { width, height } = self.extent;
        let stats = self.stats;
        let luminances = self.scratch("stats.luminances", stats::HISTOGRAM_BYTES, Storage::F32);
        let depths = self.scratch("stats.depths", stats::HISTOGRAM_BYTES, Storage::F32);
        let depth_scale = self.scratch("stats.depth_scale", 4, Storage::F32);
        let mut tiles = stats::TileStats { stats, dst: stats, runs: stats, width, height };
        tiles.dst = self.scratch("stats.tiles", tiles.tile_bytes(), Storage::F32);
        tiles.runs = self.scratch("stats.runs", tiles.run_bytes(), Storage::F32);
        let (key, tile_stats) = (tiles.key(depth_scale), tiles.dst);
        self.tile_stats = tile_stats;
        let color = self.whole(self.graph.color);
        let aux = self.whole(self.graph.aux);
        let histogram =
            |histogram, counted| Call::StatsHistogram(stats::Histogram { histogram, counted, width, height });
        let select = |histogram, counted, dst| Call::StatsSelect(stats::Select { histogram, counted, dst });
        for (name, call) in [
            ("stats.luminances", Call::StatsClear(stats::Clear { histogram: luminances })),
            ("stats.depths", Call::StatsClear(stats::Clear { histogram: depths })),
            ("stats.luminances", histogram(luminances, Counted::Luminance)),
            ("stats.depths", histogram(depths, Counted::Depth)),
            ("stats.median", select(luminances, Counted::Luminance, stats)),
            ("stats.depth_scale", select(depths, Counted::Depth, depth_scale)),
            ("stats.tiles", Call::StatsTiles(tiles)),
            ("stats.key", Call::StatsKey(key)),
            (
                "input.color",
                Call::InputColor(frame_io::InputColor {
                    stats,
                    tile_stats,
                    dst: color,
                    width,
                    height,
                    tiles: Tiles::All,
                }),
            ),
            (
                "input.aux",
                Call::InputAux(frame_io::InputAux {
                    depth_scale,
                    clean: self.options.clean_aux,
                    dst: aux,
                    width,
                    height,
                    tiles: Tiles::All,
                }),
            ),
        ] {
            self.push(name, Stage::Input, 0, call);
        }
        for dispatch in &mut self.dispatches {
            dispatch.of_depth = dispatch.traffic().touches(depths);
        }
    }

    fn frame_out(&mut self) {
        let output = frame_io::Output {
            residual: self.whole(self.graph.residual),
            log_color: self.whole(self.graph.color),
            stats: self.stats,
            width: self.extent.width,
            height: self.extent.height,
            tiles: Tiles::All,
            region: Region::all(self.extent),
            radiance: self.graph.arch.head.kernels().is_some(),
            converged: None,
        };
        self.push("output", Stage::Output, 0, Call::Output(output));
    }

    fn ops(&mut self) {
        let mut at = 0;
        while at < self.graph.ops.len() {
            at += self.chain(at);
        }
    }

    pub(super) fn flops(&self, op: &Op) -> u64 {
        op_flops(self.graph, op, self.padded.width, self.padded.height).total()
    }

    /// Places the buffers, those of `kept` for all the time, what outlives a recording in persistent memory, and finds
    /// the barriers. Fails with the size of a buffer that no block holds.
    fn finish(mut self, kept: &[BufferId], arena: Limits) -> Result<Plan, u64> {
        let options = self.options;
        let buffers = &self.buffers;
        features::mark(&mut self.dispatches, |id| matches!(buffers[id.0].place, Place::Weights { .. }));
        let multiple = self.graph.arch.pad_multiple();
        let dispatches = std::mem::take(&mut self.dispatches);
        let merged = match options.of_tile {
            true => dispatches.into_iter().map(|dispatch| (dispatch, For::Every)).collect(),
            false => featureless::merge(dispatches, &mut self.buffers, self.padded, multiple, options.kernels),
        };
        let (merged, converged) = match options.converged {
            Some(mode) => {
                let Self { extent, padded, stats, .. } = self;
                let (keeps_features, kernels) = (options.keep_features, options.kernels);
                let frame = converged::Frame { extent, padded, stats, mode, keeps_features, kernels };
                let (merged, activity) = converged::apply(merged, &mut self.buffers, &frame);
                (merged, Some(activity))
            }
            None => (merged, None),
        };
        let mut outlives: Vec<BufferId> = converged.iter().map(|converged| converged.buffer).collect();
        let given = options.of_tile.then(|| Given::of(merged.iter().map(|(dispatch, _)| dispatch)));
        outlives.extend(given.iter().flat_map(Given::buffers));
        if options.keep_features {
            outlives.extend(features::kept(merged.iter().map(|(dispatch, _)| dispatch)));
        }
        let end = merged.len();
        let mut times: Vec<Option<(usize, usize)>> = vec![None; self.buffers.len()];
        for (at, (dispatch, _)) in merged.iter().enumerate() {
            let traffic = dispatch.traffic();
            for (id, _) in traffic.reads.iter().chain(&traffic.writes) {
                let time = times[id.0].get_or_insert((at, at));
                time.1 = at;
            }
        }
        // What signals read stays for the next of them.
        let of_signals = |at: usize| merged[at].0.of_signals;
        if let (Some(first), Some(last)) = ((0..end).find(|at| of_signals(*at)), (0..end).rfind(|at| of_signals(*at))) {
            for time in times.iter_mut().flatten().filter(|time| time.0 < first && time.1 >= first) {
                time.1 = time.1.max(last);
            }
        }
        let (persistent, in_arena): (Vec<_>, Vec<_>) = (0..self.buffers.len())
            .filter(|&i| matches!(self.buffers[i].place, Place::Arena { .. }))
            .filter_map(|i| times[i].map(|time| (i, time)))
            .partition(|(i, _)| outlives.contains(&BufferId(*i)));
        let place = |buffers: &[Buffer], which: &[(usize, (usize, usize))], always: bool, limits: Limits| {
            let request = |&(i, (first, last)): &(usize, (usize, usize))| {
                let always = always || kept.contains(&BufferId(i));
                let (first, last) = if always { (0, end) } else { (first, last) };
                Request { bytes: buffers[i].bytes, first, last }
            };
            arena::place(&which.iter().map(request).collect::<Vec<_>>(), limits)
        };
        let (placements, blocks) = place(&self.buffers, &in_arena, options.keep_all, arena)?;
        for ((i, _), (block, offset)) in in_arena.into_iter().zip(placements) {
            self.buffers[i].place = Place::Arena { block, offset };
        }
        let own = Limits::Each(options.max_block_bytes);
        let (placements, persistent_blocks) = place(&self.buffers, &persistent, true, own)?;
        for ((i, _), (block, offset)) in persistent.into_iter().zip(placements) {
            self.buffers[i].place = Place::Persistent { block, offset };
        }
        let dispatches_for = |other: For| {
            let mut chosen: Vec<_> =
                merged.iter().filter(|(_, frames)| *frames != other).map(|(dispatch, _)| dispatch.clone()).collect();
            chosen.iter_mut().for_each(|dispatch: &mut Dispatch| dispatch.choose(options.kernels));
            hazards::mark(&mut chosen, &self.buffers);
            chosen
        };
        let differs = merged.iter().any(|(_, frames)| *frames == For::NoFeatures);
        let (dispatches, without_features) =
            (dispatches_for(For::NoFeatures), differs.then(|| dispatches_for(For::Features)));
        Ok(Plan {
            extent: self.extent,
            padded: self.padded,
            log_color: self.whole(self.graph.color),
            aux: self.whole(self.graph.aux),
            residual: self.whole(self.graph.residual),
            buffers: self.buffers,
            dispatches,
            without_features,
            blocks,
            persistent: persistent_blocks,
            weights_bytes: self.weights_bytes,
            stats: self.stats,
            keeps_features: options.keep_features,
            converged,
            given,
        })
    }
}

//! From graph and size to dispatches.

use super::arena::{self, Request};
use super::choices::{PlanOptions, SeparableForm, conv_pack, fuse, is_separable};
use super::featureless::{self, For};
use super::pack::{Pack, linear_outputs};
use super::{Buffer, Dispatch, ELEMENT_BYTES, Place, Plan, features, hazards};
use crate::error::{Error, Result};
use crate::frame::{Extent, Region};
use crate::kernels::stats::Counted;
use crate::kernels::winograd::Winograd3x3;
use crate::kernels::{BufferId, Call, Tiles, View, dense, film, frame_io, maps, stats, window_attention};
use crate::net::cost::op_flops;
use crate::net::graph::{Graph, Op, OpKind, Shape, Slice, Stage, ValueId, conv_outputs};
use std::collections::HashMap;

/// Pixels on a side that coordinates of tiles (16 bits) and strides (32 bits) hold with room to spare.
const MAX_SIDE: u32 = 1 << 18;

/// Plans one forward pass over a frame of `extent`.
///
/// # Errors
/// [`Error::EmptyFrame`]; [`Error::FrameTooLarge`] where a map exceeds `max_block_bytes` or a side 262144 pixels.
pub fn plan(graph: &Graph, extent: Extent, options: &PlanOptions) -> Result<Plan> {
    let mut lowering = Lowering::new(graph, extent, padded(graph, extent)?, options);
    lowering.frame_in();
    lowering.ops();
    lowering.frame_out();
    lowering.finish(&[]).map_err(|bytes| map_too_large(extent, bytes, options))
}

/// Plans a graph's operations alone, without the frame around them: the caller fills [`Plan::log_color`] and [`Plan::aux`]
/// and reads [`Plan::residual`], which keep their places throughout.
///
/// # Errors
/// As [`plan`].
pub fn plan_part(graph: &Graph, extent: Extent, options: &PlanOptions) -> Result<Plan> {
    let mut lowering = Lowering::new(graph, extent, padded(graph, extent)?, options);
    let kept = [graph.color, graph.aux, graph.residual].map(|value| lowering.value(value));
    lowering.ops();
    lowering.finish(&kept).map_err(|bytes| map_too_large(extent, bytes, options))
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

fn map_too_large(extent: Extent, bytes: u64, options: &PlanOptions) -> Error {
    let limit = options.max_block_bytes;
    let reason = format!("one feature map takes {bytes} bytes, and the device allocates at most {limit} at once");
    Error::FrameTooLarge { width: extent.width, height: extent.height, reason }
}

/// A mean that the next kernel finishes: partial sums.
struct Partials {
    buffer: BufferId,
    sums: u64,
    tokens: u64,
}

struct Lowering<'a> {
    graph: &'a Graph,
    options: &'a PlanOptions,
    extent: Extent,
    padded: Extent,
    buffers: Vec<Buffer>,
    dispatches: Vec<Dispatch>,
    /// Buffer of every value that has one.
    values: HashMap<ValueId, BufferId>,
    packs: HashMap<Pack, BufferId>,
    partials: HashMap<ValueId, Partials>,
    stats: BufferId,
    weights_bytes: u64,
}

impl<'a> Lowering<'a> {
    fn new(graph: &'a Graph, extent: Extent, padded: Extent, options: &'a PlanOptions) -> Self {
        let mut lowering = Self {
            graph,
            options,
            extent,
            padded,
            buffers: Vec::new(),
            dispatches: Vec::new(),
            values: HashMap::new(),
            packs: HashMap::new(),
            partials: HashMap::new(),
            stats: BufferId(0),
            weights_bytes: 0,
        };
        lowering.stats = lowering.scratch("stats", stats::STATS_FLOATS * 4);
        lowering
    }

    fn scratch(&mut self, name: &str, bytes: u64) -> BufferId {
        // Placed when all lifetimes are known.
        let place = Place::Arena { block: 0, offset: 0 };
        self.buffers.push(Buffer { name: name.to_owned(), bytes, place });
        BufferId(self.buffers.len() - 1)
    }

    fn pack(&mut self, name: &str, pack: Pack) -> BufferId {
        if let Some(&id) = self.packs.get(&pack) {
            return id;
        }
        let bytes = pack.len() as u64 * 4;
        let place = Place::Weights { pack: pack.clone(), offset: self.weights_bytes };
        self.weights_bytes += bytes.next_multiple_of(256);
        self.buffers.push(Buffer { name: name.to_owned(), bytes, place });
        let id = BufferId(self.buffers.len() - 1);
        self.packs.insert(pack, id);
        id
    }

    fn value(&mut self, id: ValueId) -> BufferId {
        if let Some(&buffer) = self.values.get(&id) {
            return buffer;
        }
        let value = self.graph.value(id);
        let elements = match value.shape {
            Shape::Map { stride, channels } => {
                let tokens = u64::from(self.padded.width / stride) * u64::from(self.padded.height / stride);
                tokens * u64::from(channels.next_multiple_of(4)) * ELEMENT_BYTES
            }
            Shape::Vector { len } => u64::from(len) * 4,
        };
        let buffer = self.scratch(&value.name, elements);
        self.values.insert(id, buffer);
        buffer
    }

    fn view(&mut self, slice: Slice) -> View {
        let buffer = self.value(slice.value);
        let (stride, channels) = match self.graph.value(slice.value).shape {
            Shape::Map { stride, channels } => (stride, channels),
            Shape::Vector { len } => (1, len),
        };
        View {
            buffer,
            first: slice.first,
            channels: slice.channels.next_multiple_of(4),
            stride: channels.next_multiple_of(4),
            width: self.padded.width / stride,
            height: self.padded.height / stride,
        }
    }

    fn whole(&mut self, id: ValueId) -> View {
        let slice = self.graph.whole(id);
        self.view(slice)
    }

    fn push(&mut self, name: &str, stage: Stage, flops: u64, call: Call) {
        self.dispatches.push(Dispatch {
            name: name.to_owned(),
            stage,
            call,
            barrier: false,
            flops,
            of_features: false,
            of_depth: false,
            skipped: false,
        });
    }

    /// Statistics of the frame, and its maps.
    fn frame_in(&mut self) {
        let Extent { width, height } = self.extent;
        let stats = self.stats;
        let luminances = self.scratch("stats.luminances", stats::HISTOGRAM_BYTES);
        let depths = self.scratch("stats.depths", stats::HISTOGRAM_BYTES);
        let depth_scale = self.scratch("stats.depth_scale", 4);
        let mut tiles = stats::TileMeans { stats, dst: stats, width, height };
        tiles.dst = self.scratch("stats.tiles", u64::from(tiles.tiles()) * 4);
        let key = stats::Key { src: tiles.dst, tiles: tiles.tiles(), stats };
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
                Call::InputColor(frame_io::InputColor { stats, dst: color, width, height, tiles: Tiles::All }),
            ),
            (
                "input.aux",
                Call::InputAux(frame_io::InputAux { depth_scale, dst: aux, width, height, tiles: Tiles::All }),
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
        };
        self.push("output", Stage::Output, 0, Call::Output(output));
    }

    fn ops(&mut self) {
        let graph = self.graph;
        let fused = self.options.separable == SeparableForm::Fused;
        let mut at = 0;
        while let Some(op) = graph.ops.get(at) {
            let call = self.op(op);
            let flops = self.flops(op);
            match graph.ops.get(at + 1).filter(|_| fused && is_separable(graph, at)) {
                Some(next) => {
                    let (call, flops) = (fuse(call, self.op(next)), flops + self.flops(next));
                    self.push(&next.name, next.stage, flops, call);
                    at += 2;
                }
                None => {
                    self.push(&op.name, op.stage, flops, call);
                    at += 1;
                }
            }
        }
    }

    fn flops(&self, op: &Op) -> u64 {
        op_flops(self.graph, op, self.padded.width, self.padded.height).total()
    }

    /// The kernel of an operation. Kernels that must run before it are pushed.
    fn op(&mut self, op: &Op) -> Call {
        match &op.kind {
            OpKind::Conv3x3 { input, weight, bias, stride, activation, shuffle, film, residual, output } => {
                let channels = conv_outputs(*shuffle, *output);
                let tile = self.options.conv.tile(*stride, channels);
                let pack = conv_pack(weight, *bias, (input.channels, channels), *shuffle, tile);
                let conv = dense::Conv3x3 {
                    src: self.view(*input),
                    dst: self.view(*output),
                    channels: channels.next_multiple_of(4),
                    weights: self.pack(weight, pack),
                    film: film.map(|film| self.value(film)),
                    residual: residual.map(|residual| self.view(residual)),
                    stride: *stride,
                    activation: *activation,
                    shuffle: *shuffle,
                    tiles: Tiles::All,
                };
                match tile {
                    Some(tile) => Call::Winograd3x3(Winograd3x3 { conv, tile }),
                    None => Call::Conv3x3(conv),
                }
            }
            OpKind::Linear { inputs, weight, activation, film, residual, output } => {
                debug_assert_eq!(linear_outputs(weight), output.channels, "{}", op.name);
                let views: Vec<View> = inputs.iter().map(|input| self.view(*input)).collect();
                Call::Linear(dense::Linear {
                    src: views[0],
                    src_b: views.get(1).copied(),
                    dst: self.view(*output),
                    weights: self.pack(&op.name, Pack::Linear(weight.clone())),
                    film: film.map(|film| self.value(film)),
                    residual: residual.map(|residual| self.view(residual)),
                    activation: *activation,
                    tiles: Tiles::All,
                })
            }
            OpKind::Depthwise3x3 { input, weight, activation, output } => {
                let pack = Pack::Depthwise { weight: weight.clone(), channels: input.channels };
                Call::Depthwise3x3(maps::Depthwise3x3 {
                    src: self.view(*input),
                    dst: self.whole(*output),
                    weights: self.pack(weight, pack),
                    activation: *activation,
                    tiles: Tiles::All,
                })
            }
            OpKind::LayerNorm { input, norm, output } => {
                let dst = self.whole(*output);
                self.layer_norm(*input, norm, dst)
            }
            OpKind::WindowAttention { x, f, bias_table, heads, key_width, value_width, output } => {
                let pack = Pack::BiasTable { table: bias_table.clone(), heads: *heads };
                Call::WindowAttention(window_attention::WindowAttention {
                    x: self.whole(*x),
                    f: self.whole(*f),
                    bias: self.pack(bias_table, pack),
                    dst: self.whole(*output),
                    heads: *heads,
                    key_width: *key_width,
                    value_width: *value_width,
                    tiles: Tiles::All,
                })
            }
            OpKind::FilmMean { input, norm, output } => {
                // Normed in a map of its own, then summed.
                let source = self.view(*input);
                let bytes = source.elements() * ELEMENT_BYTES;
                let normed = View {
                    buffer: self.scratch(&format!("{}.normed", op.name), bytes),
                    first: 0,
                    stride: source.channels,
                    ..source
                };
                let norm = self.layer_norm(*input, norm, normed);
                self.push(&op.name, op.stage, 0, norm);
                let stride = self.padded.width / source.width;
                let mut sum = film::TokenSum {
                    src: normed,
                    real_width: self.extent.width.div_ceil(stride),
                    real_height: self.extent.height.div_ceil(stride),
                    dst: normed.buffer,
                };
                let bytes = sum.sums() * u64::from(source.channels) * 4;
                sum.dst = self.scratch(&format!("{}.partials", op.name), bytes);
                let partials = Partials { buffer: sum.dst, sums: sum.sums(), tokens: sum.real_tokens() };
                self.partials.insert(*output, partials);
                Call::TokenSum(sum)
            }
            OpKind::FilmVector { input, weight, output } => {
                let inputs = self.graph.whole(*input).channels;
                let outputs = self.graph.whole(*output).channels;
                let weights = self.pack(weight, Pack::FilmVector { weight: weight.clone(), inputs, outputs });
                let dst = self.value(*output);
                let partials = &self.partials[input];
                Call::FilmVector(film::FilmVector {
                    partials: partials.buffer,
                    sums: partials.sums,
                    tokens: partials.tokens,
                    channels: inputs,
                    weights,
                    dst,
                    outputs,
                })
            }
        }
    }

    fn layer_norm(&mut self, input: Slice, norm: &str, dst: View) -> Call {
        let pack = Pack::Norm { norm: norm.to_owned(), channels: input.channels };
        let weights = self.pack(norm, pack);
        Call::LayerNorm(maps::LayerNorm { src: self.view(input), dst, weights, tiles: Tiles::All })
    }

    /// Places the buffers, those of `kept` for all the time, and finds the barriers. Fails with the size of a buffer that no
    /// block holds.
    fn finish(mut self, kept: &[BufferId]) -> Result<Plan, u64> {
        let options = self.options;
        let buffers = &self.buffers;
        features::mark(&mut self.dispatches, |id| matches!(buffers[id.0].place, Place::Weights { .. }));
        let multiple = self.graph.arch.pad_multiple();
        let merged = featureless::merge(std::mem::take(&mut self.dispatches), &mut self.buffers, self.padded, multiple);
        let kept = match options.keep_features {
            true => [kept, &features::kept(merged.iter().map(|(dispatch, _)| dispatch))].concat(),
            false => kept.to_vec(),
        };
        let end = merged.len();
        let mut times: Vec<Option<(usize, usize)>> = vec![None; self.buffers.len()];
        for (at, (dispatch, _)) in merged.iter().enumerate() {
            let traffic = dispatch.traffic();
            for (id, _) in traffic.reads.iter().chain(&traffic.writes) {
                let time = times[id.0].get_or_insert((at, at));
                time.1 = at;
            }
        }
        let in_arena: Vec<usize> = (0..self.buffers.len())
            .filter(|&i| matches!(self.buffers[i].place, Place::Arena { .. }) && times[i].is_some())
            .collect();
        let requests: Vec<Request> = in_arena
            .iter()
            .filter_map(|&i| times[i].map(|time| (i, time)))
            .map(|(i, (first, last))| {
                let always = options.keep_all || kept.contains(&BufferId(i));
                let (first, last) = if always { (0, end) } else { (first, last) };
                Request { bytes: self.buffers[i].bytes, first, last }
            })
            .collect();
        let (placements, blocks) = arena::place(&requests, options.max_block_bytes)?;
        for (&i, (block, offset)) in in_arena.iter().zip(placements) {
            self.buffers[i].place = Place::Arena { block, offset };
        }
        let dispatches_for = |other: For| {
            let mut chosen: Vec<_> =
                merged.iter().filter(|(_, frames)| *frames != other).map(|(dispatch, _)| dispatch.clone()).collect();
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
            weights_bytes: self.weights_bytes,
            stats: self.stats,
            keeps_features: options.keep_features,
        })
    }
}

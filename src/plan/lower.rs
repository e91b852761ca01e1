//! From steps and a size to dispatches.

use super::active::Activity;
use super::arena::Limits;
use super::bands::Band;
use super::featureless::{self, For};
use super::placing::Placing;
use super::schedule::{Scheduled, schedule};
use super::steps::{Size, Step, Steps};
use super::tile::Given;
use super::{Buffer, Dispatch, Place, Plan, converged, ensemble, features, hazards};
use crate::frame::{Extent, Region};
use crate::kernels::ensemble::{Member, result_bytes};
use crate::kernels::stats::Counted;
use crate::kernels::{BufferId, Call, Storage, TILE, TileRect, Tiles, TokenRect, View, energy, film, frame_io, stats};
use crate::net::cost::op_flops;
use crate::net::graph::Graph;
use crate::net::op::{Stage, ValueId};
use crate::target::Target;
use std::collections::{HashMap, HashSet};

/// The steps at a size.
pub(super) struct Lowering<'a> {
    pub steps: &'a Steps<'a>,
    pub graph: &'a Graph,
    pub options: &'a Target,
    pub extent: Extent,
    pub padded: Extent,
    pub buffers: Vec<Buffer>,
    pub dispatches: Vec<Dispatch>,
    /// The band that operations are lowered for, where a chain of them runs band by band.
    pub band: Option<Band>,
    /// Values that kernels leave in memory.
    pub stored: HashSet<ValueId>,
    /// How many partial sums a buffer holds, and of how many tokens.
    sums: HashMap<BufferId, (u64, u64)>,
    pub stats: BufferId,
    /// What is known of every tile of the colour.
    pub tile_stats: BufferId,
    /// What squares of the result get back, once there is a buffer for it.
    gains: Option<BufferId>,
    /// Which of an ensemble the dispatches are of.
    pub member: Option<Member>,
    /// Where the result of the turned frame is kept, where there is an ensemble.
    pub turned_result: Option<BufferId>,
}

/// What runs of one network.
pub(super) struct Lists {
    /// For frames with features, and where it differs for those without.
    pub lists: Vec<Scheduled>,
    converged: Option<Activity>,
    /// What depends on the features alone and is read by the rest.
    of_features: Vec<BufferId>,
}

impl<'a> Lowering<'a> {
    pub fn new(steps: &'a Steps<'a>, extent: Extent, padded: Extent) -> Self {
        Self {
            steps,
            graph: steps.graph,
            options: steps.target,
            extent,
            padded,
            buffers: steps.buffers.clone(),
            dispatches: Vec::new(),
            band: None,
            stored: steps.stored(),
            sums: HashMap::new(),
            stats: steps.stats,
            tile_stats: BufferId(0),
            gains: None,
            member: None,
            turned_result: None,
        }
    }

    pub(super) fn scratch(&mut self, name: &str, bytes: u64, storage: Storage) -> BufferId {
        // Placed when all lifetimes are known.
        let place = Place::Arena { block: 0, offset: 0 };
        self.buffers.push(Buffer { name: name.to_owned(), bytes, storage, place });
        BufferId(self.buffers.len() - 1)
    }

    /// Gives a map its size; within a band, the band's rows of it, in the band's own buffer where the value lives no
    /// longer than that.
    fn place(&mut self, view: &mut View) {
        let Size::Map { stride, channels } = self.steps.sizes[view.buffer.0] else { return };
        let (whole, band) = (view.buffer, self.band.as_ref());
        let local = band.is_some_and(|band| band.is_local(whole));
        let (top, height) = match band {
            Some(band) if local => (0, band.height()),
            Some(band) => (band.top, band.height()),
            None => (0, self.padded.height),
        };
        (view.width, view.height, view.top) = (self.padded.width / stride, height / stride, top / stride);
        let rows = if local { height } else { self.padded.height } / stride;
        let bytes = u64::from(view.width) * u64::from(rows) * u64::from(channels) * view.storage.bytes();
        if !local {
            self.buffers[whole.0].bytes = bytes;
            return;
        }
        let known = band.and_then(|band| band.buffers.get(&whole)).copied();
        view.buffer = known.unwrap_or_else(|| {
            let name = self.buffers[whole.0].name.clone();
            self.scratch(&name, bytes, view.storage)
        });
        if let Some(band) = &mut self.band {
            band.buffers.insert(whole, view.buffer);
        }
    }

    /// A kernel of the steps at this size.
    pub(super) fn placed(&mut self, call: &Call) -> Call {
        let mut call = call.clone();
        call.kernel_mut().maps(&mut |view, _| self.place(view));
        match &mut call {
            Call::TokenSum(sum) => {
                let stride = self.padded.width / sum.src.width;
                sum.real_width = self.extent.width.div_ceil(stride);
                sum.real_height = self.extent.height.div_ceil(stride);
                self.buffers[sum.dst.0].bytes = match self.options.of_tile {
                    true => film::TokenSum::most_bytes(sum.src.channels),
                    false => sum.sums_bytes(),
                };
                self.sums.insert(sum.dst, (sum.sums(), sum.real_tokens()));
            }
            Call::FilmVector(vector) => (vector.sums, vector.tokens) = self.sums[&vector.partials],
            _ => {}
        }
        call
    }

    /// All of a value's map, of the whole frame.
    pub(super) fn whole(&mut self, id: ValueId) -> View {
        let mut view = self.steps.of_value(id);
        self.place(&mut view);
        view
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

    /// What squares of the result get back, of the rows `first..end` of the frame; the result begins at the
    /// frame's row `top`. Nothing where the network adds a residual.
    pub(super) fn energy(&mut self, name: &str, result: View, top: u32, (first, end): (u32, u32)) {
        let Some(gains) = self.gains() else { return };
        let Extent { width, height } = self.extent;
        let (log_color, padded) = (self.whole(self.graph.color), self.padded);
        let rows = |view: View| View { height: result.height * view.height / padded.height, ..view };
        let of_rows = TokenRect { left: 0, top: first - top, right: result.width, bottom: end - top };
        let tiles = match end - first == padded.height {
            true => Tiles::All,
            false => {
                let (width, height) = (result.width / energy::TOKEN, result.height / energy::TOKEN);
                Tiles::Rect(TileRect::covering(of_rows.divided(energy::TOKEN), width, height))
            }
        };
        let call = energy::EnergyGains {
            result,
            log_color: rows(View { top, ..log_color }),
            stats: self.stats,
            dst: rows(View { top: top / energy::BLOCK, ..gains }),
            width,
            height: height.saturating_sub(top),
            tiles,
            converged: None,
        };
        self.push(name, Stage::Output, 0, Call::EnergyGains(call));
    }

    /// The squares' gains, of the whole frame, where the network makes radiance.
    pub(super) fn gains(&mut self) -> Option<View> {
        self.graph.arch.head.kernels()?;
        let of_pixels = self.whole(self.graph.residual);
        let (width, height) = (of_pixels.width / energy::BLOCK, of_pixels.height / energy::BLOCK);
        let mut view = View { first: 0, channels: 4, stride: 4, width, height, storage: Storage::F32, ..of_pixels };
        view.buffer = match self.gains {
            Some(buffer) => buffer,
            None => self.scratch("energy.gains", view.bytes(), Storage::F32),
        };
        self.gains = Some(view.buffer);
        Some(view)
    }

    /// The picture, or a band of it: the pixels of `region`, from the network's result that begins at the frame's row
    /// `top`.
    pub(super) fn frame_out(&mut self, name: &str, residual: View, top: u32, region: Region) {
        let Extent { width, height } = self.extent;
        let rows = TokenRect { left: 0, top: region.y, right: region.right(), bottom: region.bottom() };
        let tiles = match region == Region::all(self.extent) {
            true => Tiles::All,
            false => Tiles::Rect(TileRect::covering(rows, width.next_multiple_of(TILE), height.next_multiple_of(TILE))),
        };
        let ensemble = self.member.map(|member| (member, self.turned_result()));
        let output = frame_io::Output {
            residual,
            residual_top: top,
            log_color: self.whole(self.graph.color),
            stats: self.stats,
            width,
            height,
            tiles,
            region,
            gains: self.gains(),
            converged: None,
            ensemble,
        };
        self.push(name, Stage::Output, 0, Call::Output(output));
    }

    /// Where the result of the turned frame is kept.
    pub fn turned_result(&mut self) -> BufferId {
        if let Some(result) = self.turned_result {
            return result;
        }
        let result = self.scratch("turned.result", result_bytes(self.extent, 3), Storage::F32);
        *self.turned_result.insert(result)
    }

    /// All of a frame's dispatches.
    pub fn frame(&mut self) {
        self.frame_in();
        self.ops();
        let in_bands = self.dispatches.iter().any(|dispatch| matches!(dispatch.call, Call::Output(_)));
        let residual = self.whole(self.graph.residual);
        if !in_bands {
            self.energy("output.energy", residual, 0, (0, self.padded.height));
        }
        self.signals();
        if !in_bands {
            self.frame_out("output", residual, 0, Region::all(self.extent));
        }
    }

    pub fn ops(&mut self) {
        let mut at = 0;
        while at < self.steps.steps.len() {
            at += self.chain(at);
        }
    }

    /// FLOPs of the operations that a step stands for.
    pub(super) fn flops(&self, step: &Step) -> u64 {
        let Extent { width, height } = self.padded;
        let ops = &self.graph.ops[step.ops.clone()];
        ops.iter().map(|op| op_flops(self.graph, op, width, height).total()).sum()
    }

    /// The dispatches as they run, before the buffers are placed.
    pub fn lists(&mut self) -> Lists {
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
                let Self { extent, padded, stats, .. } = *self;
                let (keeps_features, kernels) = (options.keep_features, options.kernels);
                let frame = converged::Frame { extent, padded, stats, mode, keeps_features, kernels };
                let (merged, activity) = converged::apply(merged, &mut self.buffers, &frame);
                (merged, Some(activity))
            }
            None => (merged, None),
        };
        let differs = merged.iter().any(|(_, frames)| *frames == For::NoFeatures);
        let lists: &[For] = if differs { &[For::NoFeatures, For::Features] } else { &[For::NoFeatures] };
        let scheduled = lists.iter().map(|other| {
            let chosen = merged.iter().filter(|(_, frames)| frames != other).map(|(dispatch, _)| dispatch.clone());
            schedule(chosen.collect(), &self.buffers, options.overlap_bytes)
        });
        let lists = scheduled.collect();
        let of_features = features::kept(merged.iter().map(|(dispatch, _)| dispatch));
        Lists { lists, converged, of_features }
    }

    /// Places the buffers, those of `kept` for all the time, what outlives a recording in persistent memory, and finds
    /// the barriers. `turned`: what another network makes of the turned frame before. Fails with the size of a buffer
    /// that no block holds.
    pub fn finish(mut self, turned: Option<Vec<Scheduled>>, kept: &[BufferId], arena: Limits) -> Result<Plan, u64> {
        let options = self.options;
        let [log_color, aux, residual] =
            [self.graph.color, self.graph.aux, self.graph.residual].map(|value| self.whole(value));
        let Lists { lists, converged, of_features } = self.lists();
        let mut outlives: Vec<BufferId> = converged.iter().map(|converged| converged.buffer).collect();
        let given = options.of_tile.then(|| Given::of(&lists[0].dispatches));
        outlives.extend(given.iter().flat_map(Given::buffers));
        if options.keep_features {
            outlives.extend(of_features);
        }
        let repeats = self.member.is_some() && turned.is_none();
        let kept: Vec<BufferId> = kept.iter().copied().chain(self.turned_result.filter(|_| repeats)).collect();
        let lists = match turned {
            Some(turned) => ensemble::joined(turned, lists),
            None => lists,
        };
        let placing = Placing { lists: &lists, outlives: &outlives, kept: &kept, options, arena };
        let (blocks, persistent) = placing.place(&mut self.buffers)?;
        let mut marked = lists.into_iter().map(|Scheduled { mut dispatches, .. }| {
            dispatches.iter_mut().for_each(|dispatch| dispatch.choose(options.kernels));
            hazards::mark(&mut dispatches, &self.buffers);
            if repeats { ensemble::both(dispatches) } else { dispatches }
        });
        let (dispatches, without_features) = (marked.next().unwrap_or_default(), marked.next());
        Ok(Plan {
            extent: self.extent,
            padded: self.padded,
            log_color,
            aux,
            residual,
            buffers: self.buffers,
            dispatches,
            without_features,
            blocks,
            persistent,
            weights_bytes: self.steps.packing.bytes(),
            stats: self.stats,
            keeps_features: options.keep_features,
            converged,
            given,
        })
    }
}

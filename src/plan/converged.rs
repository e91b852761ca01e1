//! Leaving out tiles that need no denoising: every dispatch of the network runs over a list of tiles that the device
//! makes of its map of what is converged.
//!
//! Dispatches of one part of the network at one resolution share a list. A list's tile is active where it looks at a
//! square of the map that is to be denoised; how far it looks is known here:
//! * exact: as far as the region's propagation says ([`super::region`]), from every square of the map in turn;
//! * approximate: as far as its stage's margin says. Where others read beyond its tiles, they find zeros, as
//!   convolutions do at the border of the frame.
//!
//! What the whole frame is needed of, the features whose mean FiLM takes, stays whole in exact mode. In approximate
//! mode the mean is estimated, and their lists have the squares of a regular sample too ([`Sample`]), which stand for
//! all converged ones.

use super::active::{Activity, Part};
use super::featureless::For;
use super::ensemble::members;
use super::converged_reach::{reach_by_margins, reach_exactly, read_beyond};
use super::region::{needed_tokens, set_region};
use super::{Buffer, Dispatch, Place, Plan};
use crate::frame::{Extent, Region};
use crate::kernels::film::Computed;
use crate::kernels::converged::{Fill, MapSize, ConvergedMap, REACHES, Reach, Sample, TileList, TileNoise, list_bytes};
use crate::kernels::{BufferId, Call, Grid, KernelTarget, Storage, TILE, Tiles, View};
use crate::net::op::Stage;
use crate::options::ConvergedMode;
use std::collections::HashMap;

/// Squares of a frame that are to be sampled, at least: the more there are, the better they stand for all.
const SAMPLES: u32 = 128;
/// One of so few squares is sampled in a small frame: a sampled square has neighbours computed with it, for
/// convolutions.
const DENSEST: u32 = 16;
/// One of so many squares in a large frame.
const SPARSEST: u32 = 64;

/// Where the device says how many workgroups a dispatch has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndirectGroups {
    /// The workgroups of a list ([`TileList::groups`]).
    pub buffer: BufferId,
    /// Which list.
    pub list: usize,
    /// [`TileList::max_y`].
    pub max_y: u32,
    /// Whether the dispatch is over the idle tiles.
    pub idle: bool,
}

impl IndirectGroups {
    /// Bytes from the buffer's start to the workgroups of a dispatch; `None` where they are not counted.
    pub fn offset(&self, dispatch: &Dispatch) -> Option<u64> {
        match self.idle {
            true => Some(TileList::idle_groups_at(self.max_y)),
            false => TileList::groups_at(self.max_y, dispatch.variant.tiles_a_group, dispatch.groups[1]),
        }
    }
}

impl Plan {
    /// Restricts dispatches of a plan that leaves converged tiles out: what lies outside the region is converged.
    pub(crate) fn converged_outside(&self, region: Region, dispatches: &mut [Dispatch]) {
        for (dispatches, region) in members(dispatches, region, self.extent) {
            set_region(region, dispatches);
            for dispatch in dispatches {
                if let Call::ConvergedMap(map) = &mut dispatch.call {
                    map.region = region;
                }
            }
        }
    }
}

/// What [`apply`] needs to know of the plan that is being made.
pub(super) struct Frame {
    pub extent: Extent,
    pub padded: Extent,
    pub stats: BufferId,
    pub mode: ConvergedMode,
    pub keeps_features: bool,
    pub kernels: KernelTarget,
}

/// A list of the plan: a part of the network at one resolution.
pub(super) struct List {
    pub part: Part,
    columns: u32,
    rows: u32,
    pub reach: [Reach; REACHES],
    pub read: [Reach; REACHES],
    max_y: u32,
}

/// Dispatches of a plan, each with the frames that it is for.
type Merged = Vec<(Dispatch, For)>;

/// Has the dispatches run over lists of tiles, and puts what makes these before the first of them.
pub(super) fn apply(merged: Merged, buffers: &mut Vec<Buffer>, frame: &Frame) -> (Merged, Activity) {
    let scopes = scopes(&merged, frame);
    let (mut lists, list_of) = part(&merged, &scopes, frame.padded);
    let fills = match &frame.mode {
        ConvergedMode::Exact => {
            reach_exactly(&mut lists, &list_of, &merged, frame);
            HashMap::new()
        }
        ConvergedMode::Approximate(margins) => {
            reach_by_margins(&mut lists, &list_of, &merged, margins);
            read_beyond(&merged, &list_of)
        }
    };
    let mut maker = Maker { buffers };
    let map = MapSize::of(frame.padded);
    let noise = maker.words("converged.noise", u64::from(map.tiles()));
    let parts = lists.iter().map(|list| list.part).collect();
    let mut activity = Activity { buffer: noise, size: map, parts };
    activity.buffer = maker.words("converged.active", activity.words());
    let sums = maker.words("converged.sums", u64::from(map.sums()));
    let region = Region::all(frame.extent);
    // With nothing converged, an approximate pass is the whole one, its padding with it.
    let real = if frame.mode == ConvergedMode::Exact { map } else { MapSize::of(frame.extent) };
    let sample = Sample::one_in((real.tiles() / SAMPLES).clamp(DENSEST, SPARSEST), real);
    let dispatch = |name: &str, call| Dispatch::new(name, Stage::Input, 0, call, frame.kernels);
    let mut before = vec![
        dispatch(
            "converged.noise",
            Call::TileNoise(TileNoise { stats: frame.stats, dst: noise, frame: frame.extent, map }),
        ),
        dispatch(
            "converged.map",
            Call::ConvergedMap(ConvergedMap { src: noise, map: activity.buffer, sums, size: map, real, region }),
        ),
    ];
    let mut made = Vec::new();
    for (slot, list) in lists.iter().enumerate() {
        let name = format!("converged.{}.{}", list.part.stage, list.part.tile_pixels);
        let mut words = |what: &str, count: u64| maker.words(&format!("{name}.{what}"), count);
        let mut call = TileList {
            sums,
            list: words("tiles", list_bytes(list.part.tiles) / 4),
            idle: words("idle", list_bytes(list.part.tiles) / 4),
            groups: sums,
            counts: activity.buffer,
            slot: map.tiles() + slot as u32,
            map,
            columns: list.columns,
            rows: list.rows,
            tile_pixels: list.part.tile_pixels,
            reach: list.reach,
            read: list.read,
            max_y: list.max_y,
            sample: list.part.sampled.then_some(sample),
        };
        call.groups = words("groups", call.groups_bytes() / 4);
        made.push(call.clone());
        before.push(dispatch(&name, Call::TileList(call)));
    }
    let merged = estimate_means(merged, &scopes, &mut maker, |src, counts| Computed {
        map: activity.buffer,
        columns: map.columns,
        token_pixels: frame.padded.width / src.width,
        sample,
        counts,
    });
    let is_first = |(list, (dispatch, _)): (&Option<usize>, &(Dispatch, For))| list.is_some() || is_output(dispatch);
    let first = list_of.iter().zip(&merged).position(is_first).unwrap_or_default();
    let mut out = Vec::new();
    for (at, (mut dispatch, frames)) in merged.into_iter().enumerate() {
        if at == first {
            out.extend(before.drain(..).map(|dispatch| (dispatch, For::Every)));
        }
        match &mut dispatch.call {
            Call::Output(output) => output.converged = Some(activity.buffer),
            Call::OutputSignal(output) => output.converged = Some(activity.buffer),
            // Whole squares are computed where any of their pixels is wanted, or else what is computed counts.
            Call::EnergyGains(energy) if frame.mode != ConvergedMode::Exact => {
                energy.converged = Some(activity.buffer);
            }
            _ => {}
        }
        let Some(list) = list_of[at] else {
            out.push((dispatch, frames));
            continue;
        };
        let made = &made[list];
        let groups = IndirectGroups { buffer: made.groups, list, max_y: made.max_y, idle: false };
        let tiles = |buffer| Tiles::List { buffer, at_most: made.tiles() };
        dispatch.call.set_tiles(tiles(made.list));
        dispatch.indirect = Some(groups);
        let fill = |dst: View| {
            let side = *fills.get(&(at, dst.buffer))?;
            let call = Call::Fill(Fill { dst, side, tiles: tiles(made.idle) });
            let mut fill = dispatch.with_call(call, frame.kernels);
            fill.name = format!("{}.idle", dispatch.name);
            fill.indirect = Some(IndirectGroups { idle: true, ..groups });
            Some((fill, frames))
        };
        let filled: Vec<_> = dispatch.call.results().into_iter().filter_map(fill).collect();
        out.push((dispatch, frames));
        out.extend(filled);
    }
    (out, activity)
}

fn is_output(dispatch: &Dispatch) -> bool {
    matches!(dispatch.call, Call::Output(_) | Call::OutputSignal(_))
}

struct Maker<'a> {
    buffers: &'a mut Vec<Buffer>,
}

impl Maker<'_> {
    fn words(&mut self, name: &str, count: u64) -> BufferId {
        let place = Place::Arena { block: 0, offset: 0 };
        self.buffers.push(Buffer { name: name.to_owned(), bytes: 4 * count.max(1), storage: Storage::F32, place });
        BufferId(self.buffers.len() - 1)
    }
}

/// The dispatches for one kind of frame, with their places among all.
pub(super) fn sequence(merged: &[(Dispatch, For)], other: For) -> (Vec<usize>, Vec<Dispatch>) {
    let chosen = merged.iter().enumerate().filter(|(_, (_, frames))| *frames != other);
    chosen.map(|(at, (dispatch, _))| (at, dispatch.clone())).unzip()
}

/// Both kinds.
pub(super) const KINDS: [For; 2] = [For::NoFeatures, For::Features];

/// What of a frame a dispatch computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scope {
    /// What is denoised, as far as the mode says.
    Active,
    /// That and a sample of the rest.
    Sampled,
    /// All of it.
    Whole,
}

/// What every dispatch computes. Those that the whole frame is needed of are sampled in approximate mode, unless they
/// are kept for the next frame, of which other squares may be converged.
fn scopes(merged: &[(Dispatch, For)], frame: &Frame) -> Vec<Scope> {
    let mut scopes = vec![Scope::Active; merged.len()];
    let of_mean = match frame.mode {
        ConvergedMode::Approximate(_) => Scope::Sampled,
        ConvergedMode::Exact => Scope::Whole,
    };
    let nothing = Region { x: 0, y: 0, width: 0, height: 0 };
    for other in KINDS {
        let (places, dispatches) = sequence(merged, other);
        let needed = needed_tokens(&dispatches, nothing, |_| false);
        for (at, needed) in places.into_iter().zip(needed) {
            if needed.is_some_and(|rect| !rect.is_empty()) {
                scopes[at] = of_mean;
            }
        }
    }
    for (scope, (dispatch, frames)) in scopes.iter_mut().zip(merged) {
        if matches!(dispatch.call, Call::TokenSum(_)) {
            *scope = of_mean;
        }
        // The small maps of a frame without features stand for all of it.
        let is_small = *frames == For::NoFeatures && !matches!(dispatch.call, Call::Expand(_));
        // Beside squares that are computed there may be some of which nothing is.
        let reads_beyond = matches!(dispatch.call, Call::EnergyGains(_)) && frame.mode != ConvergedMode::Exact;
        if is_small || reads_beyond || frame.keeps_features && dispatch.of_features {
            *scope = Scope::Whole;
        }
    }
    scopes
}

/// Has the means of sampled maps be estimated from the tokens that there are.
fn estimate_means(
    mut merged: Merged,
    scopes: &[Scope],
    maker: &mut Maker,
    computed: impl Fn(&View, BufferId) -> Computed,
) -> Merged {
    let mut counts: HashMap<BufferId, BufferId> = HashMap::new();
    for ((dispatch, _), scope) in merged.iter_mut().zip(scopes) {
        match &mut dispatch.call {
            Call::TokenSum(sum) if *scope == Scope::Sampled => {
                let name = format!("{}.counts", dispatch.name);
                let own = maker.words(&name, sum.counts_bytes() / 4);
                sum.computed = Some(computed(&sum.src, own));
                maker.buffers[sum.dst.0].bytes = sum.sums_bytes();
                counts.insert(sum.dst, own);
            }
            Call::FilmVector(vector) => vector.counts = counts.get(&vector.partials).copied(),
            _ => {}
        }
    }
    merged
}

/// The lists, and for every dispatch the one that it runs over.
fn part(merged: &[(Dispatch, For)], scopes: &[Scope], padded: Extent) -> (Vec<List>, Vec<Option<usize>>) {
    let mut lists: Vec<List> = Vec::new();
    let list_of = merged.iter().zip(scopes).map(|((dispatch, _), scope)| {
        let Grid { width, height, .. } = dispatch.call.grid().filter(|_| *scope != Scope::Whole)?;
        if is_output(dispatch) {
            return None; // It writes every pixel.
        }
        let tile_pixels = padded.width / width * TILE;
        let (columns, rows) = (width / TILE, height / TILE);
        let sampled = *scope == Scope::Sampled;
        let part = Part { stage: dispatch.stage, tile_pixels, tiles: columns * rows, sampled };
        let at = lists.iter().position(|list| list.part == part).unwrap_or_else(|| {
            lists.push(List {
                part,
                columns,
                rows,
                reach: [Reach::default(); REACHES],
                read: [Reach::default(); REACHES],
                max_y: 1,
            });
            lists.len() - 1
        });
        lists[at].max_y = lists[at].max_y.max(dispatch.groups[1]);
        Some(at)
    });
    let list_of = list_of.collect();
    (lists, list_of)
}

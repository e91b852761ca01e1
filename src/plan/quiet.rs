//! Leaving out tiles that need no denoising: every dispatch of the network runs over a list of tiles that the device makes of its
//! map of what is quiet.
//!
//! Dispatches of one part of the network at one resolution share a list. A list's tile is active where it looks at a square
//! of the map that is to be denoised; how far it looks is known here:
//! * exact: as far as the region's propagation says ([`super::region`]), from every square of the map in turn;
//! * approximate: as far as its stage's margin says. Where others read beyond its tiles, they find zeros, as convolutions do at
//!   the border of the frame.
//!
//! What the whole frame is needed of (the features whose mean FiLM takes) stays whole.

use super::active::{Activity, Part};
use super::featureless::For;
use super::quiet_mode::{QuietMargins, QuietMode};
use super::region::{needed_tokens, set_region};
use super::{Buffer, Dispatch, Place, Plan};
use crate::frame::{Extent, Region};
use crate::kernels::quiet::{
    BLEND_PIXELS, Fill, MAP_TILE, MapSize, QuietMap, REACHES, Reach, TileList, TileNoise, list_bytes,
};
use crate::kernels::{BufferId, Call, Shuffle, Storage, TILE, Tiles, Variants};
use crate::net::graph::Stage;
use std::collections::HashMap;

/// Where the device says how many workgroups a dispatch has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Groups {
    /// The workgroups of a list ([`TileList::groups`]).
    pub buffer: BufferId,
    /// Which list.
    pub list: usize,
    /// [`TileList::max_y`].
    pub max_y: u32,
    /// Whether the dispatch is over the idle tiles.
    pub idle: bool,
}

impl Groups {
    /// Bytes from the buffer's start to the workgroups of a call; `None` where they are not counted.
    pub fn offset(&self, call: &Call, variants: Variants) -> Option<u64> {
        let kernel = call.kernel();
        match self.idle {
            true => Some(TileList::idle_groups_at(self.max_y)),
            false => TileList::groups_at(self.max_y, kernel.tiles_a_group(variants), kernel.groups(variants)[1]),
        }
    }
}

impl Plan {
    /// Restricts dispatches of a plan that leaves quiet tiles out: what lies outside the region is quiet.
    pub(crate) fn quiet_outside(&self, region: Region, dispatches: &mut [Dispatch]) {
        set_region(region, dispatches);
        for dispatch in dispatches {
            if let Call::QuietMap(map) = &mut dispatch.call {
                map.region = region;
            }
        }
    }
}

/// What [`apply`] needs to know of the plan that is being made.
pub(super) struct Frame {
    pub extent: Extent,
    pub padded: Extent,
    pub stats: BufferId,
    pub mode: QuietMode,
    pub keeps_features: bool,
}

/// A list of the plan: a part of the network at one resolution.
struct List {
    part: Part,
    columns: u32,
    rows: u32,
    reach: [Reach; REACHES],
    read: [Reach; REACHES],
    max_y: u32,
}

/// Dispatches of a plan, each with the frames that it is for.
type Merged = Vec<(Dispatch, For)>;

/// Has the dispatches run over lists of tiles, and puts what makes these before the first of them.
pub(super) fn apply(merged: Merged, buffers: &mut Vec<Buffer>, frame: &Frame) -> (Merged, Activity) {
    let whole = needed_whole(&merged, frame);
    let (mut lists, list_of) = part(&merged, &whole, frame.padded);
    let fills = match &frame.mode {
        QuietMode::Exact => {
            reach_exactly(&mut lists, &list_of, &merged, frame);
            HashMap::new()
        }
        QuietMode::Approximate(margins) => {
            reach_by_margins(&mut lists, &list_of, &merged, margins);
            read_beyond(&merged, &list_of)
        }
    };
    let mut maker = Maker { buffers };
    let map = MapSize::of(frame.padded);
    let noise = maker.words("quiet.noise", u64::from(map.tiles()));
    let parts = lists.iter().map(|list| list.part).collect();
    let mut activity = Activity { buffer: noise, size: map, parts };
    activity.buffer = maker.words("quiet.active", activity.words());
    let sums = maker.words("quiet.sums", u64::from(map.sums()));
    let region = Region::all(frame.extent);
    // With nothing quiet, an approximate pass is the whole one, its padding with it.
    let real = if frame.mode == QuietMode::Exact { map } else { MapSize::of(frame.extent) };
    let mut before = vec![
        dispatch(
            "quiet.noise",
            Call::TileNoise(TileNoise { stats: frame.stats, dst: noise, frame: frame.extent, map }),
        ),
        dispatch(
            "quiet.map",
            Call::QuietMap(QuietMap { src: noise, map: activity.buffer, sums, size: map, real, region }),
        ),
    ];
    let mut made = Vec::new();
    for (slot, list) in lists.iter().enumerate() {
        let name = format!("quiet.{}.{}", list.part.stage, list.part.tile_pixels);
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
        };
        call.groups = words("groups", call.groups_bytes() / 4);
        made.push(call.clone());
        before.push(dispatch(&name, Call::TileList(call)));
    }
    let is_first = |(list, (dispatch, _)): (&Option<usize>, &(Dispatch, For))| list.is_some() || is_output(dispatch);
    let first = list_of.iter().zip(&merged).position(is_first).unwrap_or_default();
    let mut out = Vec::new();
    for (at, (mut dispatch, frames)) in merged.into_iter().enumerate() {
        if at == first {
            out.extend(before.drain(..).map(|dispatch| (dispatch, For::Every)));
        }
        if let Call::Output(output) = &mut dispatch.call {
            output.quiet = Some(activity.buffer);
        }
        let Some(list) = list_of[at] else {
            out.push((dispatch, frames));
            continue;
        };
        let made = &made[list];
        let groups = Groups { buffer: made.groups, list, max_y: made.max_y, idle: false };
        let tiles = |buffer| Tiles::List { buffer, at_most: made.tiles() };
        dispatch.call.tiles_mut().into_iter().for_each(|own| *own = tiles(made.list));
        dispatch.groups = Some(groups);
        let fill = fills.get(&at).map(|side| {
            let dst = dispatch.call.result().copied();
            dst.map(|dst| Dispatch {
                name: format!("{}.idle", dispatch.name),
                call: Call::Fill(Fill { dst, side: *side, tiles: tiles(made.idle) }),
                flops: 0,
                groups: Some(Groups { idle: true, ..groups }),
                ..dispatch.clone()
            })
        });
        out.push((dispatch, frames));
        out.extend(fill.flatten().map(|fill| (fill, frames)));
    }
    (out, activity)
}

fn is_output(dispatch: &Dispatch) -> bool {
    matches!(dispatch.call, Call::Output(_))
}

fn dispatch(name: &str, call: Call) -> Dispatch {
    Dispatch {
        name: name.to_owned(),
        stage: Stage::Input,
        call,
        barrier: false,
        flops: 0,
        band: 0,
        of_features: false,
        of_depth: false,
        groups: None,
        skipped: false,
    }
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
fn sequence(merged: &[(Dispatch, For)], other: For) -> (Vec<usize>, Vec<Dispatch>) {
    let chosen = merged.iter().enumerate().filter(|(_, (_, frames))| *frames != other);
    chosen.map(|(at, (dispatch, _))| (at, dispatch.clone())).unzip()
}

/// Both kinds.
const KINDS: [For; 2] = [For::NoFeatures, For::Features];

/// For every dispatch whether it is needed in whole, whatever is denoised.
fn needed_whole(merged: &[(Dispatch, For)], frame: &Frame) -> Vec<bool> {
    let mut whole = vec![false; merged.len()];
    let nothing = Region { x: 0, y: 0, width: 0, height: 0 };
    for other in KINDS {
        let (places, dispatches) = sequence(merged, other);
        let needed = needed_tokens(&dispatches, nothing, |_| false);
        for (at, needed) in places.into_iter().zip(needed) {
            whole[at] |= needed.is_some_and(|rect| !rect.is_empty());
        }
    }
    for (whole, (dispatch, frames)) in whole.iter_mut().zip(merged) {
        // The small maps of a frame without features stand for all of it.
        let is_small = *frames == For::NoFeatures && !matches!(dispatch.call, Call::Expand(_));
        *whole |= is_small || frame.keeps_features && dispatch.of_features;
    }
    whole
}

/// The lists, and for every dispatch the one that it runs over.
fn part(merged: &[(Dispatch, For)], whole: &[bool], padded: Extent) -> (Vec<List>, Vec<Option<usize>>) {
    let mut lists: Vec<List> = Vec::new();
    let list_of = merged.iter().zip(whole).map(|((dispatch, _), whole)| {
        let (_, width, height) = dispatch.call.tiles().filter(|_| !whole)?;
        if is_output(dispatch) {
            return None; // It writes every pixel.
        }
        let tile_pixels = padded.width / width * TILE;
        let (columns, rows) = (width / TILE, height / TILE);
        let part = Part { stage: dispatch.stage, tile_pixels, tiles: columns * rows };
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
        lists[at].max_y = lists[at].max_y.max(largest_y(&dispatch.call));
        Some(at)
    });
    let list_of = list_of.collect();
    (lists, list_of)
}

/// The most workgroups in y that a call has in any variant.
fn largest_y(call: &Call) -> u32 {
    let variants = [(false, false), (true, false), (false, true)];
    let variants = variants.map(|(cpu, matrix)| Variants { cpu, matrix, images: false, output_half: false });
    variants.into_iter().map(|variants| call.kernel().groups(variants)[1]).max().unwrap_or(1)
}

/// Has tiles `first..end` of so many pixels along an axis look at a square of the map.
fn look(reach: &mut [Reach; REACHES], tile_pixels: u32, square: u32, (first, end): (u32, u32)) {
    for tile in first..end {
        let start = tile * tile_pixels / MAP_TILE;
        let reach = &mut reach[start as usize % REACHES];
        reach.back = reach.back.max(start.saturating_sub(square));
        reach.on = reach.on.max(square.saturating_sub(start));
    }
}

/// Tiles look at the squares that need them, with their blend: found square by square along the frame's diagonal, as columns and
/// rows do not depend on each other.
fn reach_exactly(lists: &mut [List], list_of: &[Option<usize>], merged: &[(Dispatch, For)], frame: &Frame) {
    let Extent { width, height } = frame.extent;
    for other in KINDS {
        let (places, dispatches) = sequence(merged, other);
        for square in 0..width.max(height).div_ceil(MAP_TILE) {
            let own = |size: u32| square.min((size - 1) / MAP_TILE);
            let (column, row) = (own(width), own(height));
            let axis = |square: u32, size: u32| {
                let first = (square * MAP_TILE).saturating_sub(BLEND_PIXELS);
                (first, ((square + 1) * MAP_TILE + BLEND_PIXELS).min(size) - first)
            };
            let ((x, width), (y, height)) = (axis(column, width), axis(row, height));
            let needed = needed_tokens(&dispatches, Region { x, y, width, height }, |_| false);
            for (at, rect) in places.iter().zip(needed) {
                let (Some(list), Some(rect)) = (list_of[*at], rect) else { continue };
                if !rect.is_empty() {
                    let List { reach, part: Part { tile_pixels, .. }, .. } = &mut lists[list];
                    look(reach, *tile_pixels, column, (rect.left / TILE, rect.right.div_ceil(TILE)));
                    look(reach, *tile_pixels, row, (rect.top / TILE, rect.bottom.div_ceil(TILE)));
                }
            }
        }
    }
}

/// Tiles look as far as their stage's margin; they are read as far as other tiles do, and a token around.
fn reach_by_margins(lists: &mut [List], list_of: &[Option<usize>], merged: &[(Dispatch, For)], margins: &QuietMargins) {
    let reads = reads(merged, list_of);
    // In the middle of a map without ends, where every phase occurs.
    let middle = 1 << 10;
    for square in (middle..).take(REACHES) {
        let around = |first: u32, end: u32, pixels: u32| (first.saturating_sub(pixels), end.saturating_add(pixels));
        let tiles = |list: &List, (first, end): (u32, u32)| {
            let pixels = list.part.tile_pixels;
            (first / pixels, end.div_ceil(pixels))
        };
        let active = |list: &List| {
            let pixels = margins.of(list.part.stage).min(middle * MAP_TILE);
            tiles(list, around(square * MAP_TILE, (square + 1) * MAP_TILE, pixels))
        };
        let spans: Vec<_> = lists.iter().map(active).collect();
        for (list, span) in lists.iter_mut().zip(&spans) {
            look(&mut list.reach, list.part.tile_pixels, square, *span);
        }
        for &(reader, producer) in &reads {
            let of_reader = lists[reader].part.tile_pixels;
            let (first, end) = (spans[reader].0 * of_reader, spans[reader].1 * of_reader);
            let list = &mut lists[producer];
            let span = tiles(list, around(first, end, list.part.tile_pixels / TILE));
            look(&mut list.read, list.part.tile_pixels, square, span);
        }
    }
}

/// Which list's dispatches read what a list's have written: (reader, producer).
fn reads(merged: &[(Dispatch, For)], list_of: &[Option<usize>]) -> Vec<(usize, usize)> {
    let mut pairs = Vec::new();
    each_read(merged, list_of, |(_, reader), (_, producer), _| {
        if !pairs.contains(&(reader, producer)) {
            pairs.push((reader, producer));
        }
    });
    pairs
}

/// A dispatch's place, and its list.
type InList = (usize, usize);

/// Calls `each` with every dispatch over a list and every one before it that has written a buffer that it reads.
fn each_read(merged: &[(Dispatch, For)], list_of: &[Option<usize>], mut each: impl FnMut(InList, InList, BufferId)) {
    for other in KINDS {
        let mut written: HashMap<BufferId, Vec<InList>> = HashMap::new();
        for (at, ((dispatch, frames), list)) in merged.iter().zip(list_of).enumerate() {
            let (Some(list), true) = (*list, *frames != other) else { continue };
            let traffic = dispatch.call.kernel().traffic();
            for (id, _) in &traffic.reads {
                written.get(id).into_iter().flatten().for_each(|producer| each((at, list), *producer, *id));
            }
            traffic.writes.iter().for_each(|(id, _)| written.entry(*id).or_default().push((at, list)));
        }
    }
}

/// The dispatches whose results are read beyond their own tiles, by convolutions or by dispatches over another list, with the side
/// of a tile of theirs in tokens of the result.
fn read_beyond(merged: &[(Dispatch, For)], list_of: &[Option<usize>]) -> HashMap<usize, u32> {
    let side = |call: &Call| match call {
        Call::Conv3x3(conv) => side_of(conv.shuffle),
        Call::Winograd3x3(winograd) => side_of(winograd.conv.shuffle),
        Call::Unembed(_) => side_of(Shuffle::Shuffle),
        _ => TILE,
    };
    let mut found = HashMap::new();
    each_read(merged, list_of, |(at, reader), (from, producer), id| {
        let around = merged[at].0.call.reads_around().is_some_and(|view| view.buffer == id);
        if around || reader != producer {
            found.insert(from, side(&merged[from].0.call));
        }
    });
    found
}

fn side_of(shuffle: Shuffle) -> u32 {
    match shuffle {
        Shuffle::None => TILE,
        Shuffle::Shuffle => 2 * TILE,
        Shuffle::Unshuffle => TILE / 2,
    }
}

//! How far tiles look on the map of what is converged, for whether they are active and for whether they are read.

use super::Dispatch;
use super::active::Part;
use super::featureless::For;
use super::converged::{Frame, KINDS, List, sequence};
use super::region::needed_tokens;
use crate::frame::{Extent, Region};
use crate::kernels::converged::{BLEND_PIXELS, MAP_TILE, REACHES, Reach};
use crate::kernels::{Access, BufferId, Scale, TILE};
use crate::options::ConvergedMargins;
use std::collections::HashMap;

/// Has tiles `first..end` of so many pixels along an axis look at a square of the map.
fn look(reach: &mut [Reach; REACHES], tile_pixels: u32, square: u32, (first, end): (u32, u32)) {
    for tile in first..end {
        let start = tile * tile_pixels / MAP_TILE;
        let reach = &mut reach[start as usize % REACHES];
        reach.back = reach.back.max(start.saturating_sub(square));
        reach.on = reach.on.max(square.saturating_sub(start));
    }
}

/// Tiles look at the squares that need them, with their blend: found square by square along the frame's diagonal, as
/// columns and rows do not depend on each other.
pub(super) fn reach_exactly(lists: &mut [List], list_of: &[Option<usize>], merged: &[(Dispatch, For)], frame: &Frame) {
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
pub(super) fn reach_by_margins(
    lists: &mut [List],
    list_of: &[Option<usize>],
    merged: &[(Dispatch, For)],
    margins: &ConvergedMargins,
) {
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
            let traffic = dispatch.call.traffic();
            for (id, _) in &traffic.reads {
                written.get(id).into_iter().flatten().for_each(|producer| each((at, list), *producer, *id));
            }
            traffic.writes.iter().for_each(|(id, _)| written.entry(*id).or_default().push((at, list)));
        }
    }
}

/// The dispatches and those of their results that are read beyond their own tiles, by convolutions or by dispatches
/// over another list, with the side of a tile of theirs in tokens of the result.
pub(super) fn read_beyond(merged: &[(Dispatch, For)], list_of: &[Option<usize>]) -> HashMap<(usize, BufferId), u32> {
    let mut found = HashMap::new();
    each_read(merged, list_of, |(at, reader), (from, producer), id| {
        let maps = merged[at].0.call.maps();
        let around = maps.iter().any(|(view, access)| access.reads_around() && view.buffer == id);
        if around || reader != producer {
            found.insert((from, id), side(&merged[from].0, id));
        }
    });
    found
}

/// The side, in tokens of a map that a dispatch writes, of a tile of its own.
fn side(dispatch: &Dispatch, id: BufferId) -> u32 {
    let scale = dispatch.call.maps().into_iter().find_map(|(view, access)| match access {
        Access::Write(scale) if view.buffer == id => Some(scale),
        _ => None,
    });
    match scale {
        Some(Scale::Double) => 2 * TILE,
        Some(Scale::Half) => TILE / 2,
        Some(Scale::Tile) => 1,
        Some(Scale::Same) | None => TILE,
    }
}

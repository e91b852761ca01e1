//! What a region of the frame depends on: from the wanted pixels back to the first kernel, the tiles of every map that
//! count. All of them are rectangles, as every kernel takes a rectangle of tokens from a rectangle of tokens: itself
//! (pointwise), a border of one more (3x3), or whole windows (attention; a window is a tile).
//!
//! What is one number for the frame stays the frame's: exposure, depth scale, and the FiLM means, which need all tokens of
//! the auxiliary features of their stage.

use super::{Dispatch, Plan};
use crate::frame::Region;
use crate::kernels::dense::Conv3x3;
use crate::kernels::frame_io::Output;
use crate::kernels::{BufferId, Call, Shuffle, TILE, TileRect, Tiles, View};
use std::collections::HashMap;

impl Plan {
    /// The dispatches, each over the tiles that the pixels of `region` depend on, their FLOPs in proportion. Those that
    /// the pixels do not depend on keep their place with no tiles. What is written has the bits of the whole frame's pass.
    pub fn of_region(&self, region: Region) -> Vec<Dispatch> {
        let mut dispatches = self.dispatches.clone();
        let mut needed = Needed::default();
        for dispatch in dispatches.iter_mut().rev() {
            match &mut dispatch.call {
                Call::Output(output) => restrict_output(output, region, &mut needed),
                call => restrict(call, &mut needed),
            }
            if let Some((tiles, width, height)) = dispatch.call.tiles() {
                let all = u64::from(Tiles::All.count(width, height)).max(1);
                dispatch.flops = dispatch.flops * u64::from(tiles.count(width, height)) / all;
            }
        }
        dispatches
    }
}

/// The tiles of every buffer that a later kernel reads.
#[derive(Default)]
struct Needed(HashMap<BufferId, TileRect>);

impl Needed {
    /// In tiles of the view.
    fn of(&self, view: &View) -> TileRect {
        let rect = self.0.get(&view.buffer).copied().unwrap_or_default();
        let row = |row: u32| row.saturating_sub(view.top / TILE).min(view.height / TILE);
        TileRect { top: row(rect.top), bottom: row(rect.bottom), ..rect }
    }

    /// Adds tiles of a view, as far as they lie in it.
    fn add(&mut self, view: &View, rect: TileRect) {
        let row = |row: u32| row.min(view.height / TILE) + view.top / TILE;
        let rect =
            TileRect { right: rect.right.min(view.width / TILE), top: row(rect.top), bottom: row(rect.bottom), ..rect };
        if rect.count() == 0 {
            return;
        }
        let known = self.0.entry(view.buffer).or_insert(rect);
        known.left = known.left.min(rect.left);
        known.top = known.top.min(rect.top);
        known.right = known.right.max(rect.right);
        known.bottom = known.bottom.max(rect.bottom);
    }

    fn add_all(&mut self, view: &View) {
        self.add(view, TileRect { left: 0, top: 0, right: view.width / TILE, bottom: view.height / TILE });
    }

    /// Adds the tiles that a 3x3 convolution of a stride needs for those of its result.
    fn add_around(&mut self, view: &View, rect: TileRect, stride: u32) {
        if rect.count() == 0 {
            return;
        }
        // In tokens: from one before the first to one after the centre of the last.
        let first = |tile: u32| (tile * TILE * stride).saturating_sub(1) / TILE;
        let end = |tile: u32| ((tile * TILE - 1) * stride + 2).div_ceil(TILE);
        let (left, top, right, bottom) = (first(rect.left), first(rect.top), end(rect.right), end(rect.bottom));
        self.add(view, TileRect { left, top, right, bottom });
    }
}

/// Restricts the last kernel to the pixels that are wanted.
fn restrict_output(output: &mut Output, region: Region, needed: &mut Needed) {
    let (right, bottom) = (region.right(), region.bottom());
    let rect = TileRect {
        left: region.x / TILE,
        top: region.y / TILE,
        right: right.div_ceil(TILE),
        bottom: bottom.div_ceil(TILE),
    };
    (output.tiles, output.region) = (Tiles::Rect(rect), region);
    needed.add(&output.residual, rect);
    needed.add(&output.log_color, rect);
}

/// Restricts a call to what is needed of its result, and adds what it needs itself.
fn restrict(call: &mut Call, needed: &mut Needed) {
    match call {
        Call::Conv3x3(conv) => restrict_conv(conv, needed),
        Call::Winograd3x3(winograd) => restrict_conv(&mut winograd.conv, needed),
        Call::Separable3x3(separable) => {
            let rect = narrow(&mut separable.pointwise.tiles, needed.of(&separable.pointwise.dst));
            needed.add_around(&separable.depthwise.src, rect, 1);
            separable.pointwise.residual.iter().for_each(|residual| needed.add(residual, rect));
        }
        Call::Linear(linear) => {
            let rect = narrow(&mut linear.tiles, needed.of(&linear.dst));
            for source in [Some(&linear.src), linear.src_b.as_ref(), linear.residual.as_ref()].into_iter().flatten() {
                needed.add(source, rect);
            }
        }
        Call::Depthwise3x3(depthwise) => {
            let rect = narrow(&mut depthwise.tiles, needed.of(&depthwise.dst));
            needed.add_around(&depthwise.src, rect, 1);
        }
        Call::LayerNorm(norm) => {
            let rect = narrow(&mut norm.tiles, needed.of(&norm.dst));
            needed.add(&norm.src, rect);
        }
        Call::WindowAttention(attention) => {
            let rect = narrow(&mut attention.tiles, needed.of(&attention.dst));
            needed.add(&attention.x, rect);
            needed.add(&attention.f, rect);
        }
        Call::InputColor(input) => input.tiles = Tiles::Rect(needed.of(&input.dst)),
        Call::InputAux(input) => input.tiles = Tiles::Rect(needed.of(&input.dst)),
        Call::TokenSum(sum) => needed.add_all(&sum.src),
        Call::Output(_)
        | Call::FilmVector(_)
        | Call::StatsClear(_)
        | Call::StatsHistogram(_)
        | Call::StatsSelect(_)
        | Call::StatsTiles(_)
        | Call::StatsKey(_) => {}
    }
}

/// Narrows the tiles of a call to those of `rect`; returns what is left.
fn narrow(tiles: &mut Tiles, rect: TileRect) -> TileRect {
    let left = match tiles {
        Tiles::Rect(own) => TileRect {
            left: own.left.max(rect.left),
            top: own.top.max(rect.top),
            right: own.right.min(rect.right),
            bottom: own.bottom.min(rect.bottom),
        },
        _ => rect,
    };
    *tiles = Tiles::Rect(left);
    left
}

/// Restricts calls that run one after the other to what the last one needs for the tiles `last` of its result, which
/// are given its size in tokens.
pub(super) fn restrict_chain(calls: &mut [&mut Call], last: impl FnOnce(u32, u32) -> TileRect) {
    let mut needed = Needed::default();
    if let Some(view) = calls.last().and_then(|call| call.result()) {
        needed.add(view, last(view.width, view.height));
    }
    for call in calls.iter_mut().rev() {
        restrict(call, &mut needed);
    }
}

fn restrict_conv(conv: &mut Conv3x3, needed: &mut Needed) {
    let wanted = needed.of(&conv.dst);
    let rect = match conv.shuffle {
        Shuffle::None => wanted,
        // The result is stored at twice its size ...
        Shuffle::Shuffle => TileRect {
            left: wanted.left / 2,
            top: wanted.top / 2,
            right: wanted.right.div_ceil(2),
            bottom: wanted.bottom.div_ceil(2),
        },
        // ... or at half of it.
        Shuffle::Unshuffle => {
            TileRect { left: wanted.left * 2, top: wanted.top * 2, right: wanted.right * 2, bottom: wanted.bottom * 2 }
        }
    };
    let rect = narrow(&mut conv.tiles, rect);
    needed.add_around(&conv.src, rect, conv.stride);
    conv.residual.iter().for_each(|residual| needed.add(residual, rect));
}

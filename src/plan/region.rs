//! What a region of the frame depends on: from the wanted pixels back to the first kernel, the tiles of every map that
//! count. All of them are rectangles, as every kernel takes a rectangle of tokens from a rectangle of tokens: itself
//! (pointwise), a border of one more (3x3), or whole windows (attention; a window is a tile).
//!
//! What is one number for the frame stays the frame's: exposure, depth scale, and the FiLM means, which need all tokens of
//! the auxiliary features of their stage.

use super::{Dispatch, Plan};
use crate::frame::Region;
use crate::kernels::dense::Conv3x3;
use crate::kernels::{BufferId, Call, Shuffle, TILE, TileRect, Tiles, View};
use std::collections::HashMap;

impl Plan {
    /// The dispatches, each over the tiles that the pixels of `region` depend on, their FLOPs in proportion. Those that
    /// the pixels do not depend on keep their place with no tiles. What is written has the bits of the whole frame's pass.
    pub fn of_region(&self, region: Region) -> Vec<Dispatch> {
        let mut dispatches = self.dispatches.clone();
        let mut needed = Needed::default();
        for dispatch in dispatches.iter_mut().rev() {
            restrict(&mut dispatch.call, region, &mut needed);
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
    fn of(&self, view: &View) -> TileRect {
        self.0.get(&view.buffer).copied().unwrap_or_default()
    }

    /// Adds tiles of a map, as far as they lie in it.
    fn add(&mut self, view: &View, rect: TileRect) {
        let rect =
            TileRect { right: rect.right.min(view.width / TILE), bottom: rect.bottom.min(view.height / TILE), ..rect };
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

/// Restricts a call to what is needed of its result, and adds what it needs itself.
fn restrict(call: &mut Call, region: Region, needed: &mut Needed) {
    match call {
        Call::Output(output) => {
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
        Call::Conv3x3(conv) => restrict_conv(conv, needed),
        Call::Winograd3x3(winograd) => restrict_conv(&mut winograd.conv, needed),
        Call::Separable3x3(separable) => {
            let rect = needed.of(&separable.pointwise.dst);
            separable.pointwise.tiles = Tiles::Rect(rect);
            needed.add_around(&separable.depthwise.src, rect, 1);
            separable.pointwise.residual.iter().for_each(|residual| needed.add(residual, rect));
        }
        Call::Linear(linear) => {
            let rect = needed.of(&linear.dst);
            linear.tiles = Tiles::Rect(rect);
            for source in [Some(&linear.src), linear.src_b.as_ref(), linear.residual.as_ref()].into_iter().flatten() {
                needed.add(source, rect);
            }
        }
        Call::Depthwise3x3(depthwise) => {
            let rect = needed.of(&depthwise.dst);
            depthwise.tiles = Tiles::Rect(rect);
            needed.add_around(&depthwise.src, rect, 1);
        }
        Call::LayerNorm(norm) => {
            let rect = needed.of(&norm.dst);
            norm.tiles = Tiles::Rect(rect);
            needed.add(&norm.src, rect);
        }
        Call::WindowAttention(attention) => {
            let rect = needed.of(&attention.dst);
            attention.tiles = Tiles::Rect(rect);
            needed.add(&attention.x, rect);
            needed.add(&attention.f, rect);
        }
        Call::InputColor(input) => input.tiles = Tiles::Rect(needed.of(&input.dst)),
        Call::InputAux(input) => input.tiles = Tiles::Rect(needed.of(&input.dst)),
        Call::TokenSum(sum) => needed.add_all(&sum.src),
        Call::FilmVector(_)
        | Call::StatsClear(_)
        | Call::StatsHistogram(_)
        | Call::StatsSelect(_)
        | Call::StatsTiles(_)
        | Call::StatsKey(_) => {}
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
    conv.tiles = Tiles::Rect(rect);
    needed.add_around(&conv.src, rect, conv.stride);
    conv.residual.iter().for_each(|residual| needed.add(residual, rect));
}

//! What a region of the frame depends on: from the wanted pixels back to the first kernel, the tokens of every map that
//! count. All of them are rectangles, as every kernel takes a rectangle of tokens from a rectangle of tokens: itself
//! (pointwise), a border of one more (3x3), or whole windows (attention; a window is a tile).
//!
//! A dispatch covers its rectangle with tiles. What these hold beyond it is computed from whatever the arena holds and is
//! read by nobody.
//!
//! What is one number for the frame stays the frame's: exposure, depth scale, and the FiLM means, which need all tokens of
//! the auxiliary features of their stage.

use super::{Dispatch, Plan};
use crate::frame::Region;
use crate::kernels::dense::Conv3x3;
use crate::kernels::frame_io::Output;
use crate::kernels::winograd::Winograd3x3;
use crate::kernels::{BufferId, Call, Shuffle, TILE, TileRect, Tiles, TokenRect, View};
use std::collections::HashMap;

impl Plan {
    /// The dispatches, each over the tiles that the pixels of `region` depend on, their FLOPs in proportion. Those that
    /// the pixels do not depend on are skipped. What is written has the bits of the whole frame's pass. Where the plan keeps
    /// what depends on the features alone, that is the whole frame's: the next frame may want another region.
    pub fn of_region(&self, region: Region) -> Vec<Dispatch> {
        let mut dispatches = self.dispatches.clone();
        self.restrict_to(region, &mut dispatches);
        dispatches
    }

    /// The same for other dispatches of this plan.
    pub(crate) fn restrict_to(&self, region: Region, dispatches: &mut [Dispatch]) {
        let mut needed = Needed::default();
        for dispatch in dispatches.iter_mut().rev() {
            if self.keeps_features && dispatch.of_features {
                continue;
            }
            match &mut dispatch.call {
                Call::Output(output) => restrict_output(output, region, &mut needed),
                call => restrict(call, &mut needed),
            }
            if let Some((tiles, width, height)) = dispatch.call.tiles() {
                let all = u64::from(Tiles::All.count(width, height)).max(1);
                let count = tiles.count(width, height);
                dispatch.flops = dispatch.flops * u64::from(count) / all;
                if count == 0 {
                    dispatch.skip();
                }
            }
        }
    }
}

/// The tokens of every buffer that a later kernel reads.
#[derive(Default)]
struct Needed(HashMap<BufferId, TokenRect>);

impl Needed {
    /// In tokens of the view.
    fn of(&self, view: &View) -> TokenRect {
        let rect = self.0.get(&view.buffer).copied().unwrap_or_default();
        let row = |row: u32| row.saturating_sub(view.top).min(view.height);
        TokenRect { top: row(rect.top), bottom: row(rect.bottom), ..rect }
    }

    /// Narrows the tiles of a kernel over `view` to what is needed of it.
    fn narrow(&self, view: &View, tiles: &mut Tiles) -> TokenRect {
        narrow(tiles, self.of(view), view.width, view.height)
    }

    /// Adds tokens of a view, as far as they lie in it.
    fn add(&mut self, view: &View, rect: TokenRect) {
        let rect = rect.within(view.width, view.height);
        let known = self.0.entry(view.buffer).or_default();
        *known = known.and(&TokenRect { top: rect.top + view.top, bottom: rect.bottom + view.top, ..rect });
    }

    fn add_all(&mut self, view: &View) {
        self.add(view, TokenRect { left: 0, top: 0, right: view.width, bottom: view.height });
    }

    /// Adds what lies within so many tokens of some.
    fn add_within(&mut self, view: &View, rect: TokenRect, reach: u32) {
        let TokenRect { left, top, right, bottom } = rect;
        if !rect.is_empty() {
            let (left, top) = (left.saturating_sub(reach), top.saturating_sub(reach));
            self.add(view, TokenRect { left, top, right: right + reach, bottom: bottom + reach });
        }
    }

    /// Adds what a 3x3 convolution of a stride reads for the tokens of its result.
    fn add_around(&mut self, view: &View, rect: TokenRect, stride: u32) {
        if rect.is_empty() {
            return;
        }
        let first = |token: u32| (token * stride).saturating_sub(1);
        let end = |token: u32| (token - 1) * stride + 2;
        let (left, top, right, bottom) = (first(rect.left), first(rect.top), end(rect.right), end(rect.bottom));
        self.add(view, TokenRect { left, top, right, bottom });
    }
}

/// Narrows tiles to those that cover `rect`, as far as they did before; returns the tokens that are left to compute.
fn narrow(tiles: &mut Tiles, rect: TokenRect, width: u32, height: u32) -> TokenRect {
    let rect = match tiles {
        // A band's.
        Tiles::Rect(own) => rect.common(&own.tokens()),
        _ => rect,
    };
    *tiles = cover(rect, width, height);
    rect
}

/// Restricts calls that run one after the other to what the last one needs for the pixel rows `first..end` of the frame.
/// The views are of the frame's rows from `top` to `bottom`.
pub(super) fn restrict_chain(calls: &mut [&mut Call], (top, bottom): (u32, u32), (first, end): (u32, u32)) {
    let mut needed = Needed::default();
    if let Some(view) = calls.last().and_then(|call| call.result()) {
        let row = |row: u32| (row - top) * view.height / (bottom - top);
        needed.add(view, TokenRect { left: 0, top: row(first), right: view.width, bottom: row(end) });
    }
    for call in calls.iter_mut().rev() {
        restrict(call, &mut needed);
    }
}

fn cover(rect: TokenRect, width: u32, height: u32) -> Tiles {
    Tiles::Rect(TileRect::covering(rect, width, height))
}

/// Restricts the last kernel to the pixels that are wanted.
fn restrict_output(output: &mut Output, region: Region, needed: &mut Needed) {
    let rect = TokenRect { left: region.x, top: region.y, right: region.right(), bottom: region.bottom() };
    (output.tiles, output.region) = (cover(rect, output.residual.width, output.residual.height), region);
    needed.add(&output.residual, rect);
    needed.add(&output.log_color, rect);
}

/// Restricts a call to what is needed of its result, and adds what it needs itself.
fn restrict(call: &mut Call, needed: &mut Needed) {
    match call {
        Call::Conv3x3(conv) => restrict_conv(conv, 1, needed),
        // A result of a Winograd tile has rounding errors of everything that the tile reads.
        Call::Winograd3x3(Winograd3x3 { conv, tile }) => restrict_conv(conv, tile.outputs(), needed),
        Call::Separable3x3(separable) => {
            let rect = needed.narrow(&separable.pointwise.dst, &mut separable.pointwise.tiles);
            needed.add_around(&separable.depthwise.src, rect, 1);
            separable.pointwise.residual.iter().for_each(|residual| needed.add(residual, rect));
        }
        Call::Linear(linear) => {
            let rect = needed.narrow(&linear.dst, &mut linear.tiles);
            for source in [Some(&linear.src), linear.src_b.as_ref(), linear.residual.as_ref()].into_iter().flatten() {
                needed.add(source, rect);
            }
        }
        Call::Depthwise3x3(depthwise) => {
            let rect = needed.narrow(&depthwise.dst, &mut depthwise.tiles);
            needed.add_around(&depthwise.src, rect, 1);
        }
        Call::LayerNorm(norm) => {
            let rect = needed.narrow(&norm.dst, &mut norm.tiles);
            needed.add(&norm.src, rect);
        }
        Call::Unembed(unembed) => {
            let rect =
                narrow(&mut unembed.tiles, needed.of(&unembed.dst).halved(), unembed.src.width, unembed.src.height);
            needed.add_within(&unembed.src, rect, 2);
        }
        Call::WindowAttention(attention) => {
            let rect = needed.of(&attention.dst).in_multiples_of(TILE);
            attention.tiles = cover(rect, attention.dst.width, attention.dst.height);
            needed.add(&attention.x, rect);
            needed.add(&attention.f, rect);
        }
        Call::Expand(expand) => {
            if !needed.narrow(&expand.dst, &mut expand.tiles).is_empty() {
                needed.add_all(&expand.src);
            }
        }
        Call::InputColor(input) => _ = needed.narrow(&input.dst, &mut input.tiles),
        Call::InputAux(input) => _ = needed.narrow(&input.dst, &mut input.tiles),
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

/// `grain`: tokens on a side that are computed together.
fn restrict_conv(conv: &mut Conv3x3, grain: u32, needed: &mut Needed) {
    let wanted = needed.of(&conv.dst);
    let TokenRect { left, top, right, bottom } = wanted;
    let rect = match conv.shuffle {
        Shuffle::None => wanted,
        // The result is stored at twice its size ...
        Shuffle::Shuffle => wanted.halved(),
        // ... or at half of it.
        Shuffle::Unshuffle => TokenRect { left: left * 2, top: top * 2, right: right * 2, bottom: bottom * 2 },
    };
    let (width, height) = conv.result_size();
    let rect = narrow(&mut conv.tiles, rect.in_multiples_of(grain), width, height);
    needed.add_around(&conv.src, rect, conv.stride);
    conv.residual.iter().for_each(|residual| needed.add(residual, rect));
}

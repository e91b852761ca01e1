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
use crate::kernels::predicted::REACH;
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
        set_region(region, dispatches);
        let keeps = |dispatch: &Dispatch| self.keeps_features && dispatch.of_features;
        let needed = needed_tokens(dispatches, region, keeps);
        for (dispatch, needed) in dispatches.iter_mut().zip(needed) {
            let (Some(rect), Some((_, width, height))) = (needed, dispatch.call.tiles()) else { continue };
            let tiles = restrict(&mut dispatch.call, rect);
            let all = u64::from(Tiles::All.count(width, height)).max(1);
            let count = tiles.count(width, height);
            dispatch.flops = dispatch.flops * u64::from(count) / all;
            if count == 0 {
                dispatch.skip();
            }
        }
    }
}

/// Has the last kernel write the pixels of a region alone.
pub(super) fn set_region(region: Region, dispatches: &mut [Dispatch]) {
    for dispatch in dispatches {
        if let Call::Output(output) = &mut dispatch.call {
            output.region = region;
        }
    }
}

/// The tokens that every dispatch has to compute of its result for the pixels of `region`, and no others; `None` for those
/// without tiles and for those that are kept as they are.
pub(super) fn needed_tokens(
    dispatches: &[Dispatch],
    region: Region,
    keeps: impl Fn(&Dispatch) -> bool,
) -> Vec<Option<TokenRect>> {
    let mut needed = Needed::default();
    let rect = |dispatch: &Dispatch| match &dispatch.call {
        _ if keeps(dispatch) => None,
        Call::Output(output) => Some(needed.output(output, region)),
        call => needed.before(call),
    };
    let mut rects: Vec<_> = dispatches.iter().rev().map(rect).collect();
    rects.reverse();
    rects
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

    /// What a kernel over `tiles` of `view` has to compute of it.
    fn within(&self, view: &View, tiles: &Tiles) -> TokenRect {
        within(self.of(view), tiles)
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

/// What of the needed tokens a kernel over `tiles` computes.
fn within(rect: TokenRect, tiles: &Tiles) -> TokenRect {
    match tiles {
        // A band's.
        Tiles::Rect(own) => rect.common(&own.tokens()),
        Tiles::All | Tiles::List { .. } => rect,
    }
}

/// Has a call work on the tiles that cover some tokens, and returns them.
fn restrict(call: &mut Call, rect: TokenRect) -> Tiles {
    let Some((_, width, height)) = call.tiles() else { return Tiles::All };
    // A frame's last tiles may be partial.
    let (width, height) = (width.next_multiple_of(TILE), height.next_multiple_of(TILE));
    let tiles = Tiles::Rect(TileRect::covering(rect, width, height));
    call.tiles_mut().into_iter().for_each(|own| *own = tiles);
    tiles
}

/// Restricts calls that run one after the other to what those whose result stays need for the pixel rows `first..end` of the frame.
/// The views are of the frame's rows from `top` to `bottom`.
pub(super) fn restrict_chain(
    calls: &mut [&mut Call],
    stays: &[bool],
    (top, bottom): (u32, u32),
    (first, end): (u32, u32),
) {
    let mut needed = Needed::default();
    let staying = calls.iter().zip(stays).filter(|(_, stays)| **stays);
    for view in staying.filter_map(|(call, _)| call.result()) {
        let row = |row: u32| (row - top) * view.height / (bottom - top);
        needed.add(view, TokenRect { left: 0, top: row(first), right: view.width, bottom: row(end) });
    }
    for call in calls.iter_mut().rev() {
        if let Some(rect) = needed.before(call) {
            restrict(call, rect);
        }
    }
}

impl Needed {
    /// What the last kernel has to compute for the pixels that are wanted; what it needs itself is added.
    fn output(&mut self, output: &Output, region: Region) -> TokenRect {
        let rect = TokenRect { left: region.x, top: region.y, right: region.right(), bottom: region.bottom() };
        self.add(&output.residual, rect);
        self.add(&output.log_color, rect);
        rect
    }

    /// What a call has to compute for those after it; what it needs itself is added. `None` for kernels without tiles.
    fn before(&mut self, call: &Call) -> Option<TokenRect> {
        Some(match call {
            Call::Conv3x3(conv) => self.before_conv(conv, 1),
            // A result of a Winograd tile has rounding errors of everything that the tile reads.
            Call::Winograd3x3(Winograd3x3 { conv, tile }) => self.before_conv(conv, tile.outputs()),
            Call::Separable3x3(separable) => {
                let rect = self.within(&separable.pointwise.dst, &separable.pointwise.tiles);
                self.add_around(&separable.depthwise.src, rect, 1);
                separable.pointwise.residual.iter().for_each(|residual| self.add(residual, rect));
                rect
            }
            Call::Linear(linear) => {
                let rect = self.within(&linear.dst, &linear.tiles);
                let sources = [Some(&linear.src), linear.src_b.as_ref(), linear.residual.as_ref()];
                sources.into_iter().flatten().for_each(|source| self.add(source, rect));
                rect
            }
            Call::Depthwise3x3(depthwise) => {
                let rect = self.within(&depthwise.dst, &depthwise.tiles);
                self.add_around(&depthwise.src, rect, 1);
                rect
            }
            Call::LayerNorm(norm) => {
                let rect = self.within(&norm.dst, &norm.tiles);
                self.add(&norm.src, rect);
                rect
            }
            Call::Unembed(unembed) => {
                let rect = within(self.of(&unembed.dst).halved(), &unembed.tiles);
                self.add_within(&unembed.src, rect, 2);
                rect
            }
            Call::PredictKernels(kernels) => {
                let wanted = self.of(&kernels.dst).halved().and(&self.of(&kernels.sums));
                let rect = within(wanted, &kernels.tiles);
                let pixels = rect.doubled();
                self.add_within(&kernels.tokens, rect, REACH.div_ceil(2));
                for map in [&kernels.early, &kernels.albedo, &kernels.color, &kernels.residual] {
                    self.add_within(map, pixels, REACH);
                }
                rect
            }
            Call::Halve(halve) => {
                let rect = self.within(&halve.dst, &halve.tiles);
                self.add(&halve.src, rect.doubled());
                rect
            }
            Call::ApplyKernels(kernels) => {
                let rect = self.within(&kernels.dst, &kernels.tiles);
                self.add(&kernels.logits, rect);
                self.add_within(&kernels.sums, rect, REACH);
                rect
            }
            Call::MixLevels(mix) => {
                let rect = self.within(&mix.dst, &mix.tiles);
                let direct = mix.direct.iter().flat_map(|(color, residual)| [color, residual]);
                [&mix.pixels].into_iter().chain(direct).for_each(|map| self.add(map, rect));
                for level in &mix.levels {
                    // The tokens that hold the pixels, and their neighbours.
                    self.add_within(level, rect.divided(mix.dst.width / level.width), 1);
                }
                rect
            }
            Call::WindowAttention(attention) => {
                let rect = self.of(&attention.dst).in_multiples_of(TILE);
                self.add(&attention.x, rect);
                self.add(&attention.f, rect);
                rect
            }
            Call::Expand(expand) => {
                let rect = self.within(&expand.dst, &expand.tiles);
                if !rect.is_empty() {
                    self.add_all(&expand.src);
                }
                rect
            }
            Call::InputColor(input) => self.within(&input.dst, &input.tiles),
            Call::InputAux(input) => self.within(&input.dst, &input.tiles),
            Call::TokenSum(sum) => {
                self.add_all(&sum.src);
                return None;
            }
            Call::Output(_)
            | Call::FilmVector(_)
            | Call::StatsClear(_)
            | Call::StatsHistogram(_)
            | Call::StatsSelect(_)
            | Call::StatsTiles(_)
            | Call::StatsKey(_)
            | Call::TileNoise(_)
            | Call::QuietMap(_)
            | Call::TileList(_)
            | Call::Fill(_) => return None,
        })
    }

    /// `grain`: tokens on a side that are computed together.
    fn before_conv(&mut self, conv: &Conv3x3, grain: u32) -> TokenRect {
        let wanted = self.of(&conv.dst);
        let TokenRect { left, top, right, bottom } = wanted;
        let rect = match conv.shuffle {
            Shuffle::None => wanted,
            // The result is stored at twice its size ...
            Shuffle::Shuffle => wanted.halved(),
            // ... or at half of it.
            Shuffle::Unshuffle => TokenRect { left: left * 2, top: top * 2, right: right * 2, bottom: bottom * 2 },
        };
        let rect = within(rect.in_multiples_of(grain), &conv.tiles);
        self.add_around(&conv.src, rect, conv.stride);
        conv.residual.iter().for_each(|residual| self.add(residual, rect));
        rect
    }
}

//! What a region of the frame depends on: from the wanted pixels back to the first kernel, the tokens of every map that
//! count. All of them are rectangles, as every kernel takes a rectangle of tokens from a rectangle of tokens: itself
//! (pointwise), a border of one more (3x3), or whole windows (attention; a window is a tile).
//!
//! A dispatch covers its rectangle with tiles. What these hold beyond it is computed from whatever the arena holds and
//! is read by nobody.
//!
//! What is one number for the frame stays the frame's: exposure, depth scale, and the FiLM means, which need all tokens
//! of the auxiliary features of their stage.

use super::ensemble::members;
use super::{Dispatch, Plan};
use crate::frame::Region;
use crate::kernels::{Access, BufferId, Call, Grid, TILE, TileRect, Tiles, TokenRect, View};
use std::collections::HashMap;

impl Plan {
    /// The dispatches, each over the tiles that the pixels of `region` depend on, their FLOPs in proportion. Those that
    /// the pixels do not depend on are skipped. What is written has the bits of the whole frame's pass. Where the plan
    /// keeps what depends on the features alone, that is the whole frame's: the next frame may want another region.
    pub fn of_region(&self, region: Region) -> Vec<Dispatch> {
        let mut dispatches = self.dispatches.clone();
        self.restrict_to(region, &mut dispatches);
        dispatches
    }

    /// The same for other dispatches of this plan.
    pub(crate) fn restrict_to(&self, region: Region, dispatches: &mut [Dispatch]) {
        for (dispatches, region) in members(dispatches, region, self.extent) {
            restrict_all(dispatches, region, |dispatch| self.keeps_features && dispatch.of_features);
        }
    }
}

/// Has the dispatches compute what the pixels of `region` depend on, and nothing else but those that are kept as they
/// are.
pub(super) fn restrict_all(dispatches: &mut [Dispatch], region: Region, keeps: impl Fn(&Dispatch) -> bool) {
    set_region(region, dispatches);
    let needed = needed_tokens(dispatches, region, keeps);
    for (dispatch, needed) in dispatches.iter_mut().zip(needed) {
        let (Some(rect), Some(grid)) = (needed, dispatch.call.grid()) else { continue };
        dispatch.set_tiles(covering(&grid, rect));
        let [count, all] = Grid { tiles: covering(&grid, rect), ..grid }.counts();
        dispatch.flops = dispatch.flops * u64::from(count) / u64::from(all).max(1);
        if count == 0 {
            dispatch.skip();
        }
    }
}

/// Has the last kernels write the pixels of a region alone, a band's those that are its own too.
pub(super) fn set_region(region: Region, dispatches: &mut [Dispatch]) {
    for dispatch in dispatches {
        match &mut dispatch.call {
            Call::Output(output) => output.region = output.region.common(&region).unwrap_or(NOTHING),
            Call::OutputSignal(output) => output.region = region,
            _ => {}
        }
    }
}

/// No pixels.
const NOTHING: Region = Region { x: 0, y: 0, width: 0, height: 0 };

/// The tokens that every dispatch has to compute of its result for the pixels of `region`, and no others; `None` for
/// those without tiles and for those that are kept as they are.
pub(super) fn needed_tokens(
    dispatches: &[Dispatch],
    region: Region,
    keeps: impl Fn(&Dispatch) -> bool,
) -> Vec<Option<TokenRect>> {
    let mut needed = Needed::default();
    let rect = |dispatch: &Dispatch| match &dispatch.call {
        _ if keeps(dispatch) => None,
        call @ (Call::Output(_) | Call::OutputSignal(_)) => Some(needed.output(call, region)),
        call => needed.before(call, false),
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

    /// Adds tokens of a view, as far as they lie in it.
    fn add(&mut self, view: &View, rect: TokenRect) {
        let rect = rect.within(view.width, view.height);
        let known = self.0.entry(view.buffer).or_default();
        *known = known.and(&TokenRect { top: rect.top + view.top, bottom: rect.bottom + view.top, ..rect });
    }

    fn add_all(&mut self, view: &View) {
        self.add(view, TokenRect { left: 0, top: 0, right: view.width, bottom: view.height });
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

/// The tiles of a grid that cover some of its tokens.
fn covering(grid: &Grid, rect: TokenRect) -> Tiles {
    // A frame's last tiles may be partial.
    let (width, height) = (grid.width.next_multiple_of(TILE), grid.height.next_multiple_of(TILE));
    Tiles::Rect(TileRect::covering(rect, width, height))
}

/// Restricts calls that run one after the other to what those of which a map stays need for the pixel rows `first..end`
/// of the frame. The views are of the frame's rows from `top` to `bottom`. In a map that stays every token that is
/// written counts: it may be one of the band before.
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
        needed.add(&view, TokenRect { left: 0, top: row(first), right: view.width, bottom: row(end) });
    }
    for (call, stays) in calls.iter_mut().zip(stays).rev() {
        let Some(grid) = call.grid() else {
            needed.before(call, false);
            continue;
        };
        if let Some(rect) = needed.before(call, *stays) {
            call.set_tiles(covering(&grid, rect));
        }
    }
}

impl Needed {
    /// What a last kernel has to compute for the pixels that are wanted; what it needs itself is added.
    fn output(&mut self, output: &Call, region: Region) -> TokenRect {
        let (region, band) = match output {
            Call::Output(output) => {
                (output.region.common(&region).unwrap_or(NOTHING), Some((output.residual.buffer, output.residual_top)))
            }
            _ => (region, None),
        };
        let rect = TokenRect { left: region.x, top: region.y, right: region.right(), bottom: region.bottom() };
        for (view, access) in output.maps() {
            let top = band.filter(|(of_band, _)| *of_band == view.buffer).map_or(0, |(_, top)| top);
            let row = |row: u32| row.saturating_sub(top);
            let read = access.of_grid(TokenRect { top: row(rect.top), bottom: row(rect.bottom), ..rect });
            read.into_iter().for_each(|read| self.add(&view, read));
        }
        rect
    }

    /// What a call has to compute for those after it; what it needs itself is added, for all of the tiles that it
    /// computes where `tiles_count`. `None` for kernels without a grid.
    fn before(&mut self, call: &Call, tiles_count: bool) -> Option<TokenRect> {
        if let Call::TokenSum(sum) = call {
            self.add(&sum.whole(), sum.tokens());
            return None;
        }
        let maps = call.maps();
        let Some(grid) = call.grid() else {
            maps.iter().filter(|(_, access)| !access.writes()).for_each(|(view, _)| self.add_all(view));
            return None;
        };
        let wanted = maps.iter().filter_map(|(view, access)| match access {
            Access::Write(scale) => Some(scale.to_grid(self.of(view))),
            _ => None,
        });
        let wanted = wanted.fold(TokenRect::default(), |all, rect| all.and(&rect));
        let rect = match covering(&grid, wanted.in_multiples_of(grid.grain)) {
            Tiles::Rect(tiles) if tiles_count => tiles.tokens(),
            _ => within(wanted.in_multiples_of(grid.grain), &grid.tiles),
        };
        for (view, access) in maps.iter().filter(|(_, access)| !access.writes()) {
            match access.of_grid(rect) {
                Some(read) => self.add(view, read),
                None => self.add_all(view),
            }
        }
        Some(rect)
    }
}

//! Tiles of a frame that is too large for the device. A tile is planned like a frame of its own size; what is one
//! number for the whole frame is given to it: exposure and other statistics, the depth scale, the FiLM means.
//!
//! A tile's pixels far enough from its borders ([`margin`]) have the bits of the whole frame, if its origin is a
//! multiple of the network's padding, so that windows lie where they lie in the whole.

use super::region::restrict_all;
use super::{Dispatch, Plan, plan};
use crate::error::Result;
use crate::frame::{Extent, Region};
use crate::kernels::{BufferId, Call, TILE, Tiles, TokenRect};
use crate::net::graph::Graph;
use crate::target::Target;

/// Where what is of the whole frame has to be before a tile's dispatches run.
#[derive(Clone, Debug, PartialEq)]
pub struct Given {
    /// The statistics ([`crate::kernels::stats`]).
    pub stats: BufferId,
    /// The depth scale.
    pub depth_scale: BufferId,
    /// What is known of the 8x8 tiles.
    pub tile_stats: BufferId,
    /// The sums over tokens that FiLM means are made of.
    pub sums: Vec<Sums>,
}

/// Sums over tokens: a tile's partial sums after [`Plan::sums_of_tile`], the whole frame's one sum before
/// [`Plan::of_tile`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sums {
    /// Where they lie, `[sums][channels]`.
    pub buffer: BufferId,
    /// Channels of each.
    pub channels: u32,
    /// Pixels of a token, on a side.
    pub stride: u32,
}

impl Given {
    pub(super) fn of(dispatches: &[Dispatch]) -> Self {
        let mut given =
            Self { stats: BufferId(0), depth_scale: BufferId(0), tile_stats: BufferId(0), sums: Vec::new() };
        let width = dispatches.iter().find_map(|dispatch| match &dispatch.call {
            Call::InputColor(input) => Some(input.dst.width),
            _ => None,
        });
        for dispatch in dispatches {
            match &dispatch.call {
                Call::StatsKey(key) => {
                    (given.stats, given.depth_scale, given.tile_stats) = (key.stats, key.depth_scale, key.tile_stats);
                }
                Call::TokenSum(sum) => {
                    let (buffer, channels) = (sum.dst, sum.src.channels);
                    given.sums.push(Sums { buffer, channels, stride: width.unwrap_or(0) / sum.src.width });
                }
                _ => {}
            }
        }
        given
    }

    pub(super) fn buffers(&self) -> impl Iterator<Item = BufferId> {
        let sums = self.sums.iter().map(|sums| sums.buffer);
        [self.stats, self.depth_scale, self.tile_stats].into_iter().chain(sums)
    }
}

impl Sums {
    /// Tokens of a frame.
    pub fn tokens(&self, frame: Extent) -> u64 {
        u64::from(frame.width.div_ceil(self.stride)) * u64::from(frame.height.div_ceil(self.stride))
    }

    /// Tokens of a rectangle that begins at a token.
    fn rect(&self, core: Region) -> TokenRect {
        let (end, first) = (|pixel: u32| pixel.div_ceil(self.stride), |pixel: u32| pixel / self.stride);
        TokenRect { left: first(core.x), top: first(core.y), right: end(core.right()), bottom: end(core.bottom()) }
    }
}

impl Plan {
    /// What of a tile's dispatches makes the partial sums over its own pixels, `core`, and how many of them there are
    /// for each of [`Given::sums`]. It reads the features and the depth scale.
    pub(crate) fn sums_of_tile(&self, core: Region) -> (Vec<Dispatch>, Vec<u64>) {
        let mut dispatches = self.dispatches.clone();
        let mut counts = Vec::new();
        let sums: &[Sums] = self.given.as_ref().map_or(&[], |given| &given.sums);
        for dispatch in &mut dispatches {
            match &mut dispatch.call {
                Call::TokenSum(sum) => {
                    let own = sums.iter().find(|sums| sums.buffer == sum.dst);
                    own.iter().for_each(|own| sum.restrict_to(own.rect(core)));
                    counts.push(sum.sums());
                    dispatch.groups = dispatch.call.kernel().groups(&dispatch.variant);
                }
                call if is_of_whole(call) || matches!(call, Call::Output(_)) => dispatch.skip(),
                _ => {}
            }
        }
        restrict_all(&mut dispatches, core, |dispatch| dispatch.skipped);
        (dispatches, counts)
    }

    /// What of a tile's dispatches makes the pixels of `region`, a part of the tile; `frame` is the size of the whole.
    pub(crate) fn of_tile(&self, region: Region, frame: Extent) -> Vec<Dispatch> {
        let mut dispatches = self.dispatches.clone();
        let sums: &[Sums] = self.given.as_ref().map_or(&[], |given| &given.sums);
        for dispatch in &mut dispatches {
            match &mut dispatch.call {
                Call::TokenSum(_) => dispatch.skip(),
                Call::FilmVector(film) => {
                    let own = sums.iter().find(|sums| sums.buffer == film.partials);
                    own.iter().for_each(|own| (film.sums, film.tokens) = (1, own.tokens(frame)));
                }
                call if is_of_whole(call) => dispatch.skip(),
                _ => {}
            }
        }
        restrict_all(&mut dispatches, region, |dispatch| dispatch.skipped);
        dispatches
    }
}

/// Whether a kernel makes what is given.
fn is_of_whole(call: &Call) -> bool {
    matches!(
        call,
        Call::StatsClear(_)
            | Call::StatsHistogram(_)
            | Call::StatsSelect(_)
            | Call::StatsTiles(_)
            | Call::StatsKey(_)
            | Call::TokenSum(_)
            | Call::FilmVector(_)
    )
}

/// Pixels beyond a pixel of the network's input that mending it looks at: three tiles and their neighbours.
const MENDING: u32 = 2 * TILE;

/// How far from a tile's border a pixel has to be to have the bits of the whole frame: pixels, a multiple of the
/// network's padding.
///
/// # Errors
/// As [`plan`].
pub(crate) fn margin(graph: &Graph, target: &Target) -> Result<u32> {
    let multiple = graph.arch.pad_multiple();
    let (max_block_bytes, max_chain_bytes, max_kept_bytes) = (u64::MAX, u64::MAX, u64::MAX);
    let target = Target { max_block_bytes, max_chain_bytes, max_kept_bytes, of_tile: true, ..*target };
    let mut side = 32 * multiple;
    loop {
        let plan = plan(graph, Extent::new(side, side), &target)?;
        let at = side / 2;
        let core = Region { x: at, y: at, width: multiple, height: multiple };
        let inputs = plan
            .of_tile(core, plan.extent)
            .into_iter()
            .filter(|dispatch| matches!(dispatch.call, Call::InputColor(_) | Call::InputAux(_)) && !dispatch.skipped);
        let reach = inputs.filter_map(|input| match input.call.grid()?.tiles {
            Tiles::Rect(rect) => {
                let TokenRect { left, top, right, bottom } = rect.tokens();
                let (last, first) = (right.max(bottom), left.min(top));
                Some(at.saturating_sub(first).max(last.saturating_sub(at + multiple)))
            }
            _ => None,
        });
        let reach = reach.max().unwrap_or(0);
        if reach < at - multiple {
            return Ok((reach + MENDING).next_multiple_of(multiple));
        }
        side *= 2;
    }
}

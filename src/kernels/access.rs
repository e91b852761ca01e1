//! What a kernel touches: the maps, each with how its tokens belong to those that the kernel works on.

use super::{BufferId, TILE, Tiles, TokenRect, View};

/// How a kernel touches a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Reads so much of it for each token that it works on.
    Read(Footprint),
    /// Reads the tokens that it writes at this scale, to add them to its result.
    Residual(Scale),
    /// Writes it, at this scale.
    Write(Scale),
}

/// What a kernel reads of a map for token `t` of its grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Footprint {
    /// Tokens `stride t - reach` to `stride t + reach`, in x and in y.
    Around {
        /// Tokens of the map from one of the grid to the next.
        stride: u32,
        /// Tokens around.
        reach: u32,
    },
    /// The `by` x `by` tokens that it is made of.
    Finer {
        /// Tokens of the map, on a side, for one of the grid.
        by: u32,
    },
    /// The token of a map that is so many times coarser, and those within `reach` of it.
    Coarser {
        /// Tokens of the grid, on a side, for one of the map.
        by: u32,
        /// Tokens around.
        reach: u32,
    },
    /// All of it.
    Whole,
}

/// Size of a written map beside the kernel's grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// The same.
    Same,
    /// Twice the grid's.
    Double,
    /// Half of the grid's.
    Half,
    /// A token for each tile of the grid.
    Tile,
}

impl Access {
    /// Reads the very tokens that it works on.
    pub const SAME: Self = Self::around(1, 0);

    /// Reads what lies within `reach`.
    pub const fn around(stride: u32, reach: u32) -> Self {
        Self::Read(Footprint::Around { stride, reach })
    }

    /// Whether the map is written.
    pub fn writes(self) -> bool {
        matches!(self, Self::Write(_))
    }

    /// Whether tokens are read that belong to other tokens of the grid.
    pub fn reads_around(self) -> bool {
        match self {
            Self::Read(Footprint::Around { reach, .. } | Footprint::Coarser { reach, .. }) => reach > 0,
            _ => false,
        }
    }

    /// How far from its border the grid feels the map's, which the map itself feels for so many tokens; `None`:
    /// nowhere, as the map is written, or everywhere.
    pub(crate) fn margin(self, of_map: u32) -> Option<u32> {
        match self {
            Self::Read(Footprint::Around { stride, reach }) => Some((of_map + reach).div_ceil(stride)),
            Self::Read(Footprint::Finer { by }) => Some(of_map.div_ceil(by)),
            Self::Read(Footprint::Coarser { by, reach }) => Some((of_map + reach) * by),
            Self::Residual(Scale::Same) => Some(of_map),
            Self::Residual(Scale::Double) => Some(of_map.div_ceil(2)),
            Self::Residual(Scale::Half) => Some(2 * of_map),
            Self::Residual(Scale::Tile) => Some(TILE * of_map),
            Self::Read(Footprint::Whole) | Self::Write(_) => None,
        }
    }

    /// The tokens of the map, as far as it goes without a border, that belong to some tokens of the grid; `None`: all.
    pub(crate) fn of_grid(self, rect: TokenRect) -> Option<TokenRect> {
        let around = |stride: u32, reach: u32, rect: TokenRect| {
            let first = |token: u32| (token * stride).saturating_sub(reach);
            let end = |token: u32| token.saturating_sub(1) * stride + 1 + reach;
            let (left, top, right, bottom) = (first(rect.left), first(rect.top), end(rect.right), end(rect.bottom));
            TokenRect { left, top, right, bottom }
        };
        match self {
            _ if rect.is_empty() => Some(TokenRect::default()),
            Self::Read(Footprint::Whole) => None,
            Self::Read(Footprint::Around { stride, reach }) => Some(around(stride, reach, rect)),
            Self::Read(Footprint::Finer { by }) => Some(rect.times(by)),
            Self::Read(Footprint::Coarser { by, reach }) => Some(around(1, reach, rect.divided(by))),
            Self::Residual(scale) | Self::Write(scale) => Some(match scale {
                Scale::Same => rect,
                Scale::Double => rect.times(2),
                Scale::Half => rect.divided(2),
                Scale::Tile => rect.divided(TILE),
            }),
        }
    }
}

impl Scale {
    /// How far from its border the map feels it, where the grid does for so many tokens.
    pub(crate) fn margin(self, of_grid: u32) -> u32 {
        match self {
            Self::Same => of_grid,
            Self::Double => 2 * of_grid,
            Self::Half => of_grid.div_ceil(2),
            Self::Tile => of_grid.div_ceil(TILE),
        }
    }

    /// The tokens of the grid that make some tokens of the map.
    pub(crate) fn to_grid(self, rect: TokenRect) -> TokenRect {
        match self {
            Self::Same => rect,
            Self::Double => rect.divided(2),
            Self::Half => rect.times(2),
            Self::Tile => rect.times(TILE),
        }
    }
}

/// The tokens that a kernel works on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grid {
    /// Which tiles of them.
    pub tiles: Tiles,
    /// Tokens in x.
    pub width: u32,
    /// Tokens in y.
    pub height: u32,
    /// Tokens on a side that are computed together, of which each depends on what any of them reads.
    pub grain: u32,
}

impl Grid {
    /// Of tokens that do not depend on each other.
    pub fn new(tiles: Tiles, width: u32, height: u32) -> Self {
        Self { tiles, width, height, grain: 1 }
    }

    /// As large as a map.
    pub(super) fn of(tiles: Tiles, map: &View) -> Self {
        Self::new(tiles, map.width, map.height)
    }

    /// The same, computed window by window.
    pub(super) fn in_windows(self) -> Self {
        Self { grain: TILE, ..self }
    }

    /// Tiles that it works on, and tiles that there are.
    pub fn counts(&self) -> [u32; 2] {
        [self.tiles, Tiles::All].map(|tiles| tiles.count(self.width, self.height))
    }
}

/// What a kernel reads and writes: (buffer, bytes).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Buffers read, each with the bytes that are needed of it once.
    pub reads: Vec<(BufferId, u64)>,
    /// Buffers written.
    pub writes: Vec<(BufferId, u64)>,
}

impl Traffic {
    /// Of reads alone.
    pub(super) fn reading(reads: impl IntoIterator<Item = (BufferId, u64)>) -> Self {
        Self { reads: reads.into_iter().collect(), writes: Vec::new() }
    }

    /// Whether a buffer is read or written.
    pub fn touches(&self, buffer: BufferId) -> bool {
        self.reads.iter().chain(&self.writes).any(|(id, _)| *id == buffer)
    }
}

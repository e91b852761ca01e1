//! The tiles that a dispatch works on. `glsl/shared/tiles.glsl` is the shaders' side.

use super::{BufferId, flags};

/// Side of a tile in tokens: the attention window, and what every kernel cuts its work into.
pub const TILE: u32 = 8;

/// A rectangle of tiles may begin at every multiple of this many tokens. Winograd's tiles begin at such places and only
/// there, and a token's place within its invocation is the same whichever rectangle it is in: so are the bits of its
/// result. (Depthwise on CPU drivers, of eight tokens in a row, treats the two halves of a row alike.)
pub const HALF_TILE: u32 = TILE / 2;

/// A rectangle of tokens, ends excluded. Nothing where `right <= left` or `bottom <= top`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TokenRect {
    /// First column.
    pub left: u32,
    /// First row.
    pub top: u32,
    /// Column after the last.
    pub right: u32,
    /// Row after the last.
    pub bottom: u32,
}

impl TokenRect {
    /// Whether it has no token.
    pub fn is_empty(&self) -> bool {
        self.right <= self.left || self.bottom <= self.top
    }

    /// The least rectangle that covers both.
    pub fn and(&self, other: &Self) -> Self {
        if self.is_empty() {
            return *other;
        }
        if other.is_empty() {
            return *self;
        }
        Self {
            left: self.left.min(other.left),
            top: self.top.min(other.top),
            right: self.right.max(other.right),
            bottom: self.bottom.max(other.bottom),
        }
    }

    /// What lies in both.
    pub fn common(&self, other: &Self) -> Self {
        Self {
            left: self.left.max(other.left),
            top: self.top.max(other.top),
            right: self.right.min(other.right),
            bottom: self.bottom.min(other.bottom),
        }
    }

    /// What of it lies in a map.
    pub fn within(&self, width: u32, height: u32) -> Self {
        Self { right: self.right.min(width), bottom: self.bottom.min(height), ..*self }
    }

    /// The tokens of a map of a part of the size that cover it.
    pub fn divided(&self, by: u32) -> Self {
        let Self { left, top, right, bottom } = *self;
        Self { left: left / by, top: top / by, right: right.div_ceil(by), bottom: bottom.div_ceil(by) }
    }

    /// The tokens of a map of so many times the size that it covers.
    pub fn times(&self, by: u32) -> Self {
        let Self { left, top, right, bottom } = *self;
        Self { left: by * left, top: by * top, right: by * right, bottom: by * bottom }
    }

    /// The least that begins and ends at multiples of `grain` and covers it.
    pub fn in_multiples_of(&self, grain: u32) -> Self {
        Self {
            left: self.left / grain * grain,
            top: self.top / grain * grain,
            right: self.right.next_multiple_of(grain),
            bottom: self.bottom.next_multiple_of(grain),
        }
    }
}

/// Tiles side by side, from a token that need not be a tile's first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileRect {
    /// First token's column, a multiple of [`HALF_TILE`].
    pub x: u32,
    /// First token's row, a multiple of [`HALF_TILE`].
    pub y: u32,
    /// Tiles in x.
    pub columns: u32,
    /// Tiles in y.
    pub rows: u32,
}

impl TileRect {
    /// The least one that covers some tokens of a map of `width` x `height`, multiples of [`TILE`], and lies within it.
    pub fn covering(tokens: TokenRect, width: u32, height: u32) -> Self {
        if tokens.is_empty() {
            return Self::default();
        }
        let axis = |first: u32, end: u32, size: u32| {
            let first = first / HALF_TILE * HALF_TILE;
            let tiles = (end - first).div_ceil(TILE);
            (first.min(size.saturating_sub(tiles * TILE)), tiles)
        };
        let (x, columns) = axis(tokens.left, tokens.right, width);
        let (y, rows) = axis(tokens.top, tokens.bottom, height);
        Self { x, y, columns, rows }
    }

    /// Tiles in it.
    pub fn count(&self) -> u32 {
        self.columns * self.rows
    }

    /// Its tokens.
    pub fn tokens(&self) -> TokenRect {
        let Self { x, y, columns, rows } = *self;
        TokenRect { left: x, top: y, right: x + columns * TILE, bottom: y + rows * TILE }
    }
}

/// The tiles that a dispatch works on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tiles {
    /// Every tile of the map, row by row.
    All,
    /// Those of a rectangle, row by row.
    Rect(TileRect),
    /// Those that a buffer lists: how many they are, then each as `x | y << 16` in tiles, none twice. The device alone
    /// need know how many.
    List {
        /// Where the list lies.
        buffer: BufferId,
        /// Most tiles that it may have.
        at_most: u32,
    },
}

impl Tiles {
    /// Flag bits and, in the upper half, the columns of the rectangle; `width` is the map's, in tokens.
    pub(super) fn flags(&self, width: u32) -> u32 {
        match self {
            Self::All => width.div_ceil(TILE) << 16,
            Self::Rect(rect) => rect.columns << 16,
            Self::List { .. } => flags::TILE_LIST,
        }
    }

    /// The first token of a rectangle, as `x | y << 16` in half tiles.
    pub(super) fn first(&self) -> u32 {
        match self {
            Self::Rect(rect) => (rect.x / HALF_TILE) | ((rect.y / HALF_TILE) << 16),
            _ => 0,
        }
    }

    /// Tiles to work on in a map of `width` x `height` tokens; of a list, the most.
    pub fn count(&self, width: u32, height: u32) -> u32 {
        match self {
            Self::All => width.div_ceil(TILE) * height.div_ceil(TILE),
            Self::Rect(rect) => rect.count(),
            Self::List { at_most, .. } => *at_most,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rectangles_cover_their_tokens_within_the_map() {
        let cover = |left, right, size| {
            let tokens = TokenRect { left, top: 0, right, bottom: 1 };
            let rect = TileRect::covering(tokens, size, 8);
            assert!(rect.tokens().left <= left && rect.tokens().right >= right && rect.tokens().right <= size);
            assert_eq!((rect.y, rect.rows), (0, 1));
            (rect.x, rect.columns)
        };
        assert_eq!(cover(0, 8, 8), (0, 1));
        assert_eq!(cover(7, 8, 24), (4, 1));
        assert_eq!(cover(7, 13, 24), (4, 2));
        assert_eq!(cover(23, 24, 24), (16, 1));
        for left in 0..32 {
            for right in left + 1..=32 {
                cover(left, right, 32);
            }
        }
        assert_eq!(TileRect::covering(TokenRect::default(), 8, 8).count(), 0);
    }
}

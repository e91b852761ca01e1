//! The tiles that a dispatch works on, as a list.

use super::Reference;
use crate::kernels::{TILE, Tiles};

/// First token of a tile.
pub type Tile = (usize, usize);

const SIDE: usize = TILE as usize;

/// Every tile of a map.
pub fn all(width: u32, height: u32) -> Vec<Tile> {
    let (across, down) = (width.div_ceil(TILE) as usize, height.div_ceil(TILE) as usize);
    grid((0, 0), across, down)
}

fn grid((left, top): Tile, columns: usize, rows: usize) -> Vec<Tile> {
    (0..rows).flat_map(|y| (0..columns).map(move |x| (left + x * SIDE, top + y * SIDE))).collect()
}

/// The four tiles of a map of twice the size that a tile becomes.
pub fn doubled((x, y): Tile) -> [Tile; 4] {
    [(0, 0), (SIDE, 0), (0, SIDE), (SIDE, SIDE)].map(|(right, below)| (2 * x + right, 2 * y + below))
}

/// The tokens of some tiles that lie within a map.
pub fn tokens(tiles: &[Tile], width: usize, height: usize) -> impl Iterator<Item = (usize, usize)> {
    let range = |first: usize, end: usize| first..(first + SIDE).min(end);
    tiles.iter().flat_map(move |&(x, y)| range(y, height).flat_map(move |y| range(x, width).map(move |x| (x, y))))
}

impl Reference<'_> {
    /// The tiles that a dispatch over a map of this size works on.
    pub(super) fn tiles(&self, tiles: &Tiles, width: u32, height: u32) -> Vec<Tile> {
        match *tiles {
            Tiles::All => all(width, height),
            Tiles::Rect(rect) => grid((rect.x as usize, rect.y as usize), rect.columns as usize, rect.rows as usize),
            Tiles::List { buffer, .. } => {
                let list = self.buffer(buffer);
                let count = list.first().map_or(0, |&count| count as usize);
                let entries = list.iter().skip(1).take(count).map(|&entry| entry as usize);
                entries.map(|entry| ((entry & 0xffff) * SIDE, (entry >> 16) * SIDE)).collect()
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partial_tiles_end_with_the_map() {
        assert_eq!(all(9, 8), [(0, 0), (8, 0)]);
        assert_eq!(tokens(&[(8, 0)], 9, 2).collect::<Vec<_>>(), [(8, 0), (8, 1)]);
        assert_eq!(tokens(&all(19, 21), 19, 21).count(), 19 * 21);
    }
}

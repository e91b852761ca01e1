//! Twin of the kernel that makes a small map large ([`crate::kernels::expand`]).

use super::map::Map;
use super::{Reference, Twin};
use crate::kernels::TILE;
use crate::kernels::expand::Expand;

impl Twin for Expand {
    /// The first half of the small map, its middle half tile again and again, the rest of it, in both directions.
    fn compute(&self, reference: &mut Reference) {
        let src = reference.map(&self.src);
        let columns = positions(src.width, self.dst.width as usize);
        let rows = positions(src.height, self.dst.height as usize);
        let tokens = rows.iter().flat_map(|&y| columns.iter().map(move |&x| (x, y)));
        let values = tokens.flat_map(|(x, y)| src.token(x, y)).copied().collect();
        let map = Map::new(self.dst.width, self.dst.height, self.dst.channels, values);
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&map, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

fn positions(small: usize, size: usize) -> Vec<usize> {
    if size == small {
        return (0..size).collect();
    }
    let (first, block) = (small / 2, TILE as usize / 2);
    let repeated = (first..first + block).cycle().take(size - small + block);
    (0..first).chain(repeated).chain(first + block..small).collect()
}

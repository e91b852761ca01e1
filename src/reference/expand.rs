//! Twin of the kernel that makes a small map large ([`crate::kernels::expand`]).

use super::Reference;
use super::map::Map;
use crate::kernels::TILE;
use crate::kernels::expand::Expand;

/// The first half of the small map, its middle half tile again and again, the rest of it, in both directions.
pub fn expand(reference: &mut Reference, call: &Expand) {
    let src = reference.map(&call.src);
    let columns = positions(src.width, call.dst.width as usize);
    let rows = positions(src.height, call.dst.height as usize);
    let tokens = rows.iter().flat_map(|&y| columns.iter().map(move |&x| (x, y)));
    let values = tokens.flat_map(|(x, y)| src.token(x, y)).copied().collect();
    let map = Map::new(call.dst.width, call.dst.height, call.dst.channels, values);
    let tiles = reference.tiles(&call.tiles, call.dst.width, call.dst.height);
    reference.store(&map, &call.dst, &tiles, |x, y, channel| (x, y, channel));
}

fn positions(small: usize, size: usize) -> Vec<usize> {
    if size == small {
        return (0..size).collect();
    }
    let (first, block) = (small / 2, TILE as usize / 2);
    let repeated = (first..first + block).cycle().take(size - small + block);
    (0..first).chain(repeated).chain(first + block..small).collect()
}

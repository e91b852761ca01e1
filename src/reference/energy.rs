//! Twin of what squares of the result get back of the light ([`crate::kernels::energy`]).

use super::map::Map;
use super::predicted::enlarged;
use super::{Reference, Twin};
use crate::kernels::TILE;
use crate::kernels::converged::MAP_TILE;
use crate::kernels::energy::{BLOCK, BOUND, CAUTION, EnergyGains};
use crate::kernels::stats::{EXPOSURE, LARGEST};

/// Tokens of the grid in a square.
const SIDE: usize = TILE as usize;

impl Twin for EnergyGains {
    fn compute(&self, reference: &mut Reference) {
        let [result, log_color] = [&self.result, &self.log_color].map(|view| reference.map(view));
        let stats = reference.buffer(self.stats);
        let converged = self.converged.map(|map| reference.buffer(map));
        let side = BLOCK as usize;
        let [columns, rows] = [self.dst.width, self.dst.height].map(|size| size as usize);
        let mut map = Map::zeros(columns, rows, 4);
        for (at, token) in map.values.chunks_exact_mut(4).enumerate() {
            let range = |block: usize, end: u32| block * side..((block + 1) * side).min(end as usize);
            let (block_x, block_y) = (at % columns, at / columns);
            let all = range(block_y, self.height).flat_map(|y| range(block_x, self.width).map(move |x| (x, y)));
            let counts = |&(x, y): &(usize, usize)| {
                let square = y / MAP_TILE as usize * (result.width / MAP_TILE as usize) + x / MAP_TILE as usize;
                converged.is_none_or(|map| map[square] > 0.0)
            };
            let pixels: Vec<_> = all.filter(counts).collect();
            for (c, gain) in token.iter_mut().take(3).enumerate() {
                let (mut missing, mut by_chance, mut with_room) = (0.0, 0.0, 0.0);
                for &(x, y) in &pixels {
                    let has = result.token(x, y)[c].max(0.0);
                    let lacks = log_color.token(x, y)[c].exp_m1() - has;
                    (missing, by_chance) = (missing + lacks, by_chance + CAUTION * lacks * lacks);
                    with_room += has * room(has / stats[EXPOSURE], stats[LARGEST + c]);
                }
                if missing * missing > by_chance && with_room > 0.0 {
                    *gain = ((missing - by_chance / missing) / with_room).clamp(-BOUND, BOUND);
                }
            }
        }
        let mut grid = Map::zeros(columns * SIDE, rows * SIDE, 4);
        for (at, token) in grid.values.chunks_exact_mut(4).enumerate() {
            token.copy_from_slice(map.token(at % grid.width / SIDE, at / grid.width / SIDE));
        }
        let tiles = reference.tiles(&self.tiles, grid.width as u32, grid.height as u32);
        reference.store(&grid, &self.dst, &tiles, |x, y, channel| (x / SIDE, y / SIDE, channel));
    }
}

/// How much a result takes beside others that are far from the frame's largest sample.
fn room(clean: f64, largest: f64) -> f64 {
    (1.0 - clean / largest.max(1e-37)).max(0.0).sqrt()
}

/// The gains of a frame of this size, without those of squares that hold no pixel of it.
pub fn of_frame(gains: &Map, [width, height]: [usize; 2]) -> Map {
    let [columns, rows] = [width, height].map(|size| size.div_ceil(BLOCK as usize));
    let values = (0..rows).flat_map(|y| (0..columns).flat_map(move |x| gains.token(x, y))).copied().collect();
    Map { width: columns, height: rows, channels: 4, values }
}

/// What a channel of a pixel's result is multiplied by.
pub fn factor(gains: &Map, pixel: (usize, usize), channel: usize, clean: f64, largest: f64) -> f64 {
    1.0 + enlarged(gains, BLOCK as usize, pixel)[channel] * room(clean, largest)
}

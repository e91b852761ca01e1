//! Light given back, so that what comes out is as bright as what went in.
//!
//! A network that was trained for small errors takes some of the light for noise, and what it gives is darker than what
//! it got: by 1 % at 4 samples a pixel. Over many pixels the noise of what it got averages out, so that there the
//! difference can be known, and given back.

use super::accesses::Accesses;
use super::contracts;
use super::pushes::EnergyGainsPush;
use super::stats::STATS_FLOATS;
use super::{
    Access, Addresses, BufferId, Footprint, Grid, Kernel, KernelTarget, PushBytes, Scale, TILE, TexelRange, Tiles,
    Traffic, Variant, View, flags, groups,
};

/// Side in pixels of a square that keeps its light, which is a tile of tokens of [`TOKEN`] pixels.
pub const BLOCK: u32 = TOKEN * TILE;
/// Side in pixels of what the kernel's grid has for a token.
pub const TOKEN: u32 = 8;
/// How pixels read the blocks' gains.
pub(super) const BESIDE_PIXELS: Access = Access::Read(Footprint::Coarser { by: BLOCK, reach: 1 });
/// Invocations of a block.
const INVOCATIONS: u64 = 256;
/// Most that a gain may be, and least: a block beside a lamp that a network smears must not flare up.
pub const BOUND: f64 = 0.125;
/// What the sum of the squares is multiplied by: with 1 a single bright pixel, which is nearly all of what is missing
/// and of its square, would have twice of what the others lack given back, however little that says.
pub const CAUTION: f64 = 1.5;

/// For every block of [`BLOCK`]x[`BLOCK`] pixels and each channel a gain, so that with it the block has the light that
/// the network was given: a result x becomes `x (1 + gain room(x))`, the gain bilinear between the blocks' middles,
/// with `room(x) = sqrt(1 - x / largest)` of the frame's largest sample.
///
/// Of a block's pixels `missing` is the sum of what the network was given less its result, and `by chance`
/// [`CAUTION`] times the sum of the squares of these differences, which is the most that noise, independent from pixel
/// to pixel, gives the other sum as a variance. The gain is `(missing - by chance / missing) / sum of x room(x)`, 0
/// where by chance exceeds missing's square, and at most [`BOUND`] from 0. So what a single pixel lacks is never given
/// back, and of what n like ones lack the share 1 - 1.5 / n: as much as can be told from noise (the positive part of
/// James and Stein's estimate, "Estimation with Quadratic Loss", 1961, has that form).
#[derive(Clone, Debug, PartialEq)]
pub struct EnergyGains {
    /// The network's result: exposed radiance in three channels, 32-bit floats.
    pub result: View,
    /// What it was given, log1p of exposed radiance, 32-bit floats; as many rows.
    pub log_color: View,
    /// Three gains and a 0 for each block; 32-bit floats.
    pub dst: View,
    /// The statistics.
    pub stats: BufferId,
    /// Pixels in x that belong to the frame.
    pub width: u32,
    /// Pixels in y that belong to the frame, of the maps' rows.
    pub height: u32,
    /// Tiles of the grid: blocks.
    pub tiles: Tiles,
    /// Map of what is to be denoised ([`super::converged::ConvergedMap`]), where the result is not computed elsewhere:
    /// converged pixels do not count.
    pub converged: Option<BufferId>,
}

impl Kernel for EnergyGains {
    fn choose(&self, target: KernelTarget) -> Variant {
        let cpu = target.cpu_with(&self.texels());
        Variant::plain(if cpu { &contracts::ENERGY_GAINS_CPU } else { &contracts::ENERGY_GAINS })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        let [count, _] = self.own_grid().counts();
        groups(count, 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(self.own_grid())
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let Grid { width, .. } = self.own_grid();
        let [count, _] = self.own_grid().counts();
        PushBytes::new(&EnergyGainsPush {
            result: at.view(&self.result),
            log_color: at.view(&self.log_color),
            dst: at.view(&self.dst),
            stats: at.of(self.stats),
            tiles: at.tiles(&self.tiles),
            map: self.converged.map_or(0, |map| at.of(map)),
            width: self.result.width,
            frame_width: self.width,
            frame_height: self.height,
            result_stride: self.result.stride / 4,
            log_color_stride: self.log_color.stride / 4,
            dst_width: self.dst.width,
            dst_stride: self.dst.stride / 4,
            first_tile: self.tiles.first(),
            tile_count: count,
            flags: self.tiles.flags(width) | self.converged.map_or(0, |_| flags::CONVERGED),
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.result, Access::Read(Footprint::Finer { by: TOKEN }));
        visit(&mut self.log_color, Access::Read(Footprint::Finer { by: TOKEN }));
        visit(&mut self.dst, Access::Write(Scale::Tile));
    }

    fn others(&self) -> Traffic {
        let pixels = u64::from(self.width) * u64::from(self.height);
        let map = self.converged.map(|map| (map, pixels / 64));
        Traffic::reading([(self.stats, STATS_FLOATS * 4)].into_iter().chain(map))
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.result).into(), (&self.log_color).into()]
    }

    fn accesses(&self, _: &Variant) -> Option<Accesses> {
        let [blocks, _] = self.own_grid().counts().map(u64::from);
        let global = Accesses::each(blocks * u64::from(BLOCK * BLOCK), 2, 0);
        // Three sums by halves.
        let (loads, stores) = (blocks * 3 * 2 * (INVOCATIONS - 1), blocks * 3 * (2 * INVOCATIONS - 1));
        Some(Accesses { global_stores: blocks, shared_loads: loads, shared_stores: stores, ..global })
    }
}

impl EnergyGains {
    fn own_grid(&self) -> Grid {
        Grid::new(self.tiles, self.result.width / TOKEN, self.result.height / TOKEN).in_windows()
    }
}

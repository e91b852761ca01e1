//! What needs no denoising: a map of converged squares, and the lists of the tiles that are left, all made on the
//! device.
//!
//! 1. [`TileNoise`] measures the relative noise of every square of [`MAP_TILE`] pixels a side.
//! 2. [`ConvergedMap`] marks those above a threshold, and sums the marks.
//! 3. [`TileList`] lists, for each part of the network, the tiles that marked squares depend on, with the workgroups of
//!    the dispatches that run over the list.
//! 4. [`Fill`] writes zeros where tiles are read that are not active.

use super::contracts::{self, halves};
use super::pushes::{ConvergedMapPush, FillPush, TileListPush, TileNoisePush};
use super::stats::STATS_FLOATS;
use super::{
    Access, Addresses, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, TILE, Tiles, Traffic, Variant, View,
    by_storage, groups,
};
use crate::frame::{Extent, Region};
use std::cmp::Ordering;

/// Pixels of a square of the map, on a side.
pub const MAP_TILE: u32 = 16;
/// The noise of a square that is to be denoised whatever the threshold: one with a bad pixel, or of which nothing is
/// known.
pub const ALWAYS: f32 = 1e30;
/// Pixels from a square that is denoised to those that are the caller's own.
pub const BLEND_PIXELS: u32 = 8;
/// Tiles a workgroup for which [`TileList`] counts the workgroups.
pub const TILES_A_GROUP: [u32; 5] = [1, 2, 4, 8, 16];

/// Size of a map of converged squares, in squares of 16x16 pixels; of a padded frame, whose sides are multiples of
/// that.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MapSize {
    /// Squares in x.
    pub columns: u32,
    /// Squares in y.
    pub rows: u32,
}

impl MapSize {
    /// The map of a frame.
    pub fn of(frame: Extent) -> Self {
        Self { columns: frame.width.div_ceil(MAP_TILE), rows: frame.height.div_ceil(MAP_TILE) }
    }

    /// Squares.
    pub fn tiles(&self) -> u32 {
        self.columns * self.rows
    }

    /// Sums of the map.
    #[cfg_attr(not(feature = "internals"), doc(hidden))]
    pub fn sums(&self) -> u32 {
        (self.columns + 1) * (self.rows + 1)
    }
}

/// Relative noise of every square, a float each: the standard deviation over the size, from the renderer's plane or,
/// where it gives none, from the frame itself: the second difference in both directions of `ln(exposed + 0.01)`, over 6
/// (Immerkaer, "Fast Noise Variance Estimation", 1996), its root mean square over 8x8 pixels, the largest of the four
/// and of the channels. Texture counts as noise.
#[derive(Clone, Debug, PartialEq)]
pub struct TileNoise {
    /// The statistics.
    pub stats: BufferId,
    /// The noise; 0 in the padding, [`ALWAYS`] where a pixel is bad.
    pub dst: BufferId,
    /// The frame, unpadded.
    pub frame: Extent,
    /// Size of the map.
    pub map: MapSize,
}

impl Kernel for TileNoise {
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(if target.images { &contracts::TILE_NOISE_IMAGE } else { &contracts::TILE_NOISE })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.map.tiles(), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&TileNoisePush {
            planes: at.frame.planes,
            stats: at.of(self.stats),
            dst: at.of(self.dst),
            width: self.frame.width,
            height: self.frame.height,
            columns: self.map.columns,
            tile_count: self.map.tiles(),
        })
    }

    fn others(&self) -> Traffic {
        Traffic {
            reads: vec![(self.stats, STATS_FLOATS * 4)],
            writes: vec![(self.dst, u64::from(self.map.tiles()) * 4)],
        }
    }

    fn reads_color(&self) -> bool {
        true
    }
}

/// Marks the squares that are noisier than the frame's threshold, and those beside one: light that few pixels have
/// found leaves squares without any. (Not where sample counts are given: they are known for every pixel.)
#[derive(Clone, Debug, PartialEq)]
pub struct ConvergedMap {
    /// The noise.
    pub src: BufferId,
    /// 1 or 0 for every square.
    pub map: BufferId,
    /// For every corner of a square, how many are marked above and to the left: `[rows + 1][columns + 1]`.
    pub sums: BufferId,
    /// Size of the map.
    pub size: MapSize,
    /// Squares beyond these columns and rows are marked as the nearest of these.
    pub real: MapSize,
    /// The pixels that are wanted. Squares without any are not marked.
    pub region: Region,
}

impl ConvergedMap {
    /// The squares that hold wanted pixels: left, top, right, bottom, ends excluded.
    pub fn wanted(&self) -> [u32; 4] {
        let Region { x, y, .. } = self.region;
        let end = |pixel: u32| pixel.div_ceil(MAP_TILE);
        [x / MAP_TILE, y / MAP_TILE, end(self.region.right()), end(self.region.bottom())]
    }
}

impl Kernel for ConvergedMap {
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::plain(&contracts::CONVERGED_MAP)
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        [1, 1, 1]
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let [left, top, right, bottom] = self.wanted();
        PushBytes::new(&ConvergedMapPush {
            src: at.of(self.src),
            map: at.of(self.map),
            sums: at.of(self.sums),
            planes: at.frame.planes,
            columns: self.size.columns,
            rows: self.size.rows,
            left,
            top,
            right,
            bottom,
            threshold: at.frame.converged_threshold,
            real_columns: self.real.columns,
            real_rows: self.real.rows,
            unused: 0,
        })
    }

    fn others(&self) -> Traffic {
        let (tiles, sums) = (u64::from(self.size.tiles()) * 4, u64::from(self.size.sums()) * 4);
        Traffic { reads: vec![(self.src, tiles)], writes: vec![(self.map, tiles), (self.sums, sums)] }
    }

    fn reads_color(&self) -> bool {
        true
    }
}

/// Squares of the map that a tile looks at along an axis, from the one in which it begins; from [`FAR`] on, all.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reach {
    /// Squares back.
    pub back: u32,
    /// Squares on.
    pub on: u32,
}

/// A reach that goes as far as the map.
pub const FAR: u32 = 255;

impl Reach {
    fn bits(self) -> u32 {
        self.back.min(FAR) | self.on.min(FAR) << 8
    }
}

/// A regular sample of the map's squares, which stand for the others in what is taken of the whole frame: squares (x,
/// y) with `(x + skew y) % pitch = 0`, one in `pitch`, the first of the map among them. With a skew of the pitch's root
/// its nearest squares are about that far apart in every direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sample {
    /// Of so many squares one.
    pub pitch: u32,
    /// Columns by which a row is shifted against the one above.
    pub skew: u32,
    /// Squares of the frame; those beyond are not sampled.
    pub real: MapSize,
}

impl Sample {
    /// One in so many squares of a frame.
    pub fn one_in(pitch: u32, real: MapSize) -> Self {
        Self { pitch, skew: f64::from(pitch).sqrt().round() as u32, real }
    }
}

/// Places of a tile among the squares of the map that may differ in reach: the coarsest tiles are 128 pixels.
pub const REACHES: usize = 8;

/// Lists the tiles of one resolution that look at a marked square, row by row, or at a sampled one, and others that are
/// read.
#[derive(Clone, Debug, PartialEq)]
pub struct TileList {
    /// Sums of the map.
    pub sums: BufferId,
    /// The active tiles, as [`Tiles::List`] has them.
    pub list: BufferId,
    /// Tiles that are read and not active.
    pub idle: BufferId,
    /// Workgroups: x, y, z for each of [`TILES_A_GROUP`] and each y from 1 to `max_y`; then for the idle tiles.
    pub groups: BufferId,
    /// Where the number of active tiles goes too.
    pub counts: BufferId,
    /// At which place.
    pub slot: u32,
    /// Size of the map.
    pub map: MapSize,
    /// Tiles in x.
    pub columns: u32,
    /// Tiles in y.
    pub rows: u32,
    /// Pixels of a tile, on a side.
    pub tile_pixels: u32,
    /// By the square in which a tile begins, how far it looks for whether it is active.
    pub reach: [Reach; REACHES],
    /// The same for whether it is read.
    pub read: [Reach; REACHES],
    /// Largest y of the dispatches over the list.
    pub max_y: u32,
    /// Squares that are looked at like marked ones, where there are such.
    pub sample: Option<Sample>,
}

impl TileList {
    /// Tiles of the resolution.
    pub fn tiles(&self) -> u32 {
        self.columns * self.rows
    }

    /// Bytes of a list.
    pub fn list_bytes(&self) -> u64 {
        list_bytes(self.tiles())
    }

    /// Bytes of the workgroups.
    pub fn groups_bytes(&self) -> u64 {
        (TILES_A_GROUP.len() as u64 * u64::from(self.max_y) + 1) * GROUPS_BYTES
    }

    /// Where the workgroups of a dispatch over the list lie, in bytes; `None` where they are not counted.
    pub fn groups_at(max_y: u32, tiles_a_group: u32, y: u32) -> Option<u64> {
        let row = TILES_A_GROUP.iter().position(|tiles| *tiles == tiles_a_group)? as u64;
        (1..=max_y).contains(&y).then(|| (row * u64::from(max_y) + u64::from(y) - 1) * GROUPS_BYTES)
    }

    /// Where those of the idle tiles lie.
    pub fn idle_groups_at(max_y: u32) -> u64 {
        TILES_A_GROUP.len() as u64 * u64::from(max_y) * GROUPS_BYTES
    }
}

/// Bytes of the workgroups of a dispatch.
pub const GROUPS_BYTES: u64 = 12;

/// Bytes of a list of at most so many tiles.
pub fn list_bytes(at_most: u32) -> u64 {
    4 * (1 + u64::from(at_most))
}

impl Kernel for TileList {
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::plain(&contracts::TILE_LIST)
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        [1, 1, 1]
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let [reach_0, reach_1, reach_2, reach_3, reach_4, reach_5, reach_6, reach_7] =
            std::array::from_fn(|i| self.reach[i].bits() | self.read[i].bits() << 16);
        let sample = self.sample.unwrap_or_default();
        PushBytes::new(&TileListPush {
            sums: at.of(self.sums),
            list: at.of(self.list),
            idle: at.of(self.idle),
            groups: at.of(self.groups),
            counts: at.of(self.counts),
            reach_0,
            reach_1,
            reach_2,
            reach_3,
            reach_4,
            reach_5,
            reach_6,
            reach_7,
            map_columns: self.map.columns,
            map_rows: self.map.rows,
            columns: self.columns,
            rows: self.rows,
            tile_pixels: self.tile_pixels,
            max_y: self.max_y,
            slot: self.slot,
            pitch: sample.pitch,
            skew: sample.skew,
            real_columns: sample.real.columns,
            real_rows: sample.real.rows,
            unused: 0,
        })
    }

    fn others(&self) -> Traffic {
        Traffic {
            reads: vec![(self.sums, u64::from(self.map.sums()) * 4)],
            writes: vec![
                (self.list, self.list_bytes()),
                (self.idle, self.list_bytes()),
                (self.groups, self.groups_bytes()),
                (self.counts, 4),
            ],
        }
    }

    fn reads_color(&self) -> bool {
        true
    }
}

/// Zeros in tiles of a map.
#[derive(Clone, Debug, PartialEq)]
pub struct Fill {
    /// The map.
    pub dst: View,
    /// Tokens of the map for a tile of the list, on a side: [`TILE`], twice or half of it.
    pub side: u32,
    /// The tiles, in the resolution of the list.
    pub tiles: Tiles,
}

impl Fill {
    /// Size of the list's resolution, in tokens.
    pub fn size(&self) -> (u32, u32) {
        (self.dst.width * TILE / self.side, self.dst.height * TILE / self.side)
    }
}

impl Kernel for Fill {
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::plain(by_storage(self.dst.storage, &contracts::FILL, &halves::FILL))
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        let (width, height) = self.size();
        groups(self.tiles.count(width, height), 1)
    }

    fn grid(&self) -> Option<Grid> {
        let (width, height) = self.size();
        Some(Grid::new(self.tiles, width, height))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let (width, height) = self.size();
        PushBytes::new(&FillPush {
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            dst_stride: self.dst.stride / 4,
            channels: self.dst.channels / 4,
            side: self.side,
            tile_count: self.tiles.count(width, height),
            flags: self.tiles.flags(width),
            first_tile: self.tiles.first(),
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        let scale = match self.side.cmp(&TILE) {
            Ordering::Less => Scale::Half,
            Ordering::Equal => Scale::Same,
            Ordering::Greater => Scale::Double,
        };
        visit(&mut self.dst, Access::Write(scale));
    }
}

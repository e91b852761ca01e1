//! Statistics of the frame: exposure and depth scale, by integer histograms and fixed-order sums.
//!
//! 1. [`Histogram`] counts the luminances (valid pixels, above 0) by the upper 16 bits of the float, 128 bins an octave,
//!    or the valid depths in 512 bins an octave, so that their unit makes no difference: the scale follows them within
//!    0.2 %.
//! 2. [`Select`] reads the median luminance `m`, or the 99.9th percentile of depth, from it.
//! 3. [`TileMeans`] takes the mean of `min(luminance, 64 m)` over the pixels of every 8x8 tile that are valid and of no
//!    channel above 1e8 m, and its base-2 logarithm relative to m, at least -10.
//! 4. [`Key`] averages those logarithms over the tiles that have any light: `key = m 2^mean`, `exposure = 0.18 / key`.
//!
//! So one pixel, whatever its value, moves the key by at most what a tile of 64 m does.

use super::contract::Contract;
use super::contracts;
use super::frame_io::{color_flags, depth_flags};
use super::pushes::{StatsClearPush, StatsHistogramPush, StatsKeyPush, StatsSelectPush, StatsTilesPush};
use super::{Addresses, BufferId, Kernel, PushBytes, TILE, Traffic, Variants, groups};

/// Bins of one histogram.
pub const BINS: u32 = 1 << 15;
/// Pixels that a workgroup counts.
const HISTOGRAM_PIXELS: u32 = 4096;
/// Bytes of a histogram.
pub const HISTOGRAM_BYTES: u64 = 4 * BINS as u64;
/// Floats of the statistics: median luminance, key, exposure. The depth scale is one by itself: it depends on the depths
/// alone.
pub const STATS_FLOATS: u64 = 3;
/// Where the median luminance stands among them.
pub const MEDIAN: usize = 0;
/// Where the key stands.
pub const KEY: usize = 1;
/// Where the exposure stands.
pub const EXPOSURE: usize = 2;

/// What a histogram counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counted {
    /// Luminances of the colour.
    Luminance,
    /// Depths.
    Depth,
}

/// Zeroes a histogram.
#[derive(Clone, Debug, PartialEq)]
pub struct Clear {
    /// The histogram.
    pub histogram: BufferId,
}

impl Kernel for Clear {
    fn contract(&self, _: Variants) -> &'static Contract {
        &contracts::STATS_CLEAR
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups(BINS.div_ceil(256), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&StatsClearPush { histogram: at.of(self.histogram), count: BINS, unused: 0 })
    }

    fn traffic(&self) -> Traffic {
        Traffic { reads: vec![], writes: vec![(self.histogram, HISTOGRAM_BYTES)] }
    }
}

/// Counts luminances or depths.
#[derive(Clone, Debug, PartialEq)]
pub struct Histogram {
    /// The histogram.
    pub histogram: BufferId,
    /// Which.
    pub counted: Counted,
    /// Size of the frame in pixels.
    pub width: u32,
    /// Size of the frame in pixels.
    pub height: u32,
}

impl Kernel for Histogram {
    fn contract(&self, variants: Variants) -> &'static Contract {
        if variants.images { &contracts::STATS_HISTOGRAM_IMAGE } else { &contracts::STATS_HISTOGRAM }
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups((self.width * self.height).div_ceil(HISTOGRAM_PIXELS), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&StatsHistogramPush {
            color: at.frame.color.address,
            depth: at.frame.depth.address,
            histogram: at.of(self.histogram),
            color_offset: at.frame.color.offset,
            color_pixel: at.frame.color.pixel,
            color_row: at.frame.color.row,
            color_channel: at.frame.color.channel,
            depth_offset: at.frame.depth.offset,
            depth_pixel: at.frame.depth.pixel,
            depth_row: at.frame.depth.row,
            width: self.width,
            height: self.height,
            flags: match self.counted {
                Counted::Luminance => color_flags(&at.frame.color),
                Counted::Depth => depth_flags(&at.frame.depth),
            },
        })
    }

    fn reads_color(&self) -> bool {
        self.counted == Counted::Luminance
    }

    fn traffic(&self) -> Traffic {
        let all = (self.histogram, HISTOGRAM_BYTES);
        Traffic { reads: vec![all], writes: vec![all] }
    }
}

/// Median luminance or depth scale.
#[derive(Clone, Debug, PartialEq)]
pub struct Select {
    /// The histogram.
    pub histogram: BufferId,
    /// What it counted.
    pub counted: Counted,
    /// The statistics, of which the median is the first; or the depth scale.
    pub dst: BufferId,
}

impl Kernel for Select {
    fn contract(&self, _: Variants) -> &'static Contract {
        &contracts::STATS_SELECT
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        [1, 1, 1]
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&StatsSelectPush {
            histogram: at.of(self.histogram),
            dst: at.of(self.dst),
            of_depth: u32::from(self.counted == Counted::Depth),
            unused: 0,
        })
    }

    fn traffic(&self) -> Traffic {
        Traffic { reads: vec![(self.histogram, HISTOGRAM_BYTES)], writes: vec![(self.dst, 4)] }
    }
}

/// Log-luminance of every 8x8 tile of the unpadded frame; below -1e30 where a tile has no light.
#[derive(Clone, Debug, PartialEq)]
pub struct TileMeans {
    /// The statistics.
    pub stats: BufferId,
    /// One float per tile.
    pub dst: BufferId,
    /// Size of the frame in pixels.
    pub width: u32,
    /// Size of the frame in pixels.
    pub height: u32,
}

impl TileMeans {
    /// Tiles of the frame, partial ones included.
    pub fn tiles(&self) -> u32 {
        self.width.div_ceil(TILE) * self.height.div_ceil(TILE)
    }
}

impl Kernel for TileMeans {
    fn contract(&self, variants: Variants) -> &'static Contract {
        if variants.images { &contracts::STATS_TILES_IMAGE } else { &contracts::STATS_TILES }
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups(self.tiles().div_ceil(64), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&StatsTilesPush {
            color: at.frame.color.address,
            stats: at.of(self.stats),
            dst: at.of(self.dst),
            color_offset: at.frame.color.offset,
            color_pixel: at.frame.color.pixel,
            color_row: at.frame.color.row,
            color_channel: at.frame.color.channel,
            width: self.width,
            height: self.height,
            tiles_x: self.width.div_ceil(TILE),
            tile_count: self.tiles(),
            flags: color_flags(&at.frame.color),
            unused: 0,
        })
    }

    fn reads_color(&self) -> bool {
        true
    }

    fn traffic(&self) -> Traffic {
        Traffic { reads: vec![(self.stats, 4)], writes: vec![(self.dst, u64::from(self.tiles()) * 4)] }
    }
}

/// Key and exposure.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// The tiles' log-luminances.
    pub src: BufferId,
    /// How many.
    pub tiles: u32,
    /// The statistics.
    pub stats: BufferId,
}

impl Kernel for Key {
    fn contract(&self, _: Variants) -> &'static Contract {
        &contracts::STATS_KEY
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        [1, 1, 1]
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&StatsKeyPush {
            src: at.of(self.src),
            stats: at.of(self.stats),
            tile_count: self.tiles,
            fixed_exposure: at.frame.exposure.unwrap_or(0.0),
        })
    }

    fn reads_color(&self) -> bool {
        true
    }

    fn traffic(&self) -> Traffic {
        Traffic { reads: vec![(self.src, u64::from(self.tiles) * 4), (self.stats, 4)], writes: vec![(self.stats, 8)] }
    }
}

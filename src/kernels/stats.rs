//! Statistics of the frame: exposure and depth scale, by integer histograms and fixed-order sums.
//!
//! 1. [`Histogram`] counts the luminances (valid pixels, above 0) by the upper 16 bits of the float, 128 bins an
//!    octave, or the valid depths in 512 bins an octave, so that their unit makes no difference: the scale follows them
//!    within 0.2 %.
//! 2. [`Select`] reads the median luminance `m`, or the 99.9th percentile of depth, from it.
//! 3. [`TileStats`] takes the mean of `min(luminance, 64 m)` over the pixels of every 8x8 tile that are valid and of no
//!    channel above 1e8 m, and its base-2 logarithm relative to m, at least -10. Beside it, what is known of the tile's
//!    noise, its mean colour and its largest samples.
//! 4. [`Key`] averages those logarithms over the tiles that have any light: `key = m 2^mean`, `exposure = 0.18 / key`.
//!    It finds the frame's share of noisy pixels and its largest samples, and fills the mean colours of tiles without a
//!    good sample.
//!
//! So one pixel, whatever its value, moves the key by at most what a tile of 64 m does. What counts as a valid sample:
//! `docs/neutral.md`.

use super::contracts;
use super::pushes::{StatsClearPush, StatsHistogramPush, StatsKeyPush, StatsSelectPush, StatsTilesPush};
use super::{Addresses, BufferId, FrameArgs, Kernel, KernelTarget, PushBytes, TILE, Traffic, Variant, flags, groups};

/// Bins of one histogram.
pub const BINS: u32 = 1 << 15;
/// Pixels that a workgroup counts.
const HISTOGRAM_PIXELS: u32 = 4096;
/// Bytes of a histogram.
pub const HISTOGRAM_BYTES: u64 = 4 * BINS as u64;
/// Floats of the statistics: median luminance, key, exposure, share of noisy pixels, largest sample of each channel.
/// The depth scale is one by itself: it depends on the depths alone.
pub const STATS_FLOATS: u64 = 7;
/// Where the median luminance stands among them.
pub const MEDIAN: usize = 0;
/// Where the key stands.
pub const KEY: usize = 1;
/// Where the exposure stands.
pub const EXPOSURE: usize = 2;
/// Where the share of the lit pixels that are noisy stands; 1 where none is lit.
pub const NOISE: usize = 3;
/// Where the largest sample of the first channel stands, the others after it.
pub const LARGEST: usize = 4;
/// Words that are known of a tile: the bits of its mean colour, a NaN where it has no good sample; its lit pixels and,
/// in the upper half, the noisy ones of them.
pub const TILE_WORDS: u64 = 4;
/// Tiles of a run.
pub const RUN_TILES: u32 = 8;
/// Floats that are known of a run: the sum of the logarithms of luminance and the tiles that have one, noisy pixels,
/// lit ones, the largest sample of each channel, the tiles that lack a channel's mean.
pub const RUN_FLOATS: u64 = 8;

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
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::plain(&contracts::STATS_CLEAR)
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(BINS.div_ceil(256), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&StatsClearPush { histogram: at.of(self.histogram), count: BINS, unused: 0 })
    }

    fn others(&self) -> Traffic {
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
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(if target.images { &contracts::STATS_HISTOGRAM_IMAGE } else { &contracts::STATS_HISTOGRAM })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups((self.width * self.height).div_ceil(HISTOGRAM_PIXELS), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&StatsHistogramPush {
            planes: at.frame.planes,
            histogram: at.of(self.histogram),
            width: self.width,
            height: self.height,
            of_depth: u32::from(self.counted == Counted::Depth),
            unused: 0,
        })
    }

    fn others(&self) -> Traffic {
        let all = (self.histogram, HISTOGRAM_BYTES);
        Traffic { reads: vec![all], writes: vec![all] }
    }

    fn reads_color(&self) -> bool {
        self.counted == Counted::Luminance
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
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::plain(&contracts::STATS_SELECT)
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
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

    fn others(&self) -> Traffic {
        Traffic { reads: vec![(self.histogram, HISTOGRAM_BYTES)], writes: vec![(self.dst, 4)] }
    }
}

/// Light and noise of every 8x8 tile of the unpadded frame and of every run of eight tiles.
///
/// A pixel counts as lit if its luminance is above 0 and pixels of its tile lie on both sides of it, and as noisy if it
/// then differs from their mean by more than 8 % of what the three have.
#[derive(Clone, Debug, PartialEq)]
pub struct TileStats {
    /// The statistics.
    pub stats: BufferId,
    /// [`TILE_WORDS`] per tile.
    pub dst: BufferId,
    /// [`RUN_FLOATS`] per run.
    pub runs: BufferId,
    /// Size of the frame in pixels.
    pub width: u32,
    /// Size of the frame in pixels.
    pub height: u32,
}

impl TileStats {
    /// Tiles of the frame, partial ones included.
    pub fn tiles(&self) -> u32 {
        self.columns() * self.height.div_ceil(TILE)
    }

    /// Tiles in x.
    pub fn columns(&self) -> u32 {
        self.width.div_ceil(TILE)
    }

    /// Bytes of [`TileStats::dst`].
    pub fn tile_bytes(&self) -> u64 {
        4 * TILE_WORDS * u64::from(self.tiles())
    }

    /// Bytes of [`TileStats::runs`].
    pub fn run_bytes(&self) -> u64 {
        4 * RUN_FLOATS * u64::from(self.tiles().div_ceil(RUN_TILES))
    }

    /// The kernel that reads what this one writes.
    pub fn key(&self, depth_scale: BufferId) -> Key {
        let Self { stats, dst: tile_stats, runs, .. } = *self;
        Key { runs, tile_stats, stats, depth_scale, columns: self.columns(), tiles: self.tiles() }
    }
}

impl Kernel for TileStats {
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(if target.images { &contracts::STATS_TILES_IMAGE } else { &contracts::STATS_TILES })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles().div_ceil(RUN_TILES), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&StatsTilesPush {
            planes: at.frame.planes,
            stats: at.of(self.stats),
            tile_stats: at.of(self.dst),
            runs: at.of(self.runs),
            width: self.width,
            height: self.height,
            tiles_x: self.columns(),
            tile_count: self.tiles(),
        })
    }

    fn others(&self) -> Traffic {
        Traffic {
            reads: vec![(self.stats, 4)],
            writes: vec![(self.dst, self.tile_bytes()), (self.runs, self.run_bytes())],
        }
    }

    fn reads_color(&self) -> bool {
        true
    }
}

/// Key, exposure, noise and largest samples. Tiles that lack a channel's mean get that of the nearest ring of tiles
/// that have it.
///
/// The exposure is the one that the frame's options give, else the frame's own.
#[derive(Clone, Debug, PartialEq)]
pub struct Key {
    /// What is known of every run of tiles.
    pub runs: BufferId,
    /// What is known of every tile.
    pub tile_stats: BufferId,
    /// The statistics.
    pub stats: BufferId,
    /// One float, told on.
    pub depth_scale: BufferId,
    /// Tiles in x.
    pub columns: u32,
    /// Tiles.
    pub tiles: u32,
}

impl Kernel for Key {
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::plain(&contracts::STATS_KEY)
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        [1, 1, 1]
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let FrameArgs { planes, exposure, exposure_at, told_at, .. } = at.frame;
        let set = |address: Option<u64>, flag| if address.is_some() { flag } else { 0 };
        // Drivers may load by an address before they ask whether to.
        let stats = at.of(self.stats);
        PushBytes::new(&StatsKeyPush {
            planes,
            runs: at.of(self.runs),
            tile_stats: at.of(self.tile_stats),
            stats,
            depth_scale: at.of(self.depth_scale),
            given: exposure_at.unwrap_or(stats),
            told: told_at.unwrap_or(stats),
            run_count: self.tiles.div_ceil(RUN_TILES),
            tiles_x: self.columns,
            tile_count: self.tiles,
            fixed_exposure: exposure.unwrap_or(0.0),
            flags: set(exposure_at, flags::GIVEN) | set(told_at, flags::TOLD),
            unused: 0,
        })
    }

    fn others(&self) -> Traffic {
        let runs = 4 * RUN_FLOATS * u64::from(self.tiles.div_ceil(RUN_TILES));
        // Of tiles nothing, where none lacks its means.
        Traffic {
            reads: vec![(self.runs, runs), (self.tile_stats, 0), (self.depth_scale, 4), (self.stats, 4)],
            writes: vec![(self.tile_stats, 0), (self.stats, 4 * (STATS_FLOATS - 1))],
        }
    }

    fn reads_color(&self) -> bool {
        true
    }
}

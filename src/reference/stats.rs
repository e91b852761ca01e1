//! Twins of the frame's statistics ([`crate::kernels::stats`]).
//!
//! Pixels are sorted into bins by their bits, so luminances are 32-bit floats here as they are on the device.

use super::frame_io::FrameData;
use super::samples::{brightest_around, is_absurd, is_absurdly_bright, light_of};
use super::tiles;
use super::{Reference, Twin};
use crate::kernels::stats::{
    BINS, Clear, Counted, EXPOSURE, Histogram, KEY, Key, LARGEST, MEDIAN, NOISE, RUN_FLOATS, RUN_TILES, Select,
    TILE_WORDS, TileStats,
};

/// What an exposed frame's key becomes, and the key of a black frame.
const MIDDLE_GREY: f64 = 0.18;
/// Keys whose exposure is a normal 32-bit float.
const KEYS: [f64; 2] = [1e-30, 1e36];
/// Of the median: what a pixel may add to its tile, and the least a tile counts for.
const CAP: f64 = 64.0;
const FLOOR: f64 = 1.0 / 1024.0;
/// A lit pixel is noisy that differs from the mean of those beside it by more than this share of what the three have.
const NOISY: f32 = 0.08;

impl Twin for Clear {
    /// Zeroes a histogram.
    fn compute(&self, reference: &mut Reference) {
        reference.set_buffer(self.histogram, &vec![0.0; BINS as usize]);
    }
}

impl Twin for Histogram {
    /// Counts luminances above 0, or valid depths.
    fn compute(&self, reference: &mut Reference) {
        let mut bins = reference.buffer(self.histogram).to_vec();
        for i in 0..self.width as usize * self.height as usize {
            let frame = &reference.frame;
            let bin = match self.counted {
                Counted::Luminance => frame.luminance(i).filter(|&l| l > 0.0).map(|luminance| LUMINANCE.bin(luminance)),
                Counted::Depth => frame.depth(i).map(|depth| DEPTH.bin(depth)),
            };
            if let Some(bin) = bin {
                bins[bin] += 1.0;
            }
        }
        reference.set_buffer(self.histogram, &bins);
    }
}

impl Twin for Select {
    /// Median luminance or depth scale.
    fn compute(&self, reference: &mut Reference) {
        let bins = reference.buffer(self.histogram);
        let value = match self.counted {
            Counted::Luminance => quantile(bins, LUMINANCE, |count| (count - 1) / 2).unwrap_or(0.0),
            Counted::Depth => quantile(bins, DEPTH, |count| (count - 1) * 999 / 1000).unwrap_or(1.0),
        };
        reference.set_buffer(self.dst, &[value]);
    }
}

impl Twin for TileStats {
    /// Light and noise of every tile and of every run of tiles.
    fn compute(&self, reference: &mut Reference) {
        let median = reference.buffer(self.stats)[MEDIAN];
        let (width, height) = (self.width as usize, self.height as usize);
        let tiles: Vec<Tile> = tiles::all(self.width, self.height)
            .chunks(1)
            .map(|tile| Tile::of(&reference.frame, &tiles::tokens(tile, width, height).collect::<Vec<_>>(), median))
            .collect();
        let words = tiles.iter().flat_map(|tile| {
            let [r, g, b] = tile.mean.map(|mean| mean.unwrap_or(f64::NAN));
            [r, g, b, f64::from(tile.lit | tile.noisy << 16)]
        });
        let words: Vec<f64> = words.collect();
        let runs = tiles.chunks(RUN_TILES as usize).flat_map(|run| {
            let logs = || run.iter().filter_map(|tile| tile.log);
            let count = |of: fn(&Tile) -> u32| f64::from(run.iter().map(of).sum::<u32>());
            let [r, g, b] = [0, 1, 2].map(|c| run.iter().map(|tile| tile.largest[c]).fold(0.0, f64::max));
            let gaps = count(|tile| u32::from(tile.mean.contains(&None)));
            [logs().sum(), logs().count() as f64, count(|tile| tile.noisy), count(|tile| tile.lit), r, g, b, gaps]
        });
        let runs: Vec<f64> = runs.collect();
        reference.set_buffer(self.dst, &words);
        reference.set_buffer(self.runs, &runs);
    }
}

/// What is known of a tile.
struct Tile {
    /// Logarithm of the mean luminance, relative to the median; `None` without light.
    log: Option<f64>,
    /// Of each channel's finite samples, none for more than [`CAP`] medians.
    mean: [Option<f64>; 3],
    /// The largest sample of each channel, without absurd lone pixels.
    largest: [f64; 3],
    /// Lit pixels with neighbours on both sides.
    lit: u32,
    /// The noisy ones of them.
    noisy: u32,
}

impl Tile {
    /// Of its pixels, row by row.
    fn of(frame: &FrameData, pixels: &[(usize, usize)], median: f64) -> Self {
        let [width, _] = frame.size();
        let luminance = |(x, y): (usize, usize)| frame.luminance(y * width + x);
        // The key is not known yet; the median stands in.
        let bright = |(x, y): (usize, usize)| {
            let light = frame.samples(x, y).map(light_of).into_iter().fold(0.0, f64::max);
            (light, is_absurdly_bright(light, median))
        };
        let counted = pixels.iter().filter(|at| !bright(**at).1).filter_map(|at| luminance(*at)).map(f64::from);
        let counted: Vec<f64> = counted.collect();
        let log = (median > 0.0 && counted.iter().any(|&l| l > 0.0)).then(|| {
            let sum: f64 = counted.iter().map(|l| (l / median).min(CAP)).sum();
            (sum / counted.len() as f64).max(FLOOR).log2()
        });
        let mean = [0, 1, 2].map(|channel| {
            let samples = pixels.iter().map(|(x, y)| frame.samples(*x, *y)[channel]).filter(|s| s.is_finite());
            let good: Vec<f64> = samples.map(|sample| light_of(sample).min(CAP * median)).collect();
            (!good.is_empty()).then(|| good.iter().sum::<f64>() / good.len() as f64)
        });
        let is_light = |at: (usize, usize)| {
            let (light, bright) = bright(at);
            !bright || !is_absurd(light, median, brightest_around(frame, at.0, at.1))
        };
        let lights: Vec<_> = pixels.iter().filter(|at| is_light(**at)).map(|(x, y)| frame.samples(*x, *y)).collect();
        let largest = [0, 1, 2].map(|channel| lights.iter().map(|s| light_of(s[channel])).fold(0.0, f64::max));
        let (mut lit, mut noisy) = (0, 0);
        for three in pixels.windows(3).filter(|three| three.iter().all(|at| at.1 == three[0].1)) {
            let [Some(a), Some(b), Some(c)] = [three[0], three[1], three[2]].map(luminance) else { continue };
            if b > 0.0 {
                // In 32-bit floats, as on the device: it is a question of yes or no.
                let outer = 0.25 * a + 0.25 * c;
                lit += 1;
                noisy += u32::from((outer - 0.5 * b).abs() > NOISY * (outer + 0.5 * b));
            }
        }
        Self { log, mean, largest, lit, noisy }
    }
}

impl Twin for Key {
    /// Key, exposure, noise and largest samples; means of the tiles that have none.
    fn compute(&self, reference: &mut Reference) {
        let runs = reference.buffer(self.runs).chunks_exact(RUN_FLOATS as usize);
        let runs: Vec<&[f64]> = runs.take(self.tiles.div_ceil(RUN_TILES) as usize).collect();
        let sum = |at: usize| runs.iter().map(|run| run[at]).sum::<f64>();
        let lit_tiles = sum(1);
        let key = if lit_tiles > 0.0 {
            (reference.buffer(self.stats)[MEDIAN] * (sum(0) / lit_tiles).exp2()).clamp(KEYS[0], KEYS[1])
        } else {
            MIDDLE_GREY
        };
        let noise = if sum(3) > 0.0 { sum(2) / sum(3) } else { 1.0 };
        let largest = [4, 5, 6].map(|at| runs.iter().map(|run| run[at]).fold(0.0, f64::max));
        let exposure = reference.frame.exposure.unwrap_or(MIDDLE_GREY / key);
        let stats = reference.buffer_mut(self.stats);
        (stats[KEY], stats[EXPOSURE], stats[NOISE]) = (key, exposure, noise);
        stats[LARGEST..LARGEST + 3].copy_from_slice(&largest);
        fill_gaps(reference.buffer_mut(self.tile_stats), self.columns as usize, self.tiles as usize);
    }
}

/// From the tiles that have means outwards, ring by ring.
fn fill_gaps(tile_stats: &mut [f64], columns: usize, tiles: usize) {
    let words = TILE_WORDS as usize;
    let near = |at: usize, end: usize| at.saturating_sub(1)..(at + 2).min(end);
    for channel in 0..3 {
        loop {
            let found = (0..tiles).filter(|tile| tile_stats[tile * words + channel].is_nan()).filter_map(|tile| {
                let around = near(tile / columns, tiles / columns)
                    .flat_map(|y| near(tile % columns, columns).map(move |x| y * columns + x));
                let means = around.map(|tile| tile_stats[tile * words + channel]).filter(|mean| !mean.is_nan());
                let means: Vec<f64> = means.collect();
                (!means.is_empty()).then(|| (tile, means.iter().sum::<f64>() / means.len() as f64))
            });
            let found: Vec<(usize, f64)> = found.collect();
            if found.is_empty() {
                break;
            }
            found.into_iter().for_each(|(tile, mean)| tile_stats[tile * words + channel] = mean);
        }
    }
}

/// How non-negative floats are sorted into bins: by their upper bits.
#[derive(Clone, Copy)]
struct Sorting {
    /// Mantissa bits that share a bin.
    shift: u32,
    /// The upper bits of the first bin, which also counts what is below it.
    first: u32,
}

/// Every non-negative float, 128 bins an octave.
const LUMINANCE: Sorting = Sorting { shift: 16, first: 0 };
/// From 2^-34 to 2^30, 512 bins an octave.
const DEPTH: Sorting = Sorting { shift: 14, first: (127 - 34) << 9 };

impl Sorting {
    fn bin(self, value: f32) -> usize {
        (value.to_bits() >> self.shift).saturating_sub(self.first) as usize
    }

    /// The lower bound of a bin; the last finite bin ends with the last finite float.
    fn bound(self, bin: usize) -> f64 {
        f64::from(f32::from_bits((bin as u32 + self.first) << self.shift).min(f32::MAX))
    }
}

/// The element of a rank, as if those of a bin lay evenly in it. `rank` is asked with the number of elements.
fn quantile(bins: &[f64], sorting: Sorting, rank: impl Fn(u64) -> u64) -> Option<f64> {
    let count = bins.iter().sum::<f64>() as u64;
    if count == 0 {
        return None;
    }
    let rank = rank(count) as f64;
    let mut before = 0.0;
    for (i, &inside) in bins.iter().enumerate() {
        if before + inside > rank {
            let share = (rank - before + 0.5) / inside;
            return Some(sorting.bound(i) + (sorting.bound(i + 1) - sorting.bound(i)) * share);
        }
        before += inside;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_filled_from_the_nearest_ring() {
        // Four by three tiles: red of the corners of a side alone, green of none, blue of all.
        let mut tiles: Vec<f64> = [f64::NAN, f64::NAN, 5.0, 0.0].repeat(12);
        (tiles[0], tiles[4 * 8]) = (1.0, 3.0);
        fill_gaps(&mut tiles, 4, 12);
        let red: Vec<f64> = tiles.iter().step_by(4).copied().collect();
        assert_eq!(red, [1.0, 1.0, 1.5, 1.75, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 2.5, 2.25]);
        assert!(tiles[1].is_nan() && tiles[2] == 5.0);
    }

    #[test]
    fn elements_lie_evenly_in_their_bin() {
        let mut bins = vec![0.0; BINS as usize];
        assert_eq!(quantile(&bins, LUMINANCE, |count| count / 2), None);
        bins[LUMINANCE.bin(1.0)] = 1.0;
        // The bin of 1 ends at 1 + 1/128.
        assert_eq!(quantile(&bins, LUMINANCE, |count| (count - 1) / 2), Some(1.0 + 0.5 / 128.0));
        bins[LUMINANCE.bin(2.0)] = 4.0;
        assert_eq!(quantile(&bins, LUMINANCE, |count| (count - 1) / 2), Some(2.0 + 1.5 / 4.0 / 64.0));
    }

    #[test]
    fn depths_of_every_unit_have_bins() {
        for (depth, bin) in [(1e-30, 0), (2f32.powi(-34), 0), (1.0, 34 * 512), (1e9, 32697)] {
            assert_eq!(DEPTH.bin(depth), bin, "{depth}");
        }
        assert!(DEPTH.bin(1e9f32.next_down()) < BINS as usize);
        assert_eq!((DEPTH.bound(0), DEPTH.bound(34 * 512)), (2f64.powi(-34), 1.0));
    }

    #[test]
    fn the_last_bin_has_an_end() {
        let mut bins = vec![0.0; BINS as usize];
        bins[LUMINANCE.bin(f32::MAX)] = 1.0;
        let top = quantile(&bins, LUMINANCE, |_| 0);
        assert!(top.is_some_and(|top| top < f64::from(f32::MAX) && top > 3e38), "{top:?}");
    }
}

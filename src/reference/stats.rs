//! Twins of the frame's statistics ([`crate::kernels::stats`]).
//!
//! Pixels are sorted into bins by their bits, so luminances are 32-bit floats here as they are on the device.

use super::Reference;
use super::frame_io::{FIREFLY_KEYS, FrameData};
use super::tiles;
use crate::kernels::stats::{BINS, Clear, Counted, EXPOSURE, Histogram, KEY, Key, MEDIAN, Select, TileMeans};

/// What an exposed frame's key becomes, and the key of a black frame.
const MIDDLE_GREY: f64 = 0.18;
/// Keys whose exposure is a normal 32-bit float.
const KEYS: [f64; 2] = [1e-30, 1e36];
/// What a tile without light has for a logarithm.
const DARK: f64 = -1e31;

/// Zeroes a histogram.
pub fn clear(reference: &mut Reference, call: &Clear) {
    reference.set_buffer(call.histogram, &vec![0.0; BINS as usize]);
}

/// Counts luminances above 0, or valid depths.
pub fn histogram(reference: &mut Reference, call: &Histogram) {
    let mut bins = reference.buffer(call.histogram).to_vec();
    for i in 0..call.width as usize * call.height as usize {
        let frame = &reference.frame;
        let bin = match call.counted {
            Counted::Luminance => frame.luminance(i).filter(|&l| l > 0.0).map(|luminance| LUMINANCE.bin(luminance)),
            Counted::Depth => frame.depth(i).map(|depth| DEPTH.bin(depth)),
        };
        if let Some(bin) = bin {
            bins[bin] += 1.0;
        }
    }
    reference.set_buffer(call.histogram, &bins);
}

/// Median luminance or depth scale.
pub fn select(reference: &mut Reference, call: &Select) {
    let bins = reference.buffer(call.histogram);
    let value = match call.counted {
        Counted::Luminance => quantile(bins, LUMINANCE, |count| (count - 1) / 2).unwrap_or(0.0),
        Counted::Depth => quantile(bins, DEPTH, |count| (count - 1) * 999 / 1000).unwrap_or(1.0),
    };
    reference.set_buffer(call.dst, &[value]);
}

/// Logarithm of every tile's mean luminance, relative to the median.
pub fn tile_means(reference: &mut Reference, call: &TileMeans) {
    let median = reference.buffer(call.stats)[MEDIAN];
    let (width, height) = (call.width as usize, call.height as usize);
    let tiles = tiles::all(call.width, call.height);
    let logs: Vec<f64> = tiles
        .chunks(1)
        .map(|tile| tiles::tokens(tile, width, height).map(|(x, y)| y * width + x))
        .map(|pixels| tile_log(pixels, &reference.frame, median))
        .collect();
    reference.set_buffer(call.dst, &logs);
}

fn tile_log(pixels: impl Iterator<Item = usize>, frame: &FrameData, median: f64) -> f64 {
    // Bad pixels stay out, by the median: the key is not known yet.
    let limit = FIREFLY_KEYS * median;
    let counts = |i: &usize| frame.color(*i).is_some_and(|color| color.iter().all(|&c| f64::from(c) <= limit));
    let luminances: Vec<f64> = pixels.filter(counts).filter_map(|i| frame.luminance(i)).map(f64::from).collect();
    if median == 0.0 || luminances.iter().all(|&luminance| luminance == 0.0) {
        return DARK;
    }
    let sum: f64 = luminances.iter().map(|luminance| (luminance / median).min(64.0)).sum();
    (sum / luminances.len() as f64).max(1.0 / 1024.0).log2()
}

/// Key and exposure.
pub fn key(reference: &mut Reference, call: &Key) {
    let logs = &reference.buffer(call.src)[..call.tiles as usize];
    let lit: Vec<f64> = logs.iter().copied().filter(|&log| log > -1e30).collect();
    let key = if lit.is_empty() {
        MIDDLE_GREY
    } else {
        let mean = lit.iter().sum::<f64>() / lit.len() as f64;
        (reference.buffer(call.stats)[MEDIAN] * mean.exp2()).clamp(KEYS[0], KEYS[1])
    };
    let exposure = reference.frame.exposure.unwrap_or(MIDDLE_GREY / key);
    let stats = reference.buffer_mut(call.stats);
    (stats[KEY], stats[EXPOSURE]) = (key, exposure);
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

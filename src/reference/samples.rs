//! What a frame's samples count as: twin of `glsl/shared/samples.glsl` and `mend.glsl`
//! ([`crate::kernels::frame_io::InputColor`]).

use super::frame_io::FrameData;
use crate::kernels::TILE;
use crate::kernels::frame_io::Fireflies;
use crate::kernels::stats::{KEY, LARGEST, NOISE, TILE_WORDS};

/// A lone pixel of more than this many keys is no light.
const ABSURD_KEYS: f64 = 1e8;
/// A firefly: more than so many keys, and so many times the second-brightest of the neighbours.
const FIREFLY: [f64; 2] = [1e3, 100.0];
/// A firefly that is kept.
const KEPT: [f64; 2] = [8.0, 8.0];
/// Rings of pixels that mend one.
const MEND_REACH: usize = 4;
/// Lit pixels that tell whether it is noisy around.
const ENOUGH_LIT: u32 = 32;
/// The share of noisy pixels from which on it is noisy.
const NOISY_SHARE: f64 = 0.25;

/// A sample that is negative or not finite is 0.
pub fn light_of(sample: f32) -> f64 {
    if sample.is_finite() { f64::from(sample.max(0.0)) } else { 0.0 }
}

/// The brightest sample of a pixel; +Inf is the largest float.
fn brightness(samples: [f32; 3]) -> f64 {
    let of = |sample| if sample == f32::INFINITY { f64::from(f32::MAX) } else { light_of(sample) };
    samples.map(of).into_iter().fold(0.0, f64::max)
}

/// The pixels at most so far from one, as far as they lie in the frame, without itself; with their distance.
fn around(frame: &FrameData, (x, y): (usize, usize), reach: usize) -> impl Iterator<Item = (usize, usize, usize)> {
    let [width, height] = frame.size();
    let range = |at: usize, end: usize| at.saturating_sub(reach)..(at + reach + 1).min(end);
    let columns = range(x, width);
    let pixels = range(y, height).flat_map(move |y| columns.clone().map(move |x| (x, y)));
    pixels.map(move |(a, b)| (a, b, a.abs_diff(x).max(b.abs_diff(y)))).filter(|(_, _, away)| *away > 0)
}

/// The brightest and the second-brightest of the neighbours.
pub fn brightest_around(frame: &FrameData, x: usize, y: usize) -> [f64; 2] {
    let mut light: Vec<f64> =
        around(frame, (x, y), 1).map(|(x, y, _)| brightness(frame.samples(x, y))).chain([0.0; 2]).collect();
    light.sort_by(|a, b| b.total_cmp(a));
    [light[0], light[1]]
}

/// Absurdly bright and alone.
pub fn is_absurd(light: f64, key: f64, neighbours: [f64; 2]) -> bool {
    light > ABSURD_KEYS * key && light > FIREFLY[1] * neighbours[0]
}

/// Whether a pixel is absurdly bright, lone or not.
pub fn is_absurdly_bright(light: f64, key: f64) -> bool {
    light > ABSURD_KEYS * key
}

fn is_firefly(light: f64, key: f64, neighbours: [f64; 2]) -> bool {
    light > FIREFLY[0] * key && light > FIREFLY[1] * neighbours[1]
}

/// Whether nothing is missing of a pixel, and it is no lone bright one.
pub fn is_sound(frame: &FrameData, x: usize, y: usize, key: f64) -> bool {
    let samples = frame.samples(x, y);
    let (light, neighbours) = (brightness(samples), brightest_around(frame, x, y));
    samples.iter().all(|sample| sample.is_finite())
        && !is_absurd(light, key, neighbours)
        && !is_firefly(light, key, neighbours)
}

/// How the network is to take a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Its samples each by itself.
    AsItIs,
    /// As missing.
    Mended,
    /// As missing, and the rest of its light is added to the result.
    Kept,
    /// As a lamp of +Inf, which is in the result what it counts for.
    Lamp,
}

/// A frame with what is known of it.
pub struct Mending<'a> {
    frame: &'a FrameData,
    key: f64,
    noise: f64,
    largest: f64,
    tile_stats: &'a [f64],
}

impl<'a> Mending<'a> {
    /// With the statistics of the frame and of its tiles.
    pub fn new(frame: &'a FrameData, stats: &[f64], tile_stats: &'a [f64]) -> Self {
        let largest = stats[LARGEST..LARGEST + 3].iter().copied().fold(0.0, f64::max);
        Self { frame, key: stats[KEY], noise: stats[NOISE], largest, tile_stats }
    }

    /// What the network takes a pixel for, and how.
    pub fn pixel(&self, x: usize, y: usize) -> ([f64; 3], Way) {
        let samples = self.frame.samples(x, y);
        let way = self.way(x, y);
        if way != Way::AsItIs {
            return (self.mended(x, y), way);
        }
        let infinite = samples.contains(&f32::INFINITY).then(|| self.infinite(x, y));
        let lamp = infinite.is_some_and(|(_, lamp)| lamp);
        let mended = samples.iter().any(|s| !s.is_finite() && *s != f32::INFINITY).then(|| self.mended(x, y));
        let light = [0, 1, 2].map(|channel| match (samples[channel], infinite, mended) {
            (f32::INFINITY, Some((light, _)), _) => light,
            (sample, _, _) if sample.is_finite() => light_of(sample),
            (_, _, mended) => mended.map_or(0.0, |mended| mended[channel]),
        });
        (light, if lamp { Way::Lamp } else { way })
    }

    /// The frame.
    pub fn frame(&self) -> &FrameData {
        self.frame
    }

    /// The means of two numbers over the nearest of the rings around a pixel that has any.
    pub fn ring(&self, x: usize, y: usize, read: impl Fn(usize, usize) -> Option<[f64; 2]>) -> Option<[f64; 2]> {
        (1..=MEND_REACH).find_map(|reach| {
            let ring = around(self.frame, (x, y), reach).filter(|(.., away)| *away == reach);
            let found: Vec<[f64; 2]> = ring.filter_map(|(x, y, _)| read(x, y)).collect();
            let mean = |which: usize| found.iter().map(|pair| pair[which]).sum::<f64>() / found.len() as f64;
            (!found.is_empty()).then(|| [mean(0), mean(1)])
        })
    }

    fn tile(&self, x: usize, y: usize) -> &[f64] {
        let columns = self.frame.size()[0].div_ceil(TILE as usize);
        let words = TILE_WORDS as usize;
        &self.tile_stats[(y * columns + x) * words..][..words]
    }

    fn is_noisy_around(&self, x: usize, y: usize) -> bool {
        let side = TILE as usize;
        let [width, height] = self.frame.size();
        let range = |at: usize, size: usize| (at / side).saturating_sub(1)..(at / side + 2).min(size.div_ceil(side));
        let tiles = range(y, height).flat_map(|y| range(x, width).map(move |x| (x, y)));
        let counts: Vec<u32> = tiles.map(|(x, y)| self.tile(x, y)[3] as u32).collect();
        let (lit, noisy): (u32, u32) =
            (counts.iter().map(|c| c & 0xffff).sum(), counts.iter().map(|count| count >> 16).sum());
        let share = if lit >= ENOUGH_LIT { f64::from(noisy) / f64::from(lit) } else { self.noise };
        share > NOISY_SHARE
    }

    /// How the network is to take a pixel, a lamp of +Inf aside.
    pub fn way(&self, x: usize, y: usize) -> Way {
        let samples = self.frame.samples(x, y);
        let light = brightness(samples);
        if light <= KEPT[0] * self.key || samples.contains(&f32::INFINITY) {
            return Way::AsItIs;
        }
        let keeps = match self.frame.fireflies {
            Fireflies::Keep => true,
            Fireflies::Mend => false,
            Fireflies::Auto => !self.is_noisy_around(x, y),
        };
        let neighbours = brightest_around(self.frame, x, y);
        if is_absurd(light, self.key, neighbours) || !keeps && is_firefly(light, self.key, neighbours) {
            Way::Mended
        } else if keeps && light > KEPT[1] * neighbours[1] {
            Way::Kept
        } else {
            Way::AsItIs
        }
    }

    /// By channel, the mean of the nearest ring that has good samples, else the tile's.
    fn mended(&self, x: usize, y: usize) -> [f64; 3] {
        let good: Vec<_> = around(self.frame, (x, y), MEND_REACH)
            .filter(|(x, y, _)| self.way(*x, *y) == Way::AsItIs)
            .map(|(x, y, away)| (self.frame.samples(x, y), away))
            .collect();
        let tile = self.tile(x / TILE as usize, y / TILE as usize);
        [0, 1, 2].map(|channel| {
            let finite = || good.iter().filter(|(samples, _)| samples[channel].is_finite());
            let Some(nearest) = finite().map(|(_, away)| *away).min() else {
                return if tile[channel].is_nan() { 0.0 } else { tile[channel] };
            };
            let ring: Vec<f64> =
                finite().filter(|(_, away)| *away == nearest).map(|(s, _)| light_of(s[channel])).collect();
            ring.iter().sum::<f64>() / ring.len() as f64
        })
    }

    /// What +Inf counts for, and whether it is a lamp.
    pub fn infinite(&self, x: usize, y: usize) -> (f64, bool) {
        let near = || around(self.frame, (x, y), 1).map(|(x, y, _)| (x, y));
        let others = near().filter(|(x, y)| self.frame.samples(*x, *y).contains(&f32::INFINITY)).count();
        let good = near().chain([(x, y)]).filter(|(x, y)| self.way(*x, *y) == Way::AsItIs);
        let finite: Vec<f64> =
            good.flat_map(|(x, y)| self.frame.samples(x, y)).filter(|s| s.is_finite()).map(light_of).collect();
        match others >= 2 || finite.is_empty() {
            true => (self.largest, true),
            false => (finite.into_iter().fold(0.0, f64::max), false),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Extent, Frame, Layout, Plane};

    fn frame(extent: Extent, color: &[f32], fireflies: Fireflies) -> FrameData {
        let rgb = Layout::interleaved(extent, 3);
        let mut data = FrameData::new(&Frame { extent, color: Plane::f32(color, rgb), features: Default::default() });
        data.fireflies = fireflies;
        data
    }

    /// A key of 1, a clean frame whose largest sample is 50, tiles of a mean of 7 of which nothing is lit.
    fn mend(frame: &FrameData, key: f64) -> impl Fn(usize, usize) -> [f64; 3] {
        let stats = [1.0, key, 0.18, 0.0, 50.0, 20.0, 1.0];
        move |x, y| Mending::new(frame, &stats, &[7.0, 7.0, f64::NAN, 0.0].repeat(16)).pixel(x, y).0
    }

    #[test]
    fn samples_are_mended_by_channel() {
        let extent = Extent::new(3, 2);
        let mut color: Vec<f32> = (0..18).map(|i| i as f32).collect();
        color[4] = f32::NAN; // Pixel (1, 0).
        color[9] = -1.0; // Pixel (0, 1).
        color[17] = 3e9; // Pixel (2, 1), alone.
        let data = frame(extent, &color, Fireflies::Mend);
        let mended = mend(&data, 1.0);
        assert_eq!(mended(0, 0), [0.0, 1.0, 2.0]);
        // Green of the four around that have it.
        assert_eq!(mended(1, 0), [3.0, (1.0 + 7.0 + 10.0 + 13.0) / 4.0, 5.0]);
        assert_eq!(mended(0, 1), [0.0, 10.0, 11.0]);
        assert_eq!(mended(2, 1), [(3.0 + 6.0 + 12.0) / 3.0, (7.0 + 13.0) / 2.0, (5.0 + 8.0 + 14.0) / 3.0]);
        assert_eq!(mend(&data, 1e7)(2, 1), [15.0, 16.0, 3e9]);
    }

    #[test]
    fn holes_take_the_nearest_ring_and_far_from_all_their_tile() {
        let extent = Extent::new(32, 32);
        let hole = |x: usize, y: usize| (8..24).contains(&x) && (8..24).contains(&y);
        let value = |i: usize| if hole(i / 3 % 32, i / 96) { f32::NAN } else { (i / 3 % 32) as f32 };
        let color: Vec<f32> = (0..3 * 1024).map(value).collect();
        let data = frame(extent, &color, Fireflies::Auto);
        let mended = mend(&data, 1e3);
        assert_eq!(mended(8, 15), [7.0; 3]);
        assert_eq!(mended(20, 16), [24.0; 3]);
        assert_eq!(mended(12, 12), [7.0, 7.0, 0.0]);
    }

    #[test]
    fn infinity_is_as_bright_as_what_is_around_or_in_the_frame() {
        let extent = Extent::new(8, 8);
        let mut color = vec![1.0f32; 3 * 64];
        color[3 * 10] = f32::INFINITY; // Pixel (2, 1).
        color[3 * 11 + 1] = 4.0;
        for pixel in [44, 45, 52, 53] {
            color[3 * pixel..][..3].fill(f32::INFINITY);
        }
        let data = frame(extent, &color, Fireflies::Auto);
        let mended = mend(&data, 1.0);
        assert_eq!(mended(2, 1), [4.0, 1.0, 1.0]);
        assert_eq!(mended(4, 5), [50.0; 3]);
        let stats = [1.0, 1.0, 0.18, 0.0, 50.0, 20.0, 1.0];
        let way = |x, y| Mending::new(&data, &stats, &[]).pixel(x, y).1;
        assert_eq!([way(2, 1), way(4, 5), way(0, 0)], [Way::AsItIs, Way::Lamp, Way::AsItIs]);
        assert_eq!(mended(3, 4), [1.0; 3]);
    }

    #[test]
    fn fireflies_are_mended_or_kept_and_small_lights_are_neither() {
        let extent = Extent::new(12, 12);
        let lit = |x: usize, y: usize| match (x, y) {
            (1, 1) | (6 | 7, 1) | (1 | 2, 5 | 6) | (6..=8, 5) => 2e3,
            (1, 9) => 9e2,
            (9 | 10, 9) => 1e30,
            _ => 1.0,
        };
        let color: Vec<f32> = (0..3 * 144).map(|i| lit(i / 3 % 12, i / 36)).collect();
        for fireflies in [Fireflies::Mend, Fireflies::Keep, Fireflies::Auto] {
            let data = frame(extent, &color, fireflies);
            let mended = mend(&data, 1.0);
            // One bright pixel and a pair are fireflies, and so are a line's two ends.
            for (x, y) in (0..144).map(|i| (i % 12, i / 12)) {
                let expected = match (x, y) {
                    (1, 1) | (6 | 7, 1) | (9 | 10, 9) => 1.0,
                    (1, 9) if fireflies != Fireflies::Mend => 1.0,
                    (6 | 8, 5) => (7.0 + 2e3) / 8.0,
                    _ => f64::from(lit(x, y)),
                };
                assert_eq!(mended(x, y), [expected; 3], "{fireflies:?} {x}, {y}");
            }
        }
    }

    #[test]
    fn auto_mends_where_it_is_noisy() {
        let extent = Extent::new(32, 8);
        let mut color = vec![1.0f32; 3 * 256];
        color[3 * 100..][..3].fill(1e6);
        let data = frame(extent, &color, Fireflies::Auto);
        let way = |noise: f64, lit: u32, noisy: u32| {
            let stats = [1.0, 1.0, 0.18, noise, 1.0, 1.0, 1.0];
            let tiles = [1.0, 1.0, 1.0, f64::from(lit | noisy << 16)].repeat(4);
            Mending::new(&data, &stats, &tiles).pixel(4, 3).1
        };
        // Two tiles are around.
        assert_eq!(way(1.0, 16, 4), Way::Kept);
        assert_eq!(way(0.0, 16, 5), Way::Mended);
        assert_eq!(way(0.3, 15, 0), Way::Mended);
        assert_eq!(way(0.25, 15, 15), Way::Kept);
    }
}

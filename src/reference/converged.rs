//! Twins of the kernels that leave out what needs no denoising ([`crate::kernels::converged`]).

use super::frame_io::{FrameData, reflect};
use super::samples::is_sound;
use super::{Reference, Twin};
use crate::frame::NoiseKind;
use crate::kernels::converged::{
    ALWAYS, ConvergedMap, FAR, Fill, MAP_TILE, REACHES, Reach, Sample, TILES_A_GROUP, TileList, TileNoise,
};
use crate::kernels::stats::{EXPOSURE, KEY};
use crate::kernels::{TILE, View};

const SQUARE: usize = MAP_TILE as usize;
/// Side of the parts over which the mean square is taken.
const QUARTER: usize = 8;
/// Of the exposed colour: relative noise below it counts for less.
const FLOOR: f64 = 0.01;
/// Workgroups in x that a dispatch may have.
const LARGEST_X: u32 = 65535;

impl Twin for TileNoise {
    /// Relative noise of every square.
    fn compute(&self, reference: &mut Reference) {
        let stats = reference.buffer(self.stats);
        let (key, exposure) = (stats[KEY], stats[EXPOSURE]);
        let frame = &reference.frame;
        let (width, height) = (self.frame.width as usize, self.frame.height as usize);
        let noise = (0..self.map.tiles() as usize).map(|i| {
            let first = (i % self.map.columns as usize * SQUARE, i / self.map.columns as usize * SQUARE);
            let (right, bottom) = ((first.0 + SQUARE).min(width), (first.1 + SQUARE).min(height));
            let pixels: Vec<_> = (first.1..bottom).flat_map(|y| (first.0..right).map(move |x| (x, y))).collect();
            if pixels.iter().any(|&(x, y)| !is_sound(frame, x, y, key)) {
                return f64::from(ALWAYS);
            }
            let Some(layer) = &frame.noise else { return estimate(frame, &pixels, first, exposure) };
            let of_layer = |&(x, y): &(usize, usize)| {
                let value = f64::from(layer[y * width + x]);
                let of_value = match frame.noise_kind {
                    NoiseKind::Samples => value.powf(-0.5),
                    NoiseKind::Variance => {
                        let light = frame.luminance(y * width + x).map_or(0.0, f64::from);
                        value.sqrt() / (light + FLOOR / exposure)
                    }
                };
                if value >= 0.0 && value.is_finite() { of_value.min(f64::from(ALWAYS)) } else { f64::from(ALWAYS) }
            };
            let layer = pixels.iter().map(of_layer).fold(0.0, f64::max);
            let is_ground = |&(x, y): &(usize, usize)| frame.has_no_depth() || frame.depth(y * width + x).is_some();
            match frame.noise_kind {
                NoiseKind::Samples if !pixels.iter().any(is_ground) => {
                    layer.min(estimate(frame, &pixels, first, exposure))
                }
                _ => layer,
            }
        });
        let noise: Vec<f64> = noise.collect();
        reference.set_buffer(self.dst, &noise);
    }
}

/// From the frame itself: the largest over quarters and channels.
fn estimate(frame: &FrameData, pixels: &[(usize, usize)], (left, top): (usize, usize), exposure: f64) -> f64 {
    let [width, height] = frame.size();
    if width.min(height) < 3 {
        return if pixels.is_empty() { 0.0 } else { f64::from(ALWAYS) };
    }
    let log = |x: isize, y: isize, channel: usize| {
        let (x, y) = (reflect(x.unsigned_abs(), width), reflect(y.unsigned_abs(), height));
        frame.color(y * width + x).map_or(0.0, |color| (f64::from(color[channel]) * exposure + FLOOR).ln())
    };
    let response = |x: usize, y: usize, channel: usize| {
        let weight = |d: isize| if d == 0 { -2.0 } else { 1.0 };
        let offsets = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
        let taps = offsets.map(|(dx, dy)| weight(dx) * weight(dy) * log(x as isize + dx, y as isize + dy, channel));
        taps.sum::<f64>()
    };
    let mut largest = 0.0f64;
    for quarter in 0..4 {
        let inside = |x: usize, y: usize| (x - left) / QUARTER + (y - top) / QUARTER * 2 == quarter;
        let own: Vec<_> = pixels.iter().filter(|(x, y)| inside(*x, *y)).collect();
        for channel in 0..3 {
            let squares: f64 = own.iter().map(|(x, y)| response(*x, *y, channel).powi(2)).sum();
            largest = largest.max(squares / own.len().max(1) as f64);
        }
    }
    largest.sqrt() / 6.0
}

impl Twin for ConvergedMap {
    /// Marks and their sums.
    fn compute(&self, reference: &mut Reference) {
        let (columns, rows) = (self.size.columns as usize, self.size.rows as usize);
        let [left, top, right, bottom] = self.wanted().map(|end| end as usize);
        let frame = &reference.frame;
        let noise = reference.buffer(self.src);
        let noisy = |x: usize, y: usize| noise[y * columns + x] > frame.converged_threshold;
        let reach = usize::from(frame.noise.is_none() || frame.noise_kind != NoiseKind::Samples);
        let near = |at: usize, end: usize| at.saturating_sub(reach)..(at + reach + 1).min(end);
        let mark = |i: usize| {
            let end = |at: usize, end: u32| at.min(end as usize - 1);
            let (x, y) = (end(i % columns, self.real.columns), end(i / columns, self.real.rows));
            let wanted = (left..right).contains(&x) && (top..bottom).contains(&y);
            wanted && near(y, rows).any(|y| near(x, columns).any(|x| noisy(x, y)))
        };
        let marks: Vec<f64> = (0..columns * rows).map(|i| f64::from(u8::from(mark(i)))).collect();
        let sum = |x: usize, y: usize| (0..y).map(|row| marks[row * columns..][..x].iter().sum::<f64>()).sum::<f64>();
        let sums: Vec<f64> =
            (0..=rows).flat_map(|y| (0..=columns).map(move |x| (x, y))).map(|(x, y)| sum(x, y)).collect();
        reference.set_buffer(self.map, &marks);
        reference.set_buffer(self.sums, &sums);
    }
}

impl Twin for TileList {
    /// Active tiles, others that are read, workgroups, the number of active ones.
    fn compute(&self, reference: &mut Reference) {
        let across = self.map.columns as usize + 1;
        let sums = reference.buffer(self.sums);
        let at = |x: usize, y: usize| sums[y * across + x];
        let marked = |x: usize, y: usize| at(x + 1, y + 1) + at(x, y) - at(x + 1, y) - at(x, y + 1) > 0.0;
        let seen = |reach: &[Reach; REACHES], tile: u32, end: u32| {
            let start = tile * self.tile_pixels / MAP_TILE;
            let Reach { back, on } = reach[start as usize % REACHES];
            let first = if back >= FAR { 0 } else { start.saturating_sub(back) };
            let end = if on >= FAR { end } else { (start + on + 1).min(end) };
            first as usize..end as usize
        };
        let sees = |reach: &[Reach; REACHES], x: u32, y: u32| {
            let looks = |column, row| marked(column, row) || self.sample.is_some_and(|s| is_sampled(&s, column, row));
            seen(reach, y, self.map.rows).any(|row| seen(reach, x, self.map.columns).any(|column| looks(column, row)))
        };
        let tiles: Vec<(u32, u32)> = (0..self.rows).flat_map(|y| (0..self.columns).map(move |x| (x, y))).collect();
        let (active, others): (Vec<_>, Vec<_>) = tiles.into_iter().partition(|(x, y)| sees(&self.reach, *x, *y));
        let idle: Vec<_> = others.into_iter().filter(|(x, y)| sees(&self.read, *x, *y)).collect();

        let groups = |x: u32, y: u32| {
            let z = x.div_ceil(LARGEST_X).max(1);
            [x.div_ceil(z), y, z].map(f64::from)
        };
        let count = active.len() as u32;
        let sizes = TILES_A_GROUP.iter().flat_map(|size| (1..=self.max_y).map(move |y| (count.div_ceil(*size), y)));
        let shapes: Vec<f64> = sizes.chain([(idle.len() as u32, 1)]).flat_map(|(x, y)| groups(x, y)).collect();
        reference.set_tiles(self.list, &active);
        reference.set_tiles(self.idle, &idle);
        reference.set_buffer(self.groups, &shapes);
        reference.set_element(self.counts, self.slot as usize, f64::from(count));
    }
}

/// Whether a square is one of a sample.
pub fn is_sampled(sample: &Sample, x: usize, y: usize) -> bool {
    let Sample { pitch, skew, real } = *sample;
    let inside = x < real.columns as usize && y < real.rows as usize;
    inside && (x + skew as usize * y).is_multiple_of(pitch as usize)
}

impl Twin for Fill {
    /// Zeros.
    fn compute(&self, reference: &mut Reference) {
        let (width, height) = self.size();
        let View { top, width: row, first, stride, channels, .. } = self.dst;
        let scaled = |at: usize| (at * self.side as usize / TILE as usize) as u32;
        for (left, upper) in reference.tiles(&self.tiles, width, height) {
            for token in 0..self.side * self.side {
                let (x, y) = (scaled(left) + token % self.side, top + scaled(upper) + token / self.side);
                for channel in first..first + channels {
                    reference.set_element(self.dst.buffer, ((y * row + x) * stride + channel) as usize, 0.0);
                }
            }
        }
    }
}

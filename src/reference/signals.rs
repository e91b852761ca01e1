//! Twins of the kernels for signals beside the colour ([`crate::kernels::signals`]).

use super::energy;
use super::frame_io::{LARGEST_HALF, RANGE, average, clamp, converged_share, fill};
use super::map::Map;
use super::predicted::demodulator;
use super::samples::{Mending, Way, light_of};
use super::tiles;
use super::{Reference, Twin};
use crate::kernels::converged::MAP_TILE;
use crate::kernels::ensemble::Member;
use crate::kernels::signals::{InputSignal, OutputSignal};
use crate::kernels::stats::{EXPOSURE, LARGEST};
use crate::signals::SignalKind;

/// A signal, its channels interleaved, and what became of it.
#[derive(Clone, Debug)]
pub struct SignalData {
    pub kind: SignalKind,
    pub channels: usize,
    pub samples: Vec<f32>,
    pub output: Vec<f64>,
    /// What became of the turned one, where results are averaged.
    pub turned: Vec<f64>,
}

impl SignalData {
    /// Whether it is a part of the light.
    pub fn is_light(&self) -> bool {
        self.kind == SignalKind::Light
    }

    /// The samples of a pixel; one channel three times.
    fn samples(&self, pixel: usize) -> [f32; 3] {
        [0, 1, 2].map(|channel| self.samples[pixel * self.channels + channel.min(self.channels - 1)])
    }
}

/// What kernels read of a part of the light, exposed, and what goes around them; `None`: that is all of the result.
fn part(mending: &Mending, signal: &SignalData, exposure: f64, (x, y): (usize, usize)) -> [(f64, Option<f64>); 3] {
    let width = mending.frame().size()[0];
    let (own, color) = (signal.samples(y * width + x), mending.frame().samples(x, y));
    let way = mending.way(x, y);
    let infinite = color.contains(&f32::INFINITY).then(|| mending.infinite(x, y));
    let lamp = infinite.is_some_and(|(_, lamp)| lamp);
    let infinite = infinite.map_or(0.0, |(light, _)| light * exposure);
    let counts = |sample: f32, color: f32| if color < 0.0 && color.is_finite() { 0.0 } else { f64::from(sample) };
    let channels = [0, 1, 2].map(|c| {
        let overflows = own[c] == f32::INFINITY && color[c] == f32::INFINITY;
        let has = (color[c].is_finite() || color[c] == f32::INFINITY) && (own[c].is_finite() || overflows);
        let exposed = if color[c] == f32::INFINITY { infinite } else { light_of(color[c]) * exposure };
        let (given, counted) = if way != Way::AsItIs || !has {
            let good = |x, y| {
                let (sample, color) = (signal.samples(y * width + x)[c], mending.frame().samples(x, y)[c]);
                let is_good = sample.is_finite() && color.is_finite() && mending.way(x, y) == Way::AsItIs;
                is_good.then(|| [counts(sample, color) * exposure, light_of(color) * exposure])
            };
            let [given, color] = mending.ring(x, y, good).unwrap_or_default();
            (given, color)
        } else if overflows {
            (infinite, exposed)
        } else {
            (counts(own[c], color[c]) * exposure, exposed)
        };
        (given, counted, exposed, overflows)
    });
    let exceeds = channels.iter().any(|(_, counted, ..)| *counted > RANGE);
    let around = way == Way::Kept || lamp || way == Way::AsItIs && exceeds;
    [0, 1, 2].map(|c| {
        let (given, counted, exposed, overflows) = channels[c];
        let given = given * (RANGE / counted.max(RANGE));
        let rest = (exposed - counted.min(RANGE)).max(0.0);
        let beyond = match (around, overflows) {
            (true, true) if lamp => return (given, None),
            (true, true) => rest,
            (true, false) if own[c].is_finite() && color[c].is_finite() && exposed > 0.0 => {
                f64::from(own[c]) * exposure * rest / exposed
            }
            _ => 0.0,
        };
        (given, Some(beyond))
    })
}

impl Twin for InputSignal {
    /// A signal to what predicted kernels read, and what goes around them.
    fn compute(&self, reference: &mut Reference) {
        let (taps, albedo) = (reference.map(&self.taps), reference.map(&self.albedo));
        let (stats, frame) = (reference.buffer(self.stats), &reference.frame);
        let Some(signal) = &frame.signal else { return };
        let mending = Mending::new(frame, stats, reference.buffer(self.tile_stats));
        let (exposure, blend) = (stats[EXPOSURE], frame.blend);
        let width = self.width as usize;
        let mut map = Map::zeros(self.dst.width as usize, self.dst.height as usize, self.dst.channels as usize);
        fill(&mut map, self.width, self.height, |x, y, token| {
            let given = match signal.kind {
                SignalKind::Light => part(&mending, signal, exposure, (x, y)),
                _ => [0, 1, 2].map(|c| {
                    let sample = |x, y| Some(signal.samples(y * width + x)[c]).filter(|s| s.is_finite()).map(f64::from);
                    let own = sample(x, y).map(|own| [own, 0.0]);
                    (
                        own.or_else(|| mending.ring(x, y, |x, y| sample(x, y).map(|s| [s, 0.0]))).unwrap_or_default()
                            [0],
                        Some(0.0),
                    )
                }),
            };
            let infinite = || mending.infinite(x, y).0 * exposure;
            for (c, (given, beyond)) in given.into_iter().enumerate() {
                token[c] = given;
                token[4 + c] = beyond.map_or_else(infinite, |beyond| blend * given + beyond);
                token[7] += f64::from(u32::from(beyond.is_none()) << c);
            }
        });
        for (i, token) in map.values.chunks_exact_mut(map.channels).enumerate() {
            let at = (i % taps.width, i / taps.width);
            let divisor = match signal.kind {
                SignalKind::Light => demodulator(albedo.token(at.0, at.1)),
                _ => [1.0; 3],
            };
            token[3] = taps.token(at.0, at.1)[3];
            for c in 0..3 {
                token[c] *= token[3] / divisor[c];
            }
        }
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&map, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Twin for OutputSignal {
    /// A filtered signal to its plane.
    fn compute(&self, reference: &mut Reference) {
        let views = [&self.filtered, &self.color, &self.input, &self.gains];
        let [filtered, color, input, gains] = views.map(|view| reference.map(view));
        let gains = energy::of_frame(&gains, reference.frame.size());
        let stats = reference.buffer(self.stats);
        let map = self.converged.map(|map| reference.buffer(map));
        let frame = &reference.frame;
        let Some(mut signal) = frame.signal.clone() else { return };
        let inverse = if signal.is_light() { 1.0 / stats[EXPOSURE] } else { 1.0 };
        let most = f64::from(f32::MAX);
        let (blend, end) = (frame.blend, if frame.output_half { LARGEST_HALF } else { most });
        let (width, height) = (self.width as usize, self.height as usize);
        signal.output.resize(signal.channels * width * height, f64::NAN);
        for (x, y) in tiles::tokens(&reference.tiles(&self.tiles, self.width, self.height), width, height) {
            if !self.region.contains(x as u32, y as u32) {
                continue;
            }
            let converged = map.map_or(0.0, |map| converged_share(map, self.filtered.width / MAP_TILE, x, y));
            let direct = input.token(x, y);
            for c in 0..signal.channels {
                let (clean, largest) = (clamp(color.token(x, y)[c] * inverse, most), stats[LARGEST + c]);
                let factor = match signal.is_light() {
                    true => energy::factor(&gains, (x, y), c, clean, largest),
                    false => 1.0,
                };
                let clean = factor * clean;
                let cut = if signal.is_light() && clean > largest { largest / clean } else { 1.0 };
                let alone = direct[7] as u32 >> c & 1 == 1;
                let share = if alone { 0.0 } else { 1.0 - blend };
                let kernels = share * filtered.token(x, y)[c] * factor * inverse * cut;
                let denoised = (kernels + direct[4 + c] * inverse).clamp(-end, end);
                let own = Some(signal.samples(y * width + x)[c]).filter(|own| own.is_finite()).map_or(0.0, f64::from);
                let mixed = match converged {
                    0.0 => denoised,
                    1.0 => own.clamp(-end, end),
                    share => (1.0 - share) * denoised + share * own.clamp(-end, end),
                };
                let result = if signal.kind == SignalKind::Alpha { mixed.clamp(0.0, 1.0) } else { mixed };
                signal.output[(y * width + x) * signal.channels + c] = result;
            }
        }
        match self.member {
            Some(Member::Turned) => signal.turned = std::mem::take(&mut signal.output),
            Some(Member::Upright) => average(&mut signal.output, &signal.turned, signal.channels),
            None => {}
        }
        reference.frame.signal = Some(signal);
    }
}

//! Twins of the head of predicted kernels ([`crate::kernels::predicted`]).

use super::map::Map;
use super::parameters::Parameters;
use super::signals::SignalData;
use super::{Reference, Twin};
use crate::kernels::BufferId;
use crate::kernels::predicted::{ApplyKernels, Halve, KernelInputs, MixLevels, PredictKernels};
use crate::net::head::{ALBEDO_SIDE, HIDDEN, KERNEL_SIDE, LEAST_ALBEDO, LOWEST_RELIABILITY};

/// The slope of the leaky rectifier.
const SLOPE: f64 = 0.01;

/// The Linears of a pixel, each `[output][input]` and its biases.
#[derive(Debug)]
pub struct KernelWeights {
    /// Of the tokens, outputs `[pixel of the token][hidden]`.
    pub tok: Linear,
    /// Of colour and direct estimate.
    pub guess: Linear,
    /// Logits, reliability, shares, gate, logits over albedo.
    pub full: Linear,
    /// Further shares; empty where there are none.
    pub more: Linear,
}

/// A matrix row by row, and biases.
#[derive(Debug, Default)]
pub struct Linear {
    /// `[output][input]`.
    pub rows: Vec<Vec<f64>>,
    /// One an output.
    pub biases: Vec<f64>,
}

impl Linear {
    fn apply(&self, input: &[f64]) -> Vec<f64> {
        let rows = self.rows.iter().zip(&self.biases);
        rows.map(|(row, bias)| bias + row.iter().zip(input).map(|(a, b)| a * b).sum::<f64>()).collect()
    }
}

/// The mean around `(x, y)` of `side` x `side` taps by `exp(logit)` times the weight that `read` gives with a value;
/// taps outside `size` are left out. `None` where nothing has a weight.
fn mean(
    logits: &[f64],
    side: u32,
    (x, y): (usize, usize),
    (width, height): (usize, usize),
    read: impl Fn(usize, usize) -> ([f64; 3], f64),
) -> Option<[f64; 3]> {
    let (side, reach) = (side as usize, side as usize / 2);
    let inside = |tap: usize| {
        let (x, y) = ((x + tap % side).checked_sub(reach)?, (y + tap / side).checked_sub(reach)?);
        (x < width && y < height).then(|| read(x, y))
    };
    let taps: Vec<_> = (0..side * side).filter_map(|tap| Some((logits[tap], inside(tap)?))).collect();
    let taps: Vec<_> = taps.into_iter().filter(|(_, (_, weight))| *weight > 0.0).collect();
    let most = taps.iter().map(|(logit, _)| *logit).fold(f64::MIN, f64::max);
    let (mut sum, mut total) = ([0.0; 3], 0.0);
    for (logit, (value, weight)) in &taps {
        let share = (logit - most).exp() * weight;
        total += share;
        for (sum, value) in sum.iter_mut().zip(value) {
            *sum += share * value;
        }
    }
    (total > 0.0).then(|| sum.map(|sum| sum / total))
}

/// What radiance is divided by.
pub fn demodulator(albedo: &[f64]) -> [f64; 3] {
    let most = albedo[0].max(albedo[1]).max(albedo[2]);
    let has = (most / LEAST_ALBEDO).clamp(0.0, 1.0);
    [0, 1, 2].map(|c| has * albedo[c].max(LEAST_ALBEDO) + (1.0 - has))
}

fn softmax(logits: &[f64]) -> Vec<f64> {
    let most = logits.iter().copied().fold(f64::MIN, f64::max);
    let shares: Vec<f64> = logits.iter().map(|logit| (logit - most).exp()).collect();
    let sum: f64 = shares.iter().sum();
    shares.into_iter().map(|share| share / sum).collect()
}

impl Twin for KernelInputs {
    /// What kernels are predicted from, and what they read.
    fn compute(&self, reference: &mut Reference) {
        let [early, tokens, albedo, color, residual] =
            [&self.early, &self.tokens, &self.albedo, &self.color, &self.residual].map(|view| reference.map(view));
        let weights = kernel_weights(reference, self.weights);
        let of_tokens: Vec<Vec<f64>> =
            tokens.values.chunks_exact(tokens.channels).map(|t| weights.tok.apply(t)).collect();
        let (width, channels) = (early.width, HIDDEN as usize);
        let mut hidden = Map::zeros(width, early.height, channels);
        let mut taps = Map::zeros(width, early.height, self.taps.channels as usize);
        let each = hidden.values.chunks_exact_mut(channels).zip(taps.values.chunks_exact_mut(taps.channels));
        for (i, (h, tap)) in each.enumerate() {
            let (x, y) = (i % width, i / width);
            let (c, r) = (&color.token(x, y)[..3], &residual.token(x, y)[..3]);
            let guess: Vec<f64> = c.iter().copied().chain(c.iter().zip(r).map(|(c, r)| c + r)).collect();
            let token = &of_tokens[y / 2 * tokens.width + x / 2][(y % 2 * 2 + x % 2) * channels..][..channels];
            for ((h, early), (token, guess)) in
                h.iter_mut().zip(early.token(x, y)).zip(token.iter().zip(weights.guess.apply(&guess)))
            {
                let sum = early + token + guess;
                *h = sum.max(SLOPE * sum);
            }
            let raw = weights.full.apply(h)[25];
            let softplus = raw.max(0.0) + (-raw.abs()).exp().ln_1p();
            let reliability = (-softplus).max(LOWEST_RELIABILITY).exp();
            let demodulator = demodulator(albedo.token(x, y));
            for channel in 0..3 {
                tap[channel] = reliability * c[channel].exp_m1() / demodulator[channel];
            }
            tap[3] = reliability;
        }
        let tiles = reference.tiles(&self.tiles, self.tokens.width, self.tokens.height);
        for (map, view) in [(hidden, &self.dst), (taps, &self.taps)] {
            let channels = map.channels;
            reference.store(&by_tokens(&map), view, &tiles, |x, y, c| {
                (2 * x + c / channels % 2, 2 * y + c / channels / 2, c % channels)
            });
        }
    }
}

fn kernel_weights<'a>(reference: &'a Reference, id: BufferId) -> &'a KernelWeights {
    match reference.parameters(id) {
        Parameters::Kernels(weights) => weights,
        other => unreachable!("predicted kernels are given {other:?}"),
    }
}

impl Twin for PredictKernels {
    /// Kernels of every pixel, predicted and applied.
    fn compute(&self, reference: &mut Reference) {
        let [hidden, taps, albedo] = [&self.hidden, &self.taps, &self.albedo].map(|view| reference.map(view));
        let weights = kernel_weights(reference, self.weights);
        let (width, height, channels) = (hidden.width, hidden.height, self.dst.channels as usize);
        let mut result = Map::zeros(width, height, channels);
        let after = channels - 8;
        let has_albedo = !self.of_signal || reference.frame.signal.as_ref().is_some_and(SignalData::is_light);
        for (i, out) in result.values.chunks_exact_mut(channels).enumerate() {
            let at = (i % width, i / width);
            let h = hidden.token(at.0, at.1);
            let (outputs, more) = (weights.full.apply(h), weights.more.apply(h));
            let read = |x: usize, y: usize| tap(taps.token(x, y));
            let mut image = mean(&outputs[..25], KERNEL_SIDE, at, (width, height), read).unwrap_or_default();
            let divided_by = |x: usize, y: usize| (demodulator(albedo.token(x, y)), 1.0);
            let mut gate = 1.0 / (1.0 + (-outputs[29]).exp());
            let mean_albedo = mean(&outputs[30..], ALBEDO_SIDE, at, (width, height), divided_by);
            let mut mean_albedo = mean_albedo.unwrap_or_default();
            if !has_albedo {
                (mean_albedo, gate) = ([1.0; 3], 1.0);
            }
            if self.gloss {
                let read = |x: usize, y: usize| {
                    let ((value, weight), (albedo, _)) = (read(x, y), divided_by(x, y));
                    ([0, 1, 2].map(|c| value[c] * albedo[c]), weight)
                };
                let undivided = mean(&outputs[..25], KERNEL_SIDE, at, (width, height), read).unwrap_or_default();
                image = with_gloss(image, undivided, &mean_albedo, gate);
            }
            let shares = softmax(&[&outputs[26..29], &more[..]].concat());
            out[..3].copy_from_slice(&image.map(|value| value * shares[0]));
            out[3] = shares[0];
            out[after..after + 3].copy_from_slice(&mean_albedo);
            out[after + 3] = gate;
            out[after + 4..after + 3 + shares.len()].copy_from_slice(&shares[1..]);
        }
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&result, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

/// A share `gate` of what was divided by the albedo, times it, and for the rest what was not.
fn with_gloss(divided: [f64; 3], undivided: [f64; 3], albedo: &[f64], gate: f64) -> [f64; 3] {
    [0, 1, 2].map(|c| undivided[c] + gate * (divided[c] * albedo[c] - undivided[c]))
}

/// A value and its weight, of their product and the weight.
fn tap(sums: &[f64]) -> ([f64; 3], f64) {
    ([0, 1, 2].map(|channel| sums[channel] / sums[3]), sums[3])
}

/// The pixels of 2x2 side by side, as the tiles are of tokens.
fn by_tokens(pixels: &Map) -> Map {
    let mut tokens = Map::zeros(pixels.width / 2, pixels.height / 2, 4 * pixels.channels);
    for (y, x) in (0..pixels.height).flat_map(|y| (0..pixels.width).map(move |x| (y, x))) {
        let at = (y / 2 * tokens.width + x / 2) * tokens.channels + (y % 2 * 2 + x % 2) * pixels.channels;
        tokens.values[at..at + pixels.channels].copy_from_slice(pixels.token(x, y));
    }
    tokens
}

/// An image, and what it was before it was divided by the albedo; each times its weight, and that.
fn with_undivided(image: &Map, albedo: &Map) -> Map {
    let mut both = Map::zeros(image.width, image.height, 8);
    for (i, out) in both.values.chunks_exact_mut(8).enumerate() {
        let (x, y) = (i % image.width, i / image.width);
        let (own, divisor) = (image.token(x, y), demodulator(albedo.token(x, y)));
        out[..4].copy_from_slice(&own[..4]);
        (0..3).for_each(|c| out[4 + c] = own[c] * divisor[c]);
        out[7] = own[3];
    }
    both
}

impl Twin for Halve {
    /// The mean of 2x2 tokens.
    fn compute(&self, reference: &mut Reference) {
        let mut src = reference.map(&self.src);
        if let Some(albedo) = &self.albedo {
            src = with_undivided(&src, &reference.map(albedo));
        }
        let mut result = Map::zeros(src.width / 2, src.height / 2, src.channels);
        for (y, x) in (0..src.height).flat_map(|y| (0..src.width).map(move |x| (y, x))) {
            let at = (y / 2 * result.width + x / 2) * src.channels;
            for (sum, value) in result.values[at..].iter_mut().zip(src.token(x, y)) {
                *sum += 0.25 * value;
            }
        }
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&result, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Twin for ApplyKernels {
    /// Kernels of every token over images.
    fn compute(&self, reference: &mut Reference) {
        let (logits, sums) = (reference.map(&self.logits), reference.map(&self.sums));
        let mut result = Map::zeros(sums.width, sums.height, sums.channels);
        let size = (sums.width, sums.height);
        for (i, out) in result.values.chunks_exact_mut(sums.channels).enumerate() {
            let at = (i % size.0, i / size.0);
            for (image, out) in out.chunks_exact_mut(4).enumerate() {
                let read = |x: usize, y: usize| tap(&sums.token(x, y)[4 * image..][..4]);
                if let Some(mean) = mean(&logits.token(at.0, at.1)[..25], KERNEL_SIDE, at, size, read) {
                    out[..3].copy_from_slice(&mean);
                    out[3] = 1.0;
                }
            }
        }
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&result, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Twin for MixLevels {
    /// The levels to one picture.
    fn compute(&self, reference: &mut Reference) {
        let pixels = reference.map(&self.pixels);
        let levels: Vec<Map> = self.levels.iter().map(|level| reference.map(level)).collect();
        let direct = self.direct.map(|(color, residual)| [reference.map(&color), reference.map(&residual)]);
        let mut result = Map::zeros(pixels.width, pixels.height, self.dst.channels as usize);
        let (width, channels) = (result.width, result.channels);
        for (i, out) in result.values.chunks_exact_mut(channels).enumerate() {
            let (x, y) = (i % width, i / width);
            let own = pixels.token(x, y);
            let (images, extra) = own.split_at(channels);
            for (image, out) in out.chunks_exact_mut(4).enumerate() {
                let mut mixed = images[4 * image..][..4].to_vec();
                for (level, share) in levels.iter().zip(&extra[4..]) {
                    let enlarged = enlarged(level, width / level.width, (x, y));
                    let mut of_level = [0, 1, 2, 3].map(|channel| enlarged[4 * image + channel]);
                    if self.gloss {
                        let images = [0, 4].map(|first| [0, 1, 2].map(|c| enlarged[first + c]));
                        of_level[..3].copy_from_slice(&with_gloss(images[0], images[1], &extra[..3], extra[3]));
                    }
                    mixed.iter_mut().zip(of_level).for_each(|(mixed, value)| *mixed += share * value);
                }
                for channel in 0..3 {
                    let albedo = if self.gloss { 1.0 } else { extra[channel] };
                    out[channel] = mixed[channel] / mixed[3] * albedo;
                    if let (Some([color, residual]), 0) = (&direct, image) {
                        let direct = color.token(x, y)[channel] + residual.token(x, y)[channel];
                        let averaged = out[channel].max(0.0).ln_1p();
                        out[channel] = (direct + extra[3] * (averaged - direct)).exp_m1();
                    }
                }
            }
        }
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&result, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

/// A level's channels at a pixel, bilinearly between the middles of its tokens of `side` pixels.
pub fn enlarged(level: &Map, side: usize, (x, y): (usize, usize)) -> Vec<f64> {
    let axis = |at: usize, size: usize| {
        let middle = ((at as f64 + 0.5) / side as f64 - 0.5).clamp(0.0, (size - 1) as f64);
        let first = middle.floor() as usize;
        (first, (first + 1).min(size - 1), middle.fract())
    };
    let ((left, right, across), (top, bottom, down)) = (axis(x, level.width), axis(y, level.height));
    let corners = [
        (left, top, (1.0 - across) * (1.0 - down)),
        (right, top, across * (1.0 - down)),
        (left, bottom, (1.0 - across) * down),
        (right, bottom, across * down),
    ];
    let mut out = vec![0.0; level.channels];
    for (x, y, share) in corners {
        out.iter_mut().zip(level.token(x, y)).for_each(|(out, value)| *out += share * value);
    }
    out
}

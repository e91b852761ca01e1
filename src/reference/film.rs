//! Twins of the kernels that make the FiLM vectors ([`crate::kernels::film`]).

use super::converged::is_sampled;
use super::maps::normalise;
use super::parameters::Parameters;
use super::{Reference, Twin};
use crate::kernels::converged::MAP_TILE;
use crate::kernels::film::{FilmVector, TokenSum};

impl Twin for TokenSum {
    /// Sums of consecutive real tokens, each normed, row by row, of those that there are.
    fn compute(&self, reference: &mut Reference) {
        let mut src = reference.map(&self.src);
        src.values.chunks_exact_mut(src.channels).for_each(normalise);
        let (width, height) = (self.real_width as usize, self.real_height as usize);
        let real: Vec<_> = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).collect();
        let kind = |x: usize, y: usize| match &self.computed {
            None => Some(DENOISED),
            Some(computed) => {
                let square = |token: usize| token * computed.token_pixels as usize / MAP_TILE as usize;
                let marked = reference.buffer(computed.map)[square(y) * computed.columns as usize + square(x)] != 0.0;
                if marked {
                    Some(DENOISED)
                } else {
                    is_sampled(&computed.sample, square(x), square(y)).then_some(SAMPLED)
                }
            }
        };
        let (mut sums, mut counts) = ([Vec::new(), Vec::new()], Vec::new());
        for run in real.chunks(self.tokens_per_sum() as usize) {
            let mut sum = [vec![0.0; src.channels], vec![0.0; src.channels]];
            let mut count = [0.0, 0.0];
            for &(x, y) in run {
                let Some(kind) = kind(x, y) else { continue };
                count[kind] += 1.0;
                for (sum, value) in sum[kind].iter_mut().zip(src.token(x, y)) {
                    *sum += value;
                }
            }
            sums.iter_mut().zip(sum).for_each(|(sums, sum)| sums.extend(sum));
            counts.extend(count);
        }
        match &self.computed {
            None => reference.set_buffer(self.dst, &sums[DENOISED]),
            Some(computed) => {
                reference.set_buffer(self.dst, &sums.concat());
                reference.set_buffer(computed.counts, &counts);
            }
        }
    }
}

/// Kinds of squares whose tokens there are.
const DENOISED: usize = 0;
const SAMPLED: usize = 1;

impl Twin for FilmVector {
    /// `W mean + bias`, the mean of all tokens or estimated from those that there are.
    fn compute(&self, reference: &mut Reference) {
        let channels = self.channels as usize;
        let counts = self.counts.map(|counts| {
            let sum = |kind: usize| reference.buffer(counts)[kind..].iter().step_by(2).sum::<f64>();
            [sum(DENOISED), sum(SAMPLED)]
        });
        let tokens = self.tokens as f64;
        let shares = match counts {
            None => [1.0 / tokens, 0.0],
            Some([denoised, 0.0]) => [1.0 / denoised, 0.0],
            Some([denoised, sampled]) => [1.0 / tokens, (tokens - denoised) / sampled / tokens],
        };
        let mut mean = vec![0.0; channels];
        let partials = reference.buffer(self.partials).chunks_exact(channels);
        let kinds = if counts.is_some() { 2 } else { 1 };
        for (i, partial) in partials.take(kinds * self.sums as usize).enumerate() {
            for (mean, value) in mean.iter_mut().zip(partial) {
                *mean += value * shares[i / self.sums as usize];
            }
        }
        let rows = match reference.parameters(self.weights) {
            Parameters::FilmVector(rows) => rows,
            other => unreachable!("film_vector is given {other:?}"),
        };
        let dot = |row: &[f64]| row.iter().zip(&mean).map(|(a, b)| a * b).sum::<f64>();
        let vector: Vec<f64> = rows.iter().map(|(bias, row)| bias + dot(row)).collect();
        reference.set_buffer(self.dst, &vector);
    }
}

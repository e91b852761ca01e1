//! Twins of the dense kernels ([`crate::kernels::dense`]).

use super::map::Map;
use super::maps::normalise;
use super::matrix::Matrix;
use super::parameters::Parameters;
use super::{Reference, Twin};
use crate::kernels::dense::{Conv3x3, Linear};
use crate::kernels::winograd::Winograd3x3;
use crate::kernels::{Activation, BufferId, Shuffle};

impl Twin for Conv3x3 {
    /// `shuffle(act(film(conv3x3(src) + bias) + residual))`, the residual a map like the result.
    fn compute(&self, reference: &mut Reference) {
        let src = reference.map(&self.src);
        reference.convolution(&src, self);
    }
}

impl Twin for Winograd3x3 {
    /// What it computes, not how.
    fn compute(&self, reference: &mut Reference) {
        self.conv.compute(reference);
    }
}

impl Twin for Linear {
    /// `act(film(W norm([src | src_b]) + bias) + residual)`.
    fn compute(&self, reference: &mut Reference) {
        let mut src = reference.map(&self.src);
        if let Some(src_b) = &self.src_b {
            src = src.beside(&reference.map(src_b));
        }
        if self.norm {
            src.values.chunks_exact_mut(src.channels).for_each(normalise);
        }
        reference.pointwise(&src, self);
    }
}

impl Reference<'_> {
    /// A convolution of a map instead of its own source.
    pub(super) fn convolution(&mut self, src: &Map, call: &Conv3x3) {
        let mut result = self.matrix(call.weights).apply(src, call.stride as usize, call.channels as usize);
        let residual = call.residual.as_ref().map(|residual| match call.shuffle {
            Shuffle::Shuffle => self.map(residual).unshuffled(),
            Shuffle::None | Shuffle::Unshuffle => self.map(residual),
        });
        self.finish(&mut result, call.film, residual, call.activation);
        let (width, height) = call.result_size();
        let tiles = self.tiles(&call.tiles, width, height);
        self.store(&result, &call.dst, &tiles, |x, y, channel| match call.shuffle {
            Shuffle::None => (x, y, channel),
            Shuffle::Shuffle => (2 * x + channel % 2, 2 * y + channel % 4 / 2, channel / 4),
            Shuffle::Unshuffle => (x / 2, y / 2, 4 * channel + 2 * (y % 2) + x % 2),
        });
    }

    /// A Linear on a map instead of its own sources.
    pub(super) fn pointwise(&mut self, src: &Map, call: &Linear) {
        let mut result = self.matrix(call.weights).apply(src, 1, call.dst.channels as usize);
        let residual = call.residual.as_ref().map(|residual| self.map(residual));
        self.finish(&mut result, call.film, residual, call.activation);
        let tiles = self.tiles(&call.tiles, call.dst.width, call.dst.height);
        self.store(&result, &call.dst, &tiles, |x, y, channel| (x, y, channel));
    }

    pub(super) fn matrix(&self, weights: BufferId) -> &Matrix {
        match self.parameters(weights) {
            Parameters::Dense(matrix) => matrix,
            other => unreachable!("a dense kernel is given {other:?}"),
        }
    }

    /// What follows the sum: FiLM, the residual, the activation.
    fn finish(&self, sums: &mut Map, film: Option<BufferId>, residual: Option<Map>, activation: Activation) {
        let channels = sums.channels;
        if let Some(film) = film {
            let (gamma, beta) = self.buffer(film).split_at(channels);
            for token in sums.values.chunks_exact_mut(channels) {
                for ((value, gamma), beta) in token.iter_mut().zip(gamma).zip(beta) {
                    *value = gamma * *value + beta;
                }
            }
        }
        if let Some(residual) = residual {
            for (value, residual) in sums.values.iter_mut().zip(residual.values) {
                *value += residual;
            }
        }
        for value in &mut sums.values {
            *value = activate(activation, *value);
        }
    }
}

/// `max` with NaN passed on, so that what was never written stays visible.
pub fn activate(activation: Activation, value: f64) -> f64 {
    match activation {
        Activation::Relu if value < 0.0 => 0.0,
        Activation::LeakyRelu if value < 0.0 => 0.01 * value,
        _ => value,
    }
}

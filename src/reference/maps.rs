//! Twins of the kernels that go over a map once ([`crate::kernels::maps`]).

use super::dense::activate;
use super::map::Map;
use super::parallel::for_each_row;
use super::parameters::Parameters;
use super::{Reference, Twin};
use crate::kernels::maps::{Depthwise3x3, LayerNorm};
use crate::kernels::{Activation, BufferId, View};

/// Added to the variance under the root.
const EPSILON: f64 = 1e-5;

impl Twin for Depthwise3x3 {
    /// `act(depthwise3x3(src) + bias)`.
    fn compute(&self, reference: &mut Reference) {
        let result = reference.depthwise(self);
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&result, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Reference<'_> {
    /// A depthwise convolution's result, not stored.
    pub(super) fn depthwise(&self, call: &Depthwise3x3) -> Map {
        self.depthwise_of(&self.map(&call.src), call.weights, call.activation)
    }

    /// The same of a map.
    pub(super) fn depthwise_of(&self, src: &Map, weights: BufferId, activation: Activation) -> Map {
        let src = src.bordered();
        let weights = match self.parameters(weights) {
            Parameters::Depthwise(weights) => weights,
            other => unreachable!("depthwise3x3 is given {other:?}"),
        };
        let mut result = Map::zeros(src.width - 2, src.height - 2, src.channels);
        let (width, channels) = (result.width, result.channels);
        for_each_row(&mut result.values, width * channels, |y, row| {
            for x in 0..width {
                let window: [&[f64]; 9] = std::array::from_fn(|tap| src.token(x + tap % 3, y + tap / 3));
                for (channel, (bias, taps)) in weights.iter().enumerate() {
                    let products = window.iter().zip(taps).map(|(token, tap)| token[channel] * tap);
                    row[x * channels + channel] = activate(activation, bias + products.sum::<f64>());
                }
            }
        });
        result
    }
}

impl Reference<'_> {
    /// A map after a layer normalisation, not stored.
    pub(super) fn normed(&self, src: &View, weights: BufferId) -> Map {
        let mut map = self.map(src);
        let weights = match self.parameters(weights) {
            Parameters::Norm(weights) => weights,
            other => unreachable!("layer_norm is given {other:?}"),
        };
        for token in map.values.chunks_exact_mut(map.channels) {
            normalise(token);
            for (value, (gain, bias)) in token.iter_mut().zip(weights) {
                *value = *value * gain + bias;
            }
        }
        map
    }
}

impl Twin for LayerNorm {
    /// Every token to mean 0 and variance 1 over its channels, then gain and bias.
    fn compute(&self, reference: &mut Reference) {
        let map = reference.normed(&self.src, self.weights);
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&map, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

/// A token to mean 0 and variance 1 over its channels.
pub(super) fn normalise(token: &mut [f64]) {
    let count = token.len() as f64;
    let mean = token.iter().sum::<f64>() / count;
    let variance = token.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    let scale = 1.0 / (variance + EPSILON).sqrt();
    for value in token {
        *value = (*value - mean) * scale;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_normalised_token() {
        let mut token = [1.0, 3.0, 5.0, 7.0];
        normalise(&mut token);
        // Mean 4, variance 5.
        let unit = 1.0 / 5.00001f64.sqrt();
        let expected = [-3.0 * unit, -unit, unit, 3.0 * unit];
        assert!(token.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{token:?}");
    }
}

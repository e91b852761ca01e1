//! The weights of a dense kernel and the product with them.

use super::map::Map;
use super::parallel::for_each_row;

/// Outputs of one block of weights, computed together.
const OUTPUTS: usize = 8;
/// Tokens computed together.
const TOKENS: usize = 4;

/// A matrix for each of 1 or 9 taps, and a bias.
#[derive(Debug)]
pub struct Matrix {
    taps: usize,
    inputs: usize,
    outputs: usize,
    bias: Vec<[f64; OUTPUTS]>,
    /// `[outputs / OUTPUTS][tap][input]`, padded with zeros.
    blocks: Vec<[f64; OUTPUTS]>,
}

impl Matrix {
    /// A matrix of zeros.
    pub fn zeros(taps: usize, inputs: usize, outputs: usize) -> Self {
        let blocks = outputs.div_ceil(OUTPUTS);
        let (bias, blocks) = (vec![[0.0; OUTPUTS]; blocks], vec![[0.0; OUTPUTS]; blocks * taps * inputs]);
        Self { taps, inputs, outputs, bias, blocks }
    }

    /// Sets the weights of one output, `[input][tap]`.
    pub fn set_weights(&mut self, output: usize, weights: &[f32]) {
        for (i, &weight) in weights.iter().enumerate() {
            let (input, tap) = (i / self.taps, i % self.taps);
            let block = (output / OUTPUTS * self.taps + tap) * self.inputs + input;
            self.blocks[block][output % OUTPUTS] = f64::from(weight);
        }
    }

    /// Sets the bias of one output.
    pub fn set_bias(&mut self, output: usize, bias: f32) {
        self.bias[output / OUTPUTS][output % OUTPUTS] = f64::from(bias);
    }

    /// Multiplies what is read of every input by its gain, after which its shift is added.
    pub fn fold_norm(&mut self, gain: &[f32], shift: &[f32]) {
        for (i, block) in self.blocks.iter_mut().enumerate() {
            let (output, input) = (i / (self.taps * self.inputs), i % self.inputs);
            for (weight, bias) in block.iter_mut().zip(&mut self.bias[output]) {
                *bias += *weight * f64::from(shift[input]);
                *weight *= f64::from(gain[input]);
            }
        }
    }

    /// The 3x3 (9 taps) or pointwise convolution with bias, zero-padded, at every `step`-th token, to `channels`
    /// channels; those beyond the matrix's own outputs are 0. Of the map's channels the matrix's first inputs count.
    pub fn apply(&self, src: &Map, step: usize, channels: usize) -> Map {
        let bordered;
        let (source, side) = if self.taps == 9 {
            bordered = src.bordered();
            (&bordered, 3)
        } else {
            (src, 1)
        };
        let mut out = Map::zeros(src.width / step, src.height / step, channels);
        let width = out.width;
        for_each_row(&mut out.values, width * channels, |y, row| {
            for x in (0..width).step_by(TOKENS) {
                let tokens: [usize; TOKENS] = std::array::from_fn(|i| (x + i).min(width - 1));
                let corners = tokens.map(|x| (y * step * source.width + x * step) * source.channels);
                for block in 0..self.bias.len() {
                    let sums = self.block(source, side, corners, block);
                    let outputs = block * OUTPUTS..self.outputs.min(channels).min((block + 1) * OUTPUTS);
                    for (token, sums) in tokens.into_iter().zip(sums) {
                        let to = &mut row[token * channels..][outputs.clone()];
                        to.copy_from_slice(&sums[..to.len()]);
                    }
                }
            }
        });
        out
    }

    /// One block of outputs for the tokens whose windows of `side` x `side` start at `corners`.
    fn block(&self, source: &Map, side: usize, corners: [usize; TOKENS], block: usize) -> [[f64; OUTPUTS]; TOKENS] {
        let mut sums = [self.bias[block]; TOKENS];
        for tap in 0..self.taps {
            let offset = (tap / side * source.width + tap % side) * source.channels;
            let inputs = corners.map(|corner| &source.values[corner + offset..][..self.inputs]);
            let weights = &self.blocks[(block * self.taps + tap) * self.inputs..][..self.inputs];
            for (k, weights) in weights.iter().enumerate() {
                for (sums, inputs) in sums.iter_mut().zip(inputs) {
                    for (sum, weight) in sums.iter_mut().zip(weights) {
                        *sum += inputs[k] * weight;
                    }
                }
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the definition, for sizes that fill no block.
    #[test]
    fn blocks_add_up_to_the_convolution() {
        for (taps, step, inputs, outputs, channels) in [(9, 1, 3, 5, 8), (9, 2, 4, 8, 8), (1, 1, 6, 11, 12)] {
            let weight = |n: usize, i: usize| ((n * 31 + i * 7) % 13) as f32 - 6.0;
            let mut matrix = Matrix::zeros(taps, inputs, outputs);
            for n in 0..outputs {
                matrix.set_weights(n, &(0..inputs * taps).map(|i| weight(n, i)).collect::<Vec<_>>());
                matrix.set_bias(n, n as f32);
            }
            let src = Map::new(6, 10, 6, (0..6 * 10 * 6).map(|i| f64::from(i * i % 17) - 8.0).collect());
            let out = matrix.apply(&src, step, channels);
            assert_eq!((out.width, out.height, out.channels), (6 / step, 10 / step, channels));
            let side = if taps == 9 { 3 } else { 1 };
            for (x, y) in (0..out.height).flat_map(|y| (0..out.width).map(move |x| (x, y))) {
                for n in 0..channels {
                    let mut sum = if n < outputs { n as f64 } else { 0.0 };
                    for i in (0..inputs * taps).filter(|_| n < outputs) {
                        let (input, tap) = (i / taps, i % taps);
                        let at = |out: usize, tap: usize| (out * step + tap).wrapping_sub(side / 2);
                        let (sx, sy) = (at(x, tap % side), at(y, tap / side));
                        if sx < 6 && sy < 10 {
                            sum += f64::from(weight(n, i)) * src.token(sx, sy)[input];
                        }
                    }
                    assert_eq!(out.token(x, y)[n], sum, "{taps} taps, token {x} {y}, output {n}");
                }
            }
        }
    }
}

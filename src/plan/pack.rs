//! How weights lie in device memory: in the order in which a kernel reads them, padded with zeros to what it computes
//! at once, as 32-bit floats or, for matrices, halves.

use super::halves::in_blocks;
use super::{predicted, unembed, winograd};
use crate::kernels::attention_block::BIAS_ROWS;
use crate::kernels::dense::{TILE_CHANNELS, conv_tile_channels};
use crate::kernels::on_matrices::DEPTH;
use crate::kernels::predicted::{MATRIX_WEIGHTS, WEIGHTS};
use crate::kernels::winograd::{WINOGRAD_CHANNELS, WinogradTile};
use crate::net::op::{ConvWeight, LinearWeight};
use crate::net::weights::{Weights, WeightsError};

/// Values of a head's bias table, padded.
pub const BIAS_TABLE_STRIDE: usize = 228;
const BIAS_TABLE: usize = 225;
/// Tokens of a window.
const WINDOW: usize = 64;

/// What one packed buffer holds, by the names of the tensors.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Pack {
    /// `[bias | [output tile][tap][input / 4][4 inputs][tile outputs]]` of a dense 3x3 convolution. With `shuffle` the
    /// outputs are ordered `[phase][channel]` instead of `4 channel + phase`.
    Conv3x3 {
        /// The weight.
        weight: ConvWeight,
        /// Whether there is a bias tensor.
        bias: bool,
        /// The network's input channels.
        inputs: u32,
        /// The network's output channels.
        outputs: u32,
        /// Whether a pixel shuffle follows.
        shuffle: bool,
    },
    /// `[bias | [output / 4][input / 4][point][4 inputs][4 outputs]]` of a dense 3x3 convolution by Winograd's
    /// filtering, outputs ordered as in [`Pack::Conv3x3`] and padded to a multiple of [`WINOGRAD_CHANNELS`].
    Winograd3x3 {
        /// The weight.
        weight: ConvWeight,
        /// Whether there is a bias tensor.
        bias: bool,
        /// The network's input channels.
        inputs: u32,
        /// The network's output channels.
        outputs: u32,
        /// Whether a pixel shuffle follows.
        shuffle: bool,
        /// Which transform.
        tile: WinogradTile,
    },
    /// `[bias | [dy][border in y][border in x][row of 4][input / 4][4 inputs][dx][column of 4]]` of an
    /// [`crate::net::OpKind::Unembed`], vectors of three outputs and a zero. A pixel `(dy, dx)` of a token takes the
    /// tokens from `(dy - 2, dx - 2)` on. On the frame's border the second convolution reads zeros for what lies
    /// beyond: in y it is the upper one of the first row of pixels and the lower one of the last; in x 1 stands for the
    /// left one, 2 for the right one.
    Unembed {
        /// Tensor prefix of the first convolution.
        spread: String,
        /// Tensor prefix of the second.
        gather: String,
        /// Input channels.
        inputs: u32,
    },
    /// The same for the kernel on matrices: `[bias | halves: [set of 9][tap of 5x5][input][pixel of 4][output of 4]]`.
    UnembedMatrix {
        /// Tensor prefix of the first convolution.
        spread: String,
        /// Tensor prefix of the second.
        gather: String,
        /// Input channels.
        inputs: u32,
    },
    /// The same as [`Pack::Conv3x3`] with one tap. A norm's gain and bias are multiplied in.
    Linear(LinearWeight),
    /// `[bias | 9 taps]`, each of all channels.
    Depthwise {
        /// Tensor prefix.
        weight: String,
        /// Channels.
        channels: u32,
    },
    /// `[gain | bias]`.
    Norm {
        /// Tensor prefix.
        norm: String,
        /// Channels.
        channels: u32,
    },
    /// One table of [`BIAS_TABLE_STRIDE`] values a head.
    BiasTable {
        /// The tensor, `[225, heads]`.
        table: String,
        /// Heads.
        heads: u32,
    },
    /// The same for kernels on matrices: of every head `[query][key]`, each of a window's 64 tokens.
    BiasMatrix {
        /// The tensor, `[225, heads]`.
        table: String,
        /// Heads.
        heads: u32,
    },
    /// A [`Pack::Conv3x3`] or a [`Pack::Linear`] for kernels on matrices: the biases 32-bit floats, the rest halves. Of
    /// a tile's rows (taps and inputs, filled up with zeros to a multiple of [`DEPTH`]) `[DEPTH rows][output][row]`, so
    /// that those of an output lie side by side.
    Halves(Box<Pack>),
    /// The biases of a [`Pack::Linear`] or [`Pack::Conv3x3`], [`BIAS_ROWS`] times: `[row][bias]`, as sums of matrices
    /// take them.
    BiasRows(Box<Pack>),
    /// `[biases of what is predicted from, by pixel of a token | the reliability's row | biases of the outputs | matrix
    /// by pixel of a token | matrix of the outputs]` of an [`crate::net::OpKind::PredictKernels`], matrices as `[output
    /// / 4][input][4 outputs]`.
    Kernels {
        /// Tensor prefix.
        head: String,
        /// Sizes of kernels.
        levels: u32,
    },
    /// The same for kernels on matrices: `[biases and the reliability's row as above | halves: matrix by pixel of a
    /// token | matrix of the outputs]`, of each `[16 rows][output][row]`, the first one's rows of colour and residual
    /// twice.
    KernelsMatrix {
        /// Tensor prefix.
        head: String,
        /// Sizes of kernels.
        levels: u32,
    },
    /// `[bias | matrix row by row]`, a norm's gain and bias multiplied in.
    FilmVector {
        /// Tensor prefix.
        weight: String,
        /// Tensor prefix of the norm of the tokens that the mean is of.
        norm: String,
        /// Channels of the mean.
        inputs: u32,
        /// Length of the result.
        outputs: u32,
    },
}

impl Pack {
    /// 32-bit words that the packed form takes.
    pub fn len(&self) -> usize {
        let dense = |inputs: u32, outputs: u32, taps: u32, tile: u32| {
            let outputs = outputs.next_multiple_of(tile) as usize;
            outputs + outputs * (taps * inputs.next_multiple_of(4)) as usize
        };
        match self {
            Self::Conv3x3 { inputs, outputs, .. } => dense(*inputs, *outputs, 9, conv_tile_channels(*outputs)),
            Self::Winograd3x3 { inputs, outputs, tile, .. } => {
                dense(*inputs, *outputs, tile.inputs().pow(2), WINOGRAD_CHANNELS)
            }
            Self::Unembed { inputs, .. } => unembed::len(*inputs),
            Self::UnembedMatrix { inputs, .. } => unembed::matrix_len(*inputs),
            Self::Linear(w) => dense(w.columns.len() as u32, linear_outputs(w), 1, TILE_CHANNELS),
            Self::Depthwise { channels, .. } => 10 * *channels as usize,
            Self::Norm { channels, .. } => 2 * *channels as usize,
            Self::BiasTable { heads, .. } => BIAS_TABLE_STRIDE * *heads as usize,
            Self::BiasMatrix { heads, .. } => WINDOW * WINDOW * *heads as usize,
            Self::Halves(pack) => {
                let rows = pack.rows();
                rows.biases + rows.biases * rows.count.next_multiple_of(DEPTH as usize) / 2
            }
            Self::BiasRows(pack) => BIAS_ROWS as usize * pack.rows().biases,
            Self::Kernels { .. } => WEIGHTS,
            Self::KernelsMatrix { .. } => MATRIX_WEIGHTS,
            Self::FilmVector { inputs, outputs, .. } => (*outputs * (*inputs + 1)) as usize,
        }
    }

    /// Bytes that it takes.
    pub fn bytes(&self) -> u64 {
        self.len() as u64 * 4
    }

    /// Whether nothing is packed.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The biases and rows of a dense matrix; of other packs none.
    fn rows(&self) -> Rows {
        let (rows, outputs, tile) = match self {
            Self::Conv3x3 { inputs, outputs, .. } => {
                (9 * inputs.next_multiple_of(4), *outputs, conv_tile_channels(*outputs))
            }
            Self::Linear(w) => ((w.columns.len() as u32).next_multiple_of(4), linear_outputs(w), TILE_CHANNELS),
            _ => (0, 0, TILE_CHANNELS),
        };
        Rows { biases: outputs.next_multiple_of(tile) as usize, count: rows as usize, width: tile as usize }
    }

    /// The packed form as 32-bit words; those of halves hold two each.
    ///
    /// # Errors
    /// A tensor that the weights lack.
    pub fn words(&self, weights: &Weights) -> Result<Vec<u32>, WeightsError> {
        if let Self::UnembedMatrix { spread, gather, inputs } = self {
            let (spread, gather, inputs) = (spread.clone(), gather.clone(), *inputs);
            let floats = Self::Unembed { spread, gather, inputs }.floats(weights)?;
            return Ok(unembed::matrix_words(&floats, inputs as usize));
        }
        if let Self::KernelsMatrix { head, levels } = self {
            let floats = Self::Kernels { head: head.clone(), levels: *levels }.floats(weights)?;
            return Ok(predicted::matrix_words(&floats));
        }
        let pack = match self {
            Self::Halves(pack) => pack,
            other => other,
        };
        let floats = pack.floats(weights)?;
        let bits = |floats: &[f32]| floats.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        if !matches!(self, Self::Halves(_)) {
            return Ok(bits(&floats));
        }
        let rows = pack.rows();
        let (biases, matrix) = floats.split_at(rows.biases);
        let mut words = bits(biases);
        for tile in matrix.chunks_exact((rows.count * rows.width).max(1)) {
            words.extend(in_blocks(rows.count, rows.width, |row, output| tile[row * rows.width + output]));
        }
        Ok(words)
    }

    /// The packed form of 32-bit floats alone.
    fn floats(&self, weights: &Weights) -> Result<Vec<f32>, WeightsError> {
        let mut floats = vec![0.0; self.len()];
        self.write(weights, &mut floats)?;
        Ok(floats)
    }

    /// Writes the packed form to `out`, which is zeroed and [`Pack::len`] long.
    fn write(&self, weights: &Weights, out: &mut [f32]) -> Result<(), WeightsError> {
        let tensor = |prefix: &str, name: &str| -> Result<&Vec<f32>, WeightsError> {
            Ok(&weights.tensor(&format!("{prefix}.{name}"))?.data)
        };
        match self {
            Self::Conv3x3 { weight, bias, inputs, outputs, shuffle } => {
                let (source, biases) = (weight.values(weights)?, weight.biases(*bias, weights)?);
                let tile = conv_tile_channels(*outputs) as usize;
                let (inputs, outputs) = (*inputs as usize, *outputs as usize);
                // Position among the outputs -> the tensor's row.
                let row = |n: usize| if *shuffle { n % (outputs / 4) * 4 + n / (outputs / 4) } else { n };
                let dense = Dense { inputs, outputs, taps: 9, tile };
                dense.write(
                    out,
                    |n| biases.map_or(0.0, |b| b[row(n)]),
                    |n, k, tap| source[(row(n) * inputs + k) * 9 + tap],
                );
            }
            Self::Winograd3x3 { weight, bias, inputs, outputs, shuffle, tile } => {
                let (source, biases) = (weight.values(weights)?, weight.biases(*bias, weights)?);
                let (inputs, outputs) = (*inputs as usize, *outputs as usize);
                let row = |n: usize| if *shuffle { n % (outputs / 4) * 4 + n / (outputs / 4) } else { n };
                let points = tile.inputs().pow(2) as usize;
                let (bias, matrix) = out.split_at_mut(outputs.next_multiple_of(WINOGRAD_CHANNELS as usize));
                for n in 0..outputs {
                    bias[n] = biases.map_or(0.0, |b| b[row(n)]);
                    for k in 0..inputs {
                        let taps = std::array::from_fn(|tap| f64::from(source[(row(n) * inputs + k) * 9 + tap]));
                        let block = (n / 4 * inputs.div_ceil(4) + k / 4) * points;
                        for (point, value) in winograd::transform(*tile, taps).into_iter().enumerate() {
                            matrix[((block + point) * 4 + k % 4) * 4 + n % 4] = value as f32;
                        }
                    }
                }
            }
            Self::Unembed { spread, gather, inputs } => {
                let weight = (&tensor(spread, "weight")?[..], &tensor(gather, "weight")?[..]);
                unembed::write(weight, tensor(gather, "bias")?, *inputs as usize, out);
            }
            Self::Linear(w) => {
                let mut rows = Vec::new();
                for part in &w.parts {
                    let source = tensor(&part.prefix, "weight")?;
                    let biases = if w.bias { Some(tensor(&part.prefix, "bias")?) } else { None };
                    rows.extend((0..part.outputs as usize).map(|row| (source, biases, row)));
                }
                let (columns, first) = (w.inputs as usize, w.columns.start as usize);
                let dense =
                    Dense { inputs: w.columns.len(), outputs: rows.len(), taps: 1, tile: TILE_CHANNELS as usize };
                let weight = |n: usize, k: usize| rows[n].0[rows[n].2 * columns + first + k];
                let bias = |n: usize| rows[n].1.map_or(0.0, |bias| bias[rows[n].2]);
                let Some(norm) = &w.norm else {
                    dense.write(out, bias, |n, k, _| weight(n, k));
                    return Ok(());
                };
                // Products and sums in f64, rounded once.
                let (gain, shift) = (tensor(norm, "weight")?, tensor(norm, "bias")?);
                let product = |n: usize, k: usize, by: &[f32]| f64::from(weight(n, k)) * f64::from(by[k]);
                dense.write(
                    out,
                    |n| {
                        let sum: f64 = (0..w.columns.len()).map(|k| product(n, k, shift)).sum();
                        (f64::from(bias(n)) + sum) as f32
                    },
                    |n, k, _| product(n, k, gain) as f32,
                );
            }
            Self::Depthwise { weight, channels } => {
                let channels = *channels as usize;
                let source = tensor(weight, "weight")?;
                out[..channels].copy_from_slice(tensor(weight, "bias")?);
                for (i, value) in out[channels..].iter_mut().enumerate() {
                    *value = source[i % channels * 9 + i / channels];
                }
            }
            Self::Norm { norm, channels } => {
                let (gain, bias) = out.split_at_mut(*channels as usize);
                gain.copy_from_slice(tensor(norm, "weight")?);
                bias.copy_from_slice(tensor(norm, "bias")?);
            }
            Self::BiasTable { table, heads } => {
                let source = &weights.tensor(table)?.data;
                for (head, out) in out.chunks_exact_mut(BIAS_TABLE_STRIDE).enumerate() {
                    for (i, value) in out.iter_mut().take(BIAS_TABLE).enumerate() {
                        *value = source[i * *heads as usize + head];
                    }
                }
            }
            Self::Kernels { head, levels } => predicted::write(head, *levels, weights, out)?,
            Self::BiasMatrix { table, heads } => {
                let source = &weights.tensor(table)?.data;
                for (at, value) in out.iter_mut().enumerate() {
                    let (head, query, key) = (at / (WINDOW * WINDOW), at / WINDOW % WINDOW, at % WINDOW);
                    let [dy, dx] = [query / 8 + 7 - key / 8, query % 8 + 7 - key % 8];
                    *value = source[(dy * 15 + dx) * *heads as usize + head];
                }
            }
            Self::BiasRows(pack) => {
                let dense = pack.floats(weights)?;
                let biases = &dense[..pack.rows().biases];
                out.chunks_exact_mut(biases.len().max(1)).for_each(|row| row.copy_from_slice(biases));
            }
            // Their words are made of those of another pack.
            Self::Halves(_) | Self::UnembedMatrix { .. } | Self::KernelsMatrix { .. } => {}
            Self::FilmVector { weight, norm, inputs, outputs } => {
                let (bias, matrix) = out.split_at_mut(*outputs as usize);
                bias.copy_from_slice(tensor(weight, "bias")?);
                matrix.copy_from_slice(tensor(weight, "weight")?);
                let (gain, shift) = (tensor(norm, "weight")?, tensor(norm, "bias")?);
                // Products and sums in f64, rounded once.
                for (bias, row) in bias.iter_mut().zip(matrix.chunks_exact_mut(*inputs as usize)) {
                    let product = |(weight, by): (&f32, &f32)| f64::from(*weight) * f64::from(*by);
                    let sum: f64 = row.iter().zip(shift).map(product).sum();
                    *bias = (f64::from(*bias) + sum) as f32;
                    row.iter_mut().zip(gain).for_each(|pair| *pair.0 = product((&*pair.0, pair.1)) as f32);
                }
            }
        }
        Ok(())
    }
}

/// A dense matrix as it is packed: tiles of `width` outputs, of each `count` rows.
struct Rows {
    biases: usize,
    count: usize,
    width: usize,
}

/// Outputs of all parts together.
pub fn linear_outputs(weight: &LinearWeight) -> u32 {
    weight.parts.iter().map(|part| part.outputs).sum()
}

/// The order of `glsl/shared/microkernel.glsl`.
struct Dense {
    inputs: usize,
    outputs: usize,
    taps: usize,
    tile: usize,
}

impl Dense {
    fn write(&self, out: &mut [f32], bias: impl Fn(usize) -> f32, weight: impl Fn(usize, usize, usize) -> f32) {
        let padded_outputs = self.outputs.next_multiple_of(self.tile);
        let padded_inputs = self.inputs.next_multiple_of(4);
        let (biases, matrix) = out.split_at_mut(padded_outputs);
        for n in 0..self.outputs {
            biases[n] = bias(n);
            for tap in 0..self.taps {
                for k in 0..self.inputs {
                    let row = (n / self.tile * self.taps + tap) * padded_inputs + k;
                    matrix[row * self.tile + n % self.tile] = weight(n, k, tap);
                }
            }
        }
    }
}

//! The weights behind a buffer, from the tensors that its [`Pack`] names.

use super::matrix::Matrix;
use super::predicted::{KernelWeights, Linear};
use crate::net::head::HIDDEN;
use crate::net::weights::{Weights, WeightsError};
use crate::plan::pack::{Pack, linear_outputs};

/// What a kernel is given instead of a packed buffer.
#[derive(Debug)]
pub enum Parameters {
    /// Of a dense kernel.
    Dense(Matrix),
    /// The first and the second convolution of a way from tokens to pixels.
    Unembed(Box<[Matrix; 2]>),
    /// Of every channel its bias and its 9 taps.
    Depthwise(Vec<(f64, [f64; 9])>),
    /// Of every channel gain and bias.
    Norm(Vec<(f64, f64)>),
    /// Of every head its 225 biases.
    BiasTable(Vec<Vec<f64>>),
    /// The Linears of predicted kernels.
    Kernels(Box<KernelWeights>),
    /// Of every result its bias and its row of the matrix.
    FilmVector(Vec<(f64, Vec<f64>)>),
}

impl Parameters {
    /// Reads the tensors of a pack.
    pub fn new(pack: &Pack, weights: &Weights) -> Result<Self, WeightsError> {
        let named = |name: &str| weights.tensor(name).map(|tensor| &tensor.data[..]);
        let tensor = |prefix: &str, name: &str| named(&format!("{prefix}.{name}"));
        Ok(match pack {
            Pack::Conv3x3 { weight, bias, inputs, outputs, .. }
            | Pack::Winograd3x3 { weight, bias, inputs, outputs, .. } => {
                Self::Dense(convolution(&weight.values(weights)?, weight.biases(*bias, weights)?, *inputs, *outputs))
            }
            Pack::Unembed { spread, gather, inputs } | Pack::UnembedMatrix { spread, gather, inputs } => {
                let spread = convolution(tensor(spread, "weight")?, None, *inputs, 4 * inputs);
                let bias = tensor(gather, "bias")?;
                Self::Unembed(Box::new([spread, convolution(tensor(gather, "weight")?, Some(bias), *inputs, 3)]))
            }
            Pack::Linear(linear) => {
                let columns = linear.columns.start as usize..linear.columns.end as usize;
                let mut matrix = Matrix::zeros(1, columns.len(), linear_outputs(linear) as usize);
                let mut first = 0;
                for part in &linear.parts {
                    let (rows, outputs) = (tensor(&part.prefix, "weight")?, part.outputs as usize);
                    for (i, row) in rows.chunks_exact(linear.inputs as usize).take(outputs).enumerate() {
                        matrix.set_weights(first + i, &row[columns.clone()]);
                    }
                    if linear.bias {
                        set_biases(&mut matrix, first, &tensor(&part.prefix, "bias")?[..outputs]);
                    }
                    first += outputs;
                }
                if let Some(norm) = &linear.norm {
                    matrix.fold_norm(tensor(norm, "weight")?, tensor(norm, "bias")?);
                }
                Self::Dense(matrix)
            }
            Pack::Depthwise { weight, channels } => {
                let taps = tensor(weight, "weight")?.chunks_exact(9);
                let taps = taps.map(|taps| std::array::from_fn(|i| f64::from(taps[i])));
                Self::Depthwise(wide(tensor(weight, "bias")?).zip(taps).take(*channels as usize).collect())
            }
            Pack::Norm { norm, channels } => {
                let pairs = wide(tensor(norm, "weight")?).zip(wide(tensor(norm, "bias")?));
                Self::Norm(pairs.take(*channels as usize).collect())
            }
            Pack::BiasTable { table, heads } => {
                let (table, heads) = (named(table)?, *heads as usize);
                Self::BiasTable(
                    (0..heads).map(|head| wide(table).skip(head).step_by(heads).take(225).collect()).collect(),
                )
            }
            Pack::BiasMatrix { table, heads } => {
                return Self::new(&Pack::BiasTable { table: table.clone(), heads: *heads }, weights);
            }
            Pack::Halves(pack) | Pack::BiasRows(pack) => return Self::new(pack, weights),
            Pack::Kernels { head, levels } | Pack::KernelsMatrix { head, levels } => {
                let linear = |name: &str, inputs: usize| -> Result<Linear, WeightsError> {
                    let rows = tensor(&format!("{head}.{name}"), "weight")?.chunks_exact(inputs);
                    let biases = wide(tensor(&format!("{head}.{name}"), "bias")?).collect();
                    Ok(Linear { rows: rows.map(|row| wide(row).collect()).collect(), biases })
                };
                let hidden = HIDDEN as usize;
                let (tok, guess, full) = (linear("tok", hidden)?, linear("guess", 6)?, linear("out_full", hidden)?);
                let more = if *levels > 3 { linear("out_more", hidden)? } else { Linear::default() };
                Self::Kernels(Box::new(KernelWeights { tok, guess, full, more }))
            }
            Pack::FilmVector { weight, norm, inputs, outputs } => {
                let (gain, shift) = (tensor(norm, "weight")?, tensor(norm, "bias")?);
                let rows = tensor(weight, "weight")?.chunks_exact(*inputs as usize);
                let vectors = wide(tensor(weight, "bias")?).zip(rows).map(|(bias, row)| {
                    let shifted = wide(row).zip(wide(shift)).map(|(weight, shift)| weight * shift).sum::<f64>();
                    (bias + shifted, wide(row).zip(wide(gain)).map(|(weight, gain)| weight * gain).collect())
                });
                Self::FilmVector(vectors.take(*outputs as usize).collect())
            }
        })
    }
}

fn convolution(weight: &[f32], bias: Option<&[f32]>, inputs: u32, outputs: u32) -> Matrix {
    let (inputs, outputs) = (inputs as usize, outputs as usize);
    let mut matrix = Matrix::zeros(9, inputs, outputs);
    for (output, row) in weight.chunks_exact(9 * inputs).take(outputs).enumerate() {
        matrix.set_weights(output, row);
    }
    if let Some(bias) = bias {
        set_biases(&mut matrix, 0, &bias[..outputs]);
    }
    matrix
}

fn set_biases(matrix: &mut Matrix, first: usize, biases: &[f32]) {
    for (i, &bias) in biases.iter().enumerate() {
        matrix.set_bias(first + i, bias);
    }
}

fn wide(values: &[f32]) -> impl Iterator<Item = f64> {
    values.iter().map(|&value| f64::from(value))
}

//! The weights of [`crate::kernels::predicted::PredictKernels`], as `glsl/predict_kernels.comp` reads them.

use super::halves::in_blocks;
use crate::kernels::predicted::{MATRIX_ROWS, MATRIX_WEIGHTS, WEIGHTS};
use crate::net::head::{FULL_OUTPUTS, HIDDEN};
use crate::net::weights::{Weights, WeightsError};

/// Inputs of the hidden numbers: a token's channels, colour and residual, three channels and a zero each.
const INPUTS: usize = HIDDEN as usize + 8;
/// Outputs with those that pad them to vectors of four.
const OUTPUTS: usize = 48;
const ROW_AT: usize = 4 * HIDDEN as usize;
const BIASES_AT: usize = ROW_AT + HIDDEN as usize;
const HIDDEN_AT: usize = BIASES_AT + OUTPUTS;
const OUTPUTS_AT: usize = HIDDEN_AT + 4 * HIDDEN as usize * INPUTS;
const _: () = assert!(OUTPUTS_AT + OUTPUTS * HIDDEN as usize == WEIGHTS);
const _: () = assert!(MATRIX_ROWS == 2 * INPUTS - HIDDEN as usize);

/// The logit of a level that there is not.
const IMPOSSIBLE: f32 = -1e30;
/// The row of the reliability's raw number in `out_full`, and where its bias goes.
const RELIABILITY: usize = 25;

/// Where row `row` of `out_full` goes among the outputs.
fn place(row: usize) -> usize {
    match row {
        0..=24 => row,
        26..=28 => 40 + row - 26,
        29 => 45,
        _ => 28 + row - 30,
    }
}

/// Writes the packed form.
///
/// # Errors
/// A tensor that the weights lack.
pub fn write(head: &str, levels: u32, weights: &Weights, out: &mut [f32]) -> Result<(), WeightsError> {
    let tensor = |name: &str| weights.tensor(&format!("{head}.{name}")).map(|tensor| &tensor.data[..]);
    let (tok, guess) = (tensor("tok.weight")?, tensor("guess.weight")?);
    let (tok_bias, guess_bias) = (tensor("tok.bias")?, tensor("guess.bias")?);
    let hidden = HIDDEN as usize;
    for (row, bias) in tok_bias.iter().enumerate() {
        let n = row % hidden;
        out[row] = bias + guess_bias[n];
        // Four outputs of an input side by side.
        let mut set = |input: usize, value: f32| out[HIDDEN_AT + ((row / 4) * INPUTS + input) * 4 + row % 4] = value;
        (0..hidden).for_each(|k| set(k, tok[row * hidden + k]));
        for c in 0..3 {
            // Of the colour and of the colour with the residual.
            let (own, direct) = (guess[n * 6 + c], guess[n * 6 + 3 + c]);
            set(hidden + c, (f64::from(own) + f64::from(direct)) as f32);
            set(hidden + 4 + c, direct);
        }
    }
    let (full, full_bias) = (tensor("out_full.weight")?, tensor("out_full.bias")?);
    out[ROW_AT..][..hidden].copy_from_slice(&full[RELIABILITY * hidden..][..hidden]);
    out[BIASES_AT + RELIABILITY] = full_bias[RELIABILITY];
    let mut set = |to: usize, row: &[f32], bias: f32| {
        out[BIASES_AT + to] = bias;
        for (k, value) in row.iter().enumerate() {
            out[OUTPUTS_AT + ((to / 4) * hidden + k) * 4 + to % 4] = *value;
        }
    };
    for row in (0..FULL_OUTPUTS as usize).filter(|row| *row != RELIABILITY) {
        set(place(row), &full[row * hidden..][..hidden], full_bias[row]);
    }
    let (more, more_bias) = match levels {
        0..=3 => (&[0.0; 2 * HIDDEN as usize][..], &[IMPOSSIBLE; 2][..]),
        _ => (tensor("out_more.weight")?, tensor("out_more.bias")?),
    };
    for (i, row) in more.chunks_exact(hidden).enumerate() {
        set(43 + i, row, more_bias[i]);
    }
    Ok(())
}

/// The form for matrices, from the packed form of 32-bit floats.
pub fn matrix_words(packed: &[f32]) -> Vec<u32> {
    let hidden = HIDDEN as usize;
    let mut words: Vec<u32> = packed[..HIDDEN_AT].iter().map(|value| value.to_bits()).collect();
    for phase in 0..4 {
        let value = |row: usize, output: usize| {
            // What halves leave of colour and residual meets the weights of these.
            let input = if row < INPUTS { row } else { row - (INPUTS - hidden) };
            let row_of_four = phase * hidden / 4 + output / 4;
            packed[HIDDEN_AT + (row_of_four * INPUTS + input) * 4 + output % 4]
        };
        words.extend(in_blocks(MATRIX_ROWS, hidden, value));
    }
    let output = |row: usize, output: usize| packed[OUTPUTS_AT + (output / 4 * hidden + row) * 4 + output % 4];
    words.extend(in_blocks(hidden, OUTPUTS, output));
    debug_assert_eq!(words.len(), MATRIX_WEIGHTS);
    words
}

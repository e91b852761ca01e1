//! The weights of [`crate::kernels::unembed`]: two convolutions with a pixel shuffle between them, as one sum.
//!
//! The second convolution reads a pixel's neighbours, each of which the first makes of 3x3 tokens; a pixel of phase `d`
//! of its token meets the tokens from `d - 2` to `d + 1` of each direction. Beyond the frame the second reads zeros,
//! not what the first would make there: weights of a border leave out that tap.

use super::halves::halves;
use crate::kernels::unembed::{BLOCK, MATRIX_OUTPUTS, MATRIX_SETS, ROWS, SETS, TAPS};

/// 32-bit floats of the packed form.
pub fn len(inputs: u32) -> usize {
    4 + 4 * 2 * (SETS * ROWS * inputs.div_ceil(4) * BLOCK) as usize
}

/// Writes the packed form. `spread`: `[4 inputs, inputs, 3, 3]`, `gather`: `[3, inputs, 3, 3]`.
pub fn write((spread, gather): (&[f32], &[f32]), bias: &[f32], inputs: usize, out: &mut [f32]) {
    let (first, matrix) = out.split_at_mut(4);
    first[..3].copy_from_slice(bias);
    let mut sums = vec![0.0f64; matrix.len()];
    let vectors = inputs.div_ceil(4);
    let [sets, rows, block] = [SETS, ROWS, BLOCK].map(|n| n as usize);
    for (dy, dx) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        // Of the second convolution's taps in one direction those that count.
        let taps = |border: bool, d: usize| (0..3).filter(move |tap| !(border && *tap == 2 * d));
        for (border_y, side) in (0..2).flat_map(|y| (0..3).map(move |side| (y, side))) {
            let set = (dy * sets + border_y * 3 + side) * rows * vectors * block;
            // A border on the other side does not concern these pixels.
            let border_x = side == 1 + dx;
            for (y, x) in taps(border_y == 1, dy).flat_map(|y| taps(border_x, dx).map(move |x| (y, x))) {
                // The neighbour, counted in pixels from the token's left neighbour, and its place in its token.
                let (row, column) = (dy + y + 1, dx + x + 1);
                let phase = 2 * (row % 2) + column % 2;
                for (tap_y, tap_x) in (0..9).map(|tap| (tap / 3, tap % 3)) {
                    // Tokens from `d - 2` on.
                    let (to_y, to_x) = (row / 2 + tap_y - dy, column / 2 + tap_x - dx);
                    for k in 0..inputs {
                        let at = set + (to_y * vectors + k / 4) * block + k % 4 * 8 + dx * 4 + to_x;
                        for n in 0..3 {
                            let products = (0..inputs).map(|c| {
                                let outer = f64::from(gather[(n * inputs + c) * 9 + y * 3 + x]);
                                outer * f64::from(spread[((4 * c + phase) * inputs + k) * 9 + tap_y * 3 + tap_x])
                            });
                            sums[4 * at + n] += products.sum::<f64>();
                        }
                    }
                }
            }
        }
    }
    for (weight, sum) in matrix.iter_mut().zip(sums) {
        *weight = sum as f32;
    }
}

/// 32-bit words of the form for matrices.
pub fn matrix_len(inputs: u32) -> usize {
    4 + (MATRIX_SETS * TAPS * TAPS * inputs * MATRIX_OUTPUTS / 2) as usize
}

/// The form for matrices, from the packed form of 32-bit floats.
pub fn matrix_words(packed: &[f32], inputs: usize) -> Vec<u32> {
    let (bias, packed) = packed.split_at(4);
    let [sets, rows, block, taps] = [SETS, ROWS, BLOCK, TAPS].map(|n| n as usize);
    let value = |set: usize, (tap_y, tap_x): (usize, usize), k: usize, n: usize| {
        let (dy, dx, channel) = (n / 8, n / 4 % 2, n % 4);
        // A border on the other side does not concern these pixels.
        let border_y = usize::from(set / 3 == 1 + dy);
        let row = tap_y.checked_sub(dy).filter(|row| *row < rows)?;
        let column = tap_x.checked_sub(dx).filter(|column| *column < 4)?;
        let vector = ((dy * sets + border_y * 3 + set % 3) * rows + row) * inputs.div_ceil(4) + k / 4;
        Some(packed[4 * (vector * block + k % 4 * 8 + dx * 4 + column) + channel])
    };
    let mut words: Vec<u32> = bias.iter().map(|value| value.to_bits()).collect();
    for (set, tap) in (0..MATRIX_SETS as usize).flat_map(|set| (0..taps * taps).map(move |tap| (set, tap))) {
        for k in 0..inputs {
            let outputs: [f32; MATRIX_OUTPUTS as usize] =
                std::array::from_fn(|n| value(set, (tap / taps, tap % taps), k, n).unwrap_or(0.0));
            words.extend(outputs.chunks_exact(2).map(halves));
        }
    }
    words
}

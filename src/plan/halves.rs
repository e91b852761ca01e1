//! Weights of kernels on matrices as halves, two in a word.

use crate::kernels::on_matrices::DEPTH;
use half::f16;

const LARGEST_HALF: f32 = 65504.0;

/// A matrix of so many rows and columns as halves, two in a word: `[DEPTH rows][column][row]`, filled up with rows of
/// zeros.
pub(super) fn in_blocks(rows: usize, columns: usize, value: impl Fn(usize, usize) -> f32) -> Vec<u32> {
    let depth = DEPTH as usize;
    let mut words = Vec::with_capacity(rows.next_multiple_of(depth) * columns / 2);
    for (block, column) in (0..rows.div_ceil(depth)).flat_map(|block| (0..columns).map(move |column| (block, column))) {
        for pair in (block * depth..(block + 1) * depth).step_by(2) {
            let of = |row: usize| if row < rows { value(row, column) } else { 0.0 };
            words.push(halves(&[of(pair), of(pair + 1)]));
        }
    }
    words
}

/// Two values as halves in a word, the first in its lower part.
pub(super) fn halves(pair: &[f32]) -> u32 {
    // Larger values would become infinite, and the sums NaN.
    let half = |value: &f32| u32::from(f16::from_f32(value.clamp(-LARGEST_HALF, LARGEST_HALF)).to_bits());
    pair.iter().rev().fold(0, |word, value| word << 16 | half(value))
}

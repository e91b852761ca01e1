//! The head of predicted kernels: every pixel a mean of pixels ([`crate::net::head`]).

mod inputs;
mod levels;
mod pixels;

pub use inputs::KernelInputs;
pub use levels::{ApplyKernels, Halve, MixLevels};
pub use pixels::PredictKernels;

/// Biases of the hidden numbers by a token's pixels, and the reliability's row: 32-bit floats on matrices too.
const HIDDEN_BIASES: usize = 4 * 32 + 32;
/// Packed weights that [`KernelInputs`] reads, in 32-bit floats: biases and the reliability's row, then 40 inputs of 32
/// hidden numbers for each of a token's pixels.
const HIDDEN_WEIGHTS: usize = HIDDEN_BIASES + 4 * 32 * 40;
/// All of them, with those that [`PredictKernels`] reads: biases, and 32 inputs of 48 outputs.
pub const WEIGHTS: usize = HIDDEN_WEIGHTS + 48 + 48 * 32;
/// Rows of the hidden numbers' matrix on matrices: 32 channels of a token, colour and residual of three channels and a
/// zero each, and once more for what halves leave of these.
pub const MATRIX_ROWS: usize = 48;
/// 32-bit words of the halves that [`KernelInputs`] reads on matrices.
const HIDDEN_HALVES: usize = 4 * 32 * MATRIX_ROWS / 2;
/// Words of all of the form for matrices.
pub const MATRIX_WEIGHTS: usize = HIDDEN_BIASES + 48 + HIDDEN_HALVES + 48 * 32 / 2;
/// How far beyond itself a kernel reads, in tokens of its image.
pub const REACH: u32 = 2;
/// How far a kernel over albedo reads.
pub const ALBEDO_REACH: u32 = 1;

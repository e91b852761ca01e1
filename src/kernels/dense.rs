//! The dense kernels: 3x3 and pointwise convolution, with bias, FiLM, residual, activation and pixel shuffles.

mod conv3x3;
mod linear;

use super::{Activation, Arithmetic, BufferId, Storage, TexelRange, View, activation_flag, flags};

pub use conv3x3::{Conv3x3, SMALL_CHANNELS};
pub use linear::Linear;

/// Output channels of one workgroup, and what the packer pads the weights to.
pub const TILE_CHANNELS: u32 = 32;
/// The same for convolutions to at most this many channels.
pub const NARROW_CHANNELS: u32 = 4;

/// Output channels that a convolution to `channels` computes per workgroup.
pub fn conv_tile_channels(channels: u32) -> u32 {
    if channels <= NARROW_CHANNELS { NARROW_CHANNELS } else { TILE_CHANNELS }
}

/// Bytes of a matrix of so many inputs and outputs, and of its biases, as they are packed.
fn weight_bytes(inputs: u64, outputs: u32, arithmetic: Arithmetic) -> u64 {
    let element = match arithmetic {
        Arithmetic::Floats => Storage::F32,
        Arithmetic::Matrices => Storage::F16,
    };
    (inputs * element.bytes() + Storage::F32.bytes()) * u64::from(outputs)
}

fn epilogue_flags(activation: Activation, film: Option<BufferId>, residual: Option<&View>) -> u32 {
    activation_flag(activation) | film.map_or(0, |_| flags::FILM) | residual.map_or(0, |_| flags::RESIDUAL)
}

/// A descriptor must be valid although its buffer is never read: the source stands in for what is missing.
pub(super) fn dense_texels(
    src: &View,
    weights: BufferId,
    film: Option<BufferId>,
    residual: Option<&View>,
) -> Vec<TexelRange> {
    vec![src.into(), weights.into(), film.unwrap_or(weights).into(), residual.unwrap_or(src).into()]
}

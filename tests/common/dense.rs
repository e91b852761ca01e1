//! Cases for the dense kernels.

use super::case::{Cases, small_net};
use vkdenoise::kernels::{Activation, BufferId};
use vkdenoise::net::Block;

/// All of them.
pub const ACTIVATIONS: [Activation; 3] = [Activation::None, Activation::Relu, Activation::LeakyRelu];

/// Cases whose packs find tensors of any size they need.
pub fn dense_cases(seed: u64) -> Cases {
    Cases::new(seed, small_net(64, Block::Jsa))
}

/// A size in tokens, both sides multiples of `unit`.
pub fn size(cases: &mut Cases, unit: u32) -> (u32, u32) {
    (unit * cases.random.integer(1, 5), unit * cases.random.integer(1, 4))
}

/// `[gamma | beta]`, in one case of three.
pub fn film(cases: &mut Cases, channels: u32) -> Option<BufferId> {
    let vector = cases.random.values(2 * channels as usize, -2.0, 2.0);
    (cases.random.integer(0, 2) == 0).then(|| cases.filled("film", vector))
}

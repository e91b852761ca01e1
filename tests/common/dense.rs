//! Cases for the dense kernels.

use super::case::{Cases, small_net};
use vkdenoise::kernels::{Activation, Arithmetic, BufferId};
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

/// What becomes of the sums of a dense kernel.
pub struct Ending {
    /// `[gamma | beta]`.
    pub film: Option<BufferId>,
    /// Whether a map is added.
    pub residual: bool,
    pub activation: Activation,
}

/// One of four, as a driver compiles a pipeline for each: every part occurs, and in one all of them, whose order
/// counts. That one alone on matrices, whose pipelines take CPU drivers long.
pub fn ending(cases: &mut Cases, channels: u32) -> Ending {
    let all = (true, true, Activation::LeakyRelu);
    let (film, residual, activation) = match cases.arithmetic {
        Arithmetic::Floats => cases.random.pick(&[
            (false, false, Activation::None),
            (true, false, Activation::None),
            (false, true, Activation::Relu),
            all,
        ]),
        Arithmetic::Matrices => all,
    };
    let vector = cases.random.values(2 * channels as usize, -2.0, 2.0);
    Ending { film: film.then(|| cases.filled("film", vector)), residual, activation }
}

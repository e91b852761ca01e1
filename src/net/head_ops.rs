//! The operations of a head of kernels ([`super::head`]).
//!
//! What every pixel predicts from is the sum of four Linears. Two of them are of maps at full size that the network
//! makes first: they are applied there, so that one map of their sum is kept and not both maps.

use super::builder::{Builder, Linear};
use super::head::{HIDDEN, KERNEL_SIDE, KernelHead};
use super::op::{Activation, OpKind, Slice, Stage};

/// The Linears of every level after the first.
const LEVEL_NAMES: [(&str, &str); 4] =
    [("mid", "out_mid"), ("low", "out_low"), ("deep", "out_deep"), ("neck", "out_neck")];

/// What a head reads.
pub(super) struct Inputs<'a> {
    /// [`early`].
    pub early: Slice,
    /// The map of 2x2 pixels a token.
    pub tokens: Slice,
    /// [`level_logits`] of every level from the third on, the finest first.
    pub logits: &'a [Slice],
    /// The network's colour input.
    pub color: Slice,
    /// The network's auxiliary input.
    pub aux: Slice,
    /// The network's residual.
    pub residual: Slice,
}

/// What F0 at full size adds to what pixels predict from.
pub(super) fn early_f(b: &mut Builder, f: Slice) -> Slice {
    b.linear(Linear::new("head.f0", vec![f], HIDDEN))
}

/// The same with X0's part.
pub(super) fn early(b: &mut Builder, x: Slice, of_f: Slice) -> Slice {
    b.linear(Linear { residual: Some(of_f), ..Linear::new("head.x0", vec![x], HIDDEN) })
}

/// The logits of the kernels of a level, counted from the first after the full size, by the map of its tokens: the
/// decoder's, or the bottleneck's. `None` where the head has no such level.
pub(super) fn level_logits(b: &mut Builder, head: &KernelHead, level: usize, tokens: Slice) -> Option<Slice> {
    let (inner, out) = LEVEL_NAMES.iter().take(head.levels.len() - 1).nth(level)?;
    let stage = std::mem::replace(&mut b.stage, Stage::Output);
    let linear = Linear::new(&format!("head.{inner}"), vec![tokens], HIDDEN);
    let inner = b.linear(Linear { activation: Activation::LeakyRelu, ..linear });
    let logits = b.linear(Linear::new(&format!("head.{out}"), vec![inner], KERNEL_SIDE * KERNEL_SIDE));
    b.stage = stage;
    Some(logits)
}

/// Channels of an image: radiance, and what it counts for.
const IMAGE: u32 = 4;

/// The exposed radiance.
pub(super) fn kernels(b: &mut Builder, head: &KernelHead, inputs: &Inputs) -> Slice {
    let &Inputs { early, tokens, logits, color, aux, residual } = inputs;
    let levels = head.levels.len() as u32;
    let (hidden, taps) = (b.map("head.hidden", 1, HIDDEN), b.map("head.taps", 1, IMAGE));
    let (prefix, albedo) = ("head".to_owned(), aux.part(0, 3));
    b.push(
        "head.hidden".into(),
        OpKind::KernelInputs {
            head: prefix.clone(),
            early,
            tokens,
            color,
            residual,
            albedo,
            levels,
            output: hidden,
            taps,
        },
    );
    // The mean at full size by its share; then the albedo and the gate, and the other levels' shares.
    let pixels = b.map("head.full", 1, IMAGE + 8);
    let gloss = head.gloss;
    b.push(
        "head.full".into(),
        OpKind::PredictKernels { head: prefix, hidden, taps, albedo, levels, gloss, output: pixels },
    );
    let images = IMAGE * (1 + u32::from(gloss));
    let mut sums = Vec::new();
    for side in &head.levels[1..] {
        let coarser = b.map(&format!("head.sums.{side}"), *side, images);
        let (input, albedo) = match sums.last() {
            None => (taps, gloss.then_some(albedo)),
            Some(finer) => (*finer, None),
        };
        b.push(format!("head.sums.{side}"), OpKind::Halve { input, albedo, output: coarser.value });
        sums.push(coarser);
    }
    let mut means = Vec::new();
    // The finest level's logits are as large as what they are made of: not before they are needed.
    let finest = level_logits(b, head, 0, tokens);
    let logits = finest.iter().chain(logits);
    for ((side, logits), sums) in head.levels[1..].iter().zip(logits).zip(sums) {
        let mean = b.map(&format!("head.level.{side}"), *side, images);
        b.push(format!("head.level.{side}"), OpKind::ApplyKernels { logits: *logits, sums, output: mean.value });
        means.push(mean);
    }
    let output = b.map("head.mix", 1, IMAGE);
    let direct = head.gated.then_some((color, residual));
    b.push("head.mix".into(), OpKind::MixLevels { pixels, levels: means, direct, gloss, output: output.value });
    output
}

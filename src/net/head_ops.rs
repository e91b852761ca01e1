//! The operations of a head of kernels ([`super::head`]).
//!
//! What every pixel predicts from is the sum of four Linears. Two of them are of maps at full size that the network
//! makes first: they are applied there, so that one map of their sum is kept and not both maps.

use super::builder::{Builder, Linear};
use super::op::{Activation, OpKind, Slice};
use super::head::{HIDDEN, KERNEL_SIDE, KernelHead};

/// The Linears of every level after the first.
const LEVEL_NAMES: [(&str, &str); 4] =
    [("mid", "out_mid"), ("low", "out_low"), ("deep", "out_deep"), ("neck", "out_neck")];

/// What a head reads.
pub(super) struct Inputs<'a> {
    /// [`early`].
    pub early: Slice,
    /// The map of 2x2 pixels a token and those of each double side, from the decoder's or the bottleneck.
    pub tokens: &'a [Slice],
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

/// Channels of an image: radiance, and what it counts for.
const IMAGE: u32 = 4;

/// The exposed radiance.
pub(super) fn kernels(b: &mut Builder, head: &KernelHead, inputs: &Inputs) -> Slice {
    let &Inputs { early, tokens, color, aux, residual } = inputs;
    let deeper = head.levels.len() - 1;
    let levels = head.levels.len() as u32;
    let (hidden, taps) = (b.map("head.hidden", 1, HIDDEN), b.map("head.taps", 1, IMAGE));
    let (prefix, albedo) = ("head".to_owned(), aux.part(0, 3));
    b.push(
        "head.hidden".into(),
        OpKind::KernelInputs {
            head: prefix.clone(),
            early,
            tokens: tokens[0],
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
    b.push("head.full".into(), OpKind::PredictKernels { head: prefix, hidden, taps, albedo, levels, output: pixels });
    let mut sums = Vec::new();
    for side in &head.levels[1..] {
        let finer = sums.last().copied().unwrap_or(taps);
        let coarser = b.map(&format!("head.sums.{side}"), *side, IMAGE);
        b.push(format!("head.sums.{side}"), OpKind::Halve { input: finer, output: coarser.value });
        sums.push(coarser);
    }
    // Level beside level: they do not wait for each other.
    let names = &LEVEL_NAMES[..deeper];
    let inner: Vec<Slice> = names
        .iter()
        .zip(tokens)
        .map(|((name, _), map)| {
            let linear = Linear::new(&format!("head.{name}"), vec![*map], HIDDEN);
            b.linear(Linear { activation: Activation::LeakyRelu, ..linear })
        })
        .collect();
    let outs = names.iter().zip(&inner);
    let logits: Vec<Slice> = outs
        .map(|((_, out), map)| b.linear(Linear::new(&format!("head.{out}"), vec![*map], KERNEL_SIDE * KERNEL_SIDE)))
        .collect();
    let mut means = Vec::new();
    for ((side, logits), sums) in head.levels[1..].iter().zip(logits).zip(sums) {
        let mean = b.map(&format!("head.level.{side}"), *side, IMAGE);
        b.push(format!("head.level.{side}"), OpKind::ApplyKernels { logits, sums, output: mean.value });
        means.push(mean);
    }
    let output = b.map("head.mix", 1, IMAGE);
    let direct = head.gated.then_some((color, residual));
    b.push("head.mix".into(), OpKind::MixLevels { pixels, levels: means, direct, output: output.value });
    output
}

//! The U-Net around the blocks: projections, the way down, the way up, the output.

use super::arch::{Arch, Decoder};
use super::blocks::{Place, block};
use super::builder::{Builder, Conv, Linear};
use super::graph::Graph;
use super::head_ops;
use super::op::{Activation, Op, OpKind, Shuffle, Slice, Stage};

/// The graph of a valid architecture.
pub(super) fn build(arch: &Arch) -> Graph {
    let mut b = Builder::new();
    let color = b.map("color", 1, 3);
    let aux = b.map("aux", 1, 7);
    // The baseline's last decoder stage reads [up | encoder 0] and [up of F1 | F0] side by side: who makes a half
    // writes it where it will be read.
    let wide = (arch.decoder == Decoder::Baseline).then(|| {
        let width = 2 * arch.channels;
        (b.map("dec.0.x", arch.patch, width), b.map("dec.0.f", arch.patch, width))
    });
    let half = |whole: Slice, i: u32| whole.part(i * arch.channels, arch.channels);

    let (f0, early) = project_aux(&mut b, arch, aux, wide.map(|(_, f)| half(f, 1)));
    let (x0, early) = project_color(&mut b, arch, color, early);

    let (mut x, mut f, mut skips) = (x0, vec![f0], Vec::new());
    for (i, stage) in arch.stages.iter().enumerate() {
        b.stage = Stage::Encoder(i as u32);
        let target = if i == 0 { wide.map(|(x, _)| half(x, 1)) } else { None };
        for n in 0..stage.encoder_blocks {
            let into = target.filter(|_| n + 1 == stage.encoder_blocks);
            x = block(&mut b, stage.block, stage.heads, Place { prefix: &format!("enc.{i}.{n}"), x, f: f[i], into });
        }
        skips.push(x);
        // The same weights for both maps; no block changes F.
        let f_down = down(&mut b, i, "f", f[i]);
        f.push(f_down);
        x = down(&mut b, i, "x", x);
    }

    b.stage = Stage::Bottleneck;
    let neck = &arch.bottleneck;
    let deepest = f[arch.stages.len()];
    for n in 0..neck.blocks {
        let place = Place { prefix: &format!("bottleneck.{n}"), x, f: deepest, into: None };
        x = block(&mut b, neck.block, neck.heads, place);
    }

    let mut logits = Vec::new();
    let head = arch.head.kernels();
    let of_level = |b: &mut Builder, level, x| head.and_then(|head| head_ops::level_logits(b, head, level, x));
    logits.extend(of_level(&mut b, arch.stages.len(), x));
    for (i, stage) in arch.stages.iter().enumerate().rev() {
        b.stage = Stage::Decoder(i as u32);
        let (mut guide, mut heads) = (f[i], stage.heads);
        match wide.filter(|_| i == 0) {
            Some((both, guides)) => {
                up(&mut b, i, "x", x, Some(half(both, 0)));
                up(&mut b, i, "f", f[1], Some(half(guides, 0)));
                (x, guide, heads) = (both, guides, 1);
            }
            None => {
                let grown = up(&mut b, i, "x", x, None);
                x = b.linear(Linear::new(&format!("skip.{i}"), vec![grown, skips[i]], grown.channels));
            }
        }
        for n in 0..stage.decoder_blocks {
            let place = Place { prefix: &format!("dec.{i}.{n}"), x, f: guide, into: None };
            x = block(&mut b, stage.block, heads, place);
        }
        if i > 0 {
            logits.extend(of_level(&mut b, i, x));
        }
    }
    logits.reverse();
    let tokens = x;

    b.stage = Stage::Output;
    if arch.patch == 2 {
        let unembed = Conv::new("patch_unembed", x, 4 * x.channels);
        x = b.conv(Conv { bias: false, shuffle: Shuffle::Shuffle, ..unembed });
    }
    let mut result = b.conv(Conv::new("output", x, 3));
    if let (Some(head), Some(early)) = (head, early) {
        let inputs = head_ops::Inputs { early, tokens, logits: &logits, color, aux, residual: result };
        result = head_ops::kernels(&mut b, head, &inputs);
    }
    Graph {
        arch: arch.clone(),
        values: b.values,
        ops: film_first(b.ops),
        color: color.value,
        aux: aux.value,
        residual: result.value,
    }
}

/// Moves what makes FiLM vectors to where the auxiliary map that it reads has just been written: the decoder's need not
/// be kept for them.
fn film_first(ops: Vec<Op>) -> Vec<Op> {
    let mut ordered: Vec<Op> = Vec::new();
    for op in ops {
        let source = match &op.kind {
            OpKind::FilmMean { input, .. } => Some(input.value),
            OpKind::FilmVector { input, .. } => Some(*input),
            _ => None,
        };
        let writes = |op: &Op, value| match &op.kind {
            OpKind::Conv3x3 { output, .. } | OpKind::Linear { output, .. } => output.value == value,
            OpKind::FilmMean { output, .. } => *output == value,
            _ => false,
        };
        let written = source.and_then(|value| ordered.iter().rposition(|op| writes(op, value)));
        ordered.insert(written.map_or(ordered.len(), |at| at + 1), op);
    }
    ordered
}

/// X0 at token resolution, and what X0 and F0 at full size add to what a head of kernels predicts from: of F0 it is
/// given.
fn project_color(b: &mut Builder, arch: &Arch, color: Slice, early: Option<Slice>) -> (Slice, Option<Slice>) {
    let x = b.conv(Conv { activation: Activation::LeakyRelu, ..Conv::new("color_proj", color, arch.channels) });
    if arch.patch == 1 {
        return (x, None);
    }
    // Before X0 is made smaller: in bands that is the last that is done with it.
    let early = early.map(|of_f| head_ops::early(b, x, of_f));
    (b.conv(Conv { stride: arch.patch, ..Conv::new("patch_embed_x", x, arch.channels) }), early)
}

/// F0 at token resolution: three steps, each feeding the next, then one Linear on their concatenated results.
///
/// The Linear is written as three partial sums, one after each step, so that the results need not all be kept at full
/// resolution at once. The second result is F0's part of [`project_color`]'s, where there is a head of kernels.
fn project_aux(b: &mut Builder, arch: &Arch, aux: Slice, into: Option<Slice>) -> (Slice, Option<Slice>) {
    let channels = arch.channels;
    let step = aux_step(b, 0, aux, channels);
    let sum = b.linear(aux_part(0, step, channels));
    let step = aux_step(b, 1, step, channels);
    let sum = b.linear(Linear { residual: Some(sum), ..aux_part(1, step, channels) });
    let step = aux_step(b, 2, step, channels);
    let mut last = aux_part(2, step, channels);
    last.weight.bias = true;
    last.activation = Activation::LeakyRelu;
    last.into = into.filter(|_| arch.patch == 1);
    let f = b.linear(Linear { residual: Some(sum), ..last });
    if arch.patch == 1 {
        return (f, None);
    }
    let early = arch.head.kernels().map(|_| head_ops::early_f(b, f));
    (b.conv(Conv { stride: arch.patch, into, ..Conv::new("patch_embed_f", f, channels) }), early)
}

/// Pointwise, depthwise, activation.
fn aux_step(b: &mut Builder, i: u32, input: Slice, channels: u32) -> Slice {
    let mixed = b.linear(Linear::new(&format!("aux_proj.{i}.pointwise"), vec![input], channels));
    b.depthwise(&format!("aux_proj.{i}.depthwise"), mixed, Activation::LeakyRelu)
}

/// What step `i` adds to F0 before its bias.
fn aux_part(i: u32, step: Slice, channels: u32) -> Linear {
    let mut out = Linear::new("aux_proj.out", vec![step], channels);
    out.name = format!("aux_proj.out.{i}");
    out.weight.inputs = 3 * channels;
    out.weight.columns = i * channels..(i + 1) * channels;
    out.weight.bias = false;
    out
}

/// Half the size, twice the channels.
fn down(b: &mut Builder, i: usize, which: &str, input: Slice) -> Slice {
    let conv = Conv::new(&format!("down.{i}"), input, input.channels / 2);
    b.conv(Conv { name: format!("down.{i}.{which}"), bias: false, shuffle: Shuffle::Unshuffle, ..conv })
}

/// Twice the size, half the channels.
fn up(b: &mut Builder, i: usize, which: &str, input: Slice, into: Option<Slice>) -> Slice {
    let conv = Conv::new(&format!("up.{i}"), input, 2 * input.channels);
    b.conv(Conv { name: format!("up.{i}.{which}"), bias: false, shuffle: Shuffle::Shuffle, into, ..conv })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::arch::{Block, Convolution};
    use crate::net::head::Head;
    use crate::net::op::Shape;
    use std::collections::HashSet;

    /// The named networks and some that are none of them.
    fn networks() -> Vec<Arch> {
        let mut separable = Arch::hybrid();
        separable.decoder = Decoder::Baseline;
        separable.stages[0].block = Block::FilmCnn { conv: Convolution::Separable };
        separable.bottleneck.block = separable.stages[0].block;
        let mut deepest = Arch::shsa_100();
        deepest.stages.resize(6, deepest.stages[0].clone());
        let mut least = Arch::three_stage();
        least.channels = 8;
        least.stages.truncate(1);
        least.bottleneck.heads = 1;
        let headed = [Head::pure(), Head::gloss(), Head::gated()].map(|head| Arch { head, ..Arch::hybrid() });
        Arch::NAMES.iter().filter_map(|n| Arch::named(n)).chain([separable, deepest, least]).chain(headed).collect()
    }

    #[test]
    fn every_channel_is_written_once_before_it_is_read_and_read() {
        for arch in networks() {
            let graph = Graph::new(&arch).unwrap();
            let channels = |s: Slice| (s.first..s.first + s.channels).map(move |c| (s.value, c));
            let mut written: HashSet<_> =
                [graph.color, graph.aux].map(|v| graph.whole(v)).into_iter().flat_map(channels).collect();
            let mut read: HashSet<_> = channels(graph.whole(graph.residual)).collect();
            for op in &graph.ops {
                for channel in graph.reads(op).into_iter().flat_map(channels) {
                    assert!(written.contains(&channel), "{}: {} reads {channel:?}", arch.name, op.name);
                    read.insert(channel);
                }
                for channel in graph.writes(op).into_iter().flat_map(channels) {
                    assert!(written.insert(channel), "{}: {} writes {channel:?} again", arch.name, op.name);
                }
            }
            let all: HashSet<_> =
                (0..graph.values.len()).flat_map(|i| channels(graph.whole(crate::net::ValueId(i)))).collect();
            assert_eq!(written, all, "{}", arch.name);
            // The last Down of F makes more channels than partial attention reads: the only work in vain.
            let idle: HashSet<_> = written.difference(&read).map(|(v, _)| &graph.value(*v).name[..]).collect();
            assert!(idle.iter().all(|name| name.ends_with(".f")), "{}: nobody reads {idle:?}", arch.name);
        }
    }

    #[test]
    fn shapes_agree_along_every_op() {
        for arch in networks() {
            let graph = Graph::new(&arch).unwrap();
            let stride = |s: Slice| match graph.value(s.value).shape {
                Shape::Map { stride, .. } => stride,
                Shape::Vector { .. } => 0,
            };
            for op in &graph.ops {
                let output = graph.result(op);
                let name = format!("{} {}", arch.name, op.name);
                match &op.kind {
                    OpKind::Conv3x3 { film, residual, stride: step, shuffle, input, .. } => {
                        let scaled = match shuffle {
                            Shuffle::None => stride(*input) * step,
                            Shuffle::Unshuffle => stride(*input) * 2,
                            Shuffle::Shuffle => stride(*input) / 2,
                        };
                        assert_eq!(stride(output), scaled, "{name}");
                        assert!(
                            residual.is_none_or(|r| (stride(r), r.channels) == (scaled, output.channels)),
                            "{name}"
                        );
                        assert!(film.is_none_or(|v| graph.whole(v).channels == 2 * output.channels), "{name}");
                    }
                    OpKind::Linear { inputs, weight, film, residual, .. } => {
                        assert!(inputs.iter().chain(residual).all(|i| stride(*i) == stride(output)), "{name}");
                        let columns = inputs.iter().map(|i| i.channels).sum::<u32>();
                        assert_eq!(weight.columns.len() as u32, columns, "{name}");
                        assert!(weight.columns.end <= weight.inputs && inputs.len() <= 2, "{name}");
                        assert_eq!(weight.parts.iter().map(|p| p.outputs).sum::<u32>(), output.channels, "{name}");
                        assert!(residual.is_none_or(|r| r.channels == output.channels), "{name}");
                        assert!(film.is_none_or(|v| graph.whole(v).channels == 2 * output.channels), "{name}");
                    }
                    OpKind::WindowAttention { x, f, heads, key_width, value_width, .. } => {
                        assert_eq!(graph.whole(*x).channels, heads * (2 * key_width + value_width), "{name}");
                        assert_eq!(graph.whole(*f).channels, heads * 2 * key_width, "{name}");
                        assert_eq!(output.channels, heads * value_width, "{name}");
                    }
                    OpKind::Unembed { .. } => unreachable!("{name}: of folded graphs only"),
                    OpKind::Depthwise3x3 { input, .. } | OpKind::LayerNorm { input, .. } => {
                        assert_eq!((stride(*input), input.channels), (stride(output), output.channels), "{name}");
                    }
                    OpKind::KernelInputs { early, tokens, color, residual, albedo, output, taps, .. } => {
                        let full = [early, color, residual, albedo, output, taps];
                        assert!(full.iter().all(|map| stride(**map) == 1) && stride(*tokens) == 2, "{name}");
                        assert_eq!(early.channels, output.channels, "{name}");
                    }
                    OpKind::PredictKernels { hidden, taps, albedo, levels, output, .. } => {
                        assert!([hidden, taps, albedo, output].iter().all(|map| stride(**map) == 1), "{name}");
                        assert_eq!(output.channels, taps.channels + 8, "{name}");
                        assert!(*levels <= 5, "{name}: a vector holds the shares of the levels after the first");
                    }
                    OpKind::Halve { input, albedo, .. } => {
                        let channels = input.channels * (1 + u32::from(albedo.is_some()));
                        assert_eq!((2 * stride(*input), channels), (stride(output), output.channels), "{name}");
                    }
                    OpKind::ApplyKernels { logits, sums, .. } => {
                        assert_eq!([stride(*logits), stride(*sums)], [stride(output); 2], "{name}");
                        assert_eq!((logits.channels, sums.channels), (25, output.channels), "{name}");
                    }
                    OpKind::MixLevels { pixels, levels, gloss, .. } => {
                        let sides: Vec<u32> = levels.iter().map(|level| stride(*level)).collect();
                        assert!(sides == [2, 4] || sides == [2, 4, 8, 16], "{name}: {sides:?}");
                        assert_eq!((stride(*pixels), stride(output)), (1, 1), "{name}");
                        let images = output.channels * (1 + u32::from(*gloss));
                        assert!(levels.iter().all(|level| level.channels == images), "{name}");
                    }
                    OpKind::FilmMean { input, .. } => assert_eq!(input.channels, output.channels, "{name}"),
                    OpKind::FilmVector { input, .. } => {
                        assert_eq!(2 * graph.whole(*input).channels, output.channels, "{name}");
                    }
                }
            }
            let names: HashSet<_> = graph.ops.iter().map(|op| &op.name).collect();
            assert_eq!(names.len(), graph.ops.len(), "{}: two ops of one name", arch.name);
        }
    }
}

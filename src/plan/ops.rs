//! From one operation to its kernel, before there is a size.

use super::pack::{Pack, linear_outputs};
use super::steps::{Size, Steps};
use crate::kernels::dense::NARROW_CHANNELS;
use crate::kernels::winograd::{Winograd3x3, WinogradTile};
use crate::kernels::{
    Arithmetic, BufferId, Call, Storage, Tiles, View, dense, film, maps, predicted, unembed, window_attention,
};
use crate::net::op::{ConvWeight, Op, OpKind, Shuffle, Slice, ValueId, conv_outputs};

impl Steps<'_> {
    /// The kernel of an operation.
    pub(super) fn op(&mut self, op: &Op) -> Call {
        match &op.kind {
            OpKind::Conv3x3 { input, weight, bias, stride, activation, shuffle, film, residual, output } => {
                let channels = conv_outputs(*shuffle, *output);
                // Winograd has no form between two storages.
                let (src, dst) = (self.view(*input), self.view(*output));
                let mut conv = dense::Conv3x3 {
                    src,
                    dst,
                    channels: channels.next_multiple_of(4),
                    weights: BufferId(0),
                    film: film.map(|film| self.value(film)),
                    residual: residual.map(|residual| self.view(residual)),
                    stride: *stride,
                    activation: *activation,
                    shuffle: *shuffle,
                    tiles: Tiles::All,
                    arithmetic: Arithmetic::Floats,
                };
                conv.arithmetic = self.arithmetic(conv.fits_matrices());
                let fits_winograd = *stride == 1 && channels > NARROW_CHANNELS && src.storage == dst.storage;
                let tile = match conv.arithmetic {
                    Arithmetic::Floats if fits_winograd => self.target.conv.tile(),
                    _ => None,
                };
                let pack = conv_pack(weight, *bias, (input.channels, channels), *shuffle, tile);
                conv.weights = self.dense_pack(&op.name, pack, conv.arithmetic);
                match tile {
                    Some(tile) => Call::Winograd3x3(Winograd3x3 { conv, tile }),
                    None => Call::Conv3x3(conv),
                }
            }
            OpKind::Unembed { input, spread, gather, output } => {
                let mut call = unembed::Unembed {
                    src: self.view(*input),
                    dst: self.view(*output),
                    weights: BufferId(0),
                    tiles: Tiles::All,
                    arithmetic: Arithmetic::Floats,
                };
                call.arithmetic = self.arithmetic(call.fits_matrices());
                let (spread, gather, inputs) = (spread.clone(), gather.clone(), input.channels);
                let pack = match call.arithmetic {
                    Arithmetic::Floats => Pack::Unembed { spread, gather, inputs },
                    Arithmetic::Matrices => Pack::UnembedMatrix { spread, gather, inputs },
                };
                call.weights = self.pack(&op.name, pack);
                Call::Unembed(call)
            }
            OpKind::Linear { inputs, weight, activation, film, residual, output } => {
                debug_assert_eq!(linear_outputs(weight), output.channels, "{}", op.name);
                let views: Vec<View> = inputs.iter().map(|input| self.view(*input)).collect();
                let mut linear = dense::Linear {
                    src: views[0],
                    src_b: views.get(1).copied(),
                    norm: weight.norm.is_some(),
                    dst: self.view(*output),
                    weights: BufferId(0),
                    film: film.map(|film| self.value(film)),
                    residual: residual.map(|residual| self.view(residual)),
                    activation: *activation,
                    tiles: Tiles::All,
                    arithmetic: Arithmetic::Floats,
                };
                linear.arithmetic = self.arithmetic(linear.fits_matrices());
                linear.weights = self.dense_pack(&op.name, Pack::Linear(weight.clone()), linear.arithmetic);
                Call::Linear(linear)
            }
            OpKind::Depthwise3x3 { input, weight, activation, output } => {
                let pack = Pack::Depthwise { weight: weight.clone(), channels: input.channels };
                Call::Depthwise3x3(maps::Depthwise3x3 {
                    src: self.view(*input),
                    dst: self.whole(*output),
                    weights: self.pack(weight, pack),
                    activation: *activation,
                    tiles: Tiles::All,
                })
            }
            OpKind::LayerNorm { input, norm, output } => {
                let dst = self.whole(*output);
                self.layer_norm(*input, norm, dst)
            }
            OpKind::WindowAttention { x, f, bias_table, heads, key_width, value_width, output } => {
                let mut attention = window_attention::WindowAttention {
                    x: self.whole(*x),
                    f: self.whole(*f),
                    bias: BufferId(0),
                    dst: self.whole(*output),
                    heads: *heads,
                    key_width: *key_width,
                    value_width: *value_width,
                    tiles: Tiles::All,
                    arithmetic: Arithmetic::Floats,
                };
                attention.arithmetic = self.arithmetic(attention.fits_matrices());
                let (table, heads) = (bias_table.clone(), *heads);
                let pack = match attention.arithmetic {
                    Arithmetic::Floats => Pack::BiasTable { table, heads },
                    Arithmetic::Matrices => Pack::BiasMatrix { table, heads },
                };
                attention.bias = self.pack(bias_table, pack);
                Call::WindowAttention(attention)
            }
            OpKind::FilmMean { input, output, .. } => {
                let partials = self.buffer(&format!("{}.partials", op.name), Size::OfFrame, Storage::F32);
                self.values.insert(*output, partials);
                Call::TokenSum(film::TokenSum {
                    src: self.view(*input),
                    real_width: 0,
                    real_height: 0,
                    dst: partials,
                    computed: None,
                })
            }
            OpKind::KernelInputs { head, early, tokens, color, residual, albedo, levels, output, taps } => {
                let mut call = predicted::KernelInputs {
                    early: self.view(*early),
                    tokens: self.view(*tokens),
                    albedo: self.view(*albedo),
                    color: self.view(*color),
                    residual: self.view(*residual),
                    weights: BufferId(0),
                    dst: self.view(*output),
                    taps: self.view(*taps),
                    tiles: Tiles::All,
                    arithmetic: Arithmetic::Floats,
                };
                call.arithmetic = self.arithmetic(call.fits_matrices());
                call.weights = self.pack(head, kernels_pack(head, *levels, call.arithmetic));
                Call::KernelInputs(call)
            }
            OpKind::PredictKernels { head, hidden, taps, albedo, levels, gloss, output } => {
                let mut call = predicted::PredictKernels {
                    hidden: self.view(*hidden),
                    taps: self.view(*taps),
                    albedo: self.view(*albedo),
                    gloss: *gloss,
                    of_signal: false,
                    weights: BufferId(0),
                    dst: self.view(*output),
                    tiles: Tiles::All,
                    arithmetic: Arithmetic::Floats,
                };
                call.arithmetic = self.arithmetic(call.fits_matrices());
                call.weights = self.pack(head, kernels_pack(head, *levels, call.arithmetic));
                Call::PredictKernels(call)
            }
            OpKind::Halve { input, albedo, output } => Call::Halve(predicted::Halve {
                src: self.view(*input),
                albedo: albedo.map(|albedo| self.view(albedo)),
                dst: self.whole(*output),
                tiles: Tiles::All,
            }),
            OpKind::ApplyKernels { logits, sums, output } => Call::ApplyKernels(predicted::ApplyKernels {
                logits: self.view(*logits),
                sums: self.view(*sums),
                dst: self.whole(*output),
                tiles: Tiles::All,
            }),
            OpKind::MixLevels { pixels, levels, direct, gloss, output } => Call::MixLevels(predicted::MixLevels {
                pixels: self.view(*pixels),
                levels: levels.iter().map(|level| self.view(*level)).collect(),
                direct: direct.map(|(color, residual)| (self.view(color), self.view(residual))),
                gloss: *gloss,
                dst: self.whole(*output),
                tiles: Tiles::All,
            }),
            OpKind::FilmVector { input, weight, output } => {
                let inputs = self.graph.whole(*input).channels;
                let outputs = self.graph.whole(*output).channels;
                let norm = self.norm_of(*input);
                let pack = Pack::FilmVector { weight: weight.clone(), norm, inputs, outputs };
                Call::FilmVector(film::FilmVector {
                    partials: self.value(*input),
                    sums: 0,
                    tokens: 0,
                    counts: None,
                    channels: inputs,
                    weights: self.pack(weight, pack),
                    dst: self.value(*output),
                    outputs,
                })
            }
        }
    }

    /// The norm of the tokens that a mean is of.
    fn norm_of(&self, mean: ValueId) -> String {
        let norms = self.graph.ops.iter().find_map(|op| match &op.kind {
            OpKind::FilmMean { norm, output, .. } if *output == mean => Some(norm.clone()),
            _ => None,
        });
        norms.unwrap_or_default()
    }

    /// What a kernel computes with that could, or could not, on matrices.
    fn arithmetic(&self, fits_matrices: bool) -> Arithmetic {
        if fits_matrices { self.target.arithmetic } else { Arithmetic::Floats }
    }

    fn dense_pack(&mut self, name: &str, pack: Pack, arithmetic: Arithmetic) -> BufferId {
        let pack = match arithmetic {
            Arithmetic::Floats => pack,
            Arithmetic::Matrices => Pack::Halves(Box::new(pack)),
        };
        self.pack(name, pack)
    }

    fn layer_norm(&mut self, input: Slice, norm: &str, dst: View) -> Call {
        let pack = Pack::Norm { norm: norm.to_owned(), channels: input.channels };
        let weights = self.pack(norm, pack);
        Call::LayerNorm(maps::LayerNorm { src: self.view(input), dst, weights, tiles: Tiles::All })
    }
}

/// The weights of predicted kernels, for either arithmetic.
fn kernels_pack(head: &str, levels: u32, arithmetic: Arithmetic) -> Pack {
    let head = head.to_owned();
    match arithmetic {
        Arithmetic::Floats => Pack::Kernels { head, levels },
        Arithmetic::Matrices => Pack::KernelsMatrix { head, levels },
    }
}

/// The weights of a dense 3x3 convolution, as the kernel that was chosen reads them.
fn conv_pack(
    weight: &ConvWeight,
    bias: bool,
    (inputs, outputs): (u32, u32),
    shuffle: Shuffle,
    tile: Option<WinogradTile>,
) -> Pack {
    let (weight, shuffle) = (weight.clone(), shuffle == Shuffle::Shuffle);
    match tile {
        Some(tile) => Pack::Winograd3x3 { weight, bias, inputs, outputs, shuffle, tile },
        None => Pack::Conv3x3 { weight, bias, inputs, outputs, shuffle },
    }
}

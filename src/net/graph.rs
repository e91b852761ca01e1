//! The graph of one network: values (feature maps and vectors) and the operations between them, in the order they run.
//!
//! Pure data, free of any image size: a map's extent is the padded frame divided by its stride. Every value is written
//! before it is read, by one op or, channel range by channel range, by several.

use std::collections::HashSet;

use super::arch::{Arch, ArchError};
use super::head::{FULL_OUTPUTS, HIDDEN};
use super::op::{ConvWeight, LinearPart, Op, OpKind, Shape, Slice, Value, ValueId, conv_outputs};
use super::unet;

/// A tensor that the network's weights must hold.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct TensorSpec {
    /// Its name in a weights file.
    pub name: String,
    /// Its shape: Linear `[out, in]`, convolution `[out, in, 3, 3]`, depthwise `[channels, 1, 3, 3]`, else `[len]`.
    pub shape: Vec<u32>,
}

impl TensorSpec {
    /// How many numbers it holds.
    pub fn elements(&self) -> u64 {
        self.shape.iter().map(|&n| u64::from(n)).product()
    }
}

/// A network as values and operations.
#[derive(Debug, Clone, PartialEq)]
pub struct Graph {
    /// What it was built from.
    pub arch: Arch,
    /// All values; [`ValueId`] is the index.
    pub values: Vec<Value>,
    /// All operations in an order that may run.
    pub ops: Vec<Op>,
    /// Input: log1p of the exposed colour, a map of stride 1 and 3 channels.
    pub color: ValueId,
    /// Input: albedo 3, normal 3, depth 1, a map of stride 1 and 7 channels.
    pub aux: ValueId,
    /// Output, a map of stride 1: what is added to `color`, 3 channels; of a head of kernels the exposed radiance
    /// itself, of every image 3 channels and a zero.
    pub residual: ValueId,
}

impl Graph {
    /// Builds the graph of `arch`.
    ///
    /// # Errors
    /// What [`Arch::validate`] finds.
    pub fn new(arch: &Arch) -> Result<Graph, ArchError> {
        arch.validate()?;
        Ok(unet::build(arch))
    }

    /// The value `id` names. `id` must come from this graph.
    pub fn value(&self, id: ValueId) -> &Value {
        &self.values[id.0]
    }

    /// All of a value's channels.
    pub fn whole(&self, id: ValueId) -> Slice {
        let (Shape::Map { channels, .. } | Shape::Vector { len: channels }) = self.value(id).shape;
        Slice { value: id, first: 0, channels }
    }

    /// Whether a value is what predicted kernels make of images, or the residual that they read.
    pub(crate) fn is_of_kernels(&self, id: ValueId) -> bool {
        self.ops.iter().any(|op| match &op.kind {
            OpKind::KernelInputs { residual, taps, .. } => [residual, taps].iter().any(|slice| slice.value == id),
            OpKind::PredictKernels { output, .. } => output.value == id,
            OpKind::Halve { output, .. } | OpKind::ApplyKernels { output, .. } | OpKind::MixLevels { output, .. } => {
                *output == id
            }
            _ => false,
        })
    }

    /// What `op` reads, weights aside.
    pub fn reads(&self, op: &Op) -> Vec<Slice> {
        match &op.kind {
            OpKind::Conv3x3 { input, film, residual, .. } => {
                [Some(*input), film.map(|v| self.whole(v)), *residual].into_iter().flatten().collect()
            }
            OpKind::Linear { inputs, film, residual, .. } => {
                inputs.iter().copied().chain(film.map(|v| self.whole(v))).chain(*residual).collect()
            }
            OpKind::Depthwise3x3 { input, .. } | OpKind::LayerNorm { input, .. } | OpKind::FilmMean { input, .. } => {
                vec![*input]
            }
            OpKind::Unembed { input, .. } => vec![*input],
            OpKind::WindowAttention { x, f, .. } => vec![self.whole(*x), self.whole(*f)],
            OpKind::FilmVector { input, .. } => vec![self.whole(*input)],
            OpKind::KernelInputs { early, tokens, color, residual, albedo, .. } => {
                vec![*early, *tokens, *color, *residual, *albedo]
            }
            OpKind::PredictKernels { hidden, taps, albedo, .. } => vec![*hidden, *taps, *albedo],
            OpKind::Halve { input, albedo, .. } => [Some(*input), *albedo].into_iter().flatten().collect(),
            OpKind::ApplyKernels { logits, sums, .. } => vec![*logits, *sums],
            OpKind::MixLevels { pixels, levels, direct, .. } => {
                let direct = direct.iter().flat_map(|(color, residual)| [*color, *residual]);
                [*pixels].into_iter().chain(levels.iter().copied()).chain(direct).collect()
            }
        }
    }

    /// All that `op` writes: mostly one slice.
    pub fn writes(&self, op: &Op) -> Vec<Slice> {
        let more = match &op.kind {
            OpKind::KernelInputs { taps, .. } => Some(*taps),
            _ => None,
        };
        std::iter::once(self.result(op)).chain(more).collect()
    }

    /// What `op` writes first.
    pub fn result(&self, op: &Op) -> Slice {
        match &op.kind {
            OpKind::Conv3x3 { output, .. }
            | OpKind::Unembed { output, .. }
            | OpKind::Linear { output, .. }
            | OpKind::KernelInputs { output, .. }
            | OpKind::PredictKernels { output, .. } => *output,
            OpKind::Depthwise3x3 { output, .. }
            | OpKind::LayerNorm { output, .. }
            | OpKind::WindowAttention { output, .. }
            | OpKind::FilmMean { output, .. }
            | OpKind::Halve { output, .. }
            | OpKind::ApplyKernels { output, .. }
            | OpKind::MixLevels { output, .. }
            | OpKind::FilmVector { output, .. } => self.whole(*output),
        }
    }

    /// Every tensor the operations read, each once, in the order of first use.
    pub fn tensors(&self) -> Vec<TensorSpec> {
        // Shared weights (a Down acts on X and on F) and partial sums name a tensor more than once.
        let mut seen = HashSet::new();
        self.ops.iter().flat_map(|op| self.op_tensors(op)).filter(|t| seen.insert(t.name.clone())).collect()
    }

    /// The tensors of one operation; a biased one has `<prefix>.bias` after `<prefix>.weight`.
    fn op_tensors(&self, op: &Op) -> Vec<TensorSpec> {
        match &op.kind {
            OpKind::Conv3x3 { input, weight, bias, shuffle, output, .. } => {
                let shape = [conv_outputs(*shuffle, *output), input.channels, 3, 3];
                match weight {
                    ConvWeight::Tensor(prefix) => affine(prefix, &shape, *bias),
                    ConvWeight::Mixed { conv, linear, columns } => {
                        [affine(conv, &shape, false), affine(linear, &[shape[0] / 4, *columns], false)].concat()
                    }
                }
            }
            OpKind::Unembed { input, spread, gather, output } => {
                let spread = affine(spread, &[4 * input.channels, input.channels, 3, 3], false);
                [spread, affine(gather, &[output.channels, input.channels, 3, 3], true)].concat()
            }
            OpKind::Linear { weight, .. } => {
                let part = |p: &LinearPart| affine(&p.prefix, &[p.outputs, weight.inputs], weight.bias);
                let norm = weight.norm.iter().flat_map(|norm| affine(norm, &[weight.columns.len() as u32], true));
                weight.parts.iter().flat_map(part).chain(norm).collect()
            }
            OpKind::Depthwise3x3 { input, weight, .. } => affine(weight, &[input.channels, 1, 3, 3], true),
            OpKind::LayerNorm { input, norm, .. } | OpKind::FilmMean { input, norm, .. } => {
                affine(norm, &[input.channels], true)
            }
            OpKind::WindowAttention { bias_table, heads, .. } => {
                vec![TensorSpec { name: bias_table.clone(), shape: vec![225, *heads] }]
            }
            OpKind::KernelInputs { head, tokens, levels, .. } => {
                let tok = kernel_linear(head, "tok", 4 * HIDDEN, tokens.channels);
                [tok, kernel_linear(head, "guess", HIDDEN, 6), kernel_outputs(head, *levels)].concat()
            }
            OpKind::PredictKernels { head, levels, .. } => kernel_outputs(head, *levels),
            OpKind::Halve { .. } | OpKind::ApplyKernels { .. } | OpKind::MixLevels { .. } => Vec::new(),
            OpKind::FilmVector { input, weight, output } => {
                affine(weight, &[self.whole(*output).channels, self.whole(*input).channels], true)
            }
        }
    }
}

/// The tensors of a Linear of a head of kernels.
fn kernel_linear(head: &str, name: &str, outputs: u32, inputs: u32) -> Vec<TensorSpec> {
    affine(&format!("{head}.{name}"), &[outputs, inputs], true)
}

/// Those of all that is predicted of a pixel.
fn kernel_outputs(head: &str, levels: u32) -> Vec<TensorSpec> {
    let mut tensors = kernel_linear(head, "out_full", FULL_OUTPUTS, HIDDEN);
    if levels > 3 {
        tensors.extend(kernel_linear(head, "out_more", levels - 3, HIDDEN));
    }
    tensors
}


fn affine(prefix: &str, shape: &[u32], bias: bool) -> Vec<TensorSpec> {
    let mut tensors = vec![TensorSpec { name: format!("{prefix}.weight"), shape: shape.to_vec() }];
    if bias {
        tensors.push(TensorSpec { name: format!("{prefix}.bias"), shape: vec![shape[0]] });
    }
    tensors
}

//! The typed operations of a network, and the values between them.

use std::fmt;
use std::ops::Range;

/// Names a [`Value`] of a [`Graph`]: its index in [`Graph::values`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct ValueId(pub usize);

/// What a value holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Shape {
    /// A feature map, channels last.
    Map {
        /// The side of one token in pixels of the padded frame.
        stride: u32,
        /// Channels per token.
        channels: u32,
    },
    /// One vector for the whole image.
    Vector {
        /// Its elements.
        len: u32,
    },
}

/// A feature map or a vector.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Value {
    /// For people: mostly the name of the op that writes it.
    pub name: String,
    /// What it holds.
    pub shape: Shape,
}

/// A channel range of a map, or a whole vector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Slice {
    /// The value it is a part of.
    pub value: ValueId,
    /// Its first channel.
    pub first: u32,
    /// How many channels.
    pub channels: u32,
}

impl Slice {
    /// Channels `first..first + channels` of this slice.
    pub(super) fn part(self, first: u32, channels: u32) -> Slice {
        Slice { first: self.first + first, channels, ..self }
    }
}

/// What is applied to every element of a result, last of all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Activation {
    /// Nothing.
    None,
    /// `max(x, 0)`.
    Relu,
    /// `x` where positive, else `0.01 x`.
    LeakyRelu,
}

/// Pixel (un)shuffle by 2, applied to a convolution's result.
#[allow(clippy::enum_variant_names, reason = "the field's own words")]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Shuffle {
    /// The result as it is.
    None,
    /// Pixel `(2y + dy, 2x + dx)`, channel `c` goes to pixel `(y, x)`, channel `c*4 + 2*dy + dx`.
    Unshuffle,
    /// The inverse: pixel `(y, x)`, channel `c*4 + 2*dy + dx` goes to pixel `(2y + dy, 2x + dx)`, channel `c`.
    Shuffle,
}

/// The weight of a Linear: parts of one input width, stacked along the outputs.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct LinearWeight {
    /// The tensors, in the order of the outputs they make.
    pub parts: Vec<LinearPart>,
    /// Columns of every part's tensor as it is stored, `[outputs, inputs]`.
    pub inputs: u32,
    /// Those of its columns that are used: as many as the op's inputs have channels.
    pub columns: Range<u32>,
    /// Whether the parts' `.bias` tensors are added.
    pub bias: bool,
    /// Tensor prefix of the layer normalisation that is folded into it: the Linear's tokens are brought to mean 0 and
    /// variance 1 first, and its matrix and bias take the norm's gain and bias.
    pub norm: Option<String>,
}

/// The weight of a 3x3 convolution, `[out, in, 3, 3]`.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub enum ConvWeight {
    /// The tensor `<prefix>.weight`.
    Tensor(String),
    /// A convolution before a pixel shuffle and the Linear after it in one: in every phase of the shuffle the first
    /// columns of the Linear's matrix times the convolution's weight.
    Mixed {
        /// Tensor prefix of the convolution, which has no bias.
        conv: String,
        /// Tensor prefix of the Linear.
        linear: String,
        /// Columns of the Linear's tensor.
        columns: u32,
    },
}

/// One tensor of a [`LinearWeight`].
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct LinearPart {
    /// The tensors are `<prefix>.weight` and `<prefix>.bias`.
    pub prefix: String,
    /// Rows of the tensor.
    pub outputs: u32,
}

/// What an operation computes. Tensors are named by prefix: `<prefix>.weight` and, where there is one, `<prefix>.bias`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum OpKind {
    /// 3x3 convolution, zero-padded by 1. With `y` the result plus bias: `y`, or `gamma * y + beta` with `film`; plus
    /// `residual`; activation; shuffle.
    Conv3x3 {
        /// What it reads.
        input: Slice,
        /// The weight.
        weight: ConvWeight,
        /// Whether there is a bias, `<prefix>.bias` of a [`ConvWeight::Tensor`].
        bias: bool,
        /// Step between output tokens in input tokens: 1 or 2.
        stride: u32,
        /// Applied to the sum.
        activation: Activation,
        /// Where the results go. `output` has the shape after it.
        shuffle: Shuffle,
        /// A vector `[gamma | beta]`, each as long as the convolution has outputs.
        film: Option<ValueId>,
        /// Added before the activation.
        residual: Option<Slice>,
        /// What it writes.
        output: Slice,
    },
    /// Pixels of tokens of 2x2: 3x3 convolution to four times the channels, pixel shuffle, 3x3 convolution to three
    /// channels, all zero-padded by 1. Nothing nonlinear lies between: a pixel is one sum over 4x4 tokens.
    Unembed {
        /// What it reads.
        input: Slice,
        /// Tensor prefix of the first convolution, `[4 in, in, 3, 3]`, without bias.
        spread: String,
        /// Tensor prefix of the second, `[3, in, 3, 3]`, with bias.
        gather: String,
        /// What it writes.
        output: Slice,
    },
    /// A matrix applied to every token. With `y` the result plus bias: `y`, or `gamma * y + beta` with `film`; plus
    /// `residual`; activation.
    Linear {
        /// What it reads, side by side: one or two slices of the same stride.
        inputs: Vec<Slice>,
        /// The matrix.
        weight: LinearWeight,
        /// Applied to the sum.
        activation: Activation,
        /// A vector `[gamma | beta]`, each as long as the Linear has outputs.
        film: Option<ValueId>,
        /// Added before the activation.
        residual: Option<Slice>,
        /// What it writes.
        output: Slice,
    },
    /// 3x3 convolution of each channel by itself, zero-padded by 1, with bias.
    Depthwise3x3 {
        /// What it reads.
        input: Slice,
        /// Tensor prefix; the weight is `[channels, 1, 3, 3]`.
        weight: String,
        /// Applied to the result.
        activation: Activation,
        /// What it writes.
        output: ValueId,
    },
    /// Normalises every token over the channels read: mean 0, variance 1 (eps 1e-5), then gain and bias.
    LayerNorm {
        /// What it reads.
        input: Slice,
        /// Tensor prefix.
        norm: String,
        /// What it writes.
        output: ValueId,
    },
    /// Joint attention in windows of 8x8 tokens from the origin, head by head:
    /// `softmax((Q K^T / sqrt(d) + B) * (Qf Kf^T / sqrt(d) + B)) V`, the product element by element.
    WindowAttention {
        /// `[Q | K | V]`, each head-major.
        x: ValueId,
        /// `[Qf | Kf]`, each head-major.
        f: ValueId,
        /// The tensor `[225, heads]` behind `B`: row `(dy + 7) * 15 + dx + 7`, `(dy, dx)` query minus key position.
        bias_table: String,
        /// Heads.
        heads: u32,
        /// Channels of Q, K, Qf and Kf per head (d).
        key_width: u32,
        /// Channels of V per head.
        value_width: u32,
        /// The attended values, head-major.
        output: ValueId,
    },
    /// The mean over all real tokens (those that hold a pixel of the unpadded frame) of the layer-normed input.
    FilmMean {
        /// What it reads.
        input: Slice,
        /// Tensor prefix of the layer norm.
        norm: String,
        /// A vector as long as `input` has channels.
        output: ValueId,
    },
    /// What kernels of pixels are predicted from, and what they read.
    ///
    /// `h = LeakyRelu(early + tok(tokens) + guess([color | color + residual]))`, where channel `(2 dy + dx) 32 + c` of
    /// a token goes to its pixel `(dy, dx)`. Of row 25 of `out_full(h)`, `x`, the reliability `b =
    /// exp(max(-softplus(x), -40))`. The image is `expm1(color) / a`, with `a = m max(albedo, 0.05) + 1 - m`, `m =
    /// clamp(20 max(albedo), 0, 1)`.
    KernelInputs {
        /// Tensor prefix.
        head: String,
        /// What maps at full size add to `h`.
        early: Slice,
        /// Tokens of 2x2 pixels.
        tokens: Slice,
        /// log1p of the exposed colour.
        color: Slice,
        /// What the network adds to it.
        residual: Slice,
        /// Albedo.
        albedo: Slice,
        /// Sizes of kernels, the full one among them.
        levels: u32,
        /// `h`.
        output: Slice,
        /// Of every image three channels times `b`, and `b`.
        taps: Slice,
    },
    /// Kernels of every pixel, predicted and applied at full size.
    ///
    /// `out_full(h)`: 25 logits of a kernel, the reliability, three levels' logits, a gate's and nine of a kernel over
    /// albedo; `out_more(h)`: the logits of further levels. A pixel's mean is by `exp(logit) b` of the taps inside the
    /// frame.
    PredictKernels {
        /// Tensor prefix.
        head: String,
        /// `h`.
        hidden: Slice,
        /// Of every image three channels times `b`, and `b`.
        taps: Slice,
        /// Albedo.
        albedo: Slice,
        /// Sizes of kernels, the full one among them.
        levels: u32,
        /// Whether the radiance that was not divided by the albedo is averaged too: the gate is then the share of the
        /// one mean, times the mean albedo, and the rest is of the other.
        gloss: bool,
        /// Of every image a vector of four, the mean times the first level's share and that share; then the mean albedo
        /// (`a` above) and the gate (sigmoid); then the shares (softmax) of the second level on, zeros beyond them.
        output: Slice,
    },
    /// The mean of 2x2 tokens.
    Halve {
        /// What it reads.
        input: Slice,
        /// Where the result is to have a second image, of the radiance that was not divided: what it was divided by.
        albedo: Option<Slice>,
        /// What it writes, of half the size.
        output: ValueId,
    },
    /// Kernels of every token over images that are stored as sums with their weight: the weighted mean of 5x5 tokens by
    /// `exp(logit)`, and 1; zeros where no tap has a weight.
    ApplyKernels {
        /// 25 logits a token, row by row.
        logits: Slice,
        /// Of every image three channels times a weight, and the weight.
        sums: Slice,
        /// Of every image its mean, and 1.
        output: ValueId,
    },
    /// The levels of kernels, enlarged bilinearly, mixed by their shares and multiplied by the albedo. With `direct`,
    /// by the gate mixed with the network's own estimate, in the logarithm. With `gloss` the levels have two images: by
    /// the gate the one that was divided by the albedo, times it, and by the rest the other. Exposed radiance.
    MixLevels {
        /// [`OpKind::PredictKernels`]' result.
        pixels: Slice,
        /// [`OpKind::ApplyKernels`]' results, the finest first.
        levels: Vec<Slice>,
        /// log1p of the exposed colour, and what the network adds to it.
        direct: Option<(Slice, Slice)>,
        /// Whether the levels have two images.
        gloss: bool,
        /// Of every image three channels and a zero.
        output: ValueId,
    },
    /// A matrix and its bias applied to a vector.
    FilmVector {
        /// The mean.
        input: ValueId,
        /// Tensor prefix; the weight is `[2C, C]`, the rows for gamma first.
        weight: String,
        /// The vector `[gamma | beta]`.
        output: ValueId,
    },
}

/// The part of the network an operation belongs to, for reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Stage {
    /// The projections of colour and auxiliary features.
    Input,
    /// An encoder stage with the Down after it.
    Encoder(u32),
    /// The coarsest blocks.
    Bottleneck,
    /// A decoder stage with the Up and the skip before it.
    Decoder(u32),
    /// Back to three channels at full size.
    Output,
}

impl fmt::Display for Stage {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Stage::Input => out.pad("input"),
            Stage::Encoder(i) => out.pad(&format!("enc{i}")),
            Stage::Bottleneck => out.pad("bottleneck"),
            Stage::Decoder(i) => out.pad(&format!("dec{i}")),
            Stage::Output => out.pad("output"),
        }
    }
}

/// One operation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Op {
    /// A name no other op of the graph has, such as `enc.1.0.qkv`.
    pub name: String,
    /// Where it belongs.
    pub stage: Stage,
    /// What it computes.
    pub kind: OpKind,
}

/// The outputs of a convolution before its shuffle.
pub(crate) fn conv_outputs(shuffle: Shuffle, output: Slice) -> u32 {
    match shuffle {
        Shuffle::None => output.channels,
        Shuffle::Unshuffle => output.channels / 4,
        Shuffle::Shuffle => output.channels * 4,
    }
}

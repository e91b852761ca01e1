//! The hand that writes a graph down: values and ops are appended, shapes of results follow from what is read.

use super::op::{Activation, ConvWeight, LinearPart, LinearWeight, Op, OpKind, Shape, Shuffle, Slice, Stage, Value, ValueId};

/// A graph under construction.
pub(super) struct Builder {
    pub values: Vec<Value>,
    pub ops: Vec<Op>,
    /// The stage that ops pushed from now on belong to.
    pub stage: Stage,
}

/// A 3x3 convolution to append. `outputs` counts before the shuffle; without `into` a new value takes the result.
pub(super) struct Conv {
    pub name: String,
    pub weight: ConvWeight,
    pub input: Slice,
    pub outputs: u32,
    pub bias: bool,
    pub stride: u32,
    pub activation: Activation,
    pub shuffle: Shuffle,
    pub film: Option<ValueId>,
    pub residual: Option<Slice>,
    pub into: Option<Slice>,
}

impl Conv {
    /// A biased convolution of stride 1, nothing after it, named as its weight.
    pub fn new(name: &str, input: Slice, outputs: u32) -> Conv {
        Conv {
            name: name.into(),
            weight: ConvWeight::Tensor(name.into()),
            input,
            outputs,
            bias: true,
            stride: 1,
            activation: Activation::None,
            shuffle: Shuffle::None,
            film: None,
            residual: None,
            into: None,
        }
    }
}

/// A Linear to append; without `into` a new value takes the result.
pub(super) struct Linear {
    pub name: String,
    pub weight: LinearWeight,
    pub inputs: Vec<Slice>,
    pub activation: Activation,
    pub film: Option<ValueId>,
    pub residual: Option<Slice>,
    pub into: Option<Slice>,
}

impl Linear {
    /// A biased Linear of one tensor, nothing after it, named as its tensor.
    pub fn new(name: &str, inputs: Vec<Slice>, outputs: u32) -> Linear {
        Linear::stacked(name, inputs, vec![LinearPart { prefix: name.into(), outputs }])
    }

    /// A biased Linear of several tensors stacked along the outputs, nothing after it.
    pub fn stacked(name: &str, inputs: Vec<Slice>, parts: Vec<LinearPart>) -> Linear {
        let columns = inputs.iter().map(|s| s.channels).sum();
        Linear {
            name: name.into(),
            weight: LinearWeight { parts, inputs: columns, columns: 0..columns, bias: true, norm: None },
            inputs,
            activation: Activation::None,
            film: None,
            residual: None,
            into: None,
        }
    }
}

impl Builder {
    /// An empty graph.
    pub fn new() -> Builder {
        Builder { values: Vec::new(), ops: Vec::new(), stage: Stage::Input }
    }

    /// Appends a map.
    pub fn map(&mut self, name: &str, stride: u32, channels: u32) -> Slice {
        let value = self.value(name, Shape::Map { stride, channels });
        Slice { value, first: 0, channels }
    }

    pub fn conv(&mut self, conv: Conv) -> Slice {
        let Conv { name, weight, input, outputs, bias, stride, activation, shuffle, film, residual, into } = conv;
        let step = self.stride(input) * stride;
        let (step, channels) = match shuffle {
            Shuffle::None => (step, outputs),
            Shuffle::Unshuffle => (step * 2, outputs * 4),
            Shuffle::Shuffle => (step / 2, outputs / 4),
        };
        let output = into.unwrap_or_else(|| self.map(&name, step, channels));
        let kind = OpKind::Conv3x3 { input, weight, bias, stride, activation, shuffle, film, residual, output };
        self.push(name, kind);
        output
    }

    pub fn linear(&mut self, linear: Linear) -> Slice {
        let Linear { name, weight, inputs, activation, film, residual, into } = linear;
        let channels = weight.parts.iter().map(|p| p.outputs).sum();
        let stride = self.stride(inputs[0]);
        let output = into.unwrap_or_else(|| self.map(&name, stride, channels));
        self.push(name, OpKind::Linear { inputs, weight, activation, film, residual, output });
        output
    }

    pub fn depthwise(&mut self, name: &str, input: Slice, activation: Activation) -> Slice {
        let output = self.map(name, self.stride(input), input.channels);
        let (weight, value) = (name.to_owned(), output.value);
        self.push(name.into(), OpKind::Depthwise3x3 { input, weight, activation, output: value });
        output
    }

    pub fn layer_norm(&mut self, name: &str, input: Slice) -> Slice {
        let output = self.map(name, self.stride(input), input.channels);
        self.push(name.into(), OpKind::LayerNorm { input, norm: name.into(), output: output.value });
        output
    }

    /// `[gamma | beta]` of a FiLM-CNN block called `prefix`, from its auxiliary map.
    pub fn film(&mut self, prefix: &str, f: Slice) -> ValueId {
        let (mean_name, name) = (format!("{prefix}.film_mean"), format!("{prefix}.film"));
        let mean = self.value(&mean_name, Shape::Vector { len: f.channels });
        self.push(mean_name, OpKind::FilmMean { input: f, norm: format!("{prefix}.norm1_f"), output: mean });
        let output = self.value(&name, Shape::Vector { len: 2 * f.channels });
        self.push(name.clone(), OpKind::FilmVector { input: mean, weight: name, output });
        output
    }

    pub fn push(&mut self, name: String, kind: OpKind) {
        self.ops.push(Op { name, stage: self.stage, kind });
    }

    /// The side of a token of `map` in pixels.
    pub fn stride(&self, map: Slice) -> u32 {
        match self.values[map.value.0].shape {
            Shape::Map { stride, .. } => stride,
            Shape::Vector { .. } => 1,
        }
    }

    fn value(&mut self, name: &str, shape: Shape) -> ValueId {
        self.values.push(Value { name: name.into(), shape });
        ValueId(self.values.len() - 1)
    }
}

//! Exact folds: operations that follow each other with nothing nonlinear between them become one, and what nobody reads
//! is not computed. A folded graph computes the same residual but for rounding; it reads the same tensors, and makes
//! its weights of them.

use super::ParseError;
use super::graph::Graph;
use super::op::{Activation, ConvWeight, LinearWeight, Op, OpKind, Shape, Shuffle, Slice};
use super::weights::{Weights, WeightsError};
use crate::parallel;
use std::borrow::Cow;
use std::str::FromStr;

/// Which operations are folded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Folds {
    /// Patch unembedding, its shuffle and the output convolution into one: a sixth of their work, and no map of the
    /// frame's full size between them.
    pub unembed: bool,
    /// The half of a skip's Linear that reads what was upsampled, into the convolution that upsamples, which adds the
    /// other half: that waits for the encoder alone.
    pub skip: bool,
    /// Channels that nobody reads: most of what the last Down makes of the features, where attention is partial.
    pub unread: bool,
    /// Layer normalisations into the Linear that alone reads them, of at most 128 channels: the normed map is not
    /// written and read again. It pays where a kernel holds all channels of a token.
    pub norm: bool,
}

/// Most input channels of a Linear that takes in the norm before it.
const NORMED_INPUTS: u32 = 128;

impl Folds {
    /// Every operation as the network has it.
    pub const NONE: Self = Self { unembed: false, skip: false, unread: false, norm: false };
    /// Those that make less work on every device.
    pub const EVERYWHERE: Self = Self { unembed: true, skip: true, unread: true, norm: false };
    /// All of them.
    pub const ALL: Self = Self { unembed: true, skip: true, unread: true, norm: true };
}

impl FromStr for Folds {
    type Err = ParseError;

    /// `all`, `none`, or a list of `unembed`, `skip`, `unread` and `norm` with commas between.
    fn from_str(text: &str) -> Result<Self, ParseError> {
        let mut folds = Self::NONE;
        for name in text.split(',') {
            match name {
                "all" => folds = Self::ALL,
                "none" => {}
                "unembed" => folds.unembed = true,
                "skip" => folds.skip = true,
                "unread" => folds.unread = true,
                "norm" => folds.norm = true,
                other => {
                    let reason = format!("'{other}'; it can be all, none, or some of unembed, skip, unread and norm");
                    return Err(ParseError { what: "folds", reason });
                }
            }
        }
        Ok(folds)
    }
}

impl Graph {
    /// The same network with fewer operations or less work in them. [`Graph::tensors`] gives the shapes that the
    /// operations use, which may be a part of what a weights file holds.
    pub fn folded(&self, folds: Folds) -> Graph {
        let mut graph = self.clone();
        if folds.unembed {
            graph.fold_unembed();
        }
        if folds.skip {
            graph.fold_skips();
        }
        if folds.unread {
            graph.drop_unread();
        }
        if folds.norm {
            graph.fold_norms();
        }
        graph
    }

    fn fold_unembed(&mut self) {
        let found = self.ops.windows(2).position(|pair| self.unembed(pair).is_some());
        let folded = found.and_then(|at| self.unembed(&self.ops[at..at + 2]).map(|op| (at, op)));
        if let Some((at, op)) = folded {
            self.ops.splice(at..at + 2, [op]);
        }
    }

    /// Two convolutions as one [`OpKind::Unembed`], where they are the two that it stands for.
    fn unembed(&self, pair: &[Op]) -> Option<Op> {
        let [first, second] = pair else { return None };
        let (from, spread, between) = plain_shuffle(first)?;
        let OpKind::Conv3x3 {
            input,
            weight: ConvWeight::Tensor(gather),
            bias: true,
            stride: 1,
            activation: Activation::None,
            shuffle: Shuffle::None,
            film: None,
            residual: None,
            output,
        } = &second.kind
        else {
            return None;
        };
        let fits = *input == between && self.is_read_once(between) && output.channels == 3;
        (fits && from.channels == between.channels).then(|| Op {
            kind: OpKind::Unembed { input: from, spread: spread.into(), gather: gather.clone(), output: *output },
            ..second.clone()
        })
    }

    fn fold_skips(&mut self) {
        for at in 1..self.ops.len() {
            let Some((linear, conv)) = self.skip(at) else { continue };
            // The map between them is now the Linear's, and named after it.
            let [between, result] = [&linear, &conv].map(|op| self.result(op).value.0);
            let names = [between, result].map(|value| self.values[value].name.clone());
            [self.values[result].name, self.values[between].name] = names;
            (self.ops[at - 1], self.ops[at]) = (linear, conv);
        }
    }

    /// A Linear on `[up | skip]` right after the convolution that makes `up`: the Linear on the skip alone, and the
    /// convolution with its new weight, which adds that one's result.
    fn skip(&self, at: usize) -> Option<(Op, Op)> {
        let (input, conv, up) = plain_shuffle(&self.ops[at - 1])?;
        let OpKind::Linear { inputs, weight, activation, film: None, residual: None, output } = &self.ops[at].kind
        else {
            return None;
        };
        let ([first, skip], [part]) = (&inputs[..], &weight.parts[..]) else { return None };
        let fits = *first == up && self.is_read_once(up) && up.channels == output.channels && weight.columns.start == 0;
        fits.then(|| {
            let mixed = ConvWeight::Mixed { conv: conv.into(), linear: part.prefix.clone(), columns: weight.inputs };
            let mut rest = weight.clone();
            rest.columns.start = up.channels;
            let linear = OpKind::Linear {
                inputs: vec![*skip],
                weight: rest,
                activation: Activation::None,
                film: None,
                residual: None,
                output: up,
            };
            let conv = OpKind::Conv3x3 {
                input,
                weight: mixed,
                bias: false,
                stride: 1,
                activation: *activation,
                shuffle: Shuffle::Shuffle,
                film: None,
                residual: Some(up),
                output: *output,
            };
            (Op { kind: linear, ..self.ops[at].clone() }, Op { kind: conv, ..self.ops[at - 1].clone() })
        })
    }

    fn drop_unread(&mut self) {
        for at in 0..self.ops.len() {
            let OpKind::Conv3x3 { shuffle: Shuffle::Unshuffle, output, film: None, residual: None, .. } =
                self.ops[at].kind
            else {
                continue;
            };
            if self.residual == output.value || output != self.whole(output.value) {
                continue;
            }
            let reads = self.ops.iter().flat_map(|op| self.reads(op)).filter(|slice| slice.value == output.value);
            // Kernels compute vectors of four outputs, each of which becomes four channels.
            let read = reads.map(|slice| slice.first + slice.channels).max().unwrap_or(0).next_multiple_of(16);
            if let Shape::Map { channels, .. } = &mut self.values[output.value.0].shape {
                *channels = read.min(*channels);
            }
            let whole = self.whole(output.value);
            if let OpKind::Conv3x3 { output, .. } = &mut self.ops[at].kind {
                *output = whole;
            }
        }
    }

    fn fold_norms(&mut self) {
        while let Some((norm, linear, kind)) = (0..self.ops.len()).find_map(|at| self.normed(at)) {
            self.ops[linear].kind = kind;
            self.ops.remove(norm);
        }
    }

    /// The position of a layer normalisation, that of the Linear that alone reads its result, and the two in one.
    fn normed(&self, norm: usize) -> Option<(usize, usize, OpKind)> {
        let OpKind::LayerNorm { input, norm: prefix, output } = &self.ops[norm].kind else { return None };
        let normed = self.whole(*output);
        let at = (norm..self.ops.len()).find(|&at| self.reads(&self.ops[at]).contains(&normed))?;
        let OpKind::Linear { inputs, weight, .. } = &self.ops[at].kind else { return None };
        let fits = *inputs == [normed] && self.is_read_once(normed) && input.channels <= NORMED_INPUTS;
        fits.then(|| {
            let mut kind = self.ops[at].kind.clone();
            if let OpKind::Linear { inputs, weight: into, .. } = &mut kind {
                *inputs = vec![*input];
                *into = LinearWeight { norm: Some(prefix.clone()), ..weight.clone() };
            }
            (norm, at, kind)
        })
    }

    /// Whether one operation reads a map, all of it, and it is not the result.
    fn is_read_once(&self, map: Slice) -> bool {
        let reads = self.ops.iter().flat_map(|op| self.reads(op)).filter(|slice| slice.value == map.value);
        map == self.whole(map.value) && reads.count() == 1 && self.residual != map.value
    }
}

/// Input, tensor prefix and output of a convolution without bias and anything after it but a pixel shuffle.
fn plain_shuffle(op: &Op) -> Option<(Slice, &str, Slice)> {
    match &op.kind {
        OpKind::Conv3x3 {
            input,
            weight: ConvWeight::Tensor(prefix),
            bias: false,
            stride: 1,
            activation: Activation::None,
            shuffle: Shuffle::Shuffle,
            film: None,
            residual: None,
            output,
        } => Some((*input, prefix, *output)),
        _ => None,
    }
}

impl ConvWeight {
    /// The weight's values, row by row; products are summed in f64 and rounded once.
    ///
    /// # Errors
    /// [`WeightsError::Missing`].
    pub fn values<'a>(&self, weights: &'a Weights) -> Result<Cow<'a, [f32]>, WeightsError> {
        let tensor = |prefix: &str| weights.tensor(&format!("{prefix}.weight"));
        Ok(match self {
            Self::Tensor(prefix) => Cow::Borrowed(&tensor(prefix)?.data),
            Self::Mixed { conv, linear, columns } => {
                let (conv, linear) = (tensor(conv)?, tensor(linear)?);
                let row = conv.data.len() / conv.shape.first().map_or(1, |rows| *rows as usize);
                Cow::Owned(mixed(&conv.data, row, &linear.data, *columns as usize))
            }
        })
    }

    /// The biases, where there are any.
    ///
    /// # Errors
    /// [`WeightsError::Missing`].
    pub fn biases<'a>(&self, bias: bool, weights: &'a Weights) -> Result<Option<&'a [f32]>, WeightsError> {
        match self {
            Self::Tensor(prefix) if bias => Ok(Some(&weights.tensor(&format!("{prefix}.bias"))?.data)),
            _ => Ok(None),
        }
    }
}

/// Rows of a Linear that are multiplied together, so that a convolution's row is loaded once for all of them.
const ROWS: usize = 4;

/// Rows `4 c + phase` of a convolution, each `row` long, mixed by a matrix of `columns` columns, of which the first
/// count.
fn mixed(conv: &[f32], row: usize, linear: &[f32], columns: usize) -> Vec<f32> {
    let channels = conv.len() / row / 4;
    let groups: Vec<_> = linear.chunks(ROWS * columns).collect();
    let mix = |group: &&[f32]| {
        let mut out = vec![0.0; group.len() / columns * 4 * row];
        for phase in 0..4 {
            let mut sums = vec![[0.0f64; ROWS]; row];
            for c in 0..channels {
                let factors: [f64; ROWS] =
                    std::array::from_fn(|i| group.get(i * columns + c).map_or(0.0, |&factor| factor.into()));
                for (sums, &weight) in sums.iter_mut().zip(&conv[(4 * c + phase) * row..][..row]) {
                    let weight = f64::from(weight);
                    sums.iter_mut().zip(factors).for_each(|(sum, factor)| *sum += factor * weight);
                }
            }
            for (i, out) in out.chunks_exact_mut(4 * row).enumerate() {
                let own = &mut out[phase * row..][..row];
                own.iter_mut().zip(&sums).for_each(|(out, sums)| *out = sums[i] as f32);
            }
        }
        out
    };
    parallel::map(&groups, mix).concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::net::arch::Arch;
    use crate::net::cost::flops;

    #[test]
    fn folds_leave_out_what_they_say() {
        let graph = Graph::new(&Arch::hybrid()).unwrap();
        let saved = |folds| {
            let [all, left] = [&graph, &graph.folded(folds)].map(|g| flops(g, 1024, 1024).total());
            format!("{:.2}", (all - left) as f64 * 1e-9)
        };
        assert_eq!(saved(Folds { unembed: true, ..Folds::NONE }), "17.92");
        assert_eq!(saved(Folds { skip: true, ..Folds::NONE }), "1.61");
        assert_eq!(saved(Folds { unread: true, ..Folds::NONE }), "1.81");
        // A norm costs nothing in this count: all but those of the FiLM blocks' convolutions and the bottleneck's FFNs
        // are gone.
        let norms = |graph: &Graph| graph.ops.iter().filter(|op| matches!(op.kind, OpKind::LayerNorm { .. })).count();
        assert_eq!((norms(&graph), norms(&graph.folded(Folds { norm: true, ..Folds::NONE }))), (46, 4));
        assert_eq!(graph.folded(Folds::NONE), graph);
        assert_eq!("skip,norm,unembed,unread".parse::<Folds>().unwrap(), Folds::ALL);
        assert_eq!("none".parse::<Folds>().unwrap(), Folds::NONE);
        assert!("skips".parse::<Folds>().is_err_and(|error| error.to_string().contains("'skips'")));
    }

    /// What cannot be folded stays as it is; nothing new is read.
    #[test]
    fn every_network_reads_its_own_tensors() {
        for name in Arch::NAMES {
            let graph = Graph::new(&Arch::named(name).unwrap()).unwrap();
            let names = |graph: &Graph| {
                let mut names: Vec<_> = graph.tensors().into_iter().map(|tensor| tensor.name).collect();
                names.sort();
                names
            };
            assert_eq!(names(&graph.folded(Folds::ALL)), names(&graph), "{name}");
        }
    }

    #[test]
    fn a_mixed_weight_is_the_product() {
        // Two channels of four phases, rows of one weight; a matrix of two rows on [up | skip].
        let conv = [1., 2., 3., 4., 10., 20., 30., 40.];
        let linear = [1., 2., 9., 9., 0.5, -1., 9., 9.];
        assert_eq!(mixed(&conv, 1, &linear, 4), [21., 42., 63., 84., -9.5, -19., -28.5, -38.]);
    }
}

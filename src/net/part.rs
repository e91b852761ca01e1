//! Graphs of a part of a network by itself, for measurements: one block, one convolution.

use super::arch::{Arch, ArchError, Block, Bottleneck, Convolution, Decoder, StageSpec, WINDOW};
use super::blocks::{Place, block};
use super::builder::{Builder, Conv, Linear};
use super::graph::Graph;
use super::op::{Activation, Slice, Stage};
use super::head::Head;

/// Name of the block, and so of its tensors: those of the first block of [`Graph::arch`].
const PREFIX: &str = "enc.0.0";

impl Graph {
    /// One block on maps of `channels` at one token a pixel: `color` and `aux` are its two inputs, `residual` its
    /// result. The weights are those of a whole network, [`Graph::arch`], whose first block it is.
    ///
    /// # Errors
    /// What [`Arch::validate`] finds.
    pub fn of_block(kind: Block, channels: u32) -> Result<Self, ArchError> {
        Self::part(kind, channels, |b, x, f| block(b, kind, 1, Place { prefix: PREFIX, x, f, into: None }))
    }

    /// The convolution of a FiLM-CNN block alone, from `color` to `residual`, with its bias and nothing after it.
    ///
    /// # Errors
    /// As [`Graph::of_block`].
    pub fn of_convolution(conv: Convolution, channels: u32) -> Result<Self, ArchError> {
        let name = format!("{PREFIX}.conv");
        Self::part(Block::FilmCnn { conv }, channels, |b, x, _| match conv {
            Convolution::Standard => b.conv(Conv::new(&name, x, channels)),
            Convolution::Separable => {
                let spread = b.depthwise(&format!("{name}.depthwise"), x, Activation::None);
                b.linear(Linear::new(&format!("{name}.pointwise"), vec![spread], channels))
            }
        })
    }

    fn part(
        kind: Block,
        channels: u32,
        build: impl FnOnce(&mut Builder, Slice, Slice) -> Slice,
    ) -> Result<Self, ArchError> {
        let arch = Arch {
            name: "part".into(),
            channels,
            window: WINDOW,
            patch: 1,
            decoder: Decoder::Symmetric,
            stages: vec![StageSpec { encoder_blocks: 1, decoder_blocks: 1, heads: 1, block: kind }],
            bottleneck: Bottleneck { blocks: 1, heads: 1, block: kind },
            head: Head::Residual,
        };
        arch.validate()?;
        let mut b = Builder::new();
        b.stage = Stage::Encoder(0);
        let (x, f) = (b.map("x", 1, channels), b.map("f", 1, channels));
        let result = build(&mut b, x, f);
        Ok(Self { arch, values: b.values, ops: b.ops, color: x.value, aux: f.value, residual: result.value })
    }
}

//! What a plan may choose: memory, and which of several lowerings an operation takes.

use super::conv_table::ConvTable;
use super::pack::Pack;
use super::quiet_mode::QuietMode;
use crate::kernels::dense::TILE_CHANNELS;
use crate::kernels::separable::Separable3x3;
use crate::kernels::winograd::WinogradTile;
use crate::kernels::{Arithmetic, Call, Storage};
use crate::net::Folds;
use crate::net::graph::{ConvWeight, Graph, OpKind, Shuffle};
use serde::{Deserialize, Serialize};

/// What a plan may choose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlanOptions {
    /// Largest block of the arena in bytes.
    pub max_block_bytes: u64,
    /// Gives every buffer a place of its own, so that all can be looked at after a run.
    pub keep_all: bool,
    /// Gives what depends on albedo, normal and depth alone, and is read by the rest, a place of its own: it can be used for
    /// the next frame.
    pub keep_features: bool,
    /// How quiet tiles are left out; `None`: none are.
    pub quiet: Option<QuietMode>,
    /// Which operations are folded into others before anything else is chosen.
    pub folds: Folds,
    /// How dense 3x3 convolutions are computed.
    pub conv: ConvAlgorithm,
    /// How those of some shapes are, in the place of [`PlanOptions::conv`].
    pub conv_table: ConvTable,
    /// How depthwise and pointwise convolutions that belong together are.
    pub separable: SeparableForm,
    /// How feature maps are stored. Log colour and residual are 32-bit floats always.
    pub storage: Storage,
    /// What dense kernels compute with, where one on matrices takes their maps: those of halves.
    pub arithmetic: Arithmetic,
    /// Bytes that a map between consecutive operations may take; where it would take more, they run band by band of the frame.
    /// Not where quiet tiles are left out.
    pub max_chain_bytes: u64,
}

/// [`PlanOptions::max_chain_bytes`] where nothing is said. Smaller bands compute more twice, larger ones take more memory: 32-bit
/// floats leave room in 2 GiB for a frame of 3840x2160, halves just fit 1 GiB. On matrices, whose kernels are short, each more
/// dispatch counts.
pub const fn max_chain_bytes(storage: Storage, arithmetic: Arithmetic) -> u64 {
    match (storage, arithmetic) {
        (Storage::F32, _) => 128 << 20,
        (Storage::F16, Arithmetic::Floats) => 24 << 20,
        (Storage::F16, Arithmetic::Matrices) => 96 << 20,
    }
}

impl Default for PlanOptions {
    /// No limit on memory, buffers share it; every fold that pays everywhere; direct convolutions, two kernels.
    fn default() -> Self {
        Self {
            max_block_bytes: u64::MAX,
            keep_all: false,
            keep_features: false,
            quiet: None,
            folds: Folds::EVERYWHERE,
            conv: ConvAlgorithm::default(),
            conv_table: ConvTable::default(),
            separable: SeparableForm::default(),
            storage: Storage::F32,
            arithmetic: Arithmetic::Floats,
            max_chain_bytes: max_chain_bytes(Storage::F32, Arithmetic::Floats),
        }
    }
}

impl PlanOptions {
    /// The forms and folds that suit a GPU, as far as GPUs were measured (`docs/performance.md`).
    pub fn for_gpu(storage: Storage, arithmetic: Arithmetic) -> Self {
        let (folds, separable) = match arithmetic {
            // A workgroup stages a token's channels once for all of its outputs.
            Arithmetic::Matrices => (Folds::ALL, SeparableForm::Fused),
            // No kernel holds all channels of a token, and a norm would be found anew for every 32 outputs.
            Arithmetic::Floats => (Folds::EVERYWHERE, SeparableForm::TwoKernels),
        };
        let max_chain_bytes = max_chain_bytes(storage, arithmetic);
        Self { folds, separable, storage, arithmetic, max_chain_bytes, ..Self::default() }
    }
}

/// How dense 3x3 convolutions of stride 1 to more than four channels are computed. Others are direct.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ConvAlgorithm {
    /// By the definition.
    #[default]
    Direct,
    /// By Winograd's minimal filtering.
    Winograd(WinogradTile),
}

impl ConvAlgorithm {
    /// The tile; `None`: direct.
    pub(super) fn tile(self) -> Option<WinogradTile> {
        match self {
            Self::Winograd(tile) => Some(tile),
            Self::Direct => None,
        }
    }
}

/// How a depthwise convolution whose result only the next, pointwise convolution reads is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum SeparableForm {
    /// As two kernels, the result between them in memory.
    #[default]
    TwoKernels,
    /// As one.
    Fused,
    /// As one where a workgroup computes all outputs of the pointwise one, as elsewhere each group of them would compute the
    /// depthwise one anew, and the pointwise one has more inputs than outputs.
    Narrow,
}

impl SeparableForm {
    /// Whether a pointwise convolution of so many inputs and outputs is one kernel with the depthwise one before it.
    pub(super) fn fuses(self, inputs: u32, outputs: u32) -> bool {
        match self {
            Self::TwoKernels => false,
            Self::Fused => true,
            Self::Narrow => outputs <= TILE_CHANNELS && outputs < inputs,
        }
    }
}

/// Whether operation `at` is a depthwise convolution whose whole result the next one, a Linear, reads, and nobody else.
pub(super) fn is_separable(graph: &Graph, at: usize) -> bool {
    let (Some(OpKind::Depthwise3x3 { output, .. }), Some(OpKind::Linear { inputs, .. })) =
        (graph.ops.get(at).map(|op| &op.kind), graph.ops.get(at + 1).map(|op| &op.kind))
    else {
        return false;
    };
    let readers = graph.ops.iter().filter(|op| graph.reads(op).iter().any(|slice| slice.value == *output)).count();
    *inputs == [graph.whole(*output)] && readers == 1 && graph.residual != *output
}

/// The weights of a dense 3x3 convolution, as the kernel that was chosen reads them.
pub(super) fn conv_pack(
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

/// The kernels of two operations that [`is_separable`], as one.
pub(super) fn fuse(depthwise: Call, pointwise: Call) -> Call {
    match (depthwise, pointwise) {
        (Call::Depthwise3x3(depthwise), Call::Linear(pointwise)) => {
            Call::Separable3x3(Separable3x3 { depthwise, pointwise })
        }
        other => unreachable!("{other:?} is no separable convolution"),
    }
}

//! Which of several lowerings operations take, where a caller wants another than suits the device.

use crate::kernels::dense::TILE_CHANNELS;
use crate::kernels::winograd::WinogradTile;

/// How dense 3x3 convolutions of stride 1 to more than four channels are computed. Others are direct.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum ConvAlgorithm {
    /// By the definition.
    #[default]
    Direct,
    /// By Winograd's minimal filtering.
    Winograd(WinogradTile),
}

impl ConvAlgorithm {
    /// The tile; `None`: direct.
    pub(crate) fn tile(self) -> Option<WinogradTile> {
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
    /// As one where a workgroup computes all outputs of the pointwise one, as elsewhere each group of them would
    /// compute the depthwise one anew, and the pointwise one has more inputs than outputs.
    Narrow,
}

impl SeparableForm {
    /// Whether a pointwise convolution of so many inputs and outputs is one kernel with the depthwise one before it.
    pub(crate) fn fuses(self, inputs: u32, outputs: u32) -> bool {
        match self {
            Self::TwoKernels => false,
            Self::Fused => true,
            Self::Narrow => outputs <= TILE_CHANNELS && outputs < inputs,
        }
    }
}

/// How a block's attention is computed, where there is a kernel for all of it: on matrices, of one head.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum AttentionForm {
    /// With its norms, Linears and residual as one kernel.
    #[default]
    Joined,
    /// As four kernels, their results between them in memory.
    FourKernels,
}

/// How an FFN is computed, where there is a kernel for all of it: on matrices, of 32 or 64 channels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum FfnForm {
    /// With its norm, Linears, depthwise convolution and residual as one kernel.
    #[default]
    Joined,
    /// As two kernels, the hidden channels between them in memory.
    TwoKernels,
}

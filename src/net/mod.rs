//! What is computed: the architecture as a value, the graph of typed operations it stands for, its weights and its
//! cost.
//!
//! ```text
//! Arch (JSON, ten named ones) --> Graph (values + ops, pure data) --> cost, table: parameters and FLOPs
//!                                    |
//!                                    +--> the tensors a weights file must hold --> Weights (checked on loading)
//! ```
//!
//! Nothing here knows of Vulkan or of a device.

pub mod arch;
mod blocks;
mod builder;
pub mod cost;
mod fold;
pub mod graph;
mod hashed;
pub mod head;
mod head_ops;
mod named;
pub mod op;
mod part;
mod rematerialize;
pub mod table;
mod unet;
pub mod weights;
mod weights_file;

pub use arch::{Arch, ArchError, Block, Bottleneck, Convolution, Decoder, StageSpec};
pub use fold::Folds;
pub use graph::{Graph, TensorSpec};
pub use op::{Activation, ConvWeight, LinearPart, LinearWeight, Op, OpKind, Shape, Shuffle, Slice, Stage, Value, ValueId};
pub use head::{Head, KernelHead};
pub use weights::{DepthRule, ExposureRule, Preprocessing, Tensor, Weights, WeightsError};

/// A word that names nothing.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{what}: {reason}")]
pub struct ParseError {
    /// What it was to name.
    pub what: &'static str,
    /// The word, and those that there are.
    pub reason: String,
}

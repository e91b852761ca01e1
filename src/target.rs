//! What a plan is made for: everything that the device and the caller's options decide, decided once.

use crate::kernels::contract::Need;
use crate::kernels::{Arithmetic, KernelTarget, Storage};
use crate::net::Folds;
use crate::options::{AttentionForm, ConvAlgorithm, ConvergedMode, FfnForm, Options, Precision, SeparableForm};
use crate::vk::caps::{Caps, DeviceKind, TEXEL_BYTES};

/// Largest block of an arena, whatever the device allows: beyond it some drivers' allocations grow unreliable.
const MAX_BLOCK_BYTES: u64 = 4 << 30;

/// What a device and the caller's options make of a network: how it is stored, computed and cut. Pure data; a plan for
/// another device than the one at hand needs no more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target {
    /// What kernels are chosen by, beside their arguments.
    pub kernels: KernelTarget,
    /// Largest block of the arena in bytes.
    pub max_block_bytes: u64,
    /// Gives every buffer a place of its own, so that all can be looked at after a run.
    pub keep_all: bool,
    /// Gives what depends on albedo, normal and depth alone, and is read by the rest, a place of its own: it can be
    /// used for the next frame.
    pub keep_features: bool,
    /// Whether albedo is taken as it is, not filtered where it is noisy.
    pub clean_aux: bool,
    /// Whether it is a tile of a larger frame, which gives what is of the whole ([`crate::plan::tile`]): the places of
    /// that are kept for it. Not with `converged` and `keep_features`.
    pub of_tile: bool,
    /// How converged tiles are left out; `None`: none are.
    pub converged: Option<ConvergedMode>,
    /// Whether the result is the average of the frame's and of what the frame turned by half a circle gives, by the
    /// same network or by another ([`crate::plan::Networks`]). Not with `of_tile` and `keep_features`.
    pub self_ensemble: bool,
    /// Whether signals beside the colour can go through the predicted kernels.
    pub signals: bool,
    /// Which operations are folded into others before anything else is chosen.
    pub folds: Folds,
    /// How dense 3x3 convolutions are computed.
    pub conv: ConvAlgorithm,
    /// How depthwise and pointwise convolutions that belong together are.
    pub separable: SeparableForm,
    /// How a block's attention and its Linears are.
    pub attention: AttentionForm,
    /// How an FFN is.
    pub ffn: FfnForm,
    /// How feature maps are stored. Log colour and residual are 32-bit floats always.
    pub storage: Storage,
    /// What dense kernels compute with, where one on matrices takes their maps: those of halves.
    pub arithmetic: Arithmetic,
    /// Bytes that a map between consecutive operations may take; where it would take more, they run band by band of the
    /// frame. Not where converged tiles are left out.
    pub max_chain_bytes: u64,
    /// Bytes that a map may take which the network makes at its beginning and reads at its end; where it would take
    /// more, it is made again at the end, in bands. Not where converged tiles are left out or features kept.
    pub max_kept_bytes: u64,
    /// Bytes of a buffer up to which dispatches that do not depend on each other run side by side; those that touch a
    /// larger one keep the network's order, in which least memory is needed at once.
    pub overlap_bytes: u64,
}

/// [`Target::overlap_bytes`] where nothing is said. On matrices what touches more keeps the largest GPU busy for as
/// long as a wait takes (32 MiB: 11 us of an H100's memory): running beside others would gain little, and take more
/// memory. On ordinary cores kernels take four times as long.
pub const fn overlap_bytes(arithmetic: Arithmetic) -> u64 {
    match arithmetic {
        Arithmetic::Floats => 8 << 20,
        Arithmetic::Matrices => 32 << 20,
    }
}

/// [`Target::max_chain_bytes`] where nothing is said. Smaller bands compute more twice, larger ones take more memory:
/// 32-bit floats leave room in 2 GiB for a frame of 3840x2160, halves just fit 1 GiB. On matrices, whose kernels are
/// short, each more dispatch counts.
pub const fn max_chain_bytes(storage: Storage, arithmetic: Arithmetic) -> u64 {
    match (storage, arithmetic) {
        (Storage::F32, _) => 128 << 20,
        (Storage::F16, Arithmetic::Floats) => 24 << 20,
        (Storage::F16, Arithmetic::Matrices) => 96 << 20,
    }
}

/// [`Target::max_kept_bytes`] where nothing is said. A map that is made again costs a twelfth of a pass' FLOPs: of
/// halves it is from some 2900x1450 pixels on, at 3840x2160 for 0.5 GB less; of 32-bit floats from twice as many.
pub const fn max_kept_bytes(storage: Storage) -> u64 {
    match storage {
        Storage::F32 => 1 << 30,
        Storage::F16 => 256 << 20,
    }
}

/// The same where [`Options::max_chain_bytes`] are given: so many maps of a chain.
const KEPT_MAPS: u64 = 4;

impl Default for Target {
    /// No limit on memory, buffers share it; every fold that pays everywhere; direct convolutions, two kernels.
    fn default() -> Self {
        Self {
            kernels: KernelTarget::default(),
            max_block_bytes: u64::MAX,
            keep_all: false,
            keep_features: false,
            clean_aux: false,
            of_tile: false,
            converged: None,
            self_ensemble: false,
            signals: false,
            folds: Folds::EVERYWHERE,
            conv: ConvAlgorithm::default(),
            separable: SeparableForm::default(),
            attention: AttentionForm::default(),
            ffn: FfnForm::default(),
            storage: Storage::F32,
            arithmetic: Arithmetic::Floats,
            max_chain_bytes: max_chain_bytes(Storage::F32, Arithmetic::Floats),
            max_kept_bytes: max_kept_bytes(Storage::F32),
            overlap_bytes: overlap_bytes(Arithmetic::Floats),
        }
    }
}

impl Target {
    /// The forms and folds that suit a GPU, as far as GPUs were measured (`docs/performance.md`).
    pub fn for_gpu(storage: Storage, arithmetic: Arithmetic) -> Self {
        let (folds, separable) = match arithmetic {
            // A workgroup stages a token's channels once for all of its outputs.
            Arithmetic::Matrices => (Folds::ALL, SeparableForm::Fused),
            // No kernel holds all channels of a token, and a norm would be found anew for every 32 outputs.
            Arithmetic::Floats => (Folds::EVERYWHERE, SeparableForm::TwoKernels),
        };
        Self {
            folds,
            separable,
            storage,
            arithmetic,
            max_chain_bytes: max_chain_bytes(storage, arithmetic),
            max_kept_bytes: max_kept_bytes(storage),
            overlap_bytes: overlap_bytes(arithmetic),
            ..Self::default()
        }
    }
}

impl Target {
    /// Of a device and options.
    ///
    /// # Errors
    /// What the device lacks of what the options ask for.
    pub fn new(caps: &Caps, options: &Options) -> Result<Self, Need> {
        let (storage, arithmetic) = (storage(caps, options.precision)?, arithmetic(caps, options.precision)?);
        let cpu = prefers_cpu_kernels(caps);
        let suitable = Self::for_gpu(storage, arithmetic);
        let suitable = match arithmetic {
            Arithmetic::Floats if cpu => Self { separable: SeparableForm::Narrow, folds: Folds::ALL, ..suitable },
            _ => suitable,
        };
        Ok(Self {
            kernels: KernelTarget { cpu, ..KernelTarget::default() },
            max_block_bytes: max_block_bytes(caps),
            folds: options.folds.unwrap_or(suitable.folds),
            conv: options.conv.unwrap_or(suitable.conv),
            separable: options.separable.unwrap_or(suitable.separable),
            attention: options.attention.unwrap_or(suitable.attention),
            ffn: options.ffn.unwrap_or(suitable.ffn),
            max_chain_bytes: options.max_chain_bytes.unwrap_or(suitable.max_chain_bytes),
            max_kept_bytes: options.max_chain_bytes.map_or(suitable.max_kept_bytes, |b| b.saturating_mul(KEPT_MAPS)),
            keep_features: options.keep_features,
            clean_aux: options.clean_aux,
            converged: options.converged.map(|converged| converged.mode),
            self_ensemble: options.self_ensemble,
            signals: options.signals,
            ..suitable
        })
    }

    /// The precision that it is of, never [`Precision::Auto`].
    pub fn precision(&self) -> Precision {
        match (self.arithmetic, self.storage) {
            (Arithmetic::Matrices, _) => Precision::Matrix,
            (Arithmetic::Floats, Storage::F32) => Precision::F32,
            (Arithmetic::Floats, Storage::F16) => Precision::F16,
        }
    }
}

/// Largest block of an arena on a device.
pub(crate) fn max_block_bytes(caps: &Caps) -> u64 {
    // A kernel that reads a map as texels must reach all of it: four halves each, at the least.
    let texels = if prefers_cpu_kernels(caps) { u64::from(caps.max_texels) * TEXEL_BYTES / 2 } else { u64::MAX };
    caps.max_buffer_bytes.min(MAX_BLOCK_BYTES).min(texels)
}

/// On CPU drivers a load costs more than the arithmetic it feeds (measured on lavapipe).
pub(crate) fn prefers_cpu_kernels(caps: &Caps) -> bool {
    caps.kind == DeviceKind::Cpu && caps.meets(Need::CpuDriver)
}

/// How feature maps are to be stored.
fn storage(caps: &Caps, precision: Precision) -> Result<Storage, Need> {
    let has_halves = caps.meets(Need::Storage16);
    match precision {
        Precision::F32 => Ok(Storage::F32),
        // Devices have no matrices without.
        Precision::Matrix => Ok(Storage::F16),
        Precision::F16 if has_halves => Ok(Storage::F16),
        Precision::F16 => Err(Need::Storage16),
        // A CPU would gain time too (docs/performance.md), and stays exact instead.
        Precision::Auto => Ok(if caps.kind != DeviceKind::Cpu && has_halves { Storage::F16 } else { Storage::F32 }),
    }
}

/// What dense kernels are to compute with.
fn arithmetic(caps: &Caps, precision: Precision) -> Result<Arithmetic, Need> {
    let has_matrices = caps.meets(Need::Matrix);
    match precision {
        Precision::F32 | Precision::F16 => Ok(Arithmetic::Floats),
        Precision::Matrix if has_matrices => Ok(Arithmetic::Matrices),
        Precision::Matrix => Err(Need::Matrix),
        // On a CPU they only take longer.
        Precision::Auto if has_matrices && caps.kind != DeviceKind::Cpu => Ok(Arithmetic::Matrices),
        Precision::Auto => Ok(Arithmetic::Floats),
    }
}

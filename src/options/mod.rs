//! What a caller chooses: for a denoiser ([`Options`]) and for each frame ([`FrameOptions`]); and what comes back
//! ([`Report`]).

mod forms;
mod converged;

use crate::error::{Error, Result};
use crate::frame::Region;
use crate::kernels::frame_io::Fireflies;
use crate::net::Folds;
use crate::renderer::BufferAddress;
use std::fmt;
use std::str::FromStr;

pub use forms::{AttentionForm, ConvAlgorithm, FfnForm, SeparableForm};
pub use converged::{Converged, ConvergedMargins, ConvergedMode};

/// Arithmetic and storage of the network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Precision {
    /// The best for the device.
    #[default]
    Auto,
    /// 32-bit floats throughout.
    F32,
    /// Feature maps stored as halves, for half of the memory; arithmetic, log colour and residual are 32-bit floats.
    F16,
    /// Feature maps stored as halves, and what is dense on cooperative matrices ([`crate::Device::has_matrices`]):
    /// products of halves, summed in 32-bit floats, as are all other operations. What GPUs with matrices take by
    /// themselves.
    Matrix,
}

impl FromStr for Precision {
    type Err = Error;

    /// `auto`, `fp32`, `fp16` or `matrix`.
    fn from_str(text: &str) -> Result<Self> {
        match text {
            "auto" => Ok(Self::Auto),
            "fp32" => Ok(Self::F32),
            "fp16" => Ok(Self::F16),
            "matrix" => Ok(Self::Matrix),
            other => Err(Error::InvalidOption {
                option: "precision",
                reason: format!("'{other}'; it can be auto, fp32, fp16 or matrix"),
            }),
        }
    }
}

impl fmt::Display for Precision {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Auto => "auto",
            Self::F32 => "fp32",
            Self::F16 => "fp16",
            Self::Matrix => "matrix",
        })
    }
}

/// The factor on the colour before the network's logarithm; undone at the end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Exposure {
    /// From the frame itself: 0.18 over its key (`docs/neutral.md`).
    #[default]
    Auto,
    /// Given by the caller, a normal number above 0. One factor for all frames of a sequence keeps them from
    /// flickering: take [`Report::exposure`] of the first.
    Fixed(f32),
    /// From a 32-bit float in a renderer's buffer, read when the recorded commands run: for an exposure that the GPU
    /// itself adapts. Where it is no normal number above 0, the frame's own. Not for the host path.
    Buffer(BufferAddress),
}

/// How a denoiser works.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// Arithmetic and storage.
    pub precision: Precision,
    /// Exposure of the host path.
    pub exposure: Exposure,
    /// Share of the noisy colour in the host path's result, 0 (all denoised) to 1 (all noisy).
    pub blend: f32,
    /// What the host path does with fireflies.
    pub fireflies: Fireflies,
    /// Whether albedo and normals are free of noise, or were denoised before. Else albedo is a mean of 7x7 pixels where
    /// it and the normals are noisy, as in glass, rough reflections and depth of field (`docs/neutral.md`); what is not
    /// noisy keeps its bits.
    pub clean_aux: bool,
    /// Which of the network's operations are folded into others: the same result but for rounding, for less work.
    /// `None`: those that pay on the device.
    pub folds: Option<Folds>,
    /// How dense 3x3 convolutions are computed; `None`: as suits the device.
    pub conv: Option<ConvAlgorithm>,
    /// How separable convolutions are; `None`: as suits the device.
    pub separable: Option<SeparableForm>,
    /// How a block's attention is; `None`: as suits the device.
    pub attention: Option<AttentionForm>,
    /// How an FFN is; `None`: as suits the device.
    pub ffn: Option<FfnForm>,
    /// Most device memory that a frame may take (arena, weights and, in the host path, staging), in bytes. The host
    /// path cuts a frame that needs more into tiles ([`Report::tiles`]), and refuses one of which no tile fits; a
    /// renderer's pass is refused. Nothing is allocated before that. `None`: what the device has.
    pub memory_budget: Option<u64>,
    /// Bytes that a map between kernels that follow each other may take; where it would take more, they run band by
    /// band of the frame, which takes less memory and a little more work. The bits stay the same. `None`:
    /// what suits the device.
    pub max_chain_bytes: Option<u64>,
    /// Whether what depends on albedo, normal and depth alone is kept between frames, for a camera that stands still:
    /// [`FrameOptions::features_unchanged`], [`crate::Denoiser::set_features_unchanged`]. It costs device memory.
    pub keep_features: bool,
    /// What is left out as it needs no denoising; `None`: nothing. A frame in tiles is denoised everywhere.
    pub converged: Option<Converged>,
    /// Whether the result is the average of what the network makes of the frame and of the frame turned by half a
    /// circle (geometric self-ensemble: Lim et al., "Enhanced Deep Residual Networks for Single Image
    /// Super-Resolution", 2017). It takes twice the time, 12 bytes more a pixel and as much as each signal, and gains
    /// 0.05 to 0.15 dB (`docs/quality.md`). The turned frame may go through another network
    /// ([`Weights::averaged_with`](crate::Weights::averaged_with)). A frame in tiles is denoised once, by the first.
    /// Not with [`Options::keep_features`].
    pub self_ensemble: bool,
    /// Whether frames may come with signals that go through the kernels of their colour ([`crate::Signal`],
    /// [`crate::Denoiser::denoise_with`], [`crate::Pass::bind_buffers_with`]). For weights that predict kernels and
    /// nothing else, as those of the network that ships do; it may cost device memory.
    pub signals: bool,
    /// Whether recordings label every kernel, by the names of [`crate::KernelRecord`], and not the pass alone, for
    /// graphics debuggers. Labels are there where the device has `VK_EXT_debug_utils`
    /// ([`RendererDevice::debug_utils`](crate::RendererDevice::debug_utils)).
    pub label_kernels: bool,
}

/// What one call of the host path did.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Report {
    /// The factor on the colour that was used.
    pub exposure: f32,
    /// Milliseconds of the device, by timestamps around the pass; `None` where its queue has none.
    pub gpu_ms: Option<f64>,
    /// Milliseconds of the whole call on the host: copies, device, wait. The first call of a size also plans, allocates
    /// and compiles.
    pub total_ms: f64,
    /// Share of the FLOPs of the whole frame's pass that were computed: 1, or less with
    /// [`crate::Denoiser::set_region`], [`crate::Denoiser::set_features_unchanged`] and [`Options::converged`]; more
    /// where tiles overlap.
    pub work: f64,
    /// Device memory that the library holds on the device, in bytes: arenas, weights and staging of all its denoisers
    /// there.
    pub device_bytes: u64,
    /// How the frame was cut, where it was too large for the device or the budget.
    pub tiles: Option<TileReport>,
}

/// How a frame was cut that does not fit the device or [`Options::memory_budget`] in whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileReport {
    /// Tiles.
    pub count: usize,
    /// Pixels beyond its own that a tile looks at, on each side where there is another.
    pub margin: u32,
    /// Whether a pixel depends on none beyond that: tiles then meet without a seam. Else they meet with one that is
    /// small (`docs/tiles.md`).
    pub exact: bool,
}

/// What may change from frame to frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameOptions {
    /// The factor on the colour.
    pub exposure: Exposure,
    /// Share of the noisy colour in the result, 0 (all denoised) to 1 (all noisy).
    pub blend: f32,
    /// What is done with fireflies.
    pub fireflies: Fireflies,
    /// Where the recorded commands write a [`FrameStatistics`](crate::FrameStatistics)(FrameStatistics).
    pub statistics: Option<BufferAddress>,
    /// The pixels that are wanted; `None`: all. Only what they depend on is computed and only they are written, with
    /// the bits that they have in the whole frame.
    pub region: Option<Region>,
    /// Whether albedo, normal and depth are those of the last recording of the pass that ran without this. What depends
    /// on them alone is not computed again and they are not read; the result has the same bits. For denoisers made with
    /// [`Options::keep_features`].
    ///
    /// Where they are not the same, the result belongs to no frame.
    pub features_unchanged: bool,
}

impl Default for FrameOptions {
    fn default() -> Self {
        Self {
            exposure: Exposure::Auto,
            blend: 0.0,
            fireflies: Fireflies::Auto,
            statistics: None,
            region: None,
            features_unchanged: false,
        }
    }
}

impl FrameOptions {
    pub(crate) fn check(&self) -> Result<()> {
        if !(0.0..=1.0).contains(&self.blend) {
            let reason = format!("{}; it must be in [0, 1]", self.blend);
            return Err(Error::InvalidOption { option: "blend", reason });
        }
        self.statistics.map_or(Ok(()), |place| place.check("statistics"))?;
        match self.exposure {
            Exposure::Buffer(place) => place.check("exposure"),
            Exposure::Fixed(factor) if !(factor.is_normal() && factor > 0.0) => Err(Error::InvalidOption {
                option: "exposure",
                reason: format!("{factor}; a fixed exposure must be a normal number above 0"),
            }),
            _ => Ok(()),
        }
    }
}

//! The public face: a denoiser, and the host path.

use crate::arena::{Arena, ArenaRequired};
use crate::engine::Engine;
use crate::error::{Error, Result};
use crate::frame::{Extent, Region};
use crate::host::HostPass;
use crate::kernels::frame_io::Fireflies;
use crate::memory::MemoryRequired;
use crate::net::weights::Weights;
use crate::options::{Exposure, FrameOptions, Options, Precision};
use crate::pass::Pass;
use crate::pipelines;
use crate::plan::active::ActiveTiles;
use crate::profile::KernelRecord;
use crate::target::Target;
use crate::tiling::Tiling;
use crate::vk::device::Device;
use crate::vk::statistics::PipelineStatistic;
use crate::vk::timestamps::Timestamps;
use std::fmt;
use std::sync::Arc;

/// A network on a device. `Send` and `Sync`; its host path takes `&mut self`.
pub struct Denoiser {
    pub(crate) engine: Arc<Engine>,
    pub(crate) options: FrameOptions,
    /// Whether the host path times its kernels.
    pub(crate) profiling: bool,
    /// The pass of the last size.
    pub(crate) host: Option<HostPass>,
    /// The tiles of the last size that was cut into such.
    pub(crate) tiling: Option<(Extent, Tiling)>,
}

impl fmt::Debug for Denoiser {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { engine, options, .. } = self;
        let arch = &engine.graph.arch.name;
        f.debug_struct("Denoiser").field("arch", arch).field("options", options).finish_non_exhaustive()
    }
}

impl Denoiser {
    /// Puts the network on the device. Nothing that depends on a frame's size is made yet.
    ///
    /// # Errors
    /// [`Error::Weights`], [`Error::InvalidOption`], [`Error::OutOfMemory`], [`Error::Vulkan`].
    pub fn new(device: &Device, weights: &Weights, options: &Options) -> Result<Self> {
        let frame = check_options(options)?;
        Ok(Self::of(Engine::new(device, weights, options)?, frame))
    }

    /// For another target than the device's own.
    pub(crate) fn for_target(device: &Device, weights: &Weights, options: &Options, target: Target) -> Result<Self> {
        let frame = check_options(options)?;
        Ok(Self::of(Engine::for_target(device, weights, options, target)?, frame))
    }

    fn of(engine: Engine, options: FrameOptions) -> Self {
        Self { engine: Arc::new(engine), options, profiling: false, host: None, tiling: None }
    }

    /// Sets the host path's exposure.
    ///
    /// # Errors
    /// [`Error::InvalidOption`]; the exposure then stays as it was.
    pub fn set_exposure(&mut self, exposure: Exposure) -> Result<()> {
        let options = FrameOptions { exposure, ..self.options };
        check_host(&options)?;
        self.options = options;
        Ok(())
    }

    /// Sets the share of the noisy colour in the host path's result, 0 (all denoised) to 1 (all noisy).
    ///
    /// # Errors
    /// [`Error::InvalidOption`]; the share then stays as it was.
    pub fn set_blend(&mut self, blend: f32) -> Result<()> {
        let options = FrameOptions { blend, ..self.options };
        check_host(&options)?;
        self.options = options;
        Ok(())
    }

    /// Sets what the host path does with fireflies.
    pub fn set_fireflies(&mut self, fireflies: Fireflies) {
        self.options.fireflies = fireflies;
    }

    /// The pixels that the host path computes and writes from now on; `None`, as at first: all. They get the bits that
    /// the whole frame would give them; every other pixel of the output keeps what it holds. A region outside the frame
    /// is an error of the next call.
    pub fn set_region(&mut self, region: Option<Region>) {
        self.options.region = region;
    }

    /// Whether the host path's next calls take albedo, normal and depth to be those of the last call without this; off
    /// at first. It then looks at no feature that it is given, and does not compute again what depends on them alone.
    /// The result has the same bits. For denoisers made with [`Options::keep_features`]; without them, and where no
    /// frame of the size was denoised before, the next call is an error.
    pub fn set_features_unchanged(&mut self, unchanged: bool) {
        self.options.features_unchanged = unchanged;
    }

    /// Whether the host path times every kernel from now on; [`Denoiser::records`] has the times. Off at first.
    ///
    /// # Errors
    /// [`Error::Unsupported`] where the device has no timestamps.
    pub fn set_profiling(&mut self, profiling: bool) -> Result<()> {
        if profiling {
            Timestamps::check(self.device())?;
        }
        self.profiling = profiling;
        Ok(())
    }

    /// What every kernel of the last call took, in the order in which they ran; empty without
    /// [`Denoiser::set_profiling`], and for a frame that was cut into tiles.
    pub fn records(&self) -> &[KernelRecord] {
        self.host.as_ref().map_or(&[], HostPass::records)
    }

    /// Which tiles the last call worked on; `None` without [`Options::converged`], and for a frame that was cut into
    /// tiles.
    pub fn active_tiles(&self) -> Option<&ActiveTiles> {
        self.host.as_ref().and_then(HostPass::active)
    }

    /// What the driver's compiler says of the kernels made for the device so far, by this and other denoisers:
    /// registers, spills, shared memory. Empty unless the device was opened with
    /// [`crate::DeviceOptions::pipeline_statistics`] and has them.
    ///
    /// # Errors
    /// [`Error::Vulkan`].
    pub fn pipeline_statistics(&self) -> Result<Vec<PipelineStatistic>> {
        pipelines::statistics(self.device())
    }

    /// The precision in use, never [`Precision::Auto`].
    pub fn precision(&self) -> Precision {
        self.engine.target.precision()
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.engine.device
    }

    /// The device memory that a frame size takes, from its plan: nothing is allocated. Where there is less, the host
    /// path takes less (`docs/tiles.md`).
    ///
    /// # Errors
    /// [`Error::EmptyFrame`], [`Error::FrameTooLarge`].
    pub fn memory_required(&self, extent: Extent) -> Result<MemoryRequired> {
        Ok(MemoryRequired::of_plan(&self.engine.plan(extent)?))
    }

    /// The memory of an arena in which passes of all these sizes fit, one at a time. Nothing is allocated. Smaller
    /// frames fit too ([`Denoiser::pass_in`]), but for what greedy placing in several blocks may leave over: list
    /// every size that must fit.
    ///
    /// # Errors
    /// As [`Denoiser::memory_required`].
    pub fn arena_required(&self, extents: &[Extent]) -> Result<ArenaRequired> {
        extents.iter().try_fold(ArenaRequired::default(), |required, &extent| {
            Ok(required.max(&ArenaRequired::of(&self.engine.plan(extent)?)))
        })
    }

    /// Prepares the pass of a frame size in an arena that it shares with others: those of other sizes, where the
    /// frame's size changes as the renderer runs, or of other denoisers on the device. What outlives a recording
    /// ([`MemoryRequired::persistent`]) is allocated for the pass alone. It takes milliseconds
    /// (`docs/INTEGRATION.md`): make passes ahead, or on another thread.
    ///
    /// # Errors
    /// As [`Denoiser::pass`]; [`Error::FrameTooLarge`] where it does not fit the arena; [`Error::InvalidOption`] where
    /// that was made on another device.
    pub fn pass_in(&self, arena: &Arena, extent: Extent) -> Result<Pass> {
        Pass::in_arena(&self.engine, extent, arena)
    }

    /// Device memory that the denoiser holds, in bytes: the weights, and what the host path keeps of the last size.
    /// Passes and arenas tell of theirs ([`Pass::device_bytes`], [`Arena::device_bytes`]).
    pub fn device_bytes(&self) -> u64 {
        self.engine.weights.size() + self.host.as_ref().map_or(0, HostPass::device_bytes)
    }

    /// Prepares the pass of a frame size for a renderer: plans it and allocates its arena.
    ///
    /// # Errors
    /// [`Error::EmptyFrame`], [`Error::FrameTooLarge`], [`Error::OutOfMemory`], [`Error::Vulkan`].
    pub fn pass(&self, extent: Extent) -> Result<Pass> {
        Pass::new(&self.engine, extent)
    }

    /// The pass that the host path ran last.
    pub(crate) fn last_pass(&self) -> Option<&Pass> {
        self.host.as_ref().map(HostPass::pass)
    }
}

/// The frame's options of a denoiser's.
fn check_options(options: &Options) -> Result<FrameOptions> {
    let Options { exposure, blend, fireflies, .. } = *options;
    let frame = FrameOptions { exposure, blend, fireflies, ..FrameOptions::default() };
    check_host(&frame)?;
    options.converged.map_or(Ok(()), |converged| converged.check())?;
    if options.self_ensemble && options.keep_features {
        let reason = "what is kept of the features is of the frame itself, not of the turned one; set either \
                      self_ensemble or keep_features";
        return Err(Error::InvalidOption { option: "self_ensemble", reason: reason.into() });
    }
    Ok(frame)
}

/// Refuses what only a renderer can give.
fn check_host(options: &FrameOptions) -> Result<()> {
    options.check()?;
    match options.exposure {
        Exposure::Buffer(_) => Err(Error::InvalidOption {
            option: "exposure",
            reason: "a buffer; the host path takes it from the frame or as a fixed number".into(),
        }),
        _ => Ok(()),
    }
}

//! The public face: a denoiser, and the host path.

use crate::engine::Engine;
use crate::error::{Error, Result};
use crate::frame::{Extent, Features, Frame, PlaneMut, Region, check_in_place};
use crate::host::HostPass;
use crate::kernels::frame_io::Fireflies;
use crate::memory::MemoryRequired;
use crate::net::weights::Weights;
use crate::options::{Exposure, FrameOptions, Options, Precision, Report};
use crate::pass::Pass;
use crate::plan::active::ActiveTiles;
use crate::profile::KernelRecord;
use crate::signals::{self, Signal};
use crate::target::Target;
use crate::vk::device::Device;
use crate::vk::statistics::PipelineStatistic;
use crate::vk::timestamps::Timestamps;
use std::fmt;
use std::sync::Arc;
use std::time::Instant;

/// A network on a device. `Send` and `Sync`; its host path takes `&mut self`.
pub struct Denoiser {
    engine: Arc<Engine>,
    options: FrameOptions,
    /// Whether the host path times its kernels.
    profiling: bool,
    host: Option<HostPass>,
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
        Self { engine: Arc::new(engine), options, profiling: false, host: None }
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

    /// Sets what the host path does with fireflies.
    pub fn set_fireflies(&mut self, fireflies: Fireflies) {
        self.options.fireflies = fireflies;
    }

    /// The pixels that the host path computes and writes from now on; `None`, as at first: all. They get the bits that the
    /// whole frame would give them; every other pixel of the output keeps what it holds. A region outside the frame is an
    /// error of the next call.
    pub fn set_region(&mut self, region: Option<Region>) {
        self.options.region = region;
    }

    /// Whether the host path's next calls take albedo, normal and depth to be those of the last call without this; off at
    /// first. It then looks at no feature that it is given, and does not compute again what depends on them alone. The
    /// result has the same bits. For denoisers made with [`Options::keep_features`]; without them, and where no frame of
    /// the size was denoised before, the next call is an error.
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
    /// [`Denoiser::set_profiling`].
    pub fn records(&self) -> &[KernelRecord] {
        self.host.as_ref().map_or(&[], HostPass::records)
    }

    /// Which tiles the last call worked on; `None` without [`Options::quiet`].
    pub fn active_tiles(&self) -> Option<&ActiveTiles> {
        self.host.as_ref().and_then(HostPass::active)
    }

    /// What the driver's compiler says of the kernels made so far: registers, spills, shared memory. Empty unless the device
    /// was opened with [`crate::DeviceOptions::pipeline_statistics`] and has them.
    ///
    /// # Errors
    /// [`Error::Vulkan`].
    pub fn pipeline_statistics(&self) -> Result<Vec<PipelineStatistic>> {
        self.engine.pipelines.statistics()
    }

    /// The precision in use, never [`Precision::Auto`].
    pub fn precision(&self) -> Precision {
        self.engine.target.precision()
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.engine.device
    }

    /// The device memory that a frame size takes, from its plan: nothing is allocated.
    ///
    /// # Errors
    /// [`Error::EmptyFrame`], [`Error::FrameTooLarge`].
    pub fn memory_required(&self, extent: Extent) -> Result<MemoryRequired> {
        Ok(MemoryRequired::of_plan(&self.engine.plan(extent)?))
    }

    /// Prepares the pass of a frame size for a renderer: plans it and allocates its arena.
    ///
    /// # Errors
    /// [`Error::EmptyFrame`], [`Error::FrameTooLarge`], [`Error::OutOfMemory`], [`Error::Vulkan`].
    pub fn pass(&self, extent: Extent) -> Result<Pass> {
        Pass::new(&self.engine, extent)
    }

    /// Denoises a frame in host memory and waits for the result. What a size needs is kept for the next call.
    ///
    /// # Errors
    /// [`Error::EmptyFrame`], [`Error::PlaneMismatch`], [`Error::InvalidOption`] for a region that leaves the frame and for
    /// unchanged features of which nothing is kept, [`Error::FrameTooLarge`], [`Error::OutOfMemory`], [`Error::DeviceLost`], [`Error::Vulkan`]; [`Error::Binding`] on a
    /// renderer's device, which has no queue of ours. The output is untouched then.
    pub fn denoise(&mut self, frame: &Frame, output: PlaneMut) -> Result<Report> {
        self.denoise_with(frame, output, &mut [])
    }

    /// The same, with signals that go through the kernels of the frame's colour, any number of them: parts of its
    /// light whose sums then hold, other layers, alpha ([`crate::signals`]).
    ///
    /// # Errors
    /// As [`Denoiser::denoise`]; [`Error::InvalidOption`] where the denoiser was made without [`Options::signals`],
    /// and for a signal of a number of channels that its kind does not have. All outputs are untouched then.
    pub fn denoise_with(&mut self, frame: &Frame, mut output: PlaneMut, signals: &mut [Signal]) -> Result<Report> {
        frame.check()?;
        output.check("output", frame.extent, 3)?;
        self.check_region(frame.extent)?;
        if !signals.is_empty() && !self.engine.target.signals {
            return Err(signals::not_asked_for());
        }
        signals.iter().try_for_each(|signal| signal.check(frame.extent))?;
        let started = Instant::now();
        let (profiling, (pass, options)) = (self.profiling, self.host_pass(frame.extent)?);
        pass.write_color(|extent, packed| frame.color.pack(extent, 3, packed));
        pass.write_signals(signals)?;
        let report = pass.run(&frame.features, &options, profiling, started)?;
        pass.read(&mut output, options.region);
        pass.read_signals(signals, options.region);
        Ok(report)
    }

    /// The same, with the result in the place of the colour.
    ///
    /// # Errors
    /// As [`Denoiser::denoise`].
    pub fn denoise_in_place(&mut self, extent: Extent, mut color: PlaneMut, features: &Features) -> Result<Report> {
        check_in_place(extent, &color, features)?;
        self.check_region(extent)?;
        let started = Instant::now();
        let (profiling, (pass, options)) = (self.profiling, self.host_pass(extent)?);
        pass.write_color(|extent, packed| color.pack(extent, 3, packed));
        pass.write_signals(&[])?;
        let report = pass.run(features, &options, profiling, started)?;
        pass.read(&mut color, options.region);
        Ok(report)
    }

    fn check_region(&self, extent: Extent) -> Result<()> {
        self.options.region.map_or(Ok(()), |region| region.check(extent))
    }

    /// The pass that the host path ran last.
    pub(crate) fn last_pass(&self) -> Option<&Pass> {
        self.host.as_ref().map(HostPass::pass)
    }

    /// The host path of a size: the last one if it fits.
    fn host_pass(&mut self, extent: Extent) -> Result<(&mut HostPass, FrameOptions)> {
        let fits = self.host.take().filter(|pass| pass.extent() == extent);
        // The old one is gone before the new one is allocated: both may not fit.
        let pass = match fits {
            Some(pass) => pass,
            None => HostPass::new(&self.engine, extent)?,
        };
        Ok((self.host.insert(pass), self.options))
    }
}

/// The frame's options of a denoiser's.
fn check_options(options: &Options) -> Result<FrameOptions> {
    let Options { exposure, blend, fireflies, .. } = *options;
    let frame = FrameOptions { exposure, blend, fireflies, ..FrameOptions::default() };
    check_host(&frame)?;
    options.quiet.map_or(Ok(()), |quiet| quiet.check())?;
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

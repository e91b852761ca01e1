//! The public face: a denoiser, its options, and the host path.

use crate::engine::{self, Engine};
use crate::error::{Error, Result};
use crate::frame::{Extent, Features, Frame, PlaneMut, Region, check_in_place};
use crate::host::HostPass;
use crate::kernels::frame_io::Fireflies;
use crate::kernels::{Arithmetic, Storage};
use crate::memory::MemoryRequired;
use crate::net::Folds;
use crate::net::weights::Weights;
use crate::pass::{FrameOptions, Pass};
use crate::plan::active::ActiveTiles;
use crate::plan::quiet_mode::QuietMode;
use crate::plan::{ConvAlgorithm, ConvTable, SeparableForm};
use crate::profile::KernelRecord;
use crate::renderer::BufferAddress;
use crate::tune;
use crate::vk::device::Device;
use crate::vk::statistics::PipelineStatistic;
use crate::vk::timestamps::Timestamps;
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Instant;

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
    /// Feature maps stored as halves, and what is dense on cooperative matrices ([`Device::has_matrices`]): products of halves,
    /// summed in 32-bit floats, as are all other operations. What GPUs with matrices take by themselves.
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
    /// From the frame itself: 0.18 over its key ([`crate::kernels::stats`]).
    #[default]
    Auto,
    /// Given by the caller, a normal number above 0. One factor for all frames of a sequence keeps them from flickering:
    /// take [`Report::exposure`] of the first.
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
    /// Which of the network's operations are folded into others: the same result but for rounding, for less work. `None`:
    /// those that pay on the device.
    pub folds: Option<Folds>,
    /// How dense 3x3 convolutions are computed; `None`: as suits the device.
    pub conv: Option<ConvAlgorithm>,
    /// How separable convolutions are; `None`: as suits the device.
    pub separable: Option<SeparableForm>,
    /// Most device memory that a frame may take (arena, weights and, in the host path, staging), in bytes; a frame that needs
    /// more is refused before anything is allocated for it. `None`: what the device has.
    pub memory_budget: Option<u64>,
    /// Bytes that a map between kernels that follow each other may take; where it would take more, they run band by band of
    /// the frame, which takes less memory and a little more work. The bits stay the same. `None`:
    /// [`crate::plan::max_chain_bytes`].
    pub max_chain_bytes: Option<u64>,
    /// Whether what depends on albedo, normal and depth alone is kept between frames, for a camera that stands still:
    /// [`FrameOptions::features_unchanged`], [`Denoiser::set_features_unchanged`]. It costs device memory.
    pub keep_features: bool,
    /// What is left out as it needs no denoising; `None`: nothing.
    pub quiet: Option<Quiet>,
}

/// Leaves out what needs no denoising: squares of 16x16 pixels whose noise is low get the caller's own colour, blended beside what
/// is denoised. The frame is not cut into bands then, so that it may take more device memory ([`Denoiser::memory_required`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quiet {
    /// The relative standard deviation of a pixel up to which it is left as it is, above 0. 0.02 is hardly visible.
    pub threshold: f32,
    /// How far beyond what is denoised the network computes.
    pub mode: QuietMode,
}

impl Quiet {
    fn check(&self) -> Result<()> {
        if self.threshold.is_finite() && self.threshold > 0.0 {
            return Ok(());
        }
        let reason = format!("{}; it must be a number above 0", self.threshold);
        Err(Error::InvalidOption { option: "quiet threshold", reason })
    }
}

/// What one call of the host path did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Report {
    /// The factor on the colour that was used.
    pub exposure: f32,
    /// Milliseconds of the device, by timestamps around the pass; `None` where its queue has none.
    pub gpu_ms: Option<f64>,
    /// Milliseconds of the whole call on the host: copies, device, wait. The first call of a size also plans, allocates
    /// and compiles.
    pub total_ms: f64,
    /// Share of the FLOPs of the whole frame's pass that were computed: 1, or less with [`Denoiser::set_region`],
    /// [`Denoiser::set_features_unchanged`] and [`Options::quiet`].
    pub work: f64,
    /// Device memory of arena, weights and staging, in bytes.
    pub device_bytes: u64,
}

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
        Self::with_kernels(device, weights, options, engine::prefers_cpu_kernels(device))
    }

    /// The same, with every dense 3x3 convolution in the form that is fastest on this device for frames of about this size: as
    /// the device's [`Cache`](crate::Cache) has it, else measured now, which takes some passes of every form, and kept there. The size class
    /// is that of powers of two of pixels; frames of every other size can be denoised too, with the forms of this one.
    ///
    /// Forms differ in rounding: the bits of a result are those of the set of forms ([`Denoiser::conv_table`]), the same for
    /// regions and unchanged features as for the whole frame. Another measurement may choose another set.
    ///
    /// # Errors
    /// As [`Denoiser::new`]. Where the cache has nothing: [`Error::Unsupported`] on a device without timestamps,
    /// [`Error::Binding`] on a renderer's device, and what [`Denoiser::denoise`] fails with.
    pub fn tuned(device: &Device, weights: &Weights, options: &Options, extent: Extent) -> Result<Self> {
        let table = tune::conv_table(device, weights, options, extent)?;
        Self::with_choices(device, weights, options, engine::prefers_cpu_kernels(device), table)
    }

    /// The forms of convolutions that were measured; empty without [`Denoiser::tuned`].
    pub fn conv_table(&self) -> ConvTable {
        self.engine.plan_options.conv_table
    }

    /// As [`Denoiser::new`], with or without the kernels shaped for CPU drivers.
    pub(crate) fn with_kernels(device: &Device, weights: &Weights, options: &Options, cpu: bool) -> Result<Self> {
        Self::with_choices(device, weights, options, cpu, ConvTable::default())
    }

    fn with_choices(
        device: &Device,
        weights: &Weights,
        options: &Options,
        cpu: bool,
        table: ConvTable,
    ) -> Result<Self> {
        let Options { exposure, blend, fireflies, .. } = *options;
        let frame = FrameOptions { exposure, blend, fireflies, ..FrameOptions::default() };
        check_host(&frame)?;
        options.quiet.map_or(Ok(()), |quiet| quiet.check())?;
        let mut engine = Engine::new(device, weights, options, table)?;
        engine.cpu = cpu;
        Ok(Self { engine: Arc::new(engine), options: frame, profiling: false, host: None })
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
        let options = &self.engine.plan_options;
        match (options.arithmetic, options.storage) {
            (Arithmetic::Matrices, _) => Precision::Matrix,
            (Arithmetic::Floats, Storage::F32) => Precision::F32,
            (Arithmetic::Floats, Storage::F16) => Precision::F16,
        }
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
    pub fn denoise(&mut self, frame: &Frame, mut output: PlaneMut) -> Result<Report> {
        frame.check()?;
        output.check("output", frame.extent, 3)?;
        self.check_region(frame.extent)?;
        let started = Instant::now();
        let (profiling, (pass, options)) = (self.profiling, self.host_pass(frame.extent)?);
        pass.write_color(|extent, packed| frame.color.pack(extent, 3, packed));
        let report = pass.run(&frame.features, &options, profiling, started)?;
        pass.read(&mut output, options.region);
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

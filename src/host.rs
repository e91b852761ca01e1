//! The host path: planes in host memory, a command buffer of our own, a wait.

use crate::denoiser::Report;
use crate::engine::Engine;
use crate::error::{Error, Result};
use crate::frame::{Extent, Features, Layout, PlaneMut, Region};
use crate::kernels::stats::EXPOSURE;
use crate::memory::{INPUT_FLOATS, MemoryRequired, OUTPUT_FLOATS, input_bytes, output_bytes};
use crate::pass::{Binding, FrameOptions, Pass};
use crate::profile::{KernelRecord, Profiler};
use crate::renderer::{BufferFrame, BufferPlane, SampleFormat};
use crate::vk::memory::Buffer;
use crate::vk::submit::{Submission, barrier};
use ash::vk;
use gpu_allocator::MemoryLocation;
use std::sync::Arc;
use std::time::Instant;

/// Which features a frame has: albedo, normal, depth.
type Present = [bool; 3];

/// A pass with its staging memory and its recording.
pub(crate) struct HostPass {
    // Fields drop in this order: the recording before what it uses.
    submission: Submission,
    binding: Option<(Present, Binding)>,
    /// What the command buffer holds now; it is recorded again only when this changes.
    recorded: Option<(Present, FrameOptions, bool)>,
    /// Share of the whole frame's work that it does.
    work: f64,
    /// The features that the arena holds what depends on.
    kept: Option<Present>,
    /// Of one slot; made when profiling is first wanted.
    profiler: Option<Profiler>,
    /// What the last run measured.
    records: Vec<KernelRecord>,
    pass: Pass,
    input: Buffer,
    /// The denoised plane, then the frame's statistics.
    output: Buffer,
    engine: Arc<Engine>,
}

impl HostPass {
    pub fn new(engine: &Arc<Engine>, extent: Extent) -> Result<Self> {
        let device = &engine.device;
        if device.queue().is_none() {
            return Err(Error::Binding(
                "the device is a renderer's, without a queue of ours: use Denoiser::pass and record".into(),
            ));
        }
        let plan = engine.plan(extent)?;
        engine.check_memory(extent, MemoryRequired::of_plan(&plan).host())?;
        let (input, output) = (input_bytes(extent.width, extent.height), output_bytes(extent.width, extent.height));
        Ok(Self {
            pass: Pass::of_plan(engine, plan)?,
            input: Buffer::new(device, "input planes", input, MemoryLocation::CpuToGpu)?,
            output: Buffer::new(device, "output plane", output, MemoryLocation::GpuToCpu)?,
            submission: Submission::new(device)?,
            binding: None,
            recorded: None,
            work: 0.0,
            kept: None,
            profiler: None,
            records: Vec::new(),
            engine: Arc::clone(engine),
        })
    }

    pub fn pass(&self) -> &Pass {
        &self.pass
    }

    pub fn extent(&self) -> Extent {
        self.pass.plan().extent
    }

    /// Fills the staged colour: `pack` writes interleaved RGB.
    pub fn write_color(&mut self, pack: impl FnOnce(Extent, &mut [f32])) {
        let extent = self.extent();
        pack(extent, &mut self.floats()[..3 * extent.pixels() as usize]);
    }

    /// What the last run measured; empty where it was not profiled.
    pub fn records(&self) -> &[KernelRecord] {
        &self.records
    }

    /// Stages the features, runs the pass, with times of its kernels if `profile`, and waits.
    pub fn run(
        &mut self,
        features: &Features,
        options: &FrameOptions,
        profile: bool,
        started: Instant,
    ) -> Result<Report> {
        let pixels = self.extent().pixels() as usize;
        let present = if options.features_unchanged { self.kept_features()? } else { self.stage(features) };
        if self.recorded != Some((present, *options, profile)) {
            self.record(present, options, profile)?;
        }
        self.records.clear();
        self.kept = None;
        let gpu_ms = self.submission.run()?;
        self.kept = Some(present);
        if let Some(profiler) = self.profiler.as_ref().filter(|_| profile) {
            self.records = profiler.read(0)?.unwrap_or_default();
        }
        let stats = &bytemuck::cast_slice::<u8, f32>(self.output.bytes())[OUTPUT_FLOATS as usize * pixels..];
        Ok(Report {
            exposure: stats.get(EXPOSURE).copied().unwrap_or(f32::NAN),
            gpu_ms,
            work: self.work,
            total_ms: started.elapsed().as_secs_f64() * 1e3,
            device_bytes: self.engine.device.memory_bytes(),
        })
    }

    /// Copies the features, and says which there are.
    fn stage(&mut self, features: &Features) -> Present {
        let extent = self.extent();
        let pixels = extent.pixels() as usize;
        let Features { albedo, normal, depth } = features;
        for (plane, first) in [(albedo, 3), (normal, 6)] {
            if let Some(plane) = plane {
                plane.pack(extent, 3, &mut self.floats()[first * pixels..][..3 * pixels]);
            }
        }
        if let Some(plane) = depth {
            plane.pack_depth(extent, &mut self.floats()[9 * pixels..][..pixels]);
        }
        [albedo, normal, depth].map(Option::is_some)
    }

    fn kept_features(&self) -> Result<Present> {
        self.kept.ok_or_else(|| Error::InvalidOption {
            option: "features_unchanged",
            reason: "no frame of this size was denoised before".into(),
        })
    }

    /// Writes the result to the caller's plane; `region` as in the last run.
    pub fn read(&self, output: &mut PlaneMut, region: Option<Region>) {
        let extent = self.extent();
        let region = region.unwrap_or(Region::all(extent));
        output.unpack(extent, region, 3, bytemuck::cast_slice(&self.output.bytes()[..12 * extent.pixels() as usize]));
    }

    fn floats(&mut self) -> &mut [f32] {
        bytemuck::cast_slice_mut(self.input.bytes_mut())
    }

    fn bind(&self, [albedo, normal, depth]: Present) -> Result<Binding> {
        let extent = self.extent();
        let plane = |buffer: &Buffer, size, first: u64, channels| BufferPlane {
            buffer: buffer.raw(),
            size,
            format: SampleFormat::F32,
            layout: Layout { offset: (first * extent.pixels()) as usize, ..Layout::interleaved(extent, channels) },
        };
        let input_bytes = extent.pixels() * INPUT_FLOATS * 4;
        let input = |first, channels| plane(&self.input, input_bytes, first, channels);
        let frame = BufferFrame {
            color: input(0, 3),
            albedo: albedo.then(|| input(3, 3)),
            normal: normal.then(|| input(6, 3)),
            depth: depth.then(|| input(9, 1)),
            output: plane(&self.output, extent.pixels() * OUTPUT_FLOATS * 4, 0, 3),
        };
        // SAFETY: the buffers are our own and as described.
        unsafe { self.pass.bind_buffers(&frame) }
    }

    fn record(&mut self, present: Present, options: &FrameOptions, profile: bool) -> Result<()> {
        if profile && self.profiler.is_none() {
            self.profiler = Some(Profiler::new(&self.pass, 1)?);
        }
        let bound = match self.binding.take() {
            Some((had, binding)) if had == present => binding,
            _ => self.bind(present)?,
        };
        self.recorded = None;
        self.work = self.pass.work(&bound, options)?;
        let (stats, stats_offset, stats_bytes) = self.pass.location(self.pass.plan().stats);
        let copy = [vk::BufferCopy {
            src_offset: stats_offset,
            dst_offset: self.extent().pixels() * OUTPUT_FLOATS * 4,
            size: stats_bytes,
        }];
        let Self { submission, pass, output, engine, profiler, .. } = self;
        let profiled = profiler.as_ref().filter(|_| profile).map(|profiler| (profiler, 0));
        let device = &engine.device;
        let compute = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_WRITE);
        let transfer = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_READ);
        let written = (
            vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::TRANSFER,
            vk::AccessFlags::SHADER_WRITE | vk::AccessFlags::TRANSFER_WRITE,
        );
        let host = (vk::PipelineStageFlags::HOST, vk::AccessFlags::HOST_READ);
        submission.record(|commands| {
            // SAFETY: the command buffer is recording and ours; everything bound and copied lives in `self`, and
            // `Submission::run` waits.
            unsafe {
                // The last run's copy of the statistics, before this run overwrites them.
                barrier(device, commands, transfer, compute);
                pass.record_with(commands, &bound, options, profiled)?;
                barrier(device, commands, compute, transfer);
                device.raw().cmd_copy_buffer(commands, stats, output.raw(), &copy);
                barrier(device, commands, written, host);
            }
            Ok(())
        })?;
        self.binding = Some((present, bound));
        self.recorded = Some((present, *options, profile));
        Ok(())
    }
}

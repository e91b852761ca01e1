//! The host path: planes in host memory, a command buffer of our own, a wait.

use crate::engine::Engine;
use crate::error::{Error, Result};
use crate::frame::{Extent, Features, Layout, Noise, PlaneMut, Region};
use crate::host_signals::SignalPlanes;
use crate::kernels::quiet::NoiseKind;
use crate::kernels::stats::{EXPOSURE, STATS_FLOATS};
use crate::memory::{MemoryRequired, input_bytes, output_bytes, plane_bytes};
use crate::options::{FrameOptions, Report};
use crate::pass::{Binding, Pass};
use crate::plan::active::{ActiveTiles, Work};
use crate::profile::{KernelRecord, Profiler};
use crate::renderer::{BufferFrame, BufferPlane, SampleFormat};
use crate::signals::{Signal, SignalKind};
use crate::vk::caps::DeviceKind;
use crate::vk::memory::Buffer;
use crate::vk::submit::{Submission, barrier};
use ash::vk;
use gpu_allocator::MemoryLocation;
use std::sync::Arc;
use std::time::Instant;

/// Which planes a frame has beside its colour: albedo, normal, depth, and what it says of its noise.
type Present = ([bool; 3], Option<NoiseKind>);
/// A frame's planes, and what signals come with it: kind and channels.
type Planes = (Present, Vec<(SignalKind, u32)>);

/// A pass with its staging memory and its recording.
pub(crate) struct HostPass {
    // Fields drop in this order: the recording before what it uses.
    submission: Submission,
    binding: Option<(Planes, Binding)>,
    /// What the command buffer holds now; it is recorded again only when this changes.
    recorded: Option<(Planes, FrameOptions, bool)>,
    /// The work of that.
    work: Option<Work>,
    /// Where the last run was active, if that differs.
    active: Option<ActiveTiles>,
    /// The features that the arena holds what depends on.
    kept: Option<[bool; 3]>,
    /// Of one slot; made when profiling is first wanted.
    profiler: Option<Profiler>,
    /// What the last run measured.
    records: Vec<KernelRecord>,
    pass: Pass,
    input: Buffer,
    /// The denoised plane, then the frame's statistics.
    output: Buffer,
    /// The planes that kernels read and write, where those are slow in memory that the host sees: copied by the device.
    in_device: Option<[Buffer; 2]>,
    signals: SignalPlanes,
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
        let (input, output) = (input_bytes(&plan), output_bytes(&plan));
        let in_device = match device.caps().kind {
            DeviceKind::DiscreteGpu | DeviceKind::VirtualGpu => {
                let planes =
                    [("input planes in the device", input), ("output plane in the device", plane_bytes(extent))];
                let [input, output] =
                    planes.map(|(name, bytes)| Buffer::new(device, name, bytes, MemoryLocation::GpuOnly));
                Some([input?, output?])
            }
            _ => None,
        };
        Ok(Self {
            in_device,
            pass: Pass::of_plan(engine, plan)?,
            input: Buffer::new(device, "input planes", input, MemoryLocation::CpuToGpu)?,
            output: Buffer::new(device, "output plane", output, MemoryLocation::GpuToCpu)?,
            signals: SignalPlanes::default(),
            submission: Submission::new(device)?,
            binding: None,
            recorded: None,
            work: None,
            active: None,
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

    /// Stages the signals of the next run.
    pub fn write_signals(&mut self, signals: &[Signal]) -> Result<()> {
        let extent = self.extent();
        if signals.len() > self.signals.room() {
            // What names the old planes goes first.
            (self.recorded, self.binding, self.signals) = (None, None, SignalPlanes::default());
            let host = MemoryRequired::of_plan(self.pass.plan()).host();
            self.engine.check_memory(extent, host + SignalPlanes::bytes(extent, signals.len()))?;
            self.signals = SignalPlanes::new(&self.engine.device, extent, signals.len())?;
        }
        self.signals.write(extent, signals);
        Ok(())
    }

    /// Writes the results to the signals' outputs; `region` as in the last run.
    pub fn read_signals(&self, signals: &mut [Signal], region: Option<Region>) {
        self.signals.read(self.extent(), region, signals);
    }

    /// Where the last run was active; `None` where nothing is left out.
    pub fn active(&self) -> Option<&ActiveTiles> {
        self.active.as_ref()
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
        let there = if options.features_unchanged { self.kept_features()? } else { self.stage(features) };
        let planes = ((there, self.stage_noise(features)), self.signals.kinds.clone());
        let wanted = Some((planes, *options, profile));
        if self.recorded != wanted {
            self.recorded = None;
            if let Some((planes, ..)) = &wanted {
                self.record(planes, options, profile)?;
            }
            self.recorded = wanted;
        }
        self.records.clear();
        self.kept = None;
        let gpu_ms = self.submission.run()?;
        self.kept = Some(there);
        if let Some(profiler) = self.profiler.as_ref().filter(|_| profile) {
            self.records = profiler.read(0)?.unwrap_or_default();
        }
        let told = &self.output.bytes()[plane_bytes(self.extent()) as usize..];
        let (stats, told) = told.split_at(4 * STATS_FLOATS as usize);
        self.active = self.pass.active_tiles(bytemuck::cast_slice(told));
        if let Some(active) = &self.active {
            self.records.iter_mut().for_each(|record| record.count_active(active));
        }
        Ok(Report {
            exposure: bytemuck::cast_slice(stats).get(EXPOSURE).copied().unwrap_or(f32::NAN),
            gpu_ms,
            work: self.work.as_ref().map_or(0.0, |work| self.pass.share(work, self.active.as_ref())),
            total_ms: started.elapsed().as_secs_f64() * 1e3,
            device_bytes: self.engine.device.memory_bytes(),
        })
    }

    /// Copies the features, and says which there are.
    fn stage(&mut self, features: &Features) -> [bool; 3] {
        let extent = self.extent();
        let pixels = extent.pixels() as usize;
        let Features { albedo, normal, depth, .. } = features;
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

    /// Copies what is known of the colour's noise, where that is asked for, and says what it is.
    fn stage_noise(&mut self, features: &Features) -> Option<NoiseKind> {
        let extent = self.extent();
        let pixels = extent.pixels() as usize;
        let noise = features.noise.filter(|_| self.pass.plan().quiet.is_some())?;
        noise.plane.pack(extent, 1, &mut self.floats()[10 * pixels..][..pixels]);
        Some(noise.kind)
    }

    fn kept_features(&self) -> Result<[bool; 3]> {
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

    fn bind(&self, ([albedo, normal, depth], noise): Present) -> Result<Binding> {
        let signals = self.signals.planes(self.extent());
        let extent = self.extent();
        let plane = |buffer: &Buffer, size, first: u64, channels| BufferPlane {
            buffer: buffer.raw(),
            size,
            format: SampleFormat::F32,
            layout: Layout { offset: (first * extent.pixels()) as usize, ..Layout::interleaved(extent, channels) },
        };
        let input_bytes = input_bytes(self.pass.plan());
        let [from, to] = self.in_device.as_ref().map_or([&self.input, &self.output], |[input, output]| [input, output]);
        let input = |first, channels| plane(from, input_bytes, first, channels);
        let mut frame = BufferFrame::new(input(0, 3), plane(to, plane_bytes(extent), 0, 3));
        frame.albedo = albedo.then(|| input(3, 3));
        frame.normal = normal.then(|| input(6, 3));
        frame.depth = depth.then(|| input(9, 1));
        frame.noise = noise.map(|kind| Noise { plane: input(10, 1), kind });
        // SAFETY: the buffers are our own and as described.
        unsafe { self.pass.bind_buffers_with(&frame, &signals) }
    }

    fn record(&mut self, planes: &Planes, options: &FrameOptions, profile: bool) -> Result<()> {
        if profile && self.profiler.is_none() {
            self.profiler = Some(self.pass.profiler(1)?);
        }
        let bound = match self.binding.take() {
            Some((had, binding)) if had == *planes => binding,
            _ => self.bind(planes.0)?,
        };
        self.work = Some(self.pass.work_of(&bound, options)?);
        let mut dst_offset = plane_bytes(self.extent());
        let copies = self.pass.plan().read_back().into_iter().map(|id| {
            let (buffer, src_offset, size) = self.pass.location(id);
            let copy = vk::BufferCopy { src_offset, dst_offset, size };
            dst_offset += size;
            (buffer, copy)
        });
        let mut copies: Vec<_> = copies.collect();
        let whole = |size| vk::BufferCopy { src_offset: 0, dst_offset: 0, size };
        copies.extend(self.in_device.as_ref().map(|[_, plane]| (plane.raw(), whole(plane.size()))));
        let Self { submission, pass, input, output, in_device, engine, profiler, .. } = self;
        let profiled = profiler.as_ref().filter(|_| profile).map(|profiler| (profiler, 0));
        let device = &engine.device;
        let compute = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_WRITE);
        let transfer = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_READ);
        let written = (
            vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::TRANSFER,
            vk::AccessFlags::SHADER_WRITE | vk::AccessFlags::TRANSFER_WRITE,
        );
        let host = (vk::PipelineStageFlags::HOST, vk::AccessFlags::HOST_READ);
        let copied = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_WRITE);
        let read = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_READ);
        // SAFETY, of all three: the command buffer is recording and ours; everything bound and copied lives in `self`, and
        // `Submission::run` waits.
        submission.record_between(
            |commands| unsafe {
                // The last run's copies of what is read back, before this run overwrites them.
                barrier(device, commands, transfer, compute);
                if let Some([planes, _]) = in_device {
                    device.raw().cmd_copy_buffer(commands, input.raw(), planes.raw(), &[whole(planes.size())]);
                    barrier(device, commands, copied, read);
                }
            },
            |commands| unsafe { pass.record_with(commands, &bound, options, profiled) },
            |commands| unsafe {
                barrier(device, commands, compute, transfer);
                for (buffer, copy) in copies {
                    device.raw().cmd_copy_buffer(commands, buffer, output.raw(), &[copy]);
                }
                barrier(device, commands, written, host);
            },
        )?;
        self.binding = Some((planes.clone(), bound));
        Ok(())
    }
}

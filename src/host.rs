//! The host path: planes in host memory, a command buffer of our own, a wait.

mod staging;

use crate::engine::Engine;
use crate::error::{Error, Result};
use crate::frame::{Extent, Features, Frame, NoiseKind};
use crate::host_signals::SignalPlanes;
use crate::kernels::stats::{EXPOSURE, STATS_FLOATS};
use crate::memory::{input_bytes, output_bytes, plane_bytes};
use crate::options::{FrameOptions, Report};
use crate::pass::{Binding, Pass};
use crate::plan::active::{ActiveTiles, Work};
use crate::plan::{Dispatch, Plan};
use crate::profile::{KernelRecord, Profiler};
use crate::progress::{self, Pieces, Progress};
use crate::role::Role;
use crate::signals::SignalKind;
use crate::vk::caps::DeviceKind;
use crate::vk::memory::Buffer;
use crate::vk::submit::{Submission, barrier};
use ash::vk;
use gpu_allocator::MemoryLocation;
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

/// Which planes a frame has beside its colour: the features, and what it says of its noise.
type Present = ([bool; Role::FEATURES.len()], Option<NoiseKind>);
/// A frame's planes, and what signals come with it: kind and channels.
type Staged = (Present, Vec<(SignalKind, u32)>);

/// A pass with its staging memory and its recording.
pub(crate) struct HostPass {
    // Fields drop in this order: the recording before what it uses.
    submission: Submission,
    binding: Option<(Staged, Binding)>,
    /// What the command buffer holds now; it is recorded again only when this changes.
    recorded: Option<(Staged, FrameOptions, bool)>,
    /// The work of the last recording.
    work: Option<Work>,
    /// How the pass is cut where the caller watches.
    pieces: Pieces,
    /// Where the last run was active, if that differs.
    active: Option<ActiveTiles>,
    /// The features that the arena holds what depends on.
    kept: Option<[bool; Role::FEATURES.len()]>,
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

/// What runs.
pub(crate) struct Commands {
    /// Of the pass's plan, one for each of its dispatches.
    pub dispatches: Vec<Dispatch>,
    /// What is copied before that: from where, to where.
    pub uploads: Vec<(vk::Buffer, vk::Buffer, vk::BufferCopy)>,
}

impl HostPass {
    pub fn new(engine: &Arc<Engine>, plan: Plan) -> Result<Self> {
        let (device, extent) = (&engine.device, plan.extent);
        if device.queue().is_none() {
            return Err(Error::Binding(
                "the device is a renderer's, without a queue of ours: use Denoiser::pass and record".into(),
            ));
        }
        engine.check_host(&plan)?;
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
            pieces: Pieces::new(device.caps().kind),
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

    /// Device memory of the pass, its staging and its signals.
    pub fn device_bytes(&self) -> u64 {
        let staging = [&self.input, &self.output].into_iter().chain(self.in_device.iter().flatten());
        let turned = self.binding.as_ref().map_or(0, |(_, binding)| binding.planes.result_bytes());
        self.pass.device_bytes() + staging.map(Buffer::size).sum::<u64>() + self.signals.device_bytes() + turned
    }

    pub fn extent(&self) -> Extent {
        self.pass.plan().extent
    }

    /// Where the last run was active; `None` where nothing is left out.
    pub fn active(&self) -> Option<&ActiveTiles> {
        self.active.as_ref()
    }

    /// What the last run measured; empty where it was not profiled.
    pub fn records(&self) -> &[KernelRecord] {
        &self.records
    }

    /// Stages the features, runs the pass, with times of its kernels if `profile`, and waits: in one submission, or
    /// where `progress` watches in several.
    pub fn run(
        &mut self,
        features: &Features,
        options: &FrameOptions,
        profile: bool,
        started: Instant,
        progress: Option<&mut Progress>,
    ) -> Result<Report> {
        let there = if options.features_unchanged { self.kept_features()? } else { self.stage(features) };
        let planes = ((there, self.stage_noise(features)), self.signals.kinds.clone());
        self.records.clear();
        self.kept = None;
        let gpu_ms = match progress {
            Some(progress) => {
                let bound = self.bound(&planes)?;
                let commands = self.commands(&bound, options)?;
                let mut tell = |done| progress::tell(progress, done);
                self.run_pieces((planes, bound), &commands, options, profile, &mut tell)?
            }
            None => {
                let wanted = Some((planes, *options, profile));
                if self.recorded != wanted {
                    self.recorded = None;
                    if let Some((planes, ..)) = &wanted {
                        self.record(planes, options, profile)?;
                    }
                    self.recorded = wanted;
                }
                self.submission.run()?
            }
        };
        self.kept = Some(there);
        if let Some(profiler) = self.profiler.as_ref().filter(|_| profile) {
            self.records = profiler.read(0)?.unwrap_or_default();
        }
        let (stats, told) = self.read_back().split_at(4 * STATS_FLOATS as usize);
        let exposure = bytemuck::cast_slice(stats).get(EXPOSURE).copied().unwrap_or(f32::NAN);
        self.active = self.pass.active_tiles(bytemuck::cast_slice(told));
        if let Some(active) = &self.active {
            self.records.iter_mut().for_each(|record| record.count_active(active));
        }
        Ok(Report {
            exposure,
            gpu_ms,
            work: self.work.as_ref().map_or(0.0, |work| self.pass.share(work, self.active.as_ref())),
            total_ms: started.elapsed().as_secs_f64() * 1e3,
            device_bytes: self.engine.device.memory_bytes(),
            tiles: None,
        })
    }

    /// Stages a frame and runs commands over it: where `tell` listens in several submissions. Returns the device's
    /// milliseconds where it has timestamps.
    pub fn run_commands(
        &mut self,
        frame: &Frame,
        commands: &Commands,
        options: &FrameOptions,
        tell: Option<&mut dyn FnMut(f64) -> Result<()>>,
    ) -> Result<Option<f64>> {
        self.write_color(&frame.color);
        let planes = ((self.stage(&frame.features), None), Vec::new());
        let bound = self.bound(&planes)?;
        if let Some(tell) = tell {
            return self.run_pieces((planes, bound), commands, options, false, tell);
        }
        let recorded = self.record_piece(&bound, commands, options, false, 0..commands.dispatches.len());
        self.binding = Some((planes, bound));
        recorded?;
        self.submission.run()
    }

    /// Runs commands in several submissions, and between them tells the share of them that is done; an error of `tell`
    /// ends it there. The binding is kept. Returns the device's milliseconds where it has timestamps.
    fn run_pieces(
        &mut self,
        (planes, bound): (Staged, Binding),
        commands: &Commands,
        options: &FrameOptions,
        profile: bool,
        tell: &mut dyn FnMut(f64) -> Result<()>,
    ) -> Result<Option<f64>> {
        let works = progress::works(&commands.dispatches, self.extent(), planes.1.len());
        let all = works.iter().sum::<f64>().max(1.0);
        self.work = Some(Work::of(&commands.dispatches));
        let (mut at, mut done, mut gpu_ms) = (0, 0.0, Some(0.0));
        let mut run = || {
            tell(0.0)?;
            while at < works.len() {
                let piece = at..self.pieces.end(&works, at);
                at = piece.end;
                let work: f64 = works[piece.clone()].iter().sum();
                self.record_piece(&bound, commands, options, profile, piece)?;
                let clock = Instant::now();
                let milliseconds = self.submission.run()?;
                gpu_ms = gpu_ms.zip(milliseconds).map(|(sum, piece)| sum + piece);
                self.pieces.took(work, milliseconds.unwrap_or_else(|| clock.elapsed().as_secs_f64() * 1e3));
                done += work;
                tell(if at < works.len() { done / all } else { 1.0 })?;
            }
            Ok(gpu_ms)
        };
        let result = run();
        self.binding = Some((planes, bound));
        result
    }

    /// What was read back of the plan ([`Plan::read_back`]) in the last run.
    pub fn read_back(&self) -> &[u8] {
        &self.output.bytes()[plane_bytes(self.extent()) as usize..]
    }

    /// The planes of the next recording: those bound last, if they are the same.
    fn bound(&mut self, planes: &Staged) -> Result<Binding> {
        self.recorded = None;
        match self.binding.take() {
            Some((had, binding)) if had == *planes => Ok(binding),
            _ => self.bind(planes.0),
        }
    }

    /// The whole pass.
    fn commands(&self, bound: &Binding, options: &FrameOptions) -> Result<Commands> {
        Ok(Commands { dispatches: self.pass.dispatches(bound, options)?.into_owned(), uploads: Vec::new() })
    }

    fn record(&mut self, planes: &Staged, options: &FrameOptions, profile: bool) -> Result<()> {
        let bound = self.bound(planes)?;
        let commands = self.commands(&bound, options)?;
        self.work = Some(Work::of(&commands.dispatches));
        self.record_piece(&bound, &commands, options, profile, 0..commands.dispatches.len())?;
        self.binding = Some((planes.clone(), bound));
        Ok(())
    }

    /// Records a part of the dispatches: the first with the copies in before it, the last with those out after it.
    fn record_piece(
        &mut self,
        bound: &Binding,
        commands: &Commands,
        options: &FrameOptions,
        profile: bool,
        piece: Range<usize>,
    ) -> Result<()> {
        if profile && self.profiler.is_none() {
            self.profiler = Some(self.pass.profiler(1)?);
        }
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
        let (first, last) = (piece.start == 0, piece.end == commands.dispatches.len());
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
        // SAFETY, of all three: the command buffer is recording and ours; everything bound and copied lives in `self`
        // or, for uploads, with the caller, and `Submission::run` waits.
        submission.record_between(
            |recording| unsafe {
                if !first {
                    return;
                }
                // The last run's copies of what is read back, before this run overwrites them.
                barrier(device, recording, transfer, compute);
                let planes = in_device.as_ref().map(|[planes, _]| (input.raw(), planes.raw(), whole(planes.size())));
                if planes.is_none() && commands.uploads.is_empty() {
                    return;
                }
                for (from, to, copy) in planes.iter().chain(&commands.uploads) {
                    device.raw().cmd_copy_buffer(recording, *from, *to, &[*copy]);
                }
                barrier(device, recording, copied, read);
            },
            |recording| unsafe { pass.record_part(recording, bound, options, &commands.dispatches, piece, profiled) },
            |recording| unsafe {
                if !last {
                    return;
                }
                barrier(device, recording, compute, transfer);
                for (buffer, copy) in copies {
                    device.raw().cmd_copy_buffer(recording, buffer, output.raw(), &[copy]);
                }
                barrier(device, recording, written, host);
            },
        )
    }
}

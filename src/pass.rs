//! A forward pass of one frame size, ready to be recorded.

mod binding;

use crate::arena::Arena;
use crate::engine::Engine;
use crate::error::{Error, Result};
use crate::frame::Extent;
use crate::kernels::{Addresses, BufferId, FrameArgs};
use crate::options::{Exposure, FrameOptions};
use crate::pass_memory::{Location, PassMemory};
use crate::plan::active::{ActiveTiles, Work};
use crate::plan::{self, Dispatch, Place, Plan};
use crate::profile::Profiler;
use crate::record::Recording;
use crate::renderer::BufferAddress;
use crate::vk::debug;
use crate::vk::device::Device;
use ash::vk;
use std::borrow::Cow;
use std::ffi::CString;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

pub use binding::Binding;

/// The denoiser for one frame size: its plan, and the arena of its feature maps. Made by [`crate::Denoiser::pass`] or,
/// in an arena that passes share, [`crate::Denoiser::pass_in`].
///
/// `Send` and `Sync`. A renderer makes one when its frame size is known, binds its buffers or images once, and records
/// every frame. Frames in flight may share it as long as they are submitted to one queue. Drop it (and its bindings)
/// only when the GPU has finished with it, like any Vulkan object.
pub struct Pass {
    engine: Arc<Engine>,
    plan: Plan,
    memory: PassMemory,
    /// What its recordings are labelled with.
    label: CString,
    /// Tells it from every other pass of the process.
    id: u64,
}

impl Pass {
    pub(crate) fn new(engine: &Arc<Engine>, extent: Extent) -> Result<Self> {
        Self::of_plan(engine, engine.plan(extent)?)
    }

    /// The pass of a plan of the engine's own graph and packing.
    pub(crate) fn of_plan(engine: &Arc<Engine>, plan: Plan) -> Result<Self> {
        engine.check_memory(plan.extent, plan.bytes())?;
        Self::in_memory(engine, plan, None)
    }

    /// The same in an arena that others have too.
    pub(crate) fn in_arena(engine: &Arc<Engine>, extent: Extent, arena: &Arena) -> Result<Self> {
        let plan = engine.plan_in(extent, &arena.blocks_on(&engine.device)?)?;
        engine.check_memory(plan.extent, plan.bytes())?;
        Self::in_memory(engine, plan, Some(arena))
    }

    fn in_memory(engine: &Arc<Engine>, plan: Plan, shared: Option<&Arena>) -> Result<Self> {
        let memory = PassMemory::new(&engine.device, &plan, shared)?;
        static PASSES: AtomicU64 = AtomicU64::new(0);
        let id = PASSES.fetch_add(1, Ordering::Relaxed);
        let Extent { width, height } = plan.extent;
        let label = debug::text(&format!("vkdenoise {} {width}x{height}", engine.graph.arch.name));
        Ok(Self { engine: Arc::clone(engine), plan, memory, label, id })
    }

    /// Device memory that the pass alone holds, in bytes: what outlives its recordings, and its arena, where that was
    /// made for it. Weights are the denoiser's, a shared arena is its own ([`Arena::device_bytes`]).
    pub fn device_bytes(&self) -> u64 {
        self.memory.device_bytes()
    }

    /// Everything that its plan writes, with its bytes.
    pub(crate) fn memory(&self) -> Vec<(Location, u64)> {
        self.memory.all(&self.plan)
    }

    pub(crate) fn device(&self) -> &Device {
        &self.engine.device
    }

    /// The plan, for reports.
    #[cfg_attr(not(feature = "internals"), doc(hidden))]
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// The share of the FLOPs of a whole frame with all features that a recording does, from 0 to 1; where converged
    /// tiles are left out, with these active tiles, or with all where there is no saying yet.
    ///
    /// # Errors
    /// [`Error::InvalidOption`] as [`Pass::record`].
    pub fn work(&self, binding: &Binding, options: &FrameOptions, active: Option<&ActiveTiles>) -> Result<f64> {
        Ok(self.share(&self.work_of(binding, options)?, active))
    }

    pub(crate) fn work_of(&self, binding: &Binding, options: &FrameOptions) -> Result<Work> {
        Ok(Work::of(&self.dispatches(binding, options)?))
    }

    pub(crate) fn share(&self, work: &Work, active: Option<&ActiveTiles>) -> f64 {
        work.flops(active) / Work::of(&self.plan.dispatches).flops(None).max(1.0)
    }

    /// Where a recording tells which tiles it worked on ([`crate::Options::converged`]): buffer, first byte, bytes.
    /// Written in `COMPUTE_SHADER`; it can be copied from. [`Pass::active_tiles`] says what the copy means. `None`
    /// where nothing is left out.
    pub fn activity_buffer(&self) -> Option<(vk::Buffer, u64, u64)> {
        self.plan.converged.as_ref().map(|converged| self.location(converged.buffer))
    }

    /// Which tiles a recording worked on, by a copy of [`Pass::activity_buffer`]; `None` where nothing is left out.
    pub fn active_tiles(&self, copy: &[u32]) -> Option<ActiveTiles> {
        self.plan.converged.as_ref().map(|converged| converged.read(copy))
    }

    /// What runs of a binding's dispatches; of all, where nothing is left out, its own list.
    pub(crate) fn dispatches<'a>(&self, binding: &'a Binding, options: &FrameOptions) -> Result<Cow<'a, [Dispatch]>> {
        if binding.pass != self.id {
            return Err(Error::Binding(
                "it was made by another pass: bind the planes with the pass that records".into(),
            ));
        }
        options.check()?;
        let mut dispatches = Cow::Borrowed(&binding.dispatches[..]);
        if let Some(region) = options.region {
            region.check(self.plan.extent)?;
            match self.plan.converged {
                Some(_) => self.plan.converged_outside(region, dispatches.to_mut()),
                None => self.plan.restrict_to(region, dispatches.to_mut()),
            }
        }
        if options.features_unchanged {
            if !self.plan.keeps_features {
                return Err(Error::InvalidOption {
                    option: "features_unchanged",
                    reason: "nothing was kept; make the denoiser with Options::keep_features".into(),
                });
            }
            plan::skip_features(dispatches.to_mut());
        }
        Ok(dispatches)
    }

    /// A profiler of this pass's recordings, of `slots` slots, at least 1: one for each recording that may be in flight
    /// at once.
    ///
    /// # Errors
    /// [`Error::Unsupported`] where kernels cannot be timed ([`crate::Device::has_timestamps`]);
    /// [`Error::InvalidOption`]; [`Error::Vulkan`].
    pub fn profiler(&self, slots: u32) -> Result<Profiler> {
        let most = self.plan.without_features.as_ref().map_or(0, Vec::len).max(self.plan.dispatches.len());
        Profiler::new(&self.engine.device, most, slots)
    }

    /// Records the pass into the renderer's command buffer. It does not submit, wait, allocate device memory or update
    /// anything.
    ///
    /// * Before: the renderer has made its writes to the input planes visible to `VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT`
    ///   / `VK_ACCESS_SHADER_READ_BIT`, and ordered earlier uses of the output plane before `COMPUTE_SHADER`. Images
    ///   are in the layouts that they were bound with.
    /// * First thing recorded: a barrier from compute to compute over the arena, so that frames in flight on one
    ///   queue, and other passes of a shared arena, do not disturb each other. A buffer of [`Exposure::Buffer`]
    ///   counts as an input plane, one of [`FrameOptions::statistics`] as an output.
    /// * After: the output was written in `COMPUTE_SHADER` with `VK_ACCESS_SHADER_WRITE_BIT`; the renderer puts the
    ///   barrier that its next use needs. Bound compute pipeline, compute descriptor set 0 and push constants have
    ///   changed.
    ///
    /// # Errors
    /// [`Error::InvalidOption`], also where the region leaves the frame; [`Error::Binding`] where another pass made the
    /// binding.
    ///
    /// # Safety
    /// `commands` is recording, belongs to the denoiser's device and to a family with compute, and is outside
    /// a render pass. The pass, the binding, what it names and the options' buffers live until the commands have run.
    /// The pass's recordings, and those of the other passes of its arena, run on one queue.
    pub unsafe fn record(&self, commands: vk::CommandBuffer, binding: &Binding, options: &FrameOptions) -> Result<()> {
        // SAFETY: the caller's promises are the same.
        unsafe { self.record_with(commands, binding, options, None) }
    }

    /// The same as [`Pass::record`], with a timestamp before and after every dispatch in `slot` of `profiler`.
    ///
    /// # Errors
    /// As [`Pass::record`]; [`Error::Binding`] where the profiler was made for another pass; [`Error::InvalidOption`]
    /// where it has no such slot.
    ///
    /// # Safety
    /// As [`Pass::record`]; the profiler lives until the commands have run, and no other recording of the slot is in
    /// flight then.
    pub unsafe fn record_profiled(
        &self,
        commands: vk::CommandBuffer,
        binding: &Binding,
        options: &FrameOptions,
        profiler: &Profiler,
        slot: u32,
    ) -> Result<()> {
        // SAFETY: the caller's promises are the same.
        unsafe { self.record_with(commands, binding, options, Some((profiler, slot))) }
    }

    /// # Safety
    /// As [`Pass::record_profiled`].
    pub(crate) unsafe fn record_with(
        &self,
        commands: vk::CommandBuffer,
        binding: &Binding,
        options: &FrameOptions,
        profiled: Option<(&Profiler, u32)>,
    ) -> Result<()> {
        let dispatches = self.dispatches(binding, options)?;
        let all = 0..dispatches.len();
        // SAFETY: the caller's promises are the same.
        unsafe { self.record_part(commands, binding, options, &dispatches, all, profiled) }
    }

    /// Records a part of what [`Pass::dispatches`] gave for the same binding, or of other dispatches of the pass's
    /// plan, one for each of the binding's. The parts run in order, the first one begins with the first dispatch.
    ///
    /// # Safety
    /// As [`Pass::record_profiled`]; the binding is this pass's.
    pub(crate) unsafe fn record_part(
        &self,
        commands: vk::CommandBuffer,
        binding: &Binding,
        options: &FrameOptions,
        dispatches: &[Dispatch],
        part: Range<usize>,
        profiled: Option<(&Profiler, u32)>,
    ) -> Result<()> {
        // SAFETY: the caller vouches for the buffers.
        let resolve = |place: &BufferAddress| unsafe { place.resolve(&self.engine.device) };
        let exposure_at = match &options.exposure {
            Exposure::Buffer(place) => Some(resolve(place)),
            _ => None,
        };
        let timestamps = match profiled {
            Some((profiler, slot)) => Some(profiler.begin(slot, dispatches)?),
            None => None,
        };
        let recording = Recording {
            device: &self.engine.device,
            addresses: Addresses {
                buffer: &|id| self.address(id),
                frame: FrameArgs {
                    exposure: self.engine.fixed_exposure(options.exposure),
                    exposure_at,
                    told_at: options.statistics.as_ref().map(resolve),
                    blend: options.blend,
                    fireflies: options.fireflies,
                    converged_threshold: self.engine.converged_threshold,
                    planes: binding.planes.upright().address,
                    signal: None,
                },
            },
            buffers: &|id| {
                let (buffer, offset, _) = self.location(id);
                (buffer, offset)
            },
            pipelines: &binding.pipelines,
            sets: &binding.sets,
            signals: &binding.planes.upright().signals,
            turned: binding.planes.turned(),
            labels: &binding.labels,
            timestamps,
        };
        let device = &self.engine.device;
        // SAFETY: the caller vouches for `commands` and for what the binding names; arena and persistent memory live as
        // long as this pass.
        unsafe {
            device.begin_label(commands, &self.label);
            recording.record(commands, dispatches, part);
            device.end_label(commands);
        }
        Ok(())
    }

    /// Device address of a buffer of the plan.
    fn address(&self, id: BufferId) -> u64 {
        match &self.plan.buffer(id).place {
            Place::Arena { block, offset } => self.memory.arena_address(*block) + offset,
            Place::Persistent { block, offset } => self.memory.persistent_address(*block) + offset,
            Place::Weights { offset, .. } => self.engine.weights.address() + offset,
        }
    }

    /// The `VkBuffer` and the byte range in which a buffer of the plan lies.
    pub(crate) fn location(&self, id: BufferId) -> (vk::Buffer, u64, u64) {
        let buffer = self.plan.buffer(id);
        let ((raw, first), offset) = match &buffer.place {
            Place::Arena { block, offset } => (self.memory.arena(*block), offset),
            Place::Persistent { block, offset } => (self.memory.persistent(*block), offset),
            Place::Weights { offset, .. } => ((self.engine.weights.raw(), 0), offset),
        };
        (raw, first + offset, buffer.bytes)
    }
}

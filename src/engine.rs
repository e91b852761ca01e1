//! What all passes of a denoiser share: the network and its packed weights on the device.

use crate::error::{Error, Result};
use crate::frame::Extent;
use crate::memory::{self, MemoryRequired};
use crate::net::graph::Graph;
use crate::net::weights::{ExposureRule, Weights, WeightsError};
use crate::options::{Exposure, Options};
use crate::plan::{Networks, Packing, Plan, packing, packing_after, plan, plan_in};
use crate::signals;
use crate::target::Target;
use crate::vk::device::Device;
use crate::vk::memory::Buffer;
use crate::vk::submit::{Submission, barrier};
use ash::vk;
use gpu_allocator::MemoryLocation;

/// Where memory is short, a map between consecutive kernels may take such a part of it, and no less than that: bands
/// beyond it compute more twice than they save.
const BANDS_A_BUDGET: u64 = 64;
const LEAST_CHAIN_BYTES: u64 = 4 << 20;
/// Where a shared arena is short, bands are made narrower from here on.
const MOST_CHAIN_BYTES: u64 = 256 << 20;

pub(crate) struct Engine {
    pub device: Device,
    pub graph: Graph,
    /// The network of the turned frame, where that is another.
    pub turned: Option<Graph>,
    /// What its plans are made for.
    pub target: Target,
    pub weights: Buffer,
    pub exposure_rule: ExposureRule,
    /// Relative noise below which nothing is denoised, where the plans leave that out.
    pub converged_threshold: f32,
    /// Whether recordings label every kernel.
    pub label_kernels: bool,
    /// Most device memory that a frame may take, in bytes.
    pub memory_budget: Option<u64>,
}

impl Engine {
    /// A network on a device, chosen for as the options say.
    pub fn new(device: &Device, weights: &Weights, options: &Options) -> Result<Self> {
        Self::for_target(device, weights, options, target(device, options)?)
    }

    /// The same for another target than the device's own.
    pub fn for_target(device: &Device, weights: &Weights, options: &Options, target: Target) -> Result<Self> {
        let partner = weights.turned().filter(|_| target.self_ensemble);
        if target.signals {
            [Some(weights), partner].into_iter().flatten().try_for_each(|used| signals::check_head(used.arch()))?;
        }
        let graph = Graph::new(weights.arch()).map_err(WeightsError::from)?;
        let turned = partner.map(|other| Graph::new(other.arch())).transpose().map_err(WeightsError::from)?;
        let own = packing(&graph, &target);
        let of_turned = turned.as_ref().map(|graph| packing_after(&own, graph, &target));
        let packings: Vec<_> = [(&own, weights)].into_iter().chain(of_turned.as_ref().zip(partner)).collect();
        let engine = Self { turned, ..Self::with_packing(device, graph, &packings, target)? };
        let converged_threshold = options.converged.map_or(0.0, |converged| converged.threshold);
        let Options { memory_budget, label_kernels, .. } = *options;
        Ok(Self { memory_budget, converged_threshold, label_kernels, ..engine })
    }

    /// For plans that are made for `target` and read the weights as the packings have them: of the frame's own network,
    /// then of the turned one's.
    pub fn with_packing(
        device: &Device,
        graph: Graph,
        packings: &[(&Packing, &Weights)],
        target: Target,
    ) -> Result<Self> {
        let (_, own) = packings[0];
        Ok(Self {
            weights: upload(device, packings)?,
            device: device.clone(),
            graph,
            turned: None,
            target,
            exposure_rule: own.preprocessing().exposure,
            converged_threshold: 0.0,
            label_kernels: false,
            memory_budget: None,
        })
    }

    fn networks(&self) -> Networks<'_> {
        Networks { own: &self.graph, turned: self.turned.as_ref() }
    }

    /// The plan of a frame size on this device.
    pub fn plan(&self, extent: Extent) -> Result<Plan> {
        plan(self.networks(), extent, &self.target)
    }

    /// The plan of a frame size in an arena that is there. Where it takes more than that, as frames just below the size
    /// from which on chains run in bands do, it is made without dispatches side by side, then without
    /// the map that is kept for predicted kernels, then in narrower bands: the bits are the same.
    pub fn plan_in(&self, extent: Extent, blocks: &[u64]) -> Result<Plan> {
        let mut target = self.target;
        loop {
            match plan_in(self.networks(), extent, &target, blocks) {
                Err(Error::FrameTooLarge { .. }) if target.overlap_bytes > 0 => target.overlap_bytes = 0,
                Err(Error::FrameTooLarge { .. }) if target.max_kept_bytes > 0 => target.max_kept_bytes = 0,
                Err(Error::FrameTooLarge { .. }) if target.max_chain_bytes > LEAST_CHAIN_BYTES => {
                    let narrower = target.max_chain_bytes.min(MOST_CHAIN_BYTES) / 2;
                    target.max_chain_bytes = narrower.max(LEAST_CHAIN_BYTES);
                }
                planned => return planned,
            }
        }
    }

    /// The plan of a tile of a larger frame ([`crate::plan::tile`]).
    pub fn tile_plan(&self, extent: Extent) -> Result<Plan> {
        plan(&self.graph, extent, &self.tile_target())
    }

    /// The plan of a frame size in less memory, for a little more work: the bits are the same.
    pub fn narrow_plan(&self, extent: Extent) -> Result<Plan> {
        plan(self.networks(), extent, &self.narrow_target())
    }

    fn narrow_target(&self) -> Target {
        let most = (self.most_bytes() / BANDS_A_BUDGET).max(LEAST_CHAIN_BYTES);
        let max_chain_bytes = self.target.max_chain_bytes.min(most);
        Target { max_chain_bytes, max_kept_bytes: 0, overlap_bytes: 0, ..self.target }
    }

    /// What the plans of tiles are made for: the larger they are, the less of them overlaps.
    pub fn tile_target(&self) -> Target {
        Target { of_tile: true, converged: None, keep_features: false, self_ensemble: false, ..self.narrow_target() }
    }

    /// Bytes of the budget, or of the device.
    pub fn most_bytes(&self) -> u64 {
        let heap = self.device.caps().memory_bytes;
        self.memory_budget.map_or(heap, |budget| budget.min(heap))
    }

    /// The plan of a frame, whether its maps fit the device or not.
    pub fn plan_anywhere(&self, extent: Extent) -> Result<Plan> {
        plan(
            &self.graph,
            extent,
            &Target {
                max_block_bytes: u64::MAX,
                max_chain_bytes: u64::MAX,
                max_kept_bytes: u64::MAX,
                ..self.tile_target()
            },
        )
    }

    /// The factor on the colour where it is not the frame's own.
    pub fn fixed_exposure(&self, exposure: Exposure) -> Option<f32> {
        match (exposure, self.exposure_rule) {
            (Exposure::Fixed(factor), _) => Some(factor),
            (_, ExposureRule::Auto) => None,
            (_, ExposureRule::None) => Some(1.0),
        }
    }

    /// Refuses a plan whose host path takes too much memory, in all or at once.
    pub fn check_host(&self, plan: &Plan) -> Result<()> {
        let required = MemoryRequired::of_plan(plan);
        self.check_memory(plan.extent, required.host())?;
        let (most, limit) = (memory::input_bytes(plan), self.device.caps().max_buffer_bytes);
        if most <= limit {
            return Ok(());
        }
        let Extent { width, height } = plan.extent;
        let reason = format!("its planes take {most} bytes, and the device allocates at most {limit} at once");
        Err(Error::FrameTooLarge { width, height, reason })
    }

    /// Whether the budget and the device have so many bytes.
    pub fn fits(&self, bytes: u64) -> bool {
        bytes <= self.most_bytes()
    }

    /// Refuses a frame that takes so many bytes of device memory, where that is too much.
    pub fn check_memory(&self, extent: Extent, bytes: u64) -> Result<()> {
        memory::check(extent, bytes, self.memory_budget, self.device.caps().memory_bytes)
    }
}

/// What options make of a device.
///
/// # Errors
/// [`Error::Unsupported`] where the device lacks what is asked for.
pub(crate) fn target(device: &Device, options: &Options) -> Result<Target> {
    Target::new(device.caps(), options)
        .map_err(|need| Error::Unsupported { device: device.info().name.clone(), missing: need.to_string() })
}

/// Packs the weights into the device's own memory, by a copy; on a renderer's device that lends no queue for it, into
/// memory that the host can write too.
fn upload(device: &Device, packings: &[(&Packing, &Weights)]) -> Result<Buffer> {
    let bytes = packings.last().map_or(0, |(packing, _)| packing.bytes());
    let mut packed = Buffer::new(device, "packed weights", bytes, MemoryLocation::CpuToGpu)?;
    packed.bytes_mut().fill(0);
    for (packing, weights) in packings {
        packing.write(weights, packed.bytes_mut())?;
    }
    let Some(queue) = device.upload_queue() else { return Ok(packed) };
    let own = Buffer::new(device, "weights", bytes, MemoryLocation::GpuOnly)?;
    let copy = [vk::BufferCopy { src_offset: 0, dst_offset: 0, size: bytes }];
    let mut submission = Submission::new(device)?;
    submission.record(|commands| {
        let copied = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_WRITE);
        let read = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_READ);
        // SAFETY: the command buffer is ours; both buffers live until `run` has waited.
        unsafe {
            device.raw().cmd_copy_buffer(commands, packed.raw(), own.raw(), &copy);
            barrier(device, commands, copied, read);
        }
        Ok(())
    })?;
    submission.run_on(queue)?;
    Ok(own)
}

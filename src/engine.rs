//! What all passes of a denoiser share: the network, its packed weights on the device, the pipelines.

use crate::error::{Error, Result};
use crate::frame::Extent;
use crate::memory;
use crate::net::graph::Graph;
use crate::net::weights::{ExposureRule, Weights, WeightsError};
use crate::options::Options;
use crate::pipelines::Pipelines;
use crate::plan::{Place, Plan, plan};
use crate::signals;
use crate::target::Target;
use crate::vk::device::Device;
use crate::vk::memory::Buffer;
use gpu_allocator::MemoryLocation;

pub(crate) struct Engine {
    pub device: Device,
    pub graph: Graph,
    /// What its plans are made for.
    pub target: Target,
    pub pipelines: Pipelines,
    pub weights: Buffer,
    pub exposure_rule: ExposureRule,
    /// Relative noise below which nothing is denoised, where the plans leave that out.
    pub quiet_threshold: f32,
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
        if target.signals {
            signals::check_head(weights.arch())?;
        }
        let graph = Graph::new(weights.arch()).map_err(WeightsError::from)?;
        // The packing is the same at every size.
        let smallest = plan(&graph, Extent::new(1, 1), &target)?;
        let engine = Self::of_plan(device, graph, &smallest, weights, target)?;
        let quiet_threshold = options.quiet.map_or(0.0, |quiet| quiet.threshold);
        Ok(Self { memory_budget: options.memory_budget, quiet_threshold, ..engine })
    }

    /// For plans that pack the weights as `plan` does, which was made for `target`.
    pub fn of_plan(device: &Device, graph: Graph, plan: &Plan, weights: &Weights, target: Target) -> Result<Self> {
        Ok(Self {
            weights: upload(device, plan, weights)?,
            pipelines: Pipelines::new(device),
            device: device.clone(),
            graph,
            target,
            exposure_rule: weights.preprocessing().exposure,
            quiet_threshold: 0.0,
            memory_budget: None,
        })
    }

    /// The plan of a frame size on this device.
    pub fn plan(&self, extent: Extent) -> Result<Plan> {
        plan(&self.graph, extent, &self.target)
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

/// Packs the weights into device memory that the host can write, so that a renderer's queue is not needed.
fn upload(device: &Device, plan: &Plan, weights: &Weights) -> Result<Buffer> {
    let mut buffer = Buffer::new(device, "weights", plan.weights_bytes, MemoryLocation::CpuToGpu)?;
    let bytes = buffer.bytes_mut();
    bytes.fill(0);
    for planned in &plan.buffers {
        if let Place::Weights { pack, offset } = &planned.place {
            let words = pack.words(weights)?;
            let start = *offset as usize;
            bytes[start..start + 4 * words.len()].copy_from_slice(bytemuck::cast_slice(&words));
        }
    }
    Ok(buffer)
}

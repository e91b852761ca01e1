//! What all passes of a denoiser share: the network, its packed weights on the device, the pipelines.

use crate::denoiser::{Options, Precision};
use crate::error::{Error, Result};
use crate::frame::Extent;
use crate::kernels::contract::Need;
use crate::kernels::winograd::WinogradTile;
use crate::kernels::{Arithmetic, Storage, Variants};
use crate::memory;
use crate::net::Folds;
use crate::net::graph::Graph;
use crate::net::weights::{ExposureRule, Weights, WeightsError};
use crate::pipelines::Pipelines;
use crate::plan::{ConvAlgorithm, ConvTable, Place, Plan, PlanOptions, SeparableForm, plan};
use crate::vk::caps::{DeviceKind, TEXEL_BYTES};
use crate::vk::device::Device;
use crate::vk::memory::Buffer;
use gpu_allocator::MemoryLocation;

/// Largest block of an arena, whatever the device allows: beyond it some drivers' allocations grow unreliable.
const MAX_BLOCK_BYTES: u64 = 4 << 30;

pub(crate) struct Engine {
    pub device: Device,
    pub graph: Graph,
    pub plan_options: PlanOptions,
    pub pipelines: Pipelines,
    pub weights: Buffer,
    pub exposure_rule: ExposureRule,
    /// Relative noise below which nothing is denoised, where the plans leave that out.
    pub quiet_threshold: f32,
    /// Most device memory that a frame may take, in bytes.
    pub memory_budget: Option<u64>,
    /// Whether kernels shaped for CPU drivers run.
    pub cpu: bool,
}

impl Engine {
    /// `conv_table` has the forms of convolutions that were measured.
    pub fn new(device: &Device, weights: &Weights, options: &Options, conv_table: ConvTable) -> Result<Self> {
        let arithmetic = wanted_arithmetic(device, options.precision)?;
        let storage = wanted_storage(device, options.precision)?;
        let suitable = suitable(device, storage, arithmetic);
        let plan_options = PlanOptions {
            max_block_bytes: Self::max_block_bytes(device),
            folds: options.folds.unwrap_or(suitable.folds),
            conv: options.conv.unwrap_or(suitable.conv),
            conv_table,
            separable: options.separable.unwrap_or(suitable.separable),
            max_chain_bytes: options.max_chain_bytes.unwrap_or(suitable.max_chain_bytes),
            keep_features: options.keep_features,
            quiet: options.quiet.map(|quiet| quiet.mode),
            ..suitable
        };
        let graph = Graph::new(weights.arch()).map_err(WeightsError::from)?;
        // The packing is the same at every size.
        let smallest = plan(&graph, Extent::new(1, 1), &plan_options)?;
        let engine = Self::of_plan(device, graph, &smallest, weights, plan_options)?;
        let quiet_threshold = options.quiet.map_or(0.0, |quiet| quiet.threshold);
        Ok(Self { memory_budget: options.memory_budget, quiet_threshold, ..engine })
    }

    /// For plans that pack the weights as `plan` does, which was made with `plan_options`.
    pub fn of_plan(
        device: &Device,
        graph: Graph,
        plan: &Plan,
        weights: &Weights,
        plan_options: PlanOptions,
    ) -> Result<Self> {
        Ok(Self {
            weights: upload(device, plan, weights)?,
            pipelines: Pipelines::new(device),
            device: device.clone(),
            graph,
            plan_options,
            exposure_rule: weights.preprocessing().exposure,
            quiet_threshold: 0.0,
            memory_budget: None,
            cpu: prefers_cpu_kernels(device),
        })
    }

    /// The plan of a frame size on this device.
    pub fn plan(&self, extent: Extent) -> Result<Plan> {
        plan(&self.graph, extent, &self.plan_options)
    }

    /// Refuses a frame that takes so many bytes of device memory, where that is too much.
    pub fn check_memory(&self, extent: Extent, bytes: u64) -> Result<()> {
        memory::check(extent, bytes, self.memory_budget, self.device.caps().memory_bytes)
    }

    /// Largest block of an arena on a device.
    pub fn max_block_bytes(device: &Device) -> u64 {
        let caps = device.caps();
        // A kernel that reads a map as texels must reach all of it.
        // Four halves each, at the least.
        let texels = if prefers_cpu_kernels(device) { u64::from(caps.max_texels) * TEXEL_BYTES / 2 } else { u64::MAX };
        caps.max_buffer_bytes.min(MAX_BLOCK_BYTES).min(texels)
    }

    /// The kernels that this device prefers, for a frame in buffers.
    pub fn variants(&self) -> Variants {
        Variants { cpu: self.cpu, images: false, output_half: false }
    }
}

/// The forms and folds that suit a device, as far as devices were measured (`docs/performance.md`).
fn suitable(device: &Device, storage: Storage, arithmetic: Arithmetic) -> PlanOptions {
    let for_gpu = PlanOptions::for_gpu(storage, arithmetic);
    if arithmetic == Arithmetic::Matrices || !prefers_cpu_kernels(device) {
        return for_gpu;
    }
    // On lavapipe of Mesa 22.3 Winograd's filtering is faster in every convolution of the network, on that of 25.0 in none.
    let old = device.caps().lavapipe.is_some_and(|mesa| mesa < 23);
    let conv = if old { ConvAlgorithm::Winograd(WinogradTile::F2) } else { ConvAlgorithm::Direct };
    PlanOptions { conv, separable: SeparableForm::Narrow, folds: Folds::ALL, ..for_gpu }
}

/// On CPU drivers a load costs more than the arithmetic it feeds (measured on lavapipe).
pub(crate) fn prefers_cpu_kernels(device: &Device) -> bool {
    device.caps().kind == DeviceKind::Cpu && device.caps().meets(Need::CpuDriver)
}

/// How feature maps are to be stored.
///
/// # Errors
/// [`Error::Unsupported`] where halves are asked for and the device cannot store them.
pub(crate) fn wanted_storage(device: &Device, precision: Precision) -> Result<Storage> {
    let has_halves = device.caps().meets(Need::Storage16);
    match precision {
        Precision::F32 => Ok(Storage::F32),
        // Devices have no matrices without.
        Precision::Matrix => Ok(Storage::F16),
        Precision::F16 if has_halves => Ok(Storage::F16),
        Precision::F16 => {
            Err(Error::Unsupported { device: device.info().name.clone(), missing: Need::Storage16.to_string() })
        }
        // A CPU would gain time too (docs/performance.md), and stays exact instead.
        Precision::Auto => {
            let gains = device.caps().kind != DeviceKind::Cpu;
            Ok(if gains && has_halves { Storage::F16 } else { Storage::F32 })
        }
    }
}

/// What dense kernels are to compute with.
///
/// # Errors
/// [`Error::Unsupported`] where they are asked for and the device has none.
pub(crate) fn wanted_arithmetic(device: &Device, precision: Precision) -> Result<Arithmetic> {
    match precision {
        Precision::F32 | Precision::F16 => Ok(Arithmetic::Floats),
        Precision::Matrix if device.has_matrices() => Ok(Arithmetic::Matrices),
        Precision::Matrix => {
            Err(Error::Unsupported { device: device.info().name.clone(), missing: Need::Matrix.to_string() })
        }
        // On a CPU they only take longer.
        Precision::Auto if device.has_matrices() && device.caps().kind != DeviceKind::Cpu => Ok(Arithmetic::Matrices),
        Precision::Auto => Ok(Arithmetic::Floats),
    }
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

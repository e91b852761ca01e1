//! What the device can do at most, measured: the roofs of Williams, Waterman and Patterson, "Roofline: an insightful
//! visual performance model for multicore architectures" (2009).

use crate::error::{Error, Result};
use crate::kernels::contract::Contract;
use crate::kernels::contracts;
use crate::kernels::pushes::{RoofCopyPush, RoofFmaPush};
use crate::pipelines;
use crate::vk::device::Device;
use crate::vk::matrix::MatrixShape;
use crate::vk::memory::Buffer;
use crate::vk::submit::Submission;
use ash::vk;
use gpu_allocator::MemoryLocation;
use std::time::Instant;

/// Rates of a device. FLOPs count a multiply-add twice, bytes what is read and what is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roof {
    /// Multiply-adds of 32-bit floats, FLOP/s.
    pub flops_f32: f64,
    /// A copy of 32-bit floats through the memory, bytes/s.
    pub bytes_f32: f64,
    /// Multiply-adds of halves, where the device has `shaderFloat16`.
    pub flops_f16: Option<f64>,
    /// A copy of halves, where it also has `storageBuffer16BitAccess`.
    pub bytes_f16: Option<f64>,
    /// Products of halves summed in 32-bit floats by cooperative matrices, where it has those that the kernels use.
    pub flops_matrix: Option<f64>,
}

/// Size of a copy: beyond any cache.
const COPY_BYTES: u64 = 256 << 20;
/// Bytes of a workgroup of the copy of 32-bit floats.
const COPY_GROUP_BYTES: u64 = 4096;
/// Workgroups of the multiply-adds: many for every core.
const FMA_GROUPS: u32 = 2048;
const FMA_INVOCATIONS: u32 = FMA_GROUPS * 64;
/// Multiply-adds of one round of an invocation, on one lane of its vectors.
const FMA_ROUND: f64 = 12.0 * 4.0;
/// Products of matrices of one round of a subgroup.
const MATRIX_ROUND: f64 = 8.0;
/// A measurement that takes less than this is repeated with more work.
const MIN_MS: f64 = 20.0;
/// Enough to find a quiet moment of a machine that does other work.
const REPEATS: u32 = 8;
/// No more repeats after so many milliseconds, but one at least.
const ENOUGH_MS: f64 = 250.0;

impl Roof {
    /// Measures the device: a few seconds. The best of several runs counts, of one where that takes long. The copy is
    /// the better of a kernel's and of `vkCmdCopyBuffer`.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`], [`Error::Vulkan`], [`Error::DeviceLost`]; [`Error::Binding`] on a renderer's device.
    pub fn measure(device: &Device) -> Result<Self> {
        let mut meter = Meter::new(device)?;
        let supported = |contract: &Contract| contract.needs.iter().all(|need| device.caps().meets(*need));
        let transfer = meter.transfer()?;
        let mut both = |fma, lanes, copy, group_bytes| -> Result<_> {
            let flops = meter.rate(fma, FMA_ROUND * lanes * f64::from(FMA_INVOCATIONS))?;
            Ok((flops, meter.copy(copy, group_bytes)?.max(transfer)))
        };
        let (flops_f32, bytes_f32) = both(&contracts::ROOF_FMA_F32, 1.0, &contracts::ROOF_COPY_F32, COPY_GROUP_BYTES)?;
        let halves = if supported(&contracts::ROOF_COPY_F16) {
            Some(both(&contracts::ROOF_FMA_F16, 2.0, &contracts::ROOF_COPY_F16, COPY_GROUP_BYTES / 2)?)
        } else {
            None
        };
        let flops_matrix = match device.caps().matrix {
            Some(MatrixShape { rows, columns, depth, .. }) => {
                let subgroups = f64::from(FMA_GROUPS * contracts::MATRIX_SUBGROUPS);
                let product = [rows, columns, depth].map(f64::from).iter().product::<f64>();
                Some(meter.rate(&contracts::ROOF_MATRIX, MATRIX_ROUND * product * subgroups)?)
            }
            None => None,
        };
        Ok(Self { flops_f32, bytes_f32, flops_f16: halves.map(|h| h.0), bytes_f16: halves.map(|h| h.1), flops_matrix })
    }

    /// FLOP/s that 32-bit floats can reach at most at an intensity in FLOPs a byte.
    pub fn at(&self, intensity: f64) -> f64 {
        self.flops_f32.min(intensity * self.bytes_f32)
    }

    /// The same of products on cooperative matrices between maps of 32-bit floats; as [`Roof::at`] where there are
    /// none.
    pub fn of_matrices_at(&self, intensity: f64) -> f64 {
        self.flops_matrix.unwrap_or(self.flops_f32).min(intensity * self.bytes_f32)
    }
}

/// Where and how it is measured.
struct Meter {
    submission: Submission,
    src: Buffer,
    dst: Buffer,
    bytes: u64,
    device: Device,
}

impl Meter {
    fn new(device: &Device) -> Result<Self> {
        // A small share of a small device.
        let bytes = COPY_BYTES.min(device.caps().memory_bytes / 16).min(device.caps().max_buffer_bytes);
        let bytes = bytes / COPY_GROUP_BYTES * COPY_GROUP_BYTES;
        // Every invocation writes a float, or every subgroup a matrix.
        let matrix = device.caps().matrix.map_or(0, |shape| shape.rows * shape.columns * contracts::MATRIX_SUBGROUPS);
        if bytes < u64::from(FMA_INVOCATIONS.max(FMA_GROUPS * matrix)) * 4 {
            let reason = "the device has too little memory".into();
            return Err(Error::OutOfMemory { what: "the roofline's copy".into(), bytes, reason });
        }
        let buffer = |name| Buffer::new(device, name, bytes, MemoryLocation::GpuOnly);
        Ok(Self {
            submission: Submission::new(device)?,
            src: buffer("copy source")?,
            dst: buffer("copy target")?,
            bytes,
            device: device.clone(),
        })
    }

    /// FLOP/s of a kernel that makes so many multiply-adds a round.
    fn rate(&mut self, contract: &'static Contract, multiply_adds: f64) -> Result<f64> {
        let mut rounds = 16u32;
        loop {
            let push = RoofFmaPush { dst: self.dst.address(), rounds, factor: 0.5 };
            let ms = self.dispatch(contract, bytemuck::bytes_of(&push), FMA_GROUPS)?;
            if ms >= MIN_MS || rounds >= 1 << 24 {
                return Ok(2.0 * multiply_adds * f64::from(rounds) / (ms * 1e-3));
            }
            // Doubling alone would take long on a fast device.
            rounds *= if ms < MIN_MS / 8.0 { 8 } else { 2 };
        }
    }

    /// Bytes/s of a copy kernel that moves `group_bytes` a workgroup.
    fn copy(&mut self, contract: &'static Contract, group_bytes: u64) -> Result<f64> {
        let push = RoofCopyPush { src: self.src.address(), dst: self.dst.address() };
        let groups = (self.bytes / group_bytes).min(u64::from(crate::kernels::MAX_GROUPS_X));
        let ms = self.dispatch(contract, bytemuck::bytes_of(&push), groups as u32)?;
        Ok(2.0 * (groups * group_bytes) as f64 / (ms * 1e-3))
    }

    /// Bytes/s of `vkCmdCopyBuffer`.
    fn transfer(&mut self) -> Result<f64> {
        let (device, src, dst) = (self.device.clone(), self.src.raw(), self.dst.raw());
        let region = [vk::BufferCopy { src_offset: 0, dst_offset: 0, size: self.bytes }];
        // SAFETY: both buffers live in `self`, and `best` waits.
        let ms = self.best(|commands| unsafe { device.raw().cmd_copy_buffer(commands, src, dst, &region) })?;
        Ok(2.0 * self.bytes as f64 / (ms * 1e-3))
    }

    fn dispatch(&mut self, contract: &'static Contract, push: &[u8], groups: u32) -> Result<f64> {
        let (device, pipeline) = (self.device.clone(), pipelines::get(&self.device, contract)?);
        // SAFETY: the command buffer is ours, the addresses are of buffers in `self` as long as the dispatch reaches,
        // and `best` waits.
        self.best(|commands| unsafe {
            let device = device.raw();
            device.cmd_bind_pipeline(commands, vk::PipelineBindPoint::COMPUTE, pipeline.raw);
            device.cmd_push_constants(commands, pipeline.layout, vk::ShaderStageFlags::COMPUTE, 0, push);
            device.cmd_dispatch(commands, groups, 1, 1);
        })
    }

    /// Milliseconds of the fastest of several runs, after one that compiles and wakes the device.
    fn best(&mut self, record: impl Fn(vk::CommandBuffer)) -> Result<f64> {
        self.submission.record(|commands| {
            record(commands);
            Ok(())
        })?;
        let mut best = f64::MAX;
        self.submission.run()?;
        let started = Instant::now();
        for _ in 0..REPEATS {
            let clock = Instant::now();
            let on_device = self.submission.run()?;
            best = best.min(on_device.unwrap_or_else(|| clock.elapsed().as_secs_f64() * 1e3));
            if started.elapsed().as_secs_f64() * 1e3 > ENOUGH_MS {
                break;
            }
        }
        Ok(best.max(1e-6))
    }
}

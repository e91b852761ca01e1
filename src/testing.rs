//! For this crate's own tests and benchmarks: single kernels on a device, with sentinels around every buffer.

use crate::denoiser::Denoiser;
use crate::descriptors::{DescriptorSets, Resources};
use crate::engine;
use crate::error::{Error, Result};
use crate::frame::{Extent, Frame, Layout, PlaneMut};
use crate::kernels::contract::Need;
use crate::kernels::planes::{Format, PlaneArgs, Planes};
use crate::kernels::{Addresses, BufferId, Call, FrameArgs, KernelTarget, TexelRange};
use crate::microbench;
use crate::net::op::Stage;
use crate::net::weights::Weights;
use crate::options::Options;
use crate::pipelines;
use crate::plan::{Dispatch, Plan};
use crate::planes::PlaneTable;
use crate::record::Recording;
use crate::target::prefers_cpu_kernels;
use crate::tiled;
use crate::vk::caps::TEXEL_BYTES;
use crate::vk::device::{Device, DeviceOptions};
use crate::vk::memory::Buffer;
use crate::vk::submit::{self, Submission};
use ash::vk;
use gpu_allocator::MemoryLocation;

/// Bytes of sentinel before and after every buffer.
const GUARD: usize = 256;
/// A NaN of an unlikely payload: what a buffer holds before anything is written.
pub const SENTINEL: u32 = 0x7fc5_a5a5;

/// Runs calls over buffers that the test made.
pub struct Bench {
    submission: Submission,
    device: Device,
    buffers: Vec<(String, Buffer)>,
    /// What kernels are chosen for.
    pub target: KernelTarget,
    /// Planes of the frame that the calls read and write; [`Bench::plane`] makes them.
    pub planes: Planes,
    /// What else the calls know of the frame; the table of planes is made of [`Bench::planes`].
    pub frame: FrameArgs,
}

impl Bench {
    /// An empty bench.
    ///
    /// # Errors
    /// [`crate::Error::Vulkan`].
    pub fn new(device: &Device, target: KernelTarget) -> Result<Self> {
        Ok(Self {
            submission: Submission::new(device)?,
            device: device.clone(),
            buffers: Vec::new(),
            target,
            planes: Planes::default(),
            frame: FrameArgs::default(),
        })
    }

    /// What the engine would choose kernels for on the device.
    pub fn default_target(device: &Device) -> KernelTarget {
        KernelTarget { cpu: prefers_cpu_kernels(device.caps()), ..KernelTarget::default() }
    }

    /// Whether the variants for CPU drivers run on the device.
    pub fn can_run_cpu_kernels(device: &Device) -> bool {
        device.caps().meets(Need::CpuDriver)
    }

    /// Whether the device can store maps of halves.
    pub fn can_store_halves(device: &Device) -> bool {
        device.caps().meets(Need::Storage16)
    }

    /// A buffer of `bytes` (a multiple of 4), filled with [`SENTINEL`], between guards.
    ///
    /// # Errors
    /// [`crate::Error::OutOfMemory`].
    pub fn buffer(&mut self, name: &str, bytes: u64) -> Result<BufferId> {
        let size = (bytes as usize).next_multiple_of(GUARD) + 2 * GUARD;
        let mut buffer = Buffer::new(&self.device, name, size as u64, MemoryLocation::CpuToGpu)?;
        for word in buffer.bytes_mut().chunks_exact_mut(4) {
            word.copy_from_slice(&SENTINEL.to_ne_bytes());
        }
        self.buffers.push((name.to_owned(), buffer));
        Ok(BufferId(self.buffers.len() - 1))
    }

    /// Writes a buffer from its start.
    pub fn upload(&mut self, id: BufferId, values: &[f32]) {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        self.buffers[id.0].1.bytes_mut()[GUARD..GUARD + bytes.len()].copy_from_slice(bytes);
    }

    /// Reads `len` floats of a buffer from its start.
    pub fn download(&self, id: BufferId, len: usize) -> Vec<f32> {
        bytemuck::cast_slice(&self.buffers[id.0].1.bytes()[GUARD..GUARD + 4 * len]).to_vec()
    }

    /// A plane of 32-bit samples that begins at the buffer's start.
    pub fn plane(&self, id: BufferId, pixel: u32, row: u32, channel: u32) -> PlaneArgs {
        let address = self.address(id);
        PlaneArgs { address, pixel, row, channel, format: Format::F32, ..PlaneArgs::default() }
    }

    /// Whether every guard is whole; `used` gives the bytes in use of each buffer, in order of making.
    ///
    /// # Errors
    /// The name of a buffer that was written outside.
    pub fn check_guards(&self, used: &[u64]) -> Result<(), String> {
        for ((name, buffer), used) in self.buffers.iter().zip(used) {
            let bytes = buffer.bytes();
            let outside = bytes[..GUARD].chunks_exact(4).chain(bytes[GUARD + *used as usize..].chunks_exact(4));
            if outside.into_iter().any(|word| word != SENTINEL.to_ne_bytes()) {
                return Err(format!("{name} was written outside its {used} bytes"));
            }
        }
        Ok(())
    }

    /// Runs the calls one after another and waits. Returns the device's milliseconds where it has timestamps.
    ///
    /// # Errors
    /// [`crate::Error::Vulkan`], [`crate::Error::DeviceLost`].
    pub fn run(&mut self, calls: &[Call]) -> Result<Option<f64>> {
        let mut dispatches: Vec<_> =
            calls.iter().map(|call| Dispatch::new("", Stage::Input, 0, call.clone(), self.target)).collect();
        dispatches.iter_mut().for_each(|dispatch| dispatch.barrier = true);
        let pipelines = pipelines::for_dispatches(&self.device, &dispatches)?;
        let Self { submission, device, buffers, planes, frame, .. } = self;
        let table = PlaneTable::new(device, planes, &[], None)?;
        let frame = FrameArgs { planes: table.upright().address, ..*frame };
        let texels = |range: &TexelRange| {
            let (_, buffer) = &buffers[range.buffer.0];
            let offset = GUARD as u64 + range.offset;
            (buffer.raw(), offset, (buffer.size() - GUARD as u64 - offset) / TEXEL_BYTES * TEXEL_BYTES)
        };
        let resources = Resources { images: None, texels: &texels };
        // SAFETY: the buffers live in `self`, and `run` waits.
        let sets = unsafe { DescriptorSets::new(device, &dispatches, &pipelines, &resources)? };
        let recording = Recording {
            device,
            addresses: Addresses { buffer: &|id| buffers[id.0].1.address() + GUARD as u64, frame },
            buffers: &|id| (buffers[id.0].1.raw(), GUARD as u64),
            pipelines: &pipelines,
            sets: &sets,
            signals: &[],
            turned: None,
            labels: &[],
            timestamps: None,
        };
        submission.record(|commands| {
            // SAFETY: the command buffer is ours; the buffers live in `self`, and `run` waits.
            unsafe { recording.record(commands, &dispatches, 0..dispatches.len()) };
            Ok(())
        })?;
        submission.run()
    }

    fn address(&self, id: BufferId) -> u64 {
        self.buffers[id.0].1.address() + GUARD as u64
    }
}

/// Opens a device with the functions that `patch` makes of its own: a test that lets some of them fail sees what the
/// library makes of it.
///
/// # Safety
/// The patched functions keep to Vulkan's specification, failing where it allows that.
///
/// # Errors
/// As [`Device::open_with`].
pub unsafe fn open_patched(
    options: &DeviceOptions,
    patch: impl FnOnce(&ash::DeviceFnV1_0) -> ash::DeviceFnV1_0,
) -> Result<Device> {
    Device::open_patched(options, |device| {
        let patched = patch(device.fp_v1_0());
        let (v1, v2, v3) = (device.fp_v1_1().clone(), device.fp_v1_2().clone(), device.fp_v1_3().clone());
        ash::Device::from_parts_1_3(device.handle(), patched, v1, v2, v3)
    })
}

/// A denoiser with or without the kernels shaped for CPU drivers ([`Bench::can_run_cpu_kernels`]), whatever the engine
/// would take.
///
/// # Errors
/// As [`Denoiser::new`].
pub fn denoiser_with_kernels(device: &Device, weights: &Weights, options: &Options, cpu: bool) -> Result<Denoiser> {
    let mut target = engine::target(device, options)?;
    target.kernels.cpu = cpu;
    Denoiser::for_target(device, weights, options, target)
}

/// Has the host path cut frames of a size into tiles of this size and these margins, multiples of the network's
/// padding, whether they fit or not. A tile is a margin on two sides and some padding between, at least, or as long as
/// the frame.
///
/// # Errors
/// Those of planning.
pub fn cut_into_tiles(denoiser: &mut Denoiser, extent: Extent, tile: [u32; 2], margin: u32) -> Result<()> {
    let tiling = tiled::tiling_of(&denoiser.engine, extent, tile, margin)?;
    (denoiser.host, denoiser.tiling) = (None, Some((extent, tiling)));
    Ok(())
}

/// Overwrites the memory that the host path's frames of a size are computed in with [`SENTINEL`], which is a NaN: what
/// another frame would leave there, only worse. What is kept of features goes too.
///
/// # Errors
/// As [`Denoiser::denoise`]; [`Error::Binding`] for a size that is cut into tiles.
pub fn overwrite_memory(denoiser: &mut Denoiser, extent: Extent) -> Result<()> {
    denoiser.prepare(extent)?;
    let pass = denoiser.last_pass().ok_or_else(|| Error::Binding("the frame is cut into tiles".into()))?;
    microbench::overwrite_memory(pass, &mut Submission::new(denoiser.device())?, SENTINEL)
}

/// Denoises a frame on the host path and reads what `pick` names of the plan afterwards, with the plan. Only what lives
/// to the end of the pass still holds its values: the residual, the log colour, the statistics.
///
/// # Errors
/// As [`Denoiser::denoise`].
pub fn denoise_and_read(
    denoiser: &mut Denoiser,
    frame: &Frame,
    pick: impl FnOnce(&Plan) -> BufferId,
) -> Result<(Vec<f32>, Plan)> {
    let mut output = vec![0.0; 3 * frame.extent.pixels() as usize];
    denoiser.denoise(frame, PlaneMut::f32(&mut output, Layout::interleaved(frame.extent, 3)))?;
    let device = denoiser.device().clone();
    let pass = denoiser.last_pass().ok_or_else(|| Error::Binding("nothing was denoised yet".into()))?;
    let (source, offset, bytes) = pass.location(pick(pass.plan()));
    let target = Buffer::new(&device, "read back", bytes, MemoryLocation::GpuToCpu)?;
    let copy = [vk::BufferCopy { src_offset: offset, dst_offset: 0, size: bytes }];
    let mut submission = Submission::new(&device)?;
    submission.record(|commands| {
        let written = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_WRITE);
        let read = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_READ);
        let copied = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_WRITE);
        let host = (vk::PipelineStageFlags::HOST, vk::AccessFlags::HOST_READ);
        // SAFETY: both buffers live until `run` returns.
        unsafe {
            submit::barrier(&device, commands, written, read);
            device.raw().cmd_copy_buffer(commands, source, target.raw(), &copy);
            submit::barrier(&device, commands, copied, host);
        }
        Ok(())
    })?;
    submission.run()?;
    Ok((bytemuck::cast_slice(&target.bytes()[..bytes as usize]).to_vec(), pass.plan().clone()))
}

//! A logical device: our own, without a window, or the renderer's.

mod own;
mod renderer;

use super::caps::{Caps, DeviceInfo};
use super::instance::{Messages, OwnedInstance};
use super::interop::Interop;
use super::pipeline::MadePipelines;
use super::pipeline_cache::PipelineCache;
use crate::error::{Error, Result};
use ash::{ext, khr, vk};
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};
use std::mem::ManuallyDrop;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};

pub use own::DeviceOptions;
pub use renderer::RendererDevice;

/// A Vulkan device that denoisers run on. Cheap to clone; `Send` and `Sync`. Kernels are compiled once for it and kept
/// as long as it lives: a second denoiser compiles only what the first has not.
#[derive(Clone)]
pub struct Device(Arc<Inner>);

struct Inner {
    info: DeviceInfo,
    caps: Caps,
    raw: ash::Device,
    allocator: ManuallyDrop<Mutex<Allocator>>,
    memory_in_use: AtomicU64,
    pipeline_cache: PipelineCache,
    /// Every kernel that was compiled so far.
    made_pipelines: Mutex<MadePipelines>,
    queue_family: u32,
    /// The queue of our own device. A renderer keeps its queues to itself.
    queue: Option<Mutex<vk::Queue>>,
    /// The renderer's queue that weights may be copied on.
    upload_queue: Option<Mutex<vk::Queue>>,
    /// Set where pipelines capture statistics.
    executables: Option<khr::pipeline_executable_properties::Device>,
    /// What can be shared with other APIs and devices: nothing of a renderer's, which shares its own.
    interop: Interop,
    /// A bit for each memory type that is the device's own.
    local_types: u32,
    /// Set where objects get names and recordings labels.
    debug: Option<ext::debug_utils::Device>,
    /// Set where the device is ours to destroy.
    owned: Option<OwnedInstance>,
}

impl std::fmt::Debug for Device {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Device").field("info", &self.0.info).finish_non_exhaustive()
    }
}

impl Device {
    /// What the device is.
    pub fn info(&self) -> &DeviceInfo {
        &self.0.info
    }

    /// Bytes of device memory that the library holds on this device now.
    pub fn memory_bytes(&self) -> u64 {
        self.0.memory_in_use.load(std::sync::atomic::Ordering::Relaxed)
    }

    /// What the validation layer has said since the device was opened: warnings and errors, one string each. Empty
    /// without validation.
    pub fn validation_messages(&self) -> Vec<String> {
        let messages: Option<Messages> = self.0.owned.as_ref().map(OwnedInstance::messages);
        messages.map_or_else(Vec::new, |m| m.lock().unwrap_or_else(PoisonError::into_inner).clone())
    }

    /// Whether kernels can be timed: the queue writes timestamps, and the host may reset them (`hostQueryReset`).
    pub fn has_timestamps(&self) -> bool {
        self.caps().lacks_for_timestamps().is_empty()
    }

    /// Whether it has the cooperative matrices that kernels can use: halves summed in 32-bit floats, by a subgroup.
    pub fn has_matrices(&self) -> bool {
        self.caps().matrix.is_some()
    }

    pub(crate) fn caps(&self) -> &Caps {
        &self.0.caps
    }

    pub(crate) fn raw(&self) -> &ash::Device {
        &self.0.raw
    }

    /// What the device can share with other APIs and devices, by file descriptors; nothing where it is a renderer's,
    /// which shares its own.
    pub fn interop(&self) -> Interop {
        self.0.interop
    }

    /// The instance, where it is ours.
    pub(crate) fn instance(&self) -> Option<&ash::Instance> {
        self.0.owned.as_ref().map(|owned| &owned.raw)
    }

    /// Of some memory types the first that is the device's own, or the first.
    pub(crate) fn memory_type(&self, types: u32) -> u32 {
        match types & self.0.local_types {
            0 => types.trailing_zeros(),
            local => local.trailing_zeros(),
        }
    }

    /// Where shaders find a buffer.
    ///
    /// # Safety
    /// The buffer is valid, of this device, bound to memory, and was made with `SHADER_DEVICE_ADDRESS`.
    pub(crate) unsafe fn buffer_address(&self, buffer: vk::Buffer) -> u64 {
        let info = vk::BufferDeviceAddressInfo::default().buffer(buffer);
        // SAFETY: the caller vouches for the buffer.
        unsafe { self.raw().get_buffer_device_address(&info) }
    }

    pub(crate) fn allocator(&self) -> &Mutex<Allocator> {
        &self.0.allocator
    }

    pub(crate) fn memory_in_use(&self) -> &AtomicU64 {
        &self.0.memory_in_use
    }

    /// What reads the statistics of pipelines; pipelines capture them where this is set.
    pub(crate) fn executables(&self) -> Option<&khr::pipeline_executable_properties::Device> {
        self.0.executables.as_ref()
    }

    /// What names objects and labels recordings, where somebody may see it.
    pub(crate) fn debug(&self) -> Option<&ext::debug_utils::Device> {
        self.0.debug.as_ref()
    }

    pub(crate) fn pipeline_cache(&self) -> &PipelineCache {
        &self.0.pipeline_cache
    }

    /// What [`crate::pipelines`] made.
    pub(crate) fn made_pipelines(&self) -> &Mutex<MadePipelines> {
        &self.0.made_pipelines
    }

    pub(crate) fn queue_family(&self) -> u32 {
        self.0.queue_family
    }

    pub(crate) fn queue(&self) -> Option<&Mutex<vk::Queue>> {
        self.0.queue.as_ref()
    }

    /// The queue on which weights are copied: our own, or one that the renderer lends for that alone.
    pub(crate) fn upload_queue(&self) -> Option<&Mutex<vk::Queue>> {
        self.queue().or(self.0.upload_queue.as_ref())
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        let pipelines = std::mem::take(self.made_pipelines.get_mut().unwrap_or_else(PoisonError::into_inner));
        // SAFETY: every object made from the device, and all that uses its pipelines, holds a clone of `Device`, so
        // none is left; allocator, pipelines and cache must go before the device, and the instance (a field) goes last.
        unsafe {
            pipelines.into_values().for_each(|pipeline| pipeline.destroy(&self.raw));
            ManuallyDrop::drop(&mut self.allocator);
            self.raw.destroy_pipeline_cache(self.pipeline_cache.raw, None);
            if self.owned.is_some() {
                self.raw.destroy_device(None);
            }
        }
    }
}

fn allocator(
    instance: &ash::Instance,
    physical_device: vk::PhysicalDevice,
    device: &ash::Device,
) -> Result<ManuallyDrop<Mutex<Allocator>>> {
    let desc = AllocatorCreateDesc {
        instance: instance.clone(),
        device: device.clone(),
        physical_device,
        debug_settings: Default::default(),
        buffer_device_address: true,
        allocation_sizes: Default::default(),
    };
    let allocator = Allocator::new(&desc).map_err(|e| Error::OutOfMemory {
        what: "the allocator".into(),
        bytes: 0,
        reason: e.to_string(),
    })?;
    Ok(ManuallyDrop::new(Mutex::new(allocator)))
}

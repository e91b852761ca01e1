//! A renderer's device.

use super::{Device, Inner, allocator};
use crate::error::{Error, Result};
use crate::vk::cache::Cache;
use crate::vk::caps::{self, Caps, Requirements};
use crate::vk::interop::Interop;
use crate::vk::pipeline_cache::PipelineCache;
use crate::vk::{Checked, debug, matrix};
use ash::{ext, khr, vk};
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex};

/// A renderer's device, as it hands it over: [`RendererDevice::new`], or of numbers [`RendererDevice::from_raw`].
#[derive(Clone)]
#[non_exhaustive]
pub struct RendererDevice {
    /// The instance, made for Vulkan 1.2 or later.
    pub instance: ash::Instance,
    /// The physical device.
    pub physical_device: vk::PhysicalDevice,
    /// The logical device, with everything of [`Device::requirements`] enabled.
    pub device: ash::Device,
    /// The family of the queue that the recorded commands will be submitted to. It must support compute.
    pub queue_family: u32,
    /// Whether `storageBuffer16BitAccess` was enabled: half-float buffers can then be written.
    pub storage_buffer_16bit: bool,
    /// Whether `shaderInt64` was enabled: CPU drivers then run faster.
    pub shader_int64: bool,
    /// Whether `subgroupBroadcastDynamicId` was enabled: CPU drivers then run faster.
    pub subgroup_broadcast_dynamic_id: bool,
    /// Whether `hostQueryReset` was enabled: [`crate::Profiler`] needs it.
    pub host_query_reset: bool,
    /// The functions of `VK_KHR_cooperative_matrix`, where it was enabled together with all of
    /// [`Requirements::matrix_extensions`] and [`Requirements::matrix_features`]: [`crate::Precision::Matrix`] needs
    /// them.
    pub cooperative_matrix: Option<khr::cooperative_matrix::Instance>,
    /// Whether `VK_EXT_debug_utils` was enabled on the instance: objects then have names, and recordings labels.
    pub debug_utils: bool,
    /// Where compiled kernels are kept for the next process.
    pub cache: Cache,
    /// A queue of `queue_family` that [`crate::Denoiser::new`] may submit to and wait for: weights then go to memory
    /// that is the GPU's own, by a copy. `None`: they stay where the host writes them, in memory that is both where
    /// the device has such, and otherwise in the host's, which kernels read over the bus at every frame.
    pub upload_queue: Option<vk::Queue>,
}

impl RendererDevice {
    /// A device without optional features, whose kernels are kept in [`Cache::User`]; the fields say what else was
    /// enabled.
    pub fn new(
        instance: ash::Instance,
        physical_device: vk::PhysicalDevice,
        device: ash::Device,
        queue_family: u32,
    ) -> Self {
        Self {
            instance,
            physical_device,
            device,
            queue_family,
            storage_buffer_16bit: false,
            shader_int64: false,
            subgroup_broadcast_dynamic_id: false,
            host_query_reset: false,
            cooperative_matrix: None,
            debug_utils: false,
            cache: Cache::User,
            upload_queue: None,
        }
    }
}

impl Device {
    /// What a renderer's device must have enabled for [`Device::from_renderer`].
    pub fn requirements() -> Requirements {
        caps::requirements()
    }

    /// Uses a renderer's device. The library makes its own memory, pipelines and descriptor sets on it. Passes are
    /// recorded into the renderer's command buffers ([`crate::Pass::record`]); nothing is submitted or waited for, but
    /// by [`crate::Denoiser::new`] on [`RendererDevice::upload_queue`] where that is given.
    ///
    /// # Errors
    /// [`Error::Unsupported`] where the physical device cannot run the denoiser at all; [`Error::InvalidOption`] where
    /// `debug_utils` is set and the functions are not there; [`Error::Vulkan`].
    ///
    /// # Safety
    /// The handles must be valid, belong together and outlive this `Device` and everything made from it; the device
    /// must have been created with everything of [`Device::requirements`] enabled, and with those of its optional
    /// features that `renderer` says were. An `upload_queue` is a queue of that device and of `queue_family`, and no
    /// other thread submits to it, or does anything else that Vulkan wants externally synchronised with it, while a
    /// [`crate::Denoiser::new`] on this `Device` or a clone of it runs; those synchronise among themselves.
    pub unsafe fn from_renderer(renderer: RendererDevice) -> Result<Self> {
        let RendererDevice {
            instance,
            physical_device,
            device,
            queue_family,
            storage_buffer_16bit,
            shader_int64,
            subgroup_broadcast_dynamic_id,
            host_query_reset,
            cooperative_matrix,
            debug_utils,
            cache,
            upload_queue,
        } = renderer;
        // SAFETY: the caller vouches for the handles.
        let physicals = unsafe { instance.enumerate_physical_devices() }.called("vkEnumeratePhysicalDevices")?;
        let index = physicals.iter().position(|p| *p == physical_device).unwrap_or(0);
        let (info, caps) = caps::inspect(&instance, physical_device, index);
        if !info.missing.is_empty() {
            return Err(Error::Unsupported { device: info.name, missing: info.missing.join(", ") });
        }
        // SAFETY: the caller vouches for the handles.
        let families = unsafe { instance.get_physical_device_queue_family_properties(physical_device) };
        let family = families.get(queue_family as usize);
        if !family.is_some_and(|f| f.queue_flags.contains(vk::QueueFlags::COMPUTE)) {
            let missing = format!("compute on queue family {queue_family}");
            return Err(Error::Unsupported { device: info.name, missing });
        }
        let debug = if debug_utils { Some(needed_debug(&instance, &device)?) } else { None };
        let caps = Caps {
            int64: caps.int64 && shader_int64,
            subgroup_broadcast: caps.subgroup_broadcast && subgroup_broadcast_dynamic_id,
            storage16: caps.storage16 && storage_buffer_16bit,
            float16: false,
            host_query_reset: caps.host_query_reset && host_query_reset,
            matrix: cooperative_matrix.and_then(|loader| matrix::shape(&loader, &instance, physical_device)),
            ..caps.with_timestamp_bits(family.map_or(0, |f| f.timestamp_valid_bits))
        };
        Ok(Self(Arc::new(Inner {
            info,
            allocator: allocator(&instance, physical_device, &device)?,
            pipeline_cache: PipelineCache::new(&device, &caps.identity, &cache),
            caps,
            raw: device,
            made_pipelines: Mutex::default(),
            memory_in_use: AtomicU64::new(0),
            queue_family,
            queue: None,
            upload_queue: upload_queue.filter(|queue| *queue != vk::Queue::null()).map(Mutex::new),
            executables: None,
            interop: Interop::default(),
            local_types: caps::local_types(&instance, physical_device),
            debug,
            owned: None,
        })))
    }
}

fn needed_debug(instance: &ash::Instance, device: &ash::Device) -> Result<ext::debug_utils::Device> {
    debug::load(instance, device).ok_or_else(|| Error::InvalidOption {
        option: "debug_utils",
        reason: "set, and the functions of VK_EXT_debug_utils are not there; make the instance with it".into(),
    })
}

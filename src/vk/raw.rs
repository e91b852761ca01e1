//! A renderer's device from raw Vulkan handles, for callers that do not use `ash`.

use super::device::RendererDevice;
use crate::error::{Error, Result};
use ash::vk::Handle;
use ash::{khr, vk};
use std::ffi::{CStr, c_void};
use std::mem;

/// A renderer's device as numbers, as C, Python and other bindings of Vulkan give its handles out: [`RawDevice::new`].
/// [`RendererDevice::from_raw`] makes of it what [`crate::Device::from_renderer`] takes.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct RawDevice {
    /// `vkGetInstanceProcAddr` of the loader that made the instance. Every other function is found by it.
    pub get_instance_proc_addr: *const c_void,
    /// The `VkInstance`, made for Vulkan 1.2 or later.
    pub instance: u64,
    /// The `VkPhysicalDevice`.
    pub physical_device: u64,
    /// The `VkDevice`, with everything of [`crate::Device::requirements`] enabled.
    pub device: u64,
    /// The family of the queue that the recorded commands will be submitted to. It must support compute.
    pub queue_family: u32,
    /// What of the optional features was enabled when the device was made.
    pub enabled: EnabledFeatures,
    /// The `VkQueue` of [`RendererDevice::upload_queue`]; 0: none.
    pub upload_queue: u64,
}

impl RawDevice {
    /// A device without optional features and without a queue; the fields say what else there is.
    pub fn new(
        get_instance_proc_addr: *const c_void,
        instance: u64,
        physical_device: u64,
        device: u64,
        queue_family: u32,
    ) -> Self {
        let enabled = EnabledFeatures::default();
        Self { get_instance_proc_addr, instance, physical_device, device, queue_family, enabled, upload_queue: 0 }
    }
}

/// Optional features that a renderer enabled on its device. What is `false` is not used, whether it was enabled or not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EnabledFeatures {
    /// `storageBuffer16BitAccess`: half-float buffers can then be written.
    pub storage_buffer_16bit: bool,
    /// `shaderInt64`: CPU drivers then run faster.
    pub shader_int64: bool,
    /// `subgroupBroadcastDynamicId`: CPU drivers then run faster.
    pub subgroup_broadcast_dynamic_id: bool,
    /// `hostQueryReset`: [`crate::Profiler`] needs it.
    pub host_query_reset: bool,
    /// `VK_KHR_cooperative_matrix`, with all of [`matrix_extensions`](crate::Requirements::matrix_extensions) and
    /// [`matrix_features`](crate::Requirements::matrix_features): [`crate::Precision::Matrix`] needs them.
    pub cooperative_matrix: bool,
    /// `VK_EXT_debug_utils`, of the instance: objects then have names, and recordings labels.
    pub debug_utils: bool,
}

impl RendererDevice {
    /// The device of these handles. Its `cache` is [`Cache::User`](crate::Cache::User); set the field for another.
    ///
    /// # Errors
    /// [`Error::InvalidOption`] where a handle or the function is null, and where `get_instance_proc_addr` does not
    /// find the functions of Vulkan 1.2 (an instance made for less, or no instance of that loader).
    ///
    /// # Safety
    /// The handles are valid and belong together, `upload_queue` too where there is one, and `get_instance_proc_addr`
    /// is the `vkGetInstanceProcAddr` of the loader that made the instance.
    pub unsafe fn from_raw(raw: &RawDevice) -> Result<Self> {
        let null =
            |option| Err(Error::InvalidOption { option, reason: "null; it must be a handle of Vulkan's".into() });
        // SAFETY: a function pointer and a data pointer have one size, and null becomes `None`.
        let found = unsafe {
            mem::transmute::<*const c_void, Option<vk::PFN_vkGetInstanceProcAddr>>(raw.get_instance_proc_addr)
        };
        let Some(get_instance_proc_addr) = found else { return null("get_instance_proc_addr") };
        if let Some((option, _)) =
            [("instance", raw.instance), ("physical_device", raw.physical_device), ("device", raw.device)]
                .into_iter()
                .find(|(_, handle)| *handle == 0)
        {
            return null(option);
        }
        let instance = vk::Instance::from_raw(raw.instance);
        let device = vk::Device::from_raw(raw.device);
        let lacks = |option, name: &CStr| {
            let name = name.to_string_lossy();
            Err(Error::InvalidOption { option, reason: format!("it has no {name}; it must be made for Vulkan 1.2") })
        };
        // What is missing would end the process when it is called.
        let name = c"vkGetPhysicalDeviceProperties2";
        // SAFETY: the caller vouches for function and instance; the same below.
        if unsafe { get_instance_proc_addr(instance, name.as_ptr()) }.is_none() {
            return lacks("instance", name);
        }
        let functions = ash::StaticFn { get_instance_proc_addr };
        // SAFETY: as above.
        let (entry, instance) =
            unsafe { (ash::Entry::from_static_fn(functions.clone()), ash::Instance::load(&functions, instance)) };
        let name = c"vkGetBufferDeviceAddress";
        // SAFETY: as above, for the device.
        if unsafe { instance.get_device_proc_addr(device, name.as_ptr()) }.is_none() {
            return lacks("device", name);
        }
        let EnabledFeatures {
            storage_buffer_16bit,
            shader_int64,
            subgroup_broadcast_dynamic_id,
            host_query_reset,
            cooperative_matrix,
            debug_utils,
        } = raw.enabled;
        let matrices = cooperative_matrix.then(|| khr::cooperative_matrix::Instance::new(&entry, &instance));
        // SAFETY: as above.
        let device = unsafe { ash::Device::load(instance.fp_v1_0(), device) };
        let physical_device = vk::PhysicalDevice::from_raw(raw.physical_device);
        Ok(Self {
            storage_buffer_16bit,
            shader_int64,
            subgroup_broadcast_dynamic_id,
            host_query_reset,
            cooperative_matrix: matrices,
            debug_utils,
            upload_queue: (raw.upload_queue != 0).then(|| vk::Queue::from_raw(raw.upload_queue)),
            ..Self::new(instance, physical_device, device, raw.queue_family)
        })
    }
}

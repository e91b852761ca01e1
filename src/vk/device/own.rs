//! A device of our own, without a window.

use super::{Device, Inner, allocator};
use crate::error::{Error, Result};
use crate::vk::cache::Cache;
use crate::vk::caps::{self, Caps, DeviceInfo};
use crate::vk::instance::OwnedInstance;
use crate::vk::interop::Interop;
use crate::vk::matrix::{self, MatrixShape};
use crate::vk::pipeline_cache::PipelineCache;
use crate::vk::selector::{DeviceSelector, enumerate, select};
use crate::vk::{Checked, debug};
use ash::{khr, vk};
use std::ffi::CStr;
use std::path::PathBuf;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex};

/// How to open a device of our own.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DeviceOptions {
    /// Which device.
    pub selector: DeviceSelector,
    /// Turns the Khronos validation layer on, with synchronisation validation. What it says is in
    /// [`Device::validation_messages`].
    pub validation: bool,
    /// Has the compiler keep what [`crate::Denoiser::pipeline_statistics`] tells, where the device can
    /// (`VK_KHR_pipeline_executable_properties`).
    pub pipeline_statistics: bool,
    /// Subgroups that share a tile's tokens in dense kernels on matrices, 1 or 2; `None`: as suits the device.
    pub matrix_halves: Option<u32>,
    /// Takes the queue for one without timestamps: passes are timed on the host, and kernels cannot be.
    pub host_clock: bool,
    /// The Vulkan loader's library, where it is not the system's own.
    pub loader: Option<PathBuf>,
    /// Where compiled kernels are kept for the next process.
    pub cache: Cache,
}

impl Device {
    /// Every Vulkan device there is, in the loader's order, usable or not ([`DeviceInfo::missing`] says why not).
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::Vulkan`].
    pub fn list() -> Result<Vec<DeviceInfo>> {
        let instance = OwnedInstance::new(None, false)?;
        Ok(enumerate(&instance)?.into_iter().map(|(_, info, _)| info).collect())
    }

    /// Opens a device of our own, without a window.
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::NoDevice`], [`Error::UnknownDevice`], [`Error::Unsupported`], [`Error::Vulkan`].
    pub fn open(selector: &DeviceSelector) -> Result<Self> {
        Self::open_with(&DeviceOptions { selector: selector.clone(), ..DeviceOptions::default() })
    }

    /// Opens a device of our own with all options.
    ///
    /// # Errors
    /// As [`Device::open`]; [`Error::InvalidOption`] where the validation layer is wanted and not installed.
    pub fn open_with(options: &DeviceOptions) -> Result<Self> {
        Self::open_patched(options, |device| device)
    }

    /// The same, with the device's functions as `patch` makes them.
    pub(crate) fn open_patched(
        options: &DeviceOptions,
        patch: impl FnOnce(ash::Device) -> ash::Device,
    ) -> Result<Self> {
        let instance = OwnedInstance::new(options.loader.as_deref(), options.validation)?;
        let mut found = enumerate(&instance)?;
        let at = select(&found, &options.selector)?;
        let (physical, info, caps) = found.swap_remove(at);
        if !info.missing.is_empty() {
            return Err(Error::Unsupported { device: info.name, missing: info.missing.join(", ") });
        }
        // SAFETY: `physical` comes from this instance.
        let families = unsafe { instance.raw.get_physical_device_queue_family_properties(physical) };
        // A family that only computes runs beside a desktop's graphics work.
        let family = families
            .iter()
            .enumerate()
            .filter(|(_, f)| f.queue_flags.contains(vk::QueueFlags::COMPUTE))
            .min_by_key(|(_, f)| f.queue_flags.contains(vk::QueueFlags::GRAPHICS))
            .map(|(i, f)| (i as u32, f.timestamp_valid_bits));
        let Some((queue_family, timestamp_bits)) = family else {
            return Err(Error::Unsupported { device: info.name, missing: "a compute queue".into() });
        };
        let loader = khr::cooperative_matrix::Instance::new(&instance.entry, &instance.raw);
        let shape = matrix::shape(&loader, &instance.raw, physical);
        let halves = options.matrix_halves.map(|halves| halves.clamp(1, 2));
        let shape = match halves {
            Some(halves) => shape.map(|shape| MatrixShape { halves, halves_of_few: halves, ..shape }),
            None => shape,
        };
        let caps = Caps { matrix: shape, ..caps };
        let priorities = [1.0];
        let queues =
            [vk::DeviceQueueCreateInfo::default().queue_family_index(queue_family).queue_priorities(&priorities)];
        let mut features12 = vk::PhysicalDeviceVulkan12Features::default()
            .buffer_device_address(true)
            .shader_float16(caps.float16)
            .host_query_reset(caps.host_query_reset)
            // Every device of Vulkan 1.2 has it.
            .timeline_semaphore(true)
            .subgroup_broadcast_dynamic_id(caps.subgroup_broadcast)
            .vulkan_memory_model(caps.matrix.is_some())
            .vulkan_memory_model_device_scope(caps.matrix.is_some());
        let mut features11 = vk::PhysicalDeviceVulkan11Features::default().storage_buffer16_bit_access(caps.storage16);
        let features = vk::PhysicalDeviceFeatures::default().shader_int64(caps.int64);
        let mut create = vk::DeviceCreateInfo::default()
            .queue_create_infos(&queues)
            .enabled_features(&features)
            .push_next(&mut features12)
            .push_next(&mut features11);
        let interop = Interop::of(&instance.raw, physical);
        let mut extensions = interop.extensions();
        let mut matrix_features = matrix::Features::all();
        if caps.matrix.is_some() {
            extensions.extend(matrix::EXTENSIONS.map(CStr::as_ptr));
            create = create.push_next(&mut matrix_features.matrix).push_next(&mut matrix_features.subgroup);
        }
        let statistics = options.pipeline_statistics && caps::has_pipeline_statistics(&instance.raw, physical);
        let mut executables =
            vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default().pipeline_executable_info(true);
        if statistics {
            extensions.push(khr::pipeline_executable_properties::NAME.as_ptr());
            create = create.push_next(&mut executables);
        }
        let create = create.enabled_extension_names(&extensions);
        // SAFETY: extensions and features were reported by this physical device; the pointers outlive the call.
        let raw = unsafe { instance.raw.create_device(physical, &create, None) }.called("vkCreateDevice")?;
        let raw = patch(raw);
        let debug = if instance.debug_utils { debug::load(&instance.raw, &raw) } else { None };
        let executables = statistics.then(|| khr::pipeline_executable_properties::Device::new(&instance.raw, &raw));
        // SAFETY: the family and the one queue of it were just created.
        let queue = unsafe { raw.get_device_queue(queue_family, 0) };
        let caps = caps.with_timestamp_bits(if options.host_clock { 0 } else { timestamp_bits });
        let allocator = match allocator(&instance.raw, physical, &raw) {
            Ok(allocator) => allocator,
            Err(error) => {
                // SAFETY: nothing has been made from the device yet.
                unsafe { raw.destroy_device(None) };
                return Err(error);
            }
        };
        Ok(Self(Arc::new(Inner {
            info,
            pipeline_cache: PipelineCache::new(&raw, &caps.identity, &options.cache),
            caps,
            raw,
            allocator,
            made_pipelines: Mutex::default(),
            memory_in_use: AtomicU64::new(0),
            queue_family,
            queue: Some(Mutex::new(queue)),
            upload_queue: None,
            executables,
            interop,
            local_types: caps::local_types(&instance.raw, physical),
            debug,
            owned: Some(instance),
        })))
    }
}

//! A logical device: our own, without a window, or the renderer's.

use super::Checked;
use super::caps::{self, Caps, DeviceInfo, Requirements};
use super::debug;
use super::instance::{Messages, OwnedInstance};
use super::interop::Interop;
use super::matrix::{self, MatrixShape};
use super::pipeline_cache::PipelineCache;
use super::selector::{DeviceSelector, enumerate, select};
use crate::vk::cache::Cache;
use crate::error::{Error, Result};
use ash::{ext, khr, vk};
use gpu_allocator::vulkan::{Allocator, AllocatorCreateDesc};
use std::ffi::CStr;
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, PoisonError};

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
        }
    }
}

/// A Vulkan device that denoisers run on. Cheap to clone; `Send` and `Sync`.
#[derive(Clone)]
pub struct Device(Arc<Inner>);

struct Inner {
    info: DeviceInfo,
    caps: Caps,
    raw: ash::Device,
    allocator: ManuallyDrop<Mutex<Allocator>>,
    memory_in_use: AtomicU64,
    pipeline_cache: PipelineCache,
    queue_family: u32,
    /// The queue of our own device. A renderer keeps its queues to itself.
    queue: Option<Mutex<vk::Queue>>,
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
    /// Every Vulkan device there is, in the loader's order, usable or not ([`DeviceInfo::missing`] says why not).
    ///
    /// # Errors
    /// [`Error::NoLoader`], [`Error::Vulkan`].
    pub fn list() -> Result<Vec<DeviceInfo>> {
        let instance = OwnedInstance::new(None, false)?;
        Ok(enumerate(&instance)?.into_iter().map(|(_, info, _)| info).collect())
    }

    /// What a renderer's device must have enabled for [`Device::from_renderer`].
    pub fn requirements() -> Requirements {
        caps::requirements()
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
            memory_in_use: AtomicU64::new(0),
            queue_family,
            queue: Some(Mutex::new(queue)),
            executables,
            interop,
            local_types: caps::local_types(&instance.raw, physical),
            debug,
            owned: Some(instance),
        })))
    }

    /// Uses a renderer's device. The library makes its own memory, pipelines and descriptor sets on it and never
    /// submits or waits: passes are recorded into the renderer's command buffers ([`crate::Pass::record`]).
    ///
    /// # Errors
    /// [`Error::Unsupported`] where the physical device cannot run the denoiser at all; [`Error::InvalidOption`] where
    /// `debug_utils` is set and the functions are not there; [`Error::Vulkan`].
    ///
    /// # Safety
    /// The handles must be valid, belong together and outlive this `Device` and everything made from it; the device
    /// must have been created with everything of [`Device::requirements`] enabled, and with those of its optional
    /// features that `renderer` says were.
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
            memory_in_use: AtomicU64::new(0),
            queue_family,
            queue: None,
            executables: None,
            interop: Interop::default(),
            local_types: caps::local_types(&instance, physical_device),
            debug,
            owned: None,
        })))
    }

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

    pub(crate) fn queue_family(&self) -> u32 {
        self.0.queue_family
    }

    pub(crate) fn queue(&self) -> Option<&Mutex<vk::Queue>> {
        self.0.queue.as_ref()
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        // SAFETY: every object made from the device holds a clone of `Device`, so none is left; allocator and cache
        // must go before the device, and the instance (a field) goes last.
        unsafe {
            ManuallyDrop::drop(&mut self.allocator);
            self.raw.destroy_pipeline_cache(self.pipeline_cache.raw, None);
            if self.owned.is_some() {
                self.raw.destroy_device(None);
            }
        }
    }
}

fn needed_debug(instance: &ash::Instance, device: &ash::Device) -> Result<ext::debug_utils::Device> {
    debug::load(instance, device).ok_or_else(|| Error::InvalidOption {
        option: "debug_utils",
        reason: "set, and the functions of VK_EXT_debug_utils are not there; make the instance with it".into(),
    })
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

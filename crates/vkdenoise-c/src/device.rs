//! Devices: a list of them, one of our own, and the renderer's.

use crate::descriptor::{self, descriptor};
use crate::handle;
use crate::status::{Failure, Status, guard};
use std::ffi::{CString, c_char, c_void};
use std::path::PathBuf;
use std::ptr;
use std::sync::LazyLock;
use vkdenoise::{Cache, DeviceOptions as OpenOptions, DeviceSelector, EnabledFeatures, RawDevice, RendererDevice};

/// A Vulkan device that denoisers run on. Can be used by several threads at once.
pub struct Device(pub(crate) vkdenoise::Device);

/// The Vulkan devices there are.
pub struct DeviceList(Vec<vkdenoise::DeviceInfo>);

/// What kind of device it is.
#[repr(u32)]
pub enum DeviceKind {
    /// None of the others.
    Other = 0,
    /// A graphics card.
    DiscreteGpu = 1,
    /// Graphics that share the processor's memory.
    IntegratedGpu = 2,
    /// A part of a GPU, in a virtual machine.
    VirtualGpu = 3,
    /// A driver that computes on the processor.
    Cpu = 4,
}

/// What a device is. Text ends with a zero and is cut where it does not fit.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct DeviceInfo {
    /// sizeof(vkdenoise_device_info), set by the caller.
    pub struct_size: usize,
    /// Bytes of its largest heap of device memory.
    pub memory_bytes: u64,
    /// Its number, for vkdenoise_device_options.device.
    pub index: u32,
    /// A vkdenoise_device_kind.
    pub kind: u32,
    /// The driver's name for it.
    pub name: [c_char; 256],
    /// The driver's name and version.
    pub driver: [c_char; 256],
    /// Its Vulkan version, such as "1.3.230".
    pub api_version: [c_char; 32],
    /// What the denoiser needs and the device lacks, named as in the Vulkan specification. Empty: it can be used.
    pub missing: [c_char; 512],
}
descriptor!(DeviceInfo, "vkdenoise_device_info", missing: [c_char; 512]);

/// How to open a device of the library's own. All zeros but struct_size: the best device.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct DeviceOptions {
    /// sizeof(vkdenoise_device_options).
    pub struct_size: usize,
    /// Which device: "best" (or NULL), a number in the list, or part of its name or its driver's.
    pub device: *const c_char,
    /// Where compiled kernels are kept for the next process: "user" (or NULL; a folder in the user's cache), "off",
    /// or a folder.
    pub cache: *const c_char,
    /// The file of the Vulkan loader's library; NULL: the system's.
    pub loader: *const c_char,
}
descriptor!(DeviceOptions, "vkdenoise_device_options", loader: *const c_char);

/// Features that a renderer can enable on its device for the denoiser's use, for vkdenoise_renderer.enabled_features.
/// bufferDeviceAddress must be enabled in any case.
#[repr(u32)]
pub enum Feature {
    /// storageBuffer16BitAccess: half-float buffers can then be written.
    Storage16 = 1,
    /// shaderInt64: CPU drivers then run faster.
    ShaderInt64 = 2,
    /// subgroupBroadcastDynamicId: CPU drivers then run faster.
    SubgroupBroadcastDynamicId = 4,
    /// hostQueryReset. Nothing of this interface uses it so far.
    HostQueryReset = 8,
    /// VK_KHR_cooperative_matrix, with all that vkdenoise_requirement names for it: GPUs then run several times as
    /// fast.
    CooperativeMatrix = 16,
    /// VK_EXT_debug_utils, of the instance: objects then have names, and recordings labels.
    DebugUtils = 32,
}

impl Feature {
    const ALL: u32 = 63;
}

/// A function of any type.
pub type Function = Option<unsafe extern "C" fn()>;

/// A renderer's own device.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Renderer {
    /// sizeof(vkdenoise_renderer).
    pub struct_size: usize,
    /// vkGetInstanceProcAddr, cast to vkdenoise_function.
    pub get_instance_proc_addr: Function,
    /// The instance, made for Vulkan 1.2 or later.
    pub instance: *mut VkInstance_T,
    /// The physical device.
    pub physical_device: *mut VkPhysicalDevice_T,
    /// The logical device, with what vkdenoise_requirement names enabled.
    pub device: *mut VkDevice_T,
    /// The family of the queue that the recorded commands are submitted to. It must support compute.
    pub queue_family: u32,
    /// The sum of vkdenoise_feature values that were enabled.
    pub enabled_features: u32,
    /// As vkdenoise_device_options.cache.
    pub cache: *const c_char,
    /// A queue of queue_family that vkdenoise_denoiser_create may submit to and wait for: weights then go to memory
    /// that is the GPU's own, by a copy. The caller sees to it that nothing else uses the queue while that function
    /// runs on the device; calls of it synchronise among themselves. NULL: weights stay where the host writes them, in memory
    /// that is both where the device has such, and otherwise in the host's, which kernels read at every frame.
    pub upload_queue: *mut VkQueue_T,
}
descriptor!(Renderer, "vkdenoise_renderer", cache: *const c_char);

/// Vulkan's.
#[repr(C)]
pub struct VkInstance_T([u8; 0]);
/// Vulkan's.
#[repr(C)]
pub struct VkPhysicalDevice_T([u8; 0]);
/// Vulkan's.
#[repr(C)]
pub struct VkDevice_T([u8; 0]);
/// Vulkan's.
#[repr(C)]
pub struct VkQueue_T([u8; 0]);

/// What a renderer's device must have, for vkdenoise_requirement.
#[repr(u32)]
pub enum RequirementKind {
    /// Device extensions that must be enabled.
    Extension = 0,
    /// Features that must be enabled.
    Feature = 1,
    /// Features that are used where they are enabled.
    OptionalFeature = 2,
    /// Device extensions for VKDENOISE_FEATURE_COOPERATIVE_MATRIX.
    MatrixExtension = 3,
    /// Features for VKDENOISE_FEATURE_COOPERATIVE_MATRIX.
    MatrixFeature = 4,
}

/// Copies text into a C array, cut to fit at a character's end.
fn fill<const N: usize>(text: &str) -> [c_char; N] {
    let mut array = [0; N];
    let end = (0..=text.len().min(N - 1)).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
    for (to, from) in array.iter_mut().zip(&text.as_bytes()[..end]) {
        *to = *from as c_char;
    }
    array
}

impl DeviceInfo {
    fn of(info: &vkdenoise::DeviceInfo) -> Self {
        use vkdenoise::DeviceKind as Kind;
        let kind = match info.kind {
            Kind::DiscreteGpu => DeviceKind::DiscreteGpu,
            Kind::IntegratedGpu => DeviceKind::IntegratedGpu,
            Kind::VirtualGpu => DeviceKind::VirtualGpu,
            Kind::Cpu => DeviceKind::Cpu,
            Kind::Other => DeviceKind::Other,
        };
        Self {
            struct_size: size_of::<Self>(),
            memory_bytes: info.memory_bytes,
            index: info.index as u32,
            kind: kind as u32,
            name: fill(&info.name),
            driver: fill(&info.driver),
            api_version: fill(&info.api_version),
            missing: fill(&info.missing.join(", ")),
        }
    }
}

/// # Safety
/// `text` is null or ends with a zero.
unsafe fn cache(text: *const c_char) -> Result<Cache, Failure> {
    // SAFETY: as the caller's.
    let Some(text) = (unsafe { handle::text(text, "cache")? }) else { return Ok(Cache::User) };
    let Ok(cache) = text.parse();
    Ok(cache)
}

/// Looks for every Vulkan device, usable or not.
///
/// @param list receives the list; destroy it with vkdenoise_device_list_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_list_create(list: *mut *mut DeviceList) -> Status {
    // SAFETY: as the caller's; the same in every function of the interface.
    guard(|| unsafe { handle::give(list, || Ok(DeviceList(vkdenoise::Device::list()?))) })
}

/// How many devices the list has; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_list_count(list: *const DeviceList) -> u32 {
    // SAFETY: as above.
    unsafe { list.as_ref() }.map_or(0, |list| list.0.len() as u32)
}

/// What the device at `index` of the list is.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_list_get(
    list: *const DeviceList,
    index: u32,
    info: *mut DeviceInfo,
) -> Status {
    guard(|| {
        // SAFETY: as above.
        let list = unsafe { handle::borrow(list, "device list")? };
        let Some(found) = list.0.get(index as usize) else {
            return Err(Failure::argument(format!("there is no device {index}; the list has {}", list.0.len())));
        };
        // SAFETY: as above.
        unsafe { descriptor::write(info, &DeviceInfo::of(found)) }
    })
}

/// Destroys a list. NULL is nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_list_destroy(list: *mut DeviceList) {
    // SAFETY: as above.
    guard(|| {
        unsafe { handle::take(list) };
        Ok(())
    });
}

/// Opens a device of the library's own, for the host path.
///
/// @param options NULL: the best device.
/// @param device receives the device; destroy it with vkdenoise_device_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_open(options: *const DeviceOptions, device: *mut *mut Device) -> Status {
    let open = || {
        // SAFETY: as above.
        let options = unsafe { descriptor::read_or_default(options)? };
        // SAFETY: as above.
        let selector = match unsafe { handle::text(options.device, "device")? } {
            Some(text) => {
                let Ok(selector) = text.parse();
                selector
            }
            None => DeviceSelector::Best,
        };
        // SAFETY: as above.
        let (cache, loader) = unsafe { (cache(options.cache)?, handle::text(options.loader, "loader")?) };
        let options = OpenOptions { selector, cache, loader: loader.map(PathBuf::from), ..OpenOptions::default() };
        Ok(Device(vkdenoise::Device::open_with(&options)?))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(device, open) })
}

/// Uses a renderer's device. The library makes memory, pipelines and descriptor sets on it. Passes are recorded into
/// the renderer's command buffers; nothing is submitted or waited for, but by vkdenoise_denoiser_create on upload_queue
/// where that is given. The handles must be valid, belong together and outlive the device and all that is made from it.
///
/// @param device receives the device; destroy it with vkdenoise_device_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_from_renderer(renderer: *const Renderer, device: *mut *mut Device) -> Status {
    let take = || {
        // SAFETY: as above.
        let renderer = unsafe { descriptor::read(renderer)? };
        let enabled = renderer.enabled_features;
        if enabled & !Feature::ALL != 0 {
            return Err(Failure::argument(format!("enabled_features has bits that are no feature: {enabled:#x}")));
        }
        let has = |feature: Feature| enabled & feature as u32 != 0;
        let function = renderer.get_instance_proc_addr;
        let mut raw = RawDevice::new(
            function.map_or(ptr::null(), |function| function as *const c_void),
            renderer.instance as u64,
            renderer.physical_device as u64,
            renderer.device as u64,
            renderer.queue_family,
        );
        raw.enabled = EnabledFeatures {
            storage_buffer_16bit: has(Feature::Storage16),
            shader_int64: has(Feature::ShaderInt64),
            subgroup_broadcast_dynamic_id: has(Feature::SubgroupBroadcastDynamicId),
            host_query_reset: has(Feature::HostQueryReset),
            cooperative_matrix: has(Feature::CooperativeMatrix),
            debug_utils: has(Feature::DebugUtils),
        };
        raw.upload_queue = renderer.upload_queue as u64;
        // SAFETY: the caller vouches for its handles.
        let mut handles = unsafe { RendererDevice::from_raw(&raw)? };
        // SAFETY: as above.
        handles.cache = unsafe { cache(renderer.cache)? };
        // SAFETY: as above.
        Ok(Device(unsafe { vkdenoise::Device::from_renderer(handles)? }))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(device, take) })
}

/// Destroys a device. What was made from it can still be used and keeps it alive. NULL is nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_destroy(device: *mut Device) {
    // SAFETY: as above.
    guard(|| {
        unsafe { handle::take(device) };
        Ok(())
    });
}

/// What a device is.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_get_info(device: *const Device, info: *mut DeviceInfo) -> Status {
    // SAFETY: as above.
    guard(|| unsafe {
        let device = handle::borrow(device, "device")?;
        descriptor::write(info, &DeviceInfo::of(device.0.info()))
    })
}

/// Bytes of device memory that the library holds on the device now; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_memory_bytes(device: *const Device) -> u64 {
    // SAFETY: as above.
    unsafe { device.as_ref() }.map_or(0, |device| device.0.memory_bytes())
}

/// Names what a renderer enables when it makes its instance and device, of Vulkan 1.2 or later.
///
/// @param kind a vkdenoise_requirement_kind.
/// @param index 0, 1, ... until the function returns NULL.
/// @return a name as in the Vulkan specification, which lives as long as the library; NULL after the last.
#[unsafe(no_mangle)]
pub extern "C" fn vkdenoise_requirement(kind: u32, index: u32) -> *const c_char {
    let names = NAMES.iter().find(|(of, _)| *of == kind).map(|(_, names)| names);
    names.and_then(|names| names.get(index as usize)).map_or(ptr::null(), |name| name.as_ptr())
}

/// Names by kind, made once for callers to keep.
static NAMES: LazyLock<Vec<(u32, Vec<CString>)>> = LazyLock::new(|| {
    let required = vkdenoise::Device::requirements();
    [
        (RequirementKind::Extension, required.extensions),
        (RequirementKind::Feature, required.features),
        (RequirementKind::OptionalFeature, required.optional_features),
        (RequirementKind::MatrixExtension, required.matrix_extensions),
        (RequirementKind::MatrixFeature, required.matrix_features),
    ]
    .map(|(kind, names)| (kind as u32, names.into_iter().filter_map(|name| CString::new(name).ok()).collect()))
    .into()
});

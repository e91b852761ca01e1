//! What a device can do, and what the denoiser needs of it.

use super::matrix::{self, MatrixShape};
use crate::kernels::contract::{ConstantValue, Need, Sharing, Specialisation};
use crate::kernels::TILE;
use crate::kernels::contracts::MATRIX_SUBGROUPS;
use ash::vk;
use std::ffi::CStr;
use std::fmt;

/// What kind of device it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum DeviceKind {
    /// A graphics card of its own memory.
    DiscreteGpu,
    /// A GPU that shares the host's memory.
    IntegratedGpu,
    /// A GPU handed to a virtual machine.
    VirtualGpu,
    /// A driver that runs on the CPU, such as lavapipe or SwiftShader.
    Cpu,
    /// Anything else.
    Other,
}

impl fmt::Display for DeviceKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::DiscreteGpu => "discrete GPU",
            Self::IntegratedGpu => "integrated GPU",
            Self::VirtualGpu => "virtual GPU",
            Self::Cpu => "CPU",
            Self::Other => "other",
        })
    }
}

/// A Vulkan device as the denoiser sees it.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct DeviceInfo {
    /// Position in [`crate::Device::list`].
    pub index: usize,
    /// The driver's name for it.
    pub name: String,
    /// The driver's name and version.
    pub driver: String,
    /// What kind of device it is.
    pub kind: DeviceKind,
    /// Vulkan version, e.g. `1.3.230`.
    pub api_version: String,
    /// What the denoiser needs and the device lacks, named as in the Vulkan specification. Empty: usable.
    pub missing: Vec<String>,
    /// Size of the largest device-local heap in bytes.
    pub memory_bytes: u64,
}

/// Limits and optional features that the plan and the kernels are chosen by.
#[derive(Clone, Debug, PartialEq)]
pub struct Caps {
    /// What kind of device it is.
    pub kind: DeviceKind,
    /// Mesa's major version, where the driver is its lavapipe.
    pub lavapipe: Option<u32>,
    /// Largest buffer and largest single allocation, in bytes.
    pub max_buffer_bytes: u64,
    /// Bytes of the largest device-local heap.
    pub memory_bytes: u64,
    /// Workgroups in x and y of one dispatch.
    pub max_groups: [u32; 3],
    /// Invocations of a subgroup.
    pub subgroup_size: u32,
    /// `subgroupShuffle` in compute shaders.
    pub subgroup_shuffle: bool,
    /// `subgroupAny` in compute shaders.
    pub subgroup_vote: bool,
    /// `subgroupBroadcast` in compute shaders, from any lane (`subgroupBroadcastDynamicId`, enabled).
    pub subgroup_broadcast: bool,
    /// Texels that a texel buffer may have.
    pub max_texels: u32,
    /// Whether a texel buffer of 16-byte texels may begin at each of them.
    pub texels_anywhere: bool,
    /// `shaderInt64` (enabled).
    pub int64: bool,
    /// `storageBuffer16BitAccess` (enabled).
    pub storage16: bool,
    /// `shaderFloat16` (enabled).
    pub float16: bool,
    /// `hostQueryReset` (enabled).
    pub host_query_reset: bool,
    /// Its cooperative matrices (enabled).
    pub matrix: Option<MatrixShape>,
    /// Nanoseconds per timestamp tick; 0 where the queue has no timestamps.
    pub timestamp_period: f32,
    /// Bits of a timestamp that count.
    pub timestamp_bits: u32,
    /// Which device and driver it is.
    pub identity: Identity,
}

/// What tells a device and its driver from others: what one made, another cannot use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The vendor's number.
    pub vendor: u32,
    /// The device's number among its vendor's.
    pub device: u32,
    /// The driver's version.
    pub driver: u32,
    /// `pipelineCacheUUID`: changes with the driver's compiler.
    pub uuid: [u8; 16],
    /// Invocations of a subgroup, which some CPU drivers can be told.
    pub subgroup: u32,
}

/// Smallest subgroup of [`Need::CpuDriver`]: so many lanes share what they load.
const SHARING_LANES: u32 = 8;

/// From this Mesa on lavapipe's `subgroupBroadcast` is one instruction where its lane is constant (25.0.7, measured).
/// On 22.3.6 it looks for an active lane in a loop.
const BROADCASTING_MESA: u32 = 25;

/// Size of a texel: four 32-bit floats.
pub(crate) const TEXEL_BYTES: u64 = 16;

impl Caps {
    /// The same on a queue whose timestamps have `bits` bits; 0: it has none.
    pub(crate) fn with_timestamp_bits(self, bits: u32) -> Self {
        let timestamp_period = if bits == 0 { 0.0 } else { self.timestamp_period };
        Self { timestamp_period, timestamp_bits: bits, ..self }
    }

    /// What kernels cannot be timed without and the device lacks, named as in the Vulkan specification; empty: nothing.
    pub(crate) fn lacks_for_timestamps(&self) -> Vec<&'static str> {
        let wanted = [
            (self.timestamp_period > 0.0, "timestamps on the queue (timestampValidBits)"),
            (self.host_query_reset, "hostQueryReset"),
        ];
        wanted.into_iter().filter(|(has, _)| !has).map(|(_, name)| name).collect()
    }

    /// What fills a specialisation constant; sizes of matrices are 0 where the device has none.
    pub(crate) fn constant(&self, value: ConstantValue, special: Specialisation) -> u32 {
        let matrix = |size: fn(MatrixShape) -> u32| self.matrix.map_or(0, size);
        let halves = matrix(if special.few { |shape| shape.halves_of_few } else { |shape| shape.halves });
        match value {
            ConstantValue::Subgroups(count) => count * matrix(|shape| shape.subgroup),
            ConstantValue::WindowInvocations => matrix(|shape| TILE * TILE / shape.rows * shape.subgroup),
            ConstantValue::MatrixRows => matrix(|shape| shape.rows),
            ConstantValue::MatrixColumns => matrix(|shape| shape.columns),
            ConstantValue::MatrixDepth => matrix(|shape| shape.depth),
            ConstantValue::Epilogue => special.epilogue,
            ConstantValue::InnerEpilogue => special.inner,
            ConstantValue::DenseInvocations => MATRIX_SUBGROUPS * halves * matrix(|shape| shape.subgroup),
            ConstantValue::Tiles => special.tiles,
            ConstantValue::Halves => halves,
            ConstantValue::Inputs => special.inputs,
            ConstantValue::Keys => special.keys,
            ConstantValue::Values => special.values,
        }
    }

    /// How lanes of a subgroup hand each other what they loaded, with [`Need::CpuDriver`].
    pub(crate) fn sharing(&self) -> Sharing {
        match self.lavapipe {
            Some(mesa) if mesa >= BROADCASTING_MESA => Sharing::Broadcast,
            _ => Sharing::Shuffle,
        }
    }

    /// Whether the device has what a kernel variant needs beyond the portable set.
    pub fn meets(&self, need: Need) -> bool {
        match need {
            Need::CpuDriver => {
                self.subgroup_shuffle
                    && self.subgroup_vote
                    && self.subgroup_broadcast
                    && self.subgroup_size >= SHARING_LANES
                    && self.int64
                    && self.texels_anywhere
            }
            Need::Storage16 => self.storage16,
            Need::Float16 => self.float16,
            // The kernels hand sums round in the subgroup.
            Need::Matrix => self.matrix.is_some() && self.storage16 && self.subgroup_shuffle,
        }
    }
}

/// What a renderer must enable on its device before it hands it over with [`crate::Device::from_renderer`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Requirements {
    /// Lowest Vulkan version of instance and device: (major, minor).
    pub api_version: (u32, u32),
    /// Device extensions to enable. Empty: everything needed is core in that version.
    pub extensions: Vec<&'static str>,
    /// Features that must be enabled, named as in `VkPhysicalDevice*Features`.
    pub features: Vec<&'static str>,
    /// Features that the denoiser uses when they are enabled.
    pub optional_features: Vec<&'static str>,
    /// Device extensions that kernels on cooperative matrices need.
    pub matrix_extensions: Vec<&'static str>,
    /// Features that they need.
    pub matrix_features: Vec<&'static str>,
}

/// The denoiser's requirements. Every Vulkan 1.3 device meets them, and nearly every 1.2 device.
pub(crate) fn requirements() -> Requirements {
    Requirements {
        api_version: (1, 2),
        extensions: Vec::new(),
        features: vec!["bufferDeviceAddress"],
        optional_features: vec![
            "storageBuffer16BitAccess",
            "shaderInt64",
            "subgroupBroadcastDynamicId",
            "hostQueryReset",
        ],
        matrix_extensions: matrix::EXTENSIONS.iter().filter_map(|name| name.to_str().ok()).collect(),
        matrix_features: matrix::FEATURES.to_vec(),
    }
}

/// Smallest limits that the portable kernels live with.
const MIN_INVOCATIONS: u32 = 256;
const MIN_SHARED_BYTES: u32 = 32 * 1024;
const MIN_PUSH_BYTES: u32 = 128;

/// Reads a physical device. `index` is its position in the enumeration.
pub(crate) fn inspect(instance: &ash::Instance, physical: vk::PhysicalDevice, index: usize) -> (DeviceInfo, Caps) {
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
    let mut maintenance3 = vk::PhysicalDeviceMaintenance3Properties::default();
    let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut subgroup).push_next(&mut maintenance3);
    // SAFETY: `physical` comes from `instance`; the chained structs live until the call returns.
    let base = unsafe { instance.get_physical_device_properties(physical) };
    // The driver's properties are core from 1.2 on; an older device is refused below without asking it.
    let modern = base.api_version >= vk::API_VERSION_1_2;
    if modern {
        properties = properties.push_next(&mut driver);
    }
    // SAFETY: as above.
    unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
    let (limits, kind) = (base.limits, kind_of(base.device_type));

    let mut features12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut features11 = vk::PhysicalDeviceVulkan11Features::default();
    if modern {
        let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut features12).push_next(&mut features11);
        // SAFETY: as above.
        unsafe { instance.get_physical_device_features2(physical, &mut features) };
    }
    // SAFETY: as above.
    let features10 = unsafe { instance.get_physical_device_features(physical) };
    // SAFETY: as above.
    let memory = unsafe { instance.get_physical_device_memory_properties(physical) };
    // SAFETY: as above.
    let families = unsafe { instance.get_physical_device_queue_family_properties(physical) };
    let memory_bytes = memory
        .memory_heaps_as_slice()
        .iter()
        .filter(|heap| heap.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL))
        .map(|heap| heap.size)
        .max()
        .unwrap_or(0);

    let mut missing = Vec::new();
    let mut need = |ok: bool, what: String| {
        if !ok {
            missing.push(what);
        }
    };
    need(modern, format!("Vulkan 1.2 (it has {})", version(base.api_version)));
    need(features12.buffer_device_address == vk::TRUE, "bufferDeviceAddress".into());
    let at_least = |name: &str, has: u32, wants: u32| format!("{name} of {wants} (it has {has})");
    for (name, has, wants) in [
        ("maxComputeWorkGroupInvocations", limits.max_compute_work_group_invocations, MIN_INVOCATIONS),
        ("maxComputeWorkGroupSize[0]", limits.max_compute_work_group_size[0], MIN_INVOCATIONS),
        ("maxComputeSharedMemorySize", limits.max_compute_shared_memory_size, MIN_SHARED_BYTES),
        ("maxPushConstantsSize", limits.max_push_constants_size, MIN_PUSH_BYTES),
    ] {
        need(has >= wants, at_least(name, has, wants));
    }
    need(families.iter().any(|f| f.queue_flags.contains(vk::QueueFlags::COMPUTE)), "a compute queue".into());

    let text = |s: Result<&std::ffi::CStr, _>| s.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    let driver_name = text(driver.driver_name_as_c_str().map_err(|_| ()));
    let driver_info = text(driver.driver_info_as_c_str().map_err(|_| ()));
    let info = DeviceInfo {
        index,
        name: text(base.device_name_as_c_str().map_err(|_| ())),
        driver: if driver_info.is_empty() { driver_name } else { format!("{driver_name}, {driver_info}") },
        kind,
        api_version: version(base.api_version),
        missing,
        memory_bytes,
    };
    let in_subgroups = |operation| {
        subgroup.supported_stages.contains(vk::ShaderStageFlags::COMPUTE)
            && subgroup.supported_operations.contains(operation)
    };
    let caps = Caps {
        kind,
        lavapipe: (driver.driver_id == vk::DriverId::MESA_LLVMPIPE).then(|| mesa_major(&driver_info)).flatten(),
        max_buffer_bytes: maintenance3.max_memory_allocation_size,
        memory_bytes,
        max_groups: limits.max_compute_work_group_count,
        subgroup_size: subgroup.subgroup_size,
        subgroup_shuffle: in_subgroups(vk::SubgroupFeatureFlags::SHUFFLE),
        subgroup_vote: in_subgroups(vk::SubgroupFeatureFlags::VOTE),
        subgroup_broadcast: in_subgroups(vk::SubgroupFeatureFlags::BALLOT)
            && features12.subgroup_broadcast_dynamic_id == vk::TRUE,
        max_texels: limits.max_texel_buffer_elements,
        texels_anywhere: limits.min_texel_buffer_offset_alignment <= TEXEL_BYTES,
        int64: features10.shader_int64 == vk::TRUE,
        storage16: features11.storage_buffer16_bit_access == vk::TRUE,
        float16: features12.shader_float16 == vk::TRUE,
        host_query_reset: features12.host_query_reset == vk::TRUE,
        // Known when the device is opened.
        matrix: None,
        timestamp_period: limits.timestamp_period,
        // The queue's own, once it is known.
        timestamp_bits: 0,
        identity: Identity {
            vendor: base.vendor_id,
            device: base.device_id,
            driver: base.driver_version,
            uuid: base.pipeline_cache_uuid,
            subgroup: subgroup.subgroup_size,
        },
    };
    (info, caps)
}

/// A bit for each memory type that is the device's own.
pub(crate) fn local_types(instance: &ash::Instance, physical: vk::PhysicalDevice) -> u32 {
    // SAFETY: `physical` comes from `instance`.
    let memory = unsafe { instance.get_physical_device_memory_properties(physical) };
    let local = |ty: &vk::MemoryType| ty.property_flags.contains(vk::MemoryPropertyFlags::DEVICE_LOCAL);
    let types = memory.memory_types_as_slice().iter().enumerate().filter(|(_, ty)| local(ty));
    types.fold(0, |bits, (i, _)| bits | 1 << i)
}

/// Whether a physical device has an extension.
pub(crate) fn has_extension(instance: &ash::Instance, physical: vk::PhysicalDevice, name: &CStr) -> bool {
    // SAFETY: `physical` comes from `instance`.
    let extensions = unsafe { instance.enumerate_device_extension_properties(physical) }.unwrap_or_default();
    extensions.iter().any(|extension| extension.extension_name_as_c_str() == Ok(name))
}

/// Whether a physical device tells what its compiler made of a pipeline.
pub(crate) fn has_pipeline_statistics(instance: &ash::Instance, physical: vk::PhysicalDevice) -> bool {
    if !has_extension(instance, physical, ash::khr::pipeline_executable_properties::NAME) {
        return false;
    }
    let mut executables = vk::PhysicalDevicePipelineExecutablePropertiesFeaturesKHR::default();
    let mut features = vk::PhysicalDeviceFeatures2::default().push_next(&mut executables);
    // SAFETY: `physical` comes from `instance`; the chained struct is one of an extension that the device has.
    unsafe { instance.get_physical_device_features2(physical, &mut features) };
    executables.pipeline_executable_info == vk::TRUE
}

/// The major version that lavapipe tells of Mesa, such as `Mesa 22.3.6 (LLVM 15.0.6)`: before Mesa 23 `driverVersion`
/// says 1.
fn mesa_major(driver_info: &str) -> Option<u32> {
    driver_info.strip_prefix("Mesa ")?.split('.').next()?.parse().ok()
}

fn kind_of(ty: vk::PhysicalDeviceType) -> DeviceKind {
    match ty {
        vk::PhysicalDeviceType::DISCRETE_GPU => DeviceKind::DiscreteGpu,
        vk::PhysicalDeviceType::INTEGRATED_GPU => DeviceKind::IntegratedGpu,
        vk::PhysicalDeviceType::VIRTUAL_GPU => DeviceKind::VirtualGpu,
        vk::PhysicalDeviceType::CPU => DeviceKind::Cpu,
        _ => DeviceKind::Other,
    }
}

fn version(v: u32) -> String {
    format!("{}.{}.{}", vk::api_version_major(v), vk::api_version_minor(v), vk::api_version_patch(v))
}

//! What a device of our own can share with other APIs and devices, by file descriptors.

use super::caps::has_extension;
use ash::{ext, khr, vk};
use std::ffi::{CStr, c_char};

/// Which way something can be handed over.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Transfer {
    /// Whether the device can take another's.
    pub import: bool,
    /// Whether another can take the device's.
    pub export: bool,
    /// Whether memory must be allocated for the one buffer in it (`VK_MEMORY_DEDICATED_ALLOCATE_INFO`), by both sides.
    pub dedicated: bool,
}

/// What a device that the library opened can share ([`crate::Device::interop`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Interop {
    /// Buffers by opaque file descriptors (`VK_KHR_external_memory_fd`): with Vulkan, CUDA and OpenGL on the same
    /// device and driver.
    pub opaque_fd: Transfer,
    /// Buffers by dma-bufs (`VK_EXT_external_memory_dma_buf`): with whatever else in the system knows them.
    pub dma_buf: Transfer,
    /// Timeline semaphores by opaque file descriptors (`VK_KHR_external_semaphore_fd`).
    pub timeline_fd: Transfer,
    /// What tells the device from others in every API (`VkPhysicalDeviceIDProperties`).
    pub device_uuid: [u8; 16],
    /// The same of its driver: opaque file descriptors pass between equal drivers.
    pub driver_uuid: [u8; 16],
}

/// A kind of file descriptor for memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemoryHandle {
    /// `VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT`.
    OpaqueFd,
    /// `VK_EXTERNAL_MEMORY_HANDLE_TYPE_DMA_BUF_BIT_EXT`.
    DmaBuf,
}

impl MemoryHandle {
    pub(crate) fn raw(self) -> vk::ExternalMemoryHandleTypeFlags {
        match self {
            Self::OpaqueFd => vk::ExternalMemoryHandleTypeFlags::OPAQUE_FD,
            Self::DmaBuf => vk::ExternalMemoryHandleTypeFlags::DMA_BUF_EXT,
        }
    }
}

impl Interop {
    /// Of a kind of memory.
    pub fn memory(&self, handle: MemoryHandle) -> Transfer {
        match handle {
            MemoryHandle::OpaqueFd => self.opaque_fd,
            MemoryHandle::DmaBuf => self.dma_buf,
        }
    }

    /// Reads a physical device of Vulkan 1.2.
    pub(crate) fn of(instance: &ash::Instance, physical: vk::PhysicalDevice) -> Self {
        let has = |name: &CStr| has_extension(instance, physical, name);
        let mut id = vk::PhysicalDeviceIDProperties::default();
        let mut properties = vk::PhysicalDeviceProperties2::default().push_next(&mut id);
        // SAFETY: `physical` comes from `instance`; the chained struct lives until the call returns.
        unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
        let fds = has(khr::external_memory_fd::NAME);
        let memory = |there: bool, handle| if there { memory(instance, physical, handle) } else { Transfer::default() };
        Self {
            opaque_fd: memory(fds, MemoryHandle::OpaqueFd),
            dma_buf: memory(fds && has(ext::external_memory_dma_buf::NAME), MemoryHandle::DmaBuf),
            timeline_fd: match has(khr::external_semaphore_fd::NAME) {
                true => timeline(instance, physical),
                false => Transfer::default(),
            },
            device_uuid: id.device_uuid,
            driver_uuid: id.driver_uuid,
        }
    }

    /// The device extensions that it takes.
    pub(crate) fn extensions(&self) -> Vec<*const c_char> {
        let any = |transfer: Transfer| transfer.import || transfer.export;
        let mut names = Vec::new();
        if any(self.opaque_fd) || any(self.dma_buf) {
            names.push(khr::external_memory_fd::NAME.as_ptr());
        }
        if any(self.dma_buf) {
            names.push(ext::external_memory_dma_buf::NAME.as_ptr());
        }
        if any(self.timeline_fd) {
            names.push(khr::external_semaphore_fd::NAME.as_ptr());
        }
        names
    }
}

/// What shared buffers are used for.
pub(crate) const SHARED_USAGE: vk::BufferUsageFlags = vk::BufferUsageFlags::from_raw(
    vk::BufferUsageFlags::STORAGE_BUFFER.as_raw()
        | vk::BufferUsageFlags::SHADER_DEVICE_ADDRESS.as_raw()
        | vk::BufferUsageFlags::TRANSFER_SRC.as_raw()
        | vk::BufferUsageFlags::TRANSFER_DST.as_raw(),
);

fn memory(instance: &ash::Instance, physical: vk::PhysicalDevice, handle: MemoryHandle) -> Transfer {
    let info = vk::PhysicalDeviceExternalBufferInfo::default().usage(SHARED_USAGE).handle_type(handle.raw());
    let mut found = vk::ExternalBufferProperties::default();
    // SAFETY: `physical` comes from `instance`.
    unsafe { instance.get_physical_device_external_buffer_properties(physical, &info, &mut found) };
    let features = found.external_memory_properties.external_memory_features;
    Transfer {
        import: features.contains(vk::ExternalMemoryFeatureFlags::IMPORTABLE),
        export: features.contains(vk::ExternalMemoryFeatureFlags::EXPORTABLE),
        dedicated: features.contains(vk::ExternalMemoryFeatureFlags::DEDICATED_ONLY),
    }
}

fn timeline(instance: &ash::Instance, physical: vk::PhysicalDevice) -> Transfer {
    let mut ty = vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
    let info = vk::PhysicalDeviceExternalSemaphoreInfo::default()
        .handle_type(vk::ExternalSemaphoreHandleTypeFlags::OPAQUE_FD)
        .push_next(&mut ty);
    let mut found = vk::ExternalSemaphoreProperties::default();
    // SAFETY: `physical` comes from `instance`; the chained struct lives until the call returns.
    unsafe { instance.get_physical_device_external_semaphore_properties(physical, &info, &mut found) };
    let features = found.external_semaphore_features;
    Transfer {
        import: features.contains(vk::ExternalSemaphoreFeatureFlags::IMPORTABLE),
        export: features.contains(vk::ExternalSemaphoreFeatureFlags::EXPORTABLE),
        dedicated: false,
    }
}

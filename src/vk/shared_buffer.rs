//! Buffers whose memory other APIs and devices use too, on a device of our own.

use super::Checked;
use super::device::Device;
use super::interop::{MemoryHandle, SHARED_USAGE};
use crate::error::{Error, Result};
use ash::{khr, vk};
use std::os::fd::{AsRawFd, FromRawFd, IntoRawFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// A buffer on a device that the library opened, in memory that another API or device has too: CUDA, OpenGL, another
/// Vulkan device. Its handle is what a [`BufferPlane`](crate::BufferPlane) takes. `Send` and `Sync`; cheap to clone:
/// clones are the same buffer.
#[derive(Clone)]
pub struct SharedBuffer(Arc<Inner>);

struct Inner {
    device: Device,
    raw: vk::Buffer,
    memory: vk::DeviceMemory,
    size: u64,
    /// Bytes of the memory.
    allocated: u64,
    memory_type: u32,
    handle: MemoryHandle,
    /// Whether the memory is another's.
    imported: bool,
    /// Bytes that count as the library's.
    counted: u64,
}

/// Memory on its way from one API or device to another.
#[derive(Debug)]
pub struct SharedMemory {
    /// The descriptor: whoever takes the memory takes it too.
    pub fd: OwnedFd,
    /// What kind of descriptor it is.
    pub handle: MemoryHandle,
    /// Bytes that were allocated.
    pub bytes: u64,
    /// The index of its memory type; of a dma-buf it is not looked at.
    pub memory_type: u32,
}

impl SharedBuffer {
    /// Allocates a buffer of `size` bytes that can be exported.
    ///
    /// # Errors
    /// [`Error::Unsupported`] where the device cannot ([`crate::Device::interop`]); [`Error::InvalidOption`] for no
    /// bytes; [`Error::OutOfMemory`], [`Error::Vulkan`].
    pub fn new(device: &Device, size: u64, handle: MemoryHandle) -> Result<Self> {
        check(device, device.interop().memory(handle).export, handle, "export")?;
        let (raw, requirements) = create(device, size, handle)?;
        let mut export = vk::ExportMemoryAllocateInfo::default().handle_types(handle.raw());
        let info = vk::MemoryAllocateInfo::default().allocation_size(requirements.size).push_next(&mut export);
        Self::bind(device, (raw, size), handle, info, requirements.memory_type_bits, false)
    }

    /// A buffer of `size` bytes at the start of another's memory.
    ///
    /// # Errors
    /// As [`SharedBuffer::new`]; [`Error::InvalidOption`] where the memory is too small for the buffer or of a type
    /// that buffers cannot have.
    ///
    /// # Safety
    /// The descriptor is as the fields beside it say. Opaque ones were exported by the same driver
    /// ([`Interop::driver_uuid`](crate::Interop::driver_uuid)) for the same device, from a dedicated allocation if and
    /// only if [`Transfer::dedicated`](crate::Transfer::dedicated) says so.
    pub unsafe fn import(device: &Device, memory: SharedMemory, size: u64) -> Result<Self> {
        let SharedMemory { fd, handle, bytes, memory_type } = memory;
        let functions = check(device, device.interop().memory(handle).import, handle, "import")?;
        let (raw, requirements) = create(device, size, handle)?;
        let types = match handle {
            MemoryHandle::OpaqueFd => Ok(1u32.checked_shl(memory_type).unwrap_or(0)),
            MemoryHandle::DmaBuf => {
                let mut found = vk::MemoryFdPropertiesKHR::default();
                // SAFETY: the caller vouches for the descriptor.
                unsafe { functions.get_memory_fd_properties(handle.raw(), fd.as_raw_fd(), &mut found) }
                    .called("vkGetMemoryFdPropertiesKHR")
                    .map(|()| found.memory_type_bits)
            }
        };
        let types = match types {
            Ok(types) if bytes >= requirements.size && types & requirements.memory_type_bits != 0 => types,
            other => {
                // SAFETY: nobody has the buffer yet.
                unsafe { device.raw().destroy_buffer(raw, None) };
                let (wants, types, can) = (requirements.size, other?, requirements.memory_type_bits);
                let reason = format!(
                    "{bytes} bytes of the memory types {types:#b}; a buffer of {size} bytes takes {wants} bytes of one \
                     of {can:#b}"
                );
                return Err(Error::InvalidOption { option: "shared memory", reason });
            }
        };
        let mut import = vk::ImportMemoryFdInfoKHR::default().handle_type(handle.raw()).fd(fd.as_raw_fd());
        let info = vk::MemoryAllocateInfo::default().allocation_size(bytes).push_next(&mut import);
        let types = types & requirements.memory_type_bits;
        let made = Self::bind(device, (raw, size), handle, info, types, true)?;
        // It is the driver's from now on.
        let _ = fd.into_raw_fd();
        Ok(made)
    }

    /// Allocates as `info` says and binds the buffer, which is destroyed where that fails.
    fn bind(
        device: &Device,
        (raw, size): (vk::Buffer, u64),
        handle: MemoryHandle,
        info: vk::MemoryAllocateInfo,
        types: u32,
        imported: bool,
    ) -> Result<Self> {
        let memory_type = device.memory_type(types);
        let mut inner = Inner {
            device: device.clone(),
            raw,
            memory: vk::DeviceMemory::null(),
            size,
            allocated: info.allocation_size,
            memory_type,
            handle,
            imported,
            counted: 0,
        };
        let mut flags = vk::MemoryAllocateFlagsInfo::default().flags(vk::MemoryAllocateFlags::DEVICE_ADDRESS);
        let mut dedicated = vk::MemoryDedicatedAllocateInfo::default().buffer(raw);
        let mut info = info.memory_type_index(memory_type).push_next(&mut flags);
        if device.interop().memory(handle).dedicated {
            info = info.push_next(&mut dedicated);
        }
        // SAFETY: the chained structs live until the call returns; the caller vouches for a descriptor among them.
        inner.memory = unsafe { device.raw().allocate_memory(&info, None) }.map_err(|e| Error::OutOfMemory {
            what: "a shared buffer".into(),
            bytes: info.allocation_size,
            reason: e.to_string(),
        })?;
        // SAFETY: fresh memory of a type and size that the buffer can have.
        unsafe { device.raw().bind_buffer_memory(raw, inner.memory, 0) }.called("vkBindBufferMemory")?;
        device.name(raw, "shared buffer");
        if !imported {
            inner.counted = inner.allocated;
            device.memory_in_use().fetch_add(inner.counted, Ordering::Relaxed);
        }
        Ok(Self(Arc::new(inner)))
    }

    /// A descriptor of the memory, for another API or device; with the other fields it is what that has to know.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for memory that was imported; [`Error::Vulkan`].
    pub fn export(&self) -> Result<SharedMemory> {
        let Inner { device, memory, allocated, memory_type, handle, imported, .. } = &*self.0;
        let functions = check(device, !imported, *handle, "export of imported memory")?;
        let info = vk::MemoryGetFdInfoKHR::default().memory(*memory).handle_type(handle.raw());
        // SAFETY: the memory was allocated to be exported so.
        let fd = unsafe { functions.get_memory_fd(&info) }.called("vkGetMemoryFdKHR")?;
        // SAFETY: the descriptor is new and the caller's.
        let fd = unsafe { OwnedFd::from_raw_fd(fd) };
        Ok(SharedMemory { fd, handle: *handle, bytes: *allocated, memory_type: *memory_type })
    }

    /// The `VkBuffer`, with the usages `STORAGE_BUFFER`, `SHADER_DEVICE_ADDRESS`, `TRANSFER_SRC` and `TRANSFER_DST`.
    pub fn raw(&self) -> vk::Buffer {
        self.0.raw
    }

    /// Bytes.
    pub fn size(&self) -> u64 {
        self.0.size
    }

    pub(crate) fn device(&self) -> &Device {
        &self.0.device
    }
}

/// The functions for file descriptors, where the device can do `what`.
fn check(device: &Device, can: bool, handle: MemoryHandle, what: &str) -> Result<khr::external_memory_fd::Device> {
    match device.instance().filter(|_| can) {
        Some(instance) => Ok(khr::external_memory_fd::Device::new(instance, device.raw())),
        None => Err(Error::Unsupported {
            device: device.info().name.clone(),
            missing: format!("{what} of buffers by {handle:?} (VK_KHR_external_memory_fd)"),
        }),
    }
}

/// A buffer for shared memory, and what it needs.
fn create(device: &Device, size: u64, handle: MemoryHandle) -> Result<(vk::Buffer, vk::MemoryRequirements)> {
    if size == 0 {
        return Err(Error::InvalidOption { option: "size", reason: "0; a shared buffer has a byte at least".into() });
    }
    let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(handle.raw());
    let info = vk::BufferCreateInfo::default().size(size).usage(SHARED_USAGE).push_next(&mut external);
    // SAFETY: the device is alive; the chained struct lives until the call returns.
    let raw = unsafe { device.raw().create_buffer(&info, None) }.called("vkCreateBuffer")?;
    // SAFETY: the buffer was made from this device.
    Ok((raw, unsafe { device.raw().get_buffer_memory_requirements(raw) }))
}

impl Drop for Inner {
    fn drop(&mut self) {
        self.device.memory_in_use().fetch_sub(self.counted, Ordering::Relaxed);
        // SAFETY: owners wait for the device to be done before they drop a buffer; null memory is allowed.
        unsafe {
            self.device.raw().destroy_buffer(self.raw, None);
            self.device.raw().free_memory(self.memory, None);
        }
    }
}

//! Buffers with a device address, from gpu-allocator.

use super::Checked;
use super::device::Device;
use crate::error::{Error, Result};
use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{Allocation, AllocationCreateDesc, AllocationScheme};
use std::sync::PoisonError;
use std::sync::atomic::Ordering;

/// A storage buffer that kernels reach by its address. Freed when dropped.
pub(crate) struct Buffer {
    device: Device,
    raw: vk::Buffer,
    allocation: Option<Allocation>,
    address: u64,
    size: u64,
}

impl Buffer {
    /// Allocates `size` bytes.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`] with the name and the size; [`Error::Vulkan`].
    pub fn new(device: &Device, name: &str, size: u64, location: MemoryLocation) -> Result<Self> {
        let vk_device = device.raw();
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::SHADER_DEVICE_ADDRESS
            | vk::BufferUsageFlags::UNIFORM_TEXEL_BUFFER
            | vk::BufferUsageFlags::INDIRECT_BUFFER
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        let info = vk::BufferCreateInfo::default().size(size).usage(usage);
        // SAFETY: the device is alive, as are the pointers in `info`.
        let raw = match unsafe { vk_device.create_buffer(&info, None) } {
            Err(e @ (vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY)) => {
                return Err(Error::OutOfMemory { what: name.into(), bytes: size, reason: e.to_string() });
            }
            created => created.called("vkCreateBuffer")?,
        };
        let mut buffer = Self { device: device.clone(), raw, allocation: None, address: 0, size };
        device.name(raw, name);
        // SAFETY: the buffer was made from this device.
        let requirements = unsafe { vk_device.get_buffer_memory_requirements(raw) };
        // The arena is one block for long: a block of its own memory keeps gpu-allocator from rounding it up.
        let allocation_scheme = if size >= 16 << 20 {
            AllocationScheme::DedicatedBuffer(raw)
        } else {
            AllocationScheme::GpuAllocatorManaged
        };
        let desc = AllocationCreateDesc { name, requirements, location, linear: true, allocation_scheme };
        let allocation = device
            .allocator()
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .allocate(&desc)
            .map_err(|e| Error::OutOfMemory { what: name.into(), bytes: size, reason: e.to_string() })?;
        // SAFETY: fresh memory of this device that meets the buffer's requirements.
        let bound = unsafe { vk_device.bind_buffer_memory(raw, allocation.memory(), allocation.offset()) };
        buffer.allocation = Some(allocation);
        device.memory_in_use().fetch_add(size, Ordering::Relaxed);
        bound.called("vkBindBufferMemory")?;
        // SAFETY: bound, and made with SHADER_DEVICE_ADDRESS.
        buffer.address = unsafe { device.buffer_address(raw) };
        Ok(buffer)
    }

    /// The handle, for copies.
    pub fn raw(&self) -> vk::Buffer {
        self.raw
    }

    /// The address that kernels use.
    pub fn address(&self) -> u64 {
        self.address
    }

    /// Bytes.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// The bytes of a host-visible buffer.
    pub fn bytes(&self) -> &[u8] {
        let mapped = self.allocation.as_ref().and_then(Allocation::mapped_slice).unwrap_or_default();
        &mapped[..mapped.len().min(self.size as usize)]
    }

    /// The bytes of a host-visible buffer, to write.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        let size = self.size as usize;
        let mapped = self.allocation.as_mut().and_then(Allocation::mapped_slice_mut).unwrap_or_default();
        let len = mapped.len().min(size);
        &mut mapped[..len]
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        // SAFETY: owners wait for the device to be done before they drop a buffer.
        unsafe { self.device.raw().destroy_buffer(self.raw, None) };
        if let Some(allocation) = self.allocation.take() {
            self.device.memory_in_use().fetch_sub(self.size, Ordering::Relaxed);
            let mut allocator = self.device.allocator().lock().unwrap_or_else(PoisonError::into_inner);
            // The allocator only fails on an allocation that is not its own.
            let _ = allocator.free(allocation);
        }
    }
}

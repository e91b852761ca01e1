//! Memory and timeline semaphores shared with other APIs and devices by file descriptors, on a device of the library's
//! own.

use crate::choice::choice;
use crate::descriptor::{self, descriptor, reserved};
use crate::device::Device;
use crate::handle;
use crate::status::{Failure, Status, guard};
use std::os::fd::{BorrowedFd, IntoRawFd, OwnedFd};
use std::time::Duration;
use vkdenoise::ash::vk::Handle;
use vkdenoise::{MemoryHandle as CoreHandle, TimelineSemaphore};

/// A buffer whose memory another API or device has too.
pub struct SharedBuffer(pub(crate) vkdenoise::SharedBuffer);

/// A timeline semaphore: a number that grows, and that queues and hosts wait for and raise.
pub struct Timeline(pub(crate) TimelineSemaphore);

/// Which way something can be handed over, added up in vkdenoise_interop.
#[repr(u32)]
pub enum Transfer {
    /// The device can take another's.
    Import = 1,
    /// Another can take the device's.
    Export = 2,
    /// Memory must be allocated for the one buffer in it (VkMemoryDedicatedAllocateInfo), by both sides.
    Dedicated = 4,
}

/// A kind of file descriptor for memory.
#[repr(u32)]
pub enum MemoryHandle {
    /// VK_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD_BIT: between Vulkan, CUDA and OpenGL on the same device and driver.
    OpaqueFd = 0,
    /// VK_EXTERNAL_MEMORY_HANDLE_TYPE_DMA_BUF_BIT_EXT.
    DmaBuf = 1,
}

/// What a device that the library opened can share with other APIs and devices; all 0 for a renderer's, which shares
/// its own.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Interop {
    /// sizeof(vkdenoise_interop), set by the caller.
    pub struct_size: usize,
    /// vkdenoise_transfer values of buffers by VKDENOISE_MEMORY_HANDLE_OPAQUE_FD.
    pub opaque_fd: u32,
    /// vkdenoise_transfer values of buffers by VKDENOISE_MEMORY_HANDLE_DMA_BUF.
    pub dma_buf: u32,
    /// vkdenoise_transfer values of timeline semaphores by opaque file descriptors.
    pub timeline_fd: u32,
    /// Must be 0.
    pub reserved: u32,
    /// What tells the device from others in every API (VkPhysicalDeviceIDProperties).
    pub device_uuid: [u8; 16],
    /// The same of its driver.
    pub driver_uuid: [u8; 16],
}
descriptor!(Interop, "vkdenoise_interop", driver_uuid: [u8; 16]);

/// Memory on its way from one API or device to another.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct SharedMemory {
    /// sizeof(vkdenoise_shared_memory).
    pub struct_size: usize,
    /// Bytes that were allocated.
    pub bytes: u64,
    /// The file descriptor.
    pub fd: i32,
    /// A vkdenoise_memory_handle.
    pub handle: u32,
    /// The index of the memory type that it was allocated of; of a dma-buf it is not looked at.
    pub memory_type: u32,
    /// Must be 0.
    pub reserved: u32,
}
descriptor!(SharedMemory, "vkdenoise_shared_memory", reserved: u32);

const HANDLES: [(u32, CoreHandle); 2] =
    [(MemoryHandle::OpaqueFd as u32, CoreHandle::OpaqueFd), (MemoryHandle::DmaBuf as u32, CoreHandle::DmaBuf)];

fn memory_handle(number: u32) -> Result<CoreHandle, Failure> {
    choice(number, "handle", "vkdenoise_memory_handle", &HANDLES)
}

/// A descriptor of the caller's, which stays the caller's: the library gets one of its own.
fn duplicate(fd: i32) -> Result<OwnedFd, Failure> {
    let refused = |why: &str| Failure::argument(format!("fd is {fd}; {why}"));
    if fd < 0 {
        return Err(refused("it must be an open file descriptor"));
    }
    // SAFETY: it is looked at here alone, and what is not open is an error.
    let borrowed = unsafe { BorrowedFd::borrow_raw(fd) };
    borrowed.try_clone_to_owned().map_err(|error| refused(&error.to_string()))
}

/// What a device can share with CUDA, OpenGL and other Vulkan devices.
///
/// @param interop set its struct_size; the rest is filled in.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_device_get_interop(device: *const Device, interop: *mut Interop) -> Status {
    guard(|| {
        // SAFETY: the caller's pointers are as the header says; the same below.
        let found = unsafe { handle::borrow(device, "device")? }.0.interop();
        let bits = |transfer: vkdenoise::Transfer| {
            let ways = [
                (transfer.import, Transfer::Import),
                (transfer.export, Transfer::Export),
                (transfer.dedicated, Transfer::Dedicated),
            ];
            ways.into_iter().filter(|(can, _)| *can).map(|(_, way)| way as u32).sum()
        };
        let filled = Interop {
            struct_size: size_of::<Interop>(),
            opaque_fd: bits(found.opaque_fd),
            dma_buf: bits(found.dma_buf),
            timeline_fd: bits(found.timeline_fd),
            reserved: 0,
            device_uuid: found.device_uuid,
            driver_uuid: found.driver_uuid,
        };
        // SAFETY: as above.
        unsafe { descriptor::write(interop, &filled) }
    })
}

/// Allocates a buffer that can be exported, on a device of the library's own.
///
/// @param handle a vkdenoise_memory_handle.
/// @param buffer receives the buffer; destroy it with vkdenoise_shared_buffer_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_shared_buffer_create(
    device: *const Device,
    size: u64,
    handle: u32,
    buffer: *mut *mut SharedBuffer,
) -> Status {
    let make = || {
        // SAFETY: as above.
        let device = unsafe { handle::borrow(device, "device")? };
        Ok(SharedBuffer(vkdenoise::SharedBuffer::new(&device.0, size, memory_handle(handle)?)?))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(buffer, make) })
}

/// A buffer at the start of another's memory. An opaque descriptor is of the same device and driver, from a dedicated
/// allocation if and only if vkdenoise_interop says so. The descriptor stays the caller's, to be closed by it.
///
/// @param buffer receives the buffer; destroy it with vkdenoise_shared_buffer_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_shared_buffer_import(
    device: *const Device,
    memory: *const SharedMemory,
    size: u64,
    buffer: *mut *mut SharedBuffer,
) -> Status {
    let make = || {
        // SAFETY: as above.
        let (device, memory) = unsafe { (handle::borrow(device, "device")?, descriptor::read(memory)?) };
        reserved::<SharedMemory>(memory.reserved)?;
        let SharedMemory { bytes, memory_type, .. } = memory;
        let handle = memory_handle(memory.handle)?;
        let memory = vkdenoise::SharedMemory { fd: duplicate(memory.fd)?, handle, bytes, memory_type };
        // SAFETY: the caller promises what the header asks for.
        Ok(SharedBuffer(unsafe { vkdenoise::SharedBuffer::import(&device.0, memory, size)? }))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(buffer, make) })
}

/// A file descriptor of the buffer's memory, with what the other side has to know. The descriptor is the caller's.
///
/// @param memory set its struct_size; the rest is filled in.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_shared_buffer_export(
    buffer: *const SharedBuffer,
    memory: *mut SharedMemory,
) -> Status {
    guard(|| {
        // SAFETY: as above.
        let buffer = unsafe {
            descriptor::size_of_caller(memory.cast_const())?;
            handle::borrow(buffer, "shared buffer")?
        };
        let exported = buffer.0.export()?;
        let number = HANDLES.iter().find(|(_, handle)| *handle == exported.handle).map_or(0, |(number, _)| *number);
        let filled = SharedMemory {
            struct_size: size_of::<SharedMemory>(),
            bytes: exported.bytes,
            fd: exported.fd.into_raw_fd(),
            handle: number,
            memory_type: exported.memory_type,
            reserved: 0,
        };
        // SAFETY: as above.
        unsafe { descriptor::write(memory, &filled) }
    })
}

/// The VkBuffer, for vkdenoise_buffer_plane.buffer; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_shared_buffer_handle(buffer: *const SharedBuffer) -> u64 {
    // SAFETY: as above.
    unsafe { buffer.as_ref() }.map_or(0, |buffer| buffer.0.raw().as_raw())
}

/// Destroys a shared buffer. What was submitted with it must have run. NULL is nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_shared_buffer_destroy(buffer: *mut SharedBuffer) {
    // SAFETY: as above.
    guard(|| {
        unsafe { handle::take(buffer) };
        Ok(())
    });
}

/// Makes a timeline semaphore on a device of the library's own.
///
/// @param timeline receives the semaphore; destroy it with vkdenoise_timeline_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_timeline_create(
    device: *const Device,
    value: u64,
    timeline: *mut *mut Timeline,
) -> Status {
    // SAFETY: as above.
    let make = || Ok(Timeline(TimelineSemaphore::new(&unsafe { handle::borrow(device, "device")? }.0, value)?));
    // SAFETY: as above.
    guard(|| unsafe { handle::give(timeline, make) })
}

/// Another's timeline semaphore, by a descriptor that was exported as VK_EXTERNAL_SEMAPHORE_HANDLE_TYPE_OPAQUE_FD_BIT
/// by the same driver for the same device. The descriptor stays the caller's, to be closed by it.
///
/// @param timeline receives the semaphore; destroy it with vkdenoise_timeline_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_timeline_import(
    device: *const Device,
    fd: i32,
    timeline: *mut *mut Timeline,
) -> Status {
    let make = || {
        // SAFETY: as above; the caller promises what the header asks for.
        unsafe {
            let device = handle::borrow(device, "device")?;
            Ok(Timeline(TimelineSemaphore::import(&device.0, duplicate(fd)?)?))
        }
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(timeline, make) })
}

/// An opaque file descriptor of the semaphore, which is the caller's.
///
/// @param fd receives the descriptor.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_timeline_export(timeline: *const Timeline, fd: *mut i32) -> Status {
    // SAFETY: as above.
    guard(|| unsafe {
        let timeline = handle::borrow(timeline, "timeline")?;
        let fd = fd.as_mut().ok_or_else(|| Failure::argument("fd is NULL"))?;
        *fd = timeline.0.export()?.into_raw_fd();
        Ok(())
    })
}

/// The semaphore's value now.
///
/// @param value receives it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_timeline_value(timeline: *const Timeline, value: *mut u64) -> Status {
    // SAFETY: as above.
    guard(|| unsafe {
        let timeline = handle::borrow(timeline, "timeline")?;
        let value = value.as_mut().ok_or_else(|| Failure::argument("value is NULL"))?;
        *value = timeline.0.value()?;
        Ok(())
    })
}

/// Raises the value from the host; it must be larger than the value now.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_timeline_signal(timeline: *const Timeline, value: u64) -> Status {
    // SAFETY: as above.
    guard(|| Ok(unsafe { handle::borrow(timeline, "timeline")? }.0.signal(value)?))
}

/// Waits on the host for a value.
///
/// @param reached receives 1, or 0 where the value did not come within the time.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_timeline_wait(
    timeline: *const Timeline,
    value: u64,
    timeout_ns: u64,
    reached: *mut u32,
) -> Status {
    // SAFETY: as above.
    guard(|| unsafe {
        let timeline = handle::borrow(timeline, "timeline")?;
        let reached = reached.as_mut().ok_or_else(|| Failure::argument("reached is NULL"))?;
        *reached = timeline.0.wait(value, Duration::from_nanos(timeout_ns))?.into();
        Ok(())
    })
}

/// Destroys a semaphore. Submissions that name it keep it. NULL is nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_timeline_destroy(timeline: *mut Timeline) {
    // SAFETY: as above.
    guard(|| {
        unsafe { handle::take(timeline) };
        Ok(())
    });
}

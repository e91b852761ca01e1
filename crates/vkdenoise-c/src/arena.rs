//! Device memory that passes share.

use crate::denoiser::Denoiser;
use crate::descriptor::{self, descriptor};
use crate::device::Device;
use crate::handle;
use crate::pass::Pass;
use crate::status::{Failure, Status, guard};
use std::slice;
use vkdenoise::ash::vk::{self, Handle};
use vkdenoise::{ArenaRequired, Extent};

/// Device memory that passes of several frame sizes, or of several denoisers on one device, compute in, whichever
/// runs. Nothing in it outlives a recording. Its passes are submitted to one queue.
pub struct Arena(pub(crate) vkdenoise::Arena);

/// A frame's size in pixels.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Size {
    pub width: u32,
    pub height: u32,
}

/// A block of an arena in a caller's buffer.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct ArenaBlock {
    /// sizeof(vkdenoise_arena_block).
    pub struct_size: usize,
    /// A VkBuffer made with vkdenoise_arena_usage(), bound to device-local memory that was allocated with
    /// VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT. Several blocks may lie in one.
    pub buffer: u64,
    /// Bytes from its start, a multiple of vkdenoise_arena_alignment().
    pub offset: u64,
    /// Bytes of the block.
    pub bytes: u64,
}
descriptor!(ArenaBlock, "vkdenoise_arena_block", bytes: u64);

/// The VkBufferUsageFlags of the buffers of an arena.
#[unsafe(no_mangle)]
pub extern "C" fn vkdenoise_arena_usage() -> u32 {
    ArenaRequired::USAGE.as_raw()
}

/// Of what number of bytes the offset of a block in its buffer must be a multiple.
#[unsafe(no_mangle)]
pub extern "C" fn vkdenoise_arena_alignment() -> u64 {
    ArenaRequired::ALIGNMENT
}

/// The memory of an arena in which passes of all these sizes fit, one at a time: bytes of each block. There is more
/// than one block where a frame's maps take more than the device allocates at once. A smaller frame takes less of each
/// as a rule and not by law: list every size that must fit. Nothing is allocated.
///
/// @param sizes as many as `size_count` says.
/// @param blocks receives the bytes of each block, as many as `block_count` says at most; NULL: only counted.
/// @param block_count receives how many blocks there are.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_denoiser_arena_required(
    denoiser: *const Denoiser,
    sizes: *const Size,
    size_count: usize,
    blocks: *mut u64,
    block_count: *mut usize,
) -> Status {
    guard(|| {
        // SAFETY: the caller's pointers are as the header says; the same below.
        let (denoiser, sizes) = unsafe { (handle::borrow(denoiser, "denoiser")?, array(sizes, size_count, "sizes")?) };
        // SAFETY: as above.
        let count = unsafe { block_count.as_mut() }.ok_or_else(|| Failure::argument("block_count is NULL"))?;
        let extents: Vec<_> = sizes.iter().map(|size| Extent::new(size.width, size.height)).collect();
        let required = denoiser.take()?.arena_required(&extents)?.blocks;
        if !blocks.is_null() {
            if *count < required.len() {
                let (has, wants) = (*count, required.len());
                return Err(Failure::argument(format!("there is room for {has} blocks, and there are {wants}")));
            }
            // SAFETY: there is room for as many.
            unsafe { blocks.copy_from_nonoverlapping(required.as_ptr(), required.len()) };
        }
        *count = required.len();
        Ok(())
    })
}

/// Allocates an arena.
///
/// @param blocks bytes of each block; where several denoisers share an arena, of each block the largest.
/// @param arena receives the arena; destroy it with vkdenoise_arena_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_arena_create(
    device: *const Device,
    blocks: *const u64,
    block_count: usize,
    arena: *mut *mut Arena,
) -> Status {
    let make = || {
        // SAFETY: as above.
        let (device, blocks) = unsafe { (handle::borrow(device, "device")?, array(blocks, block_count, "blocks")?) };
        if blocks.contains(&0) {
            return Err(Failure::argument("a block of the arena has 0 bytes"));
        }
        let mut required = ArenaRequired::default();
        required.blocks = blocks.to_vec();
        Ok(Arena(vkdenoise::Arena::new(&device.0, &required)?))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(arena, make) })
}

/// An arena in the caller's memory, which is neither freed nor mapped. The buffers belong to the device and live until
/// the commands of the arena's passes have run and the passes are destroyed; blocks do not overlap. What else uses the
/// memory is ordered by the caller, as compute shaders that write all of it would be.
///
/// @param arena receives the arena; destroy it with vkdenoise_arena_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_arena_from_buffers(
    device: *const Device,
    blocks: *const ArenaBlock,
    block_count: usize,
    arena: *mut *mut Arena,
) -> Status {
    let make = || {
        // SAFETY: as above.
        let (device, blocks) =
            unsafe { (handle::borrow(device, "device")?, descriptor::read_all(blocks, block_count)?) };
        if blocks.iter().any(|block| block.buffer == 0) {
            return Err(Failure::argument("the buffer of a block is VK_NULL_HANDLE"));
        }
        let block = |block: ArenaBlock| {
            let ArenaBlock { offset, bytes, .. } = block;
            vkdenoise::ArenaBlock { buffer: vk::Buffer::from_raw(block.buffer), offset, bytes }
        };
        let blocks: Vec<_> = blocks.into_iter().map(block).collect();
        // SAFETY: the caller promises what the header asks for.
        Ok(Arena(unsafe { vkdenoise::Arena::from_buffers(&device.0, &blocks)? }))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(arena, make) })
}

/// Device memory that the library allocated for the arena, in bytes: 0 in the caller's memory, and for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_arena_device_bytes(arena: *const Arena) -> u64 {
    // SAFETY: as above.
    unsafe { arena.as_ref() }.map_or(0, |arena| arena.0.device_bytes())
}

/// Destroys an arena. Its passes can still be used and keep its memory. NULL is nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_arena_destroy(arena: *mut Arena) {
    // SAFETY: as above.
    guard(|| {
        unsafe { handle::take(arena) };
        Ok(())
    });
}

/// Prepares a frame size for a renderer in an arena that passes share, as for a resolution that changes while the
/// renderer runs: make the passes of all sizes ahead, and record the one that a frame needs. Plans; what outlives a
/// recording (vkdenoise_memory.persistent) is allocated for the pass alone.
///
/// @param pass receives the pass; destroy it with vkdenoise_pass_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_pass_create_in(
    denoiser: *const Denoiser,
    arena: *const Arena,
    width: u32,
    height: u32,
    pass: *mut *mut Pass,
) -> Status {
    let make = || {
        // SAFETY: as above.
        let (denoiser, arena) = unsafe { (handle::borrow(denoiser, "denoiser")?, handle::borrow(arena, "arena")?) };
        let extent = Extent::new(width, height);
        Ok(Pass::new(denoiser.take()?.pass_in(&arena.0, extent)?, extent))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(pass, make) })
}

/// An array of the caller's.
///
/// # Errors
/// Where it is null and not empty.
///
/// # Safety
/// `first` is null or points to as many values.
unsafe fn array<'a, T>(first: *const T, count: usize, name: &str) -> Result<&'a [T], Failure> {
    match (first.is_null(), count) {
        (_, 0) => Ok(&[]),
        (true, _) => Err(Failure::argument(format!("{name} is NULL"))),
        // SAFETY: as the caller's.
        (false, _) => Ok(unsafe { slice::from_raw_parts(first, count) }),
    }
}

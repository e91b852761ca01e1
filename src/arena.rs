//! Device memory of feature maps: a pass's own, or shared by passes that run one after another.

use crate::error::{Error, Result};
use crate::plan::Plan;
use crate::plan::arena::ALIGNMENT;
use crate::vk::device::Device;
use crate::vk::memory::Buffer;
use ash::vk;
use gpu_allocator::MemoryLocation;
use std::sync::Arc;

/// Device memory that passes compute in ([`crate::Denoiser::pass_in`]): of several frame sizes, of several denoisers
/// on one device, whichever runs. Nothing in it outlives a recording, so that the passes of an arena may be recorded
/// in any order, and the renderer may use memory of its own for other things in between.
///
/// Its passes are submitted to one queue; each recording waits for the one before. `Send` and `Sync`; cheap to clone:
/// clones are the same memory, and passes keep it alive.
#[derive(Clone)]
pub struct Arena(Arc<Inner>);

struct Inner {
    device: Device,
    blocks: Vec<Block>,
}

/// A range of a buffer with an address.
struct Block {
    buffer: vk::Buffer,
    offset: u64,
    bytes: u64,
    address: u64,
    /// The buffer, where it is the library's.
    own: Option<Buffer>,
}

/// The memory of an arena, block by block ([`crate::Denoiser::arena_required`]). There is more than one where a frame's
/// maps take more than the device allocates at once, or more than its shaders reach in one buffer.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct ArenaRequired {
    /// Bytes of each block.
    pub blocks: Vec<u64>,
}

/// A block of an arena in a caller's buffer ([`Arena::from_buffers`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArenaBlock {
    /// The buffer, made with [`ArenaRequired::USAGE`], bound to device-local memory that was allocated with
    /// `VK_MEMORY_ALLOCATE_DEVICE_ADDRESS_BIT`. Several blocks may lie in one.
    pub buffer: vk::Buffer,
    /// Bytes from its start, a multiple of [`ArenaRequired::ALIGNMENT`].
    pub offset: u64,
    /// Bytes of the block.
    pub bytes: u64,
}

impl ArenaRequired {
    /// What the buffers of an arena are used for.
    pub const USAGE: vk::BufferUsageFlags = vk::BufferUsageFlags::from_raw(
        vk::BufferUsageFlags::STORAGE_BUFFER.as_raw()
            | vk::BufferUsageFlags::SHADER_DEVICE_ADDRESS.as_raw()
            | vk::BufferUsageFlags::UNIFORM_TEXEL_BUFFER.as_raw()
            | vk::BufferUsageFlags::INDIRECT_BUFFER.as_raw()
            | vk::BufferUsageFlags::TRANSFER_SRC.as_raw()
            | vk::BufferUsageFlags::TRANSFER_DST.as_raw(),
    );

    /// Of what number of bytes the offset of a block in its buffer must be a multiple.
    pub const ALIGNMENT: u64 = ALIGNMENT;

    pub(crate) fn of(plan: &Plan) -> Self {
        Self { blocks: plan.blocks.clone() }
    }

    /// An arena for both: of each block the larger.
    #[must_use]
    pub fn max(&self, other: &Self) -> Self {
        let count = self.blocks.len().max(other.blocks.len());
        let bytes = |of: &Self, i: usize| of.blocks.get(i).copied().unwrap_or(0);
        Self { blocks: (0..count).map(|i| bytes(self, i).max(bytes(other, i))).collect() }
    }

    /// Bytes of all blocks.
    pub fn bytes(&self) -> u64 {
        self.blocks.iter().sum()
    }
}

impl Arena {
    /// Allocates an arena on a device.
    ///
    /// # Errors
    /// [`Error::OutOfMemory`], [`Error::Vulkan`].
    pub fn new(device: &Device, required: &ArenaRequired) -> Result<Self> {
        let block = |(i, &bytes): (usize, &u64)| {
            let own = Buffer::new(device, &format!("arena {i}"), bytes, MemoryLocation::GpuOnly)?;
            Ok(Block { buffer: own.raw(), offset: 0, bytes, address: own.address(), own: Some(own) })
        };
        let blocks = required.blocks.iter().enumerate().map(block).collect::<Result<_>>()?;
        Ok(Self(Arc::new(Inner { device: device.clone(), blocks })))
    }

    /// An arena in the caller's memory, which [`crate::Denoiser::arena_required`] tells the size of. The library
    /// neither frees nor maps it.
    ///
    /// # Errors
    /// [`Error::InvalidOption`] where a block begins at no multiple of [`ArenaRequired::ALIGNMENT`].
    ///
    /// # Safety
    /// The buffers are as [`ArenaBlock`] says, as long as that, belong to the device and live until the commands of the
    /// arena's passes have run and the passes are dropped. Blocks do not overlap. What else uses the memory is ordered
    /// by the caller: before a recording, made available to `COMPUTE_SHADER` writes; after it, as after any compute
    /// shader's writes.
    pub unsafe fn from_buffers(device: &Device, blocks: &[ArenaBlock]) -> Result<Self> {
        let block = |(i, block): (usize, &ArenaBlock)| {
            let ArenaBlock { buffer, offset, bytes } = *block;
            if !offset.is_multiple_of(ALIGNMENT) {
                let reason = format!("block {i} begins at byte {offset}; it must be a multiple of {ALIGNMENT}");
                return Err(Error::InvalidOption { option: "arena", reason });
            }
            // SAFETY: the caller vouches for the buffer.
            let address = unsafe { device.buffer_address(buffer) } + offset;
            Ok(Block { buffer, offset, bytes, address, own: None })
        };
        let blocks = blocks.iter().enumerate().map(block).collect::<Result<_>>()?;
        Ok(Self(Arc::new(Inner { device: device.clone(), blocks })))
    }

    /// Its bytes, the caller's or the library's.
    pub fn bytes(&self) -> u64 {
        self.0.blocks.iter().map(|block| block.bytes).sum()
    }

    /// Device memory that the library allocated for it, in bytes: none in the caller's memory.
    pub fn device_bytes(&self) -> u64 {
        self.0.blocks.iter().filter_map(|block| block.own.as_ref()).map(Buffer::size).sum()
    }

    /// The bytes of its blocks, for a plan on this device.
    ///
    /// # Errors
    /// [`Error::InvalidOption`] where the arena is of another.
    pub(crate) fn blocks_on(&self, device: &Device) -> Result<Vec<u64>> {
        if self.0.device.raw().handle() != device.raw().handle() {
            let reason = "it was made on another device than the denoiser".into();
            return Err(Error::InvalidOption { option: "arena", reason });
        }
        Ok(self.0.blocks.iter().map(|block| block.bytes).collect())
    }

    pub(crate) fn address(&self, block: usize) -> u64 {
        self.0.blocks[block].address
    }

    /// Where a block lies: buffer, first byte.
    pub(crate) fn location(&self, block: usize) -> (vk::Buffer, u64) {
        let Block { buffer, offset, .. } = self.0.blocks[block];
        (buffer, offset)
    }
}

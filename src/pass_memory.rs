//! Where the buffers of a plan lie on the device, but for its weights: in an arena, and in memory of the pass's own.

use crate::arena::{Arena, ArenaRequired};
use crate::error::Result;
use crate::plan::Plan;
use crate::vk::device::Device;
use crate::vk::memory::Buffer;
use ash::vk;
use gpu_allocator::MemoryLocation;

pub(crate) struct PassMemory {
    arena: Arena,
    /// Whether nobody else has the arena.
    owns_arena: bool,
    /// What outlives a recording.
    persistent: Vec<Buffer>,
}

/// A buffer and a byte of it.
pub(crate) type Location = (vk::Buffer, u64);

impl PassMemory {
    /// In an arena that is made for the plan, or in one that others have too and that the plan was made for.
    pub fn new(device: &Device, plan: &Plan, shared: Option<&Arena>) -> Result<Self> {
        let arena = shared.map_or_else(|| Arena::new(device, &ArenaRequired::of(plan)), |arena| Ok(arena.clone()))?;
        let block = |(i, &bytes): (usize, &u64)| {
            Buffer::new(device, &format!("persistent {i}"), bytes, MemoryLocation::GpuOnly)
        };
        let persistent = plan.persistent.iter().enumerate().map(block).collect::<Result<_>>()?;
        Ok(Self { arena, owns_arena: shared.is_none(), persistent })
    }

    /// Bytes that the pass alone holds.
    pub fn device_bytes(&self) -> u64 {
        let arena = if self.owns_arena { self.arena.device_bytes() } else { 0 };
        arena + self.persistent.iter().map(Buffer::size).sum::<u64>()
    }

    /// The address of a block of the arena.
    pub fn arena_address(&self, block: usize) -> u64 {
        self.arena.address(block)
    }

    /// Where a block of the arena begins.
    pub fn arena(&self, block: usize) -> Location {
        self.arena.location(block)
    }

    /// The address of a block of persistent memory.
    pub fn persistent_address(&self, block: usize) -> u64 {
        self.persistent[block].address()
    }

    /// Where a block of persistent memory begins.
    pub fn persistent(&self, block: usize) -> Location {
        (self.persistent[block].raw(), 0)
    }

    /// Everything that the plan writes, with its bytes.
    pub fn all(&self, plan: &Plan) -> Vec<(Location, u64)> {
        let arena = plan.blocks.iter().enumerate().map(|(block, &bytes)| (self.arena(block), bytes));
        let persistent = plan.persistent.iter().enumerate().map(|(block, &bytes)| (self.persistent(block), bytes));
        arena.chain(persistent).collect()
    }
}

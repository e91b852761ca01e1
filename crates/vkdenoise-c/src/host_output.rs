//! What the host path writes: in place, or apart where planes overlap.

use crate::host_planes::Memory;
use crate::status::Failure;
use vkdenoise::{Error, Extent, Layout, PlaneMut, Region};

/// A plane that is written.
pub struct Output {
    memory: Memory,
    channels: usize,
    /// The result until nothing reads the caller's planes any more: Rust's planes may not overlap what is written.
    apart: Option<Vec<f32>>,
}

impl Output {
    /// Of planes with their channels, beside what is read.
    ///
    /// # Errors
    /// Where there is no memory for a result.
    pub fn of_call(planes: Vec<(Memory, usize)>, inputs: &[&Memory], extent: Extent) -> Result<Vec<Self>, Failure> {
        let overlaps = |at: usize, memory: &Memory| {
            let others = planes.iter().enumerate().filter(|(other, _)| *other != at).map(|(_, (memory, _))| memory);
            inputs.iter().copied().chain(others).any(|other| other.overlaps(memory))
        };
        let apart: Vec<bool> = planes.iter().enumerate().map(|(at, (memory, _))| overlaps(at, memory)).collect();
        let output = |((memory, channels), apart): ((Memory, usize), bool)| {
            let apart = apart.then(|| zeros(channels as u64 * extent.pixels())).transpose()?;
            Ok(Self { memory, channels, apart })
        };
        planes.into_iter().zip(apart).map(output).collect()
    }

    /// As the library takes it.
    ///
    /// # Safety
    /// The memory is the caller's, and nothing else reads or writes it during `'a`.
    pub unsafe fn plane(&mut self, extent: Extent) -> PlaneMut<'_> {
        match &mut self.apart {
            Some(packed) => PlaneMut::f32(packed, Layout::interleaved(extent, self.channels)),
            // SAFETY: as the caller's; it overlaps none of the call's other planes.
            None => unsafe { self.memory.plane_mut() },
        }
    }

    /// Stores what was made apart.
    ///
    /// # Safety
    /// As [`Output::plane`]; the call's planes are not used after this.
    pub unsafe fn store(&self, extent: Extent, region: Region) {
        if let Some(packed) = &self.apart {
            // SAFETY: as the caller's.
            unsafe { self.memory.store(extent, region, packed) };
        }
    }
}

fn zeros(samples: u64) -> Result<Vec<f32>, Failure> {
    let mut zeros = Vec::new();
    zeros.try_reserve_exact(samples as usize).map_err(|error| Error::OutOfMemory {
        what: "a result that overlaps its frame".into(),
        bytes: samples.saturating_mul(4),
        reason: error.to_string(),
    })?;
    zeros.resize(samples as usize, 0.0);
    Ok(zeros)
}

//! The table of planes on the device: written when planes are bound, never again.

use crate::error::Result;
use crate::kernels::planes::{PlaneArgs, Planes};
use crate::kernels::signals::{SignalArgs, SignalRows};
use crate::vk::device::Device;
use crate::vk::memory::Buffer;
use gpu_allocator::MemoryLocation;

/// Bytes of a row.
const ROW_BYTES: u64 = size_of::<PlaneArgs>() as u64;

/// A row for each plane of a frame, then two for each signal. It lives as long as what is recorded with it.
pub(crate) struct PlaneTable {
    buffer: Buffer,
    signals: Vec<SignalArgs>,
}

impl PlaneTable {
    /// Writes the table.
    ///
    /// # Errors
    /// [`crate::Error::OutOfMemory`], [`crate::Error::Vulkan`].
    pub fn new(device: &Device, planes: &Planes, signals: &[SignalRows]) -> Result<Self> {
        let of_signals = signals.iter().flat_map(|signal| [signal.plane, signal.output]);
        let mut rows: Vec<_> = planes.rows().iter().copied().chain(of_signals).collect();
        let bytes = ROW_BYTES * rows.len() as u64;
        let mut buffer = Buffer::new(device, "table of planes", bytes, MemoryLocation::CpuToGpu)?;
        // Drivers may load a sample before they ask whether there is such a plane.
        let address = buffer.address();
        rows.iter_mut().filter(|row| row.address == 0).for_each(|row| row.address = address);
        buffer.bytes_mut().copy_from_slice(bytemuck::cast_slice(&rows));
        let first = address + ROW_BYTES * planes.rows().len() as u64;
        let args = |(i, signal): (u64, &SignalRows)| SignalArgs {
            kind: signal.kind,
            channels: signal.channels,
            planes: first + 2 * i * ROW_BYTES,
        };
        Ok(Self { buffer, signals: (0..).zip(signals).map(args).collect() })
    }

    /// Its device address.
    pub fn address(&self) -> u64 {
        self.buffer.address()
    }

    /// The signals, as recordings take them.
    pub fn signals(&self) -> &[SignalArgs] {
        &self.signals
    }
}

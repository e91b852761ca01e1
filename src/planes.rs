//! The table of planes on the device: written when planes are bound, never again.

use crate::error::Result;
use crate::frame::Extent;
use crate::kernels::ensemble;
use crate::kernels::planes::{PlaneArgs, Planes};
use crate::kernels::signals::{SignalArgs, SignalRows};
use crate::vk::device::Device;
use crate::vk::memory::Buffer;
use gpu_allocator::MemoryLocation;

/// Bytes of a row.
const ROW_BYTES: u64 = size_of::<PlaneArgs>() as u64;

/// A row for each plane of a frame, then two for each signal; where results are averaged all of it once more, of the
/// frame turned by half a circle. It lives as long as what is recorded with it.
pub(crate) struct PlaneTable {
    _rows: Buffer,
    /// What the turned frame makes of the signals, all channels of one after all of another.
    results: Option<Buffer>,
    upright: FrameTable,
    turned: Option<FrameTable>,
}

/// The part of a frame.
pub(crate) struct FrameTable {
    /// Its device address.
    pub address: u64,
    /// The signals, as recordings take them.
    pub signals: Vec<SignalArgs>,
}

impl PlaneTable {
    /// Writes the table. `turned`: the frame's size, where it is of an ensemble.
    ///
    /// # Errors
    /// [`crate::Error::OutOfMemory`], [`crate::Error::Vulkan`].
    pub fn new(device: &Device, planes: &Planes, signals: &[SignalRows], turned: Option<Extent>) -> Result<Self> {
        let rows_of = |planes: &Planes, signals: &[SignalRows]| -> Vec<PlaneArgs> {
            let of_signals = signals.iter().flat_map(|signal| [signal.plane, signal.output]);
            planes.rows().iter().copied().chain(of_signals).collect()
        };
        let mut rows = rows_of(planes, signals);
        let frame_bytes = ROW_BYTES * rows.len() as u64;
        if let Some(extent) = turned {
            let turn = |signal: &SignalRows| SignalRows {
                plane: signal.plane.turned(extent),
                output: signal.output.turned(extent),
                ..*signal
            };
            rows.extend(rows_of(&planes.turned(extent), &signals.iter().map(turn).collect::<Vec<_>>()));
        }
        let bytes = ROW_BYTES * rows.len() as u64;
        let mut buffer = Buffer::new(device, "table of planes", bytes, MemoryLocation::CpuToGpu)?;
        // Drivers may load a sample before they ask whether there is such a plane.
        let address = buffer.address();
        rows.iter_mut().filter(|row| row.address == 0).for_each(|row| row.address = address);
        buffer.bytes_mut().copy_from_slice(bytemuck::cast_slice(&rows));

        let result_bytes =
            |signal: &SignalRows| turned.map_or(0, |extent| ensemble::result_bytes(extent, u64::from(signal.channels)));
        let results = match signals.iter().map(result_bytes).sum() {
            0 => None,
            bytes => Some(Buffer::new(device, "turned signals", bytes, MemoryLocation::GpuOnly)?),
        };
        let frame = |address: u64| {
            let mut result = results.as_ref().map_or(0, Buffer::address);
            let mut row = address + ROW_BYTES * planes.rows().len() as u64;
            let args = |signal: &SignalRows| {
                let SignalRows { kind, channels, .. } = *signal;
                let args = SignalArgs { kind, channels, planes: row, turned: result };
                row += 2 * ROW_BYTES;
                result += result_bytes(signal);
                args
            };
            FrameTable { address, signals: signals.iter().map(args).collect() }
        };
        let (upright, turned) = (frame(address), turned.map(|_| frame(address + frame_bytes)));
        Ok(Self { _rows: buffer, results, upright, turned })
    }

    /// Of the frame itself.
    pub fn upright(&self) -> &FrameTable {
        &self.upright
    }

    /// Of the turned frame, where there is an ensemble.
    pub fn turned(&self) -> Option<&FrameTable> {
        self.turned.as_ref()
    }

    /// Bytes of what the turned frame makes of the signals.
    pub fn result_bytes(&self) -> u64 {
        self.results.as_ref().map_or(0, Buffer::size)
    }
}

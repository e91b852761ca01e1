//! The host path's memory for signals beside the colour.

use crate::error::Result;
use crate::formats::SampleFormat;
use crate::frame::{Extent, Layout, Region};
use crate::renderer::BufferPlane;
use crate::signals::{BufferSignal, Signal, SignalKind};
use crate::vk::device::Device;
use crate::vk::memory::Buffer;
use gpu_allocator::MemoryLocation;

/// Bytes of a pixel of one signal's plane: room for three channels.
const PIXEL_BYTES: u64 = 12;

/// Planes of signals on their way in and out, with room for some number of them. Kernels read and write each sample
/// once, so they do so where the host sees it, on every device.
#[derive(Default)]
pub(crate) struct SignalPlanes {
    /// Kind and channels of those that are there.
    pub kinds: Vec<(SignalKind, u32)>,
    planes: Option<Planes>,
}

struct Planes {
    room: usize,
    input: Buffer,
    output: Buffer,
}

impl SignalPlanes {
    /// Room for so many signals.
    pub fn new(device: &Device, extent: Extent, room: usize) -> Result<Self> {
        let bytes = Self::bytes(extent, room) / 2;
        let input = Buffer::new(device, "signals", bytes, MemoryLocation::CpuToGpu)?;
        let output = Buffer::new(device, "denoised signals", bytes, MemoryLocation::GpuToCpu)?;
        Ok(Self { kinds: Vec::new(), planes: Some(Planes { room, input, output }) })
    }

    /// Bytes of the planes of so many signals.
    pub fn bytes(extent: Extent, signals: usize) -> u64 {
        2 * extent.pixels() * PIXEL_BYTES * signals as u64
    }

    /// Bytes of the planes that there are.
    pub fn device_bytes(&self) -> u64 {
        self.planes.as_ref().map_or(0, |planes| planes.input.size() + planes.output.size())
    }

    /// How many signals there is room for.
    pub fn room(&self) -> usize {
        self.planes.as_ref().map_or(0, |planes| planes.room)
    }

    /// Copies the signals, for which there is room.
    pub fn write(&mut self, extent: Extent, signals: &[Signal]) {
        self.kinds = signals.iter().map(|signal| (signal.kind, signal.channels)).collect();
        let Some(planes) = &mut self.planes else { return };
        let floats: &mut [f32] = bytemuck::cast_slice_mut(planes.input.bytes_mut());
        for (signal, packed) in signals.iter().zip(floats.chunks_mut(3 * extent.pixels() as usize)) {
            signal.plane.pack(extent, signal.channels as usize, packed);
        }
    }

    /// The planes of the signals that are there.
    pub fn planes(&self, extent: Extent) -> Vec<BufferSignal> {
        let Some(planes) = &self.planes else { return Vec::new() };
        let signal = |(i, &(kind, channels)): (usize, &(SignalKind, u32))| {
            let plane = |buffer: &Buffer| BufferPlane {
                buffer: buffer.raw(),
                size: buffer.size(),
                format: SampleFormat::F32,
                layout: Layout {
                    offset: i * 3 * extent.pixels() as usize,
                    ..Layout::interleaved(extent, channels as usize)
                },
            };
            BufferSignal { kind, channels, plane: plane(&planes.input), output: plane(&planes.output) }
        };
        self.kinds.iter().enumerate().map(signal).collect()
    }

    /// Writes the results of a region to the signals' outputs.
    pub fn read(&self, extent: Extent, region: Option<Region>, signals: &mut [Signal]) {
        let Some(planes) = &self.planes else { return };
        let region = region.unwrap_or(Region::all(extent));
        let floats: &[f32] = bytemuck::cast_slice(planes.output.bytes());
        for (signal, values) in signals.iter_mut().zip(floats.chunks(3 * extent.pixels() as usize)) {
            signal.output.unpack(extent, region, signal.channels as usize, values);
        }
    }
}

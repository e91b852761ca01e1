//! Signals beside a frame, that go through the kernels of its colour.

use crate::choice::choice;
use crate::descriptor::{descriptor, read_all};
use crate::host_planes::{Memory, Plane, PlaneMut, input, output};
use crate::renderer_planes::{BufferPlane, buffer, needed};
use crate::status::Failure;
use vkdenoise::Extent;

/// What a signal is to the colour.
#[repr(u32)]
pub enum SignalKind {
    /// A part of its light, such as a light group, three channels: parts that add up to the noisy colour add up to the
    /// denoised one.
    Light = 0,
    /// Anything else, three channels or one: averaged as it is.
    Value = 1,
    /// Coverage, one channel: averaged as it is, and in [0, 1] afterwards.
    Alpha = 2,
}

/// A signal in host memory, beside a frame's colour. For denoisers with vkdenoise_options.signals.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Signal {
    /// sizeof(vkdenoise_signal).
    pub struct_size: usize,
    /// The noisy samples.
    pub plane: *const Plane,
    /// Where the denoised ones go.
    pub output: *const PlaneMut,
    /// A vkdenoise_signal_kind.
    pub kind: u32,
    /// Channels of both planes, 1 or 3; 0: 1 of VKDENOISE_SIGNAL_KIND_ALPHA, else 3.
    pub channels: u32,
}
descriptor!(Signal, "vkdenoise_signal", channels: u32);

/// A signal in a renderer's buffers, beside a frame in its buffers or images. For denoisers with
/// vkdenoise_options.signals.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct BufferSignal {
    /// sizeof(vkdenoise_buffer_signal).
    pub struct_size: usize,
    /// The noisy samples.
    pub plane: *const BufferPlane,
    /// Where the denoised ones go, in the samples' format of the frame's output; it may be the same plane.
    pub output: *const BufferPlane,
    /// A vkdenoise_signal_kind.
    pub kind: u32,
    /// Channels of both planes, as vkdenoise_signal.channels.
    pub channels: u32,
}
descriptor!(BufferSignal, "vkdenoise_buffer_signal", channels: u32);

/// What the numbers of a signal stand for.
fn kind_and_channels(kind: u32, channels: u32) -> Result<(vkdenoise::SignalKind, u32), Failure> {
    let choices = [
        (SignalKind::Light as u32, vkdenoise::SignalKind::Light),
        (SignalKind::Value as u32, vkdenoise::SignalKind::Value),
        (SignalKind::Alpha as u32, vkdenoise::SignalKind::Alpha),
    ];
    let kind = choice(kind, "a signal's kind", "vkdenoise_signal_kind", &choices)?;
    match (channels, kind) {
        (0, vkdenoise::SignalKind::Alpha) => Ok((kind, 1)),
        (0, _) => Ok((kind, 3)),
        (1 | 3, _) => Ok((kind, channels)),
        (other, _) => Err(Failure::argument(format!("a signal has {other} channels; it can have 1 or 3"))),
    }
}

/// A signal in host memory, checked.
pub struct HostSignal {
    pub kind: vkdenoise::SignalKind,
    pub channels: u32,
    pub plane: Memory,
    pub output: Memory,
}

/// # Safety
/// The signals are as their header says.
pub unsafe fn host_signals(first: *const Signal, count: usize, extent: Extent) -> Result<Vec<HostSignal>, Failure> {
    // SAFETY: as the caller's; the same below.
    let signals = unsafe { read_all(first, count)? };
    let checked = |signal: Signal| {
        let (kind, channels) = kind_and_channels(signal.kind, signal.channels)?;
        // SAFETY: as above.
        let (plane, output) = unsafe {
            let plane = input(signal.plane, "signal", extent, channels.into())?;
            (needed(plane, "signal")?, output(signal.output, "signal's output", extent, channels.into())?)
        };
        Ok(HostSignal { kind, channels, plane, output })
    };
    signals.into_iter().map(checked).collect()
}

/// # Safety
/// The signals are as their header says.
pub unsafe fn buffer_signals(
    first: *const BufferSignal,
    count: usize,
    extent: Extent,
) -> Result<Vec<vkdenoise::BufferSignal>, Failure> {
    // SAFETY: as the caller's; the same below.
    let signals = unsafe { read_all(first, count)? };
    let checked = |signal: BufferSignal| {
        let (kind, channels) = kind_and_channels(signal.kind, signal.channels)?;
        // SAFETY: as above.
        let plane = |plane, name| unsafe { needed(buffer(plane, name, extent, channels.into())?, name) };
        let (plane, output) = (plane(signal.plane, "signal")?, plane(signal.output, "signal's output")?);
        Ok(vkdenoise::BufferSignal { kind, channels, plane, output })
    };
    signals.into_iter().map(checked).collect()
}

//! Byte strides of C made strides in samples.

use crate::choice::choice;
use crate::status::Failure;
use vkdenoise::{Error, Extent, Layout};

/// How a plane's samples are stored. Planes in the caller's memory are of floats; those in a renderer's buffers can be
/// integers where it says so.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleFormat {
    /// 32-bit floats.
    F32 = 0,
    /// 16-bit floats.
    F16 = 1,
    /// Bytes from 0 to 1: albedo, normals. RGBA8 pixels have a pixel_stride of 4.
    Unorm8 = 2,
    /// 16 bits from 0 to 1: albedo, normals, depth.
    Unorm16 = 3,
    /// 16 bits from -1 to 1: normals.
    Snorm16 = 4,
    /// Words of 32 bits, a whole pixel each (VK_FORMAT_A2B10G10R10_UNORM_PACK32): normals.
    Rgb10a2Unorm = 5,
}

impl SampleFormat {
    /// Whether samples of the caller's memory are halves.
    pub fn is_half(format: u32, plane: &str) -> Result<bool, Failure> {
        let choices = [(Self::F32 as u32, false), (Self::F16 as u32, true)];
        let name = format!("the {plane} plane's format");
        choice(format, &name, "vkdenoise_sample_format of floats", &choices)
    }

    /// The samples of a renderer's buffer.
    pub fn from_c(format: u32, plane: &str) -> Result<vkdenoise::SampleFormat, Failure> {
        let choices = [
            (Self::F32, vkdenoise::SampleFormat::F32),
            (Self::F16, vkdenoise::SampleFormat::F16),
            (Self::Unorm8, vkdenoise::SampleFormat::Unorm8),
            (Self::Unorm16, vkdenoise::SampleFormat::Unorm16),
            (Self::Snorm16, vkdenoise::SampleFormat::Snorm16),
            (Self::Rgb10a2Unorm, vkdenoise::SampleFormat::Rgb10A2Unorm),
        ];
        let choices = choices.map(|(number, format)| (number as u32, format));
        choice(format, &format!("the {plane} plane's format"), "vkdenoise_sample_format", &choices)
    }
}

/// Distances in bytes; 0: packed.
#[derive(Clone, Copy)]
pub struct Strides {
    pub pixel: u64,
    pub row: u64,
    pub channel: u64,
}

/// A plane's place in memory: what the frame reads or writes of it.
pub struct Placed {
    pub layout: Layout,
    /// Samples from the first to the last that the frame reaches, both included, counted from the first of the memory.
    pub reach: u64,
}

/// The layout in samples, of so many bytes each, of a plane that begins `offset` bytes into its memory, and how far it reaches.
///
/// # Errors
/// Where the offset or a stride is no whole number of samples, or the last sample is beyond 2^63 bytes.
pub fn place(
    plane: &'static str,
    extent: Extent,
    channels: u64,
    bytes: u64,
    offset: u64,
    strides: Strides,
) -> Result<Placed, Failure> {
    let or = |stride: u64, packed: u64| if stride == 0 { Some(packed) } else { Some(stride / bytes) };
    for (name, value) in [
        ("offset", offset),
        ("pixel_stride", strides.pixel),
        ("row_stride", strides.row),
        ("channel_stride", strides.channel),
    ] {
        if !value.is_multiple_of(bytes) {
            let reason = format!("{name} is {value} bytes; it must be a multiple of the sample's {bytes}");
            return Err(Error::PlaneMismatch { plane, reason }.into());
        }
    }
    let placed = || {
        let channel = or(strides.channel, 1)?;
        let pixel = or(strides.pixel, channels)?;
        let row = or(strides.row, pixel.checked_mul(extent.width.into())?)?;
        let step = |count: u64, stride: u64| count.saturating_sub(1).checked_mul(stride);
        let last = (offset / bytes)
            .checked_add(step(extent.width.into(), pixel)?)?
            .checked_add(step(extent.height.into(), row)?)?
            .checked_add(step(channels, channel)?)?;
        let reach = last.checked_add(1).filter(|reach| reach.checked_mul(bytes).is_some_and(|b| b < 1 << 63))?;
        let size = |value: u64| usize::try_from(value).ok();
        let layout = Layout {
            offset: size(offset / bytes)?,
            pixel_stride: size(pixel)?,
            row_stride: size(row)?,
            channel_stride: size(channel)?,
        };
        size(reach)?;
        Some(Placed { layout, reach })
    };
    placed().ok_or_else(|| {
        let reason = "its strides reach beyond what memory can hold".into();
        Error::PlaneMismatch { plane, reason }.into()
    })
}

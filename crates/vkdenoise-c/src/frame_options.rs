//! What may change from frame to frame.

use crate::choice::{choice, flag};
use crate::descriptor::{self, descriptor};
use crate::progress::{Progress, ProgressFunction};
use crate::status::Failure;
use std::ffi::c_void;
use vkdenoise::ash::vk::{self, Handle};
use vkdenoise::{BufferAddress, Exposure, Fireflies};

/// What is done with lone bright pixels.
#[repr(u32)]
pub enum FirefliesChoice {
    /// They are mended, but where the frame is clean.
    Auto = 0,
    /// They are light.
    Keep = 1,
    /// They are mended.
    Mend = 2,
}

/// A rectangle of a frame's pixels. All zeros: the whole frame.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Region {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// What may change from frame to frame. All zeros but struct_size: the defaults.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct FrameOptions {
    /// sizeof(vkdenoise_frame_options).
    pub struct_size: usize,
    /// The factor on the colour before the network, undone at the end. 0: found in the frame. Take one factor for all
    /// frames of a sequence (vkdenoise_report.exposure of the first), so that they do not flicker.
    pub exposure: f32,
    /// Share of the noisy colour in the result, 0 (all denoised) to 1 (all noisy).
    pub blend: f32,
    /// A vkdenoise_fireflies.
    pub fireflies: u32,
    /// 1: albedo, normal and depth are those of the last frame of this size that was denoised with 0. They are not
    /// read then, and what depends on them alone is not computed again. For denoisers with
    /// vkdenoise_options.keep_aux.
    pub aux_unchanged: u32,
    /// The pixels that are wanted. Only what they depend on is computed, and only they are written.
    pub region: Region,
    /// Renderer's path alone: a VkBuffer with the exposure as a 32-bit float, read when the commands run. 0: none.
    pub exposure_buffer: u64,
    /// Bytes from its start, a multiple of 4.
    pub exposure_offset: u64,
    /// Renderer's path alone: a VkBuffer in which the commands write four 32-bit floats: the exposure that was used;
    /// what depths were divided by; the frame's robust log-mean luminance; the share of lit pixels that are noisy. 0:
    /// none.
    pub statistics_buffer: u64,
    /// Bytes from its start, a multiple of 4.
    pub statistics_offset: u64,
    /// Host path alone: a function that is told how much is done, and can end the call. NULL: none. The result has the
    /// same bits with it. Where aux_unchanged was to follow, a call that was ended has to be made again first.
    pub progress: ProgressFunction,
    /// What the function is given.
    pub progress_user: *mut c_void,
}
descriptor!(FrameOptions, "vkdenoise_frame_options", statistics_offset: u64);

/// Reads the options of a frame, and the callback with them; null: the defaults.
///
/// # Errors
/// A value that stands for nothing. Ranges are checked by the library where the options are used.
///
/// # Safety
/// As [`descriptor::read`].
pub unsafe fn read(options: *const FrameOptions) -> Result<(vkdenoise::FrameOptions, Option<Progress>), Failure> {
    // SAFETY: as the caller's.
    let options = unsafe { descriptor::read_or_default(options)? };
    let place = |buffer: u64, offset: u64| {
        (buffer != 0).then(|| BufferAddress { buffer: vk::Buffer::from_raw(buffer), offset })
    };
    let exposure = match (place(options.exposure_buffer, options.exposure_offset), options.exposure) {
        (Some(_), factor) if factor != 0.0 => {
            return Err(Failure::argument("exposure and exposure_buffer are both set; one must be 0"));
        }
        (Some(place), _) => Exposure::Buffer(place),
        (None, 0.0) => Exposure::Auto,
        (None, factor) => Exposure::Fixed(factor),
    };
    let choices = [
        (FirefliesChoice::Auto as u32, Fireflies::Auto),
        (FirefliesChoice::Keep as u32, Fireflies::Keep),
        (FirefliesChoice::Mend as u32, Fireflies::Mend),
    ];
    let fireflies = choice(options.fireflies, "fireflies", "vkdenoise_fireflies", &choices)?;
    let Region { x, y, width, height } = options.region;
    let region = vkdenoise::Region { x, y, width, height };
    let progress = Progress::new(options.progress, options.progress_user);
    let options = vkdenoise::FrameOptions {
        exposure,
        blend: options.blend,
        fireflies,
        statistics: place(options.statistics_buffer, options.statistics_offset),
        region: [x, y, width, height].iter().any(|value| *value != 0).then_some(region),
        features_unchanged: flag(options.aux_unchanged, "aux_unchanged")?,
    };
    Ok((options, progress))
}

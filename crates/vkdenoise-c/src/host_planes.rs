//! Planes in the caller's memory.

use crate::choice::choice;
use crate::descriptor::{self, descriptor, reserved};
use crate::layout::{Placed, SampleFormat, Strides, place};
use crate::status::Failure;
use std::ffi::c_void;
use std::ops::Range;
use std::slice;
use vkdenoise::half::f16;
use vkdenoise::{Error, Extent, Plane as CorePlane, PlaneMut as CorePlaneMut, Region};

/// A plane to read: three channels (colour, albedo, normal) or one (depth, noise); a signal's own. Channels beyond
/// those, such as alpha, are skipped by the strides.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Plane {
    /// sizeof(vkdenoise_plane).
    pub struct_size: usize,
    /// The first channel of the top left pixel.
    pub samples: *const c_void,
    /// Bytes that may be read from there, which are checked to be enough; 0: as many as the strides reach.
    pub size: usize,
    /// Bytes from a pixel to its right neighbour; 0: the plane's channels, packed.
    pub pixel_stride: usize,
    /// Bytes from a pixel to the one below; 0: rows packed.
    pub row_stride: usize,
    /// Bytes from a channel to the next of the same pixel; 0: a sample.
    pub channel_stride: usize,
    /// A vkdenoise_sample_format of floats.
    pub format: u32,
    /// Must be 0.
    pub reserved: u32,
}
descriptor!(Plane, "vkdenoise_plane", reserved: u32);

/// A plane to write, of three channels; a signal's own. The fields are those of vkdenoise_plane. It may overlap the
/// planes that are read, or be one of them.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct PlaneMut {
    /// sizeof(vkdenoise_plane_mut).
    pub struct_size: usize,
    /// The first channel of the top left pixel.
    pub samples: *mut c_void,
    /// Bytes that may be written from there; 0: as many as the strides reach.
    pub size: usize,
    /// Bytes from a pixel to its right neighbour; 0: the plane's channels, packed.
    pub pixel_stride: usize,
    /// Bytes from a pixel to the one below; 0: rows packed.
    pub row_stride: usize,
    /// Bytes from a channel to the next of the same pixel; 0: a sample.
    pub channel_stride: usize,
    /// A vkdenoise_sample_format of floats.
    pub format: u32,
    /// Must be 0.
    pub reserved: u32,
}
descriptor!(PlaneMut, "vkdenoise_plane_mut", reserved: u32);

/// What a plane says of the colour's noise.
#[repr(u32)]
pub enum NoiseKind {
    /// Variance of a pixel's luminance, in the colour's own unit squared.
    Variance = 0,
    /// Samples of a pixel.
    Samples = 1,
}

impl NoiseKind {
    pub fn from_c(kind: u32) -> Result<vkdenoise::NoiseKind, Failure> {
        let choices = [
            (Self::Variance as u32, vkdenoise::NoiseKind::Variance),
            (Self::Samples as u32, vkdenoise::NoiseKind::Samples),
        ];
        choice(kind, "noise_kind", "vkdenoise_noise_kind", &choices)
    }
}

/// A plane of the caller's memory, checked.
pub struct Memory {
    half: bool,
    placed: Placed,
    channels: usize,
    /// Of the first sample.
    address: usize,
}

impl Memory {
    fn new(
        plane: &'static str,
        extent: Extent,
        channels: u64,
        address: usize,
        size: usize,
        format: u32,
        strides: [usize; 3],
    ) -> Result<Self, Failure> {
        let half = SampleFormat::is_half(format, plane)?;
        let bytes = sample_bytes(half);
        let mismatch = |reason: String| Err(Error::PlaneMismatch { plane, reason }.into());
        if address == 0 {
            return Err(Failure::argument(format!("the samples of the {plane} plane are NULL")));
        }
        if !(address as u64).is_multiple_of(bytes) {
            return mismatch(format!("its samples lie at {address:#x}, which is no multiple of their {bytes} bytes"));
        }
        let [pixel, row, channel] = strides.map(|stride| stride as u64);
        let placed = place(plane, extent, channels, bytes, 0, Strides { pixel, row, channel })?;
        let reached = placed.reach * bytes;
        if size != 0 && reached > size as u64 {
            return mismatch(format!("the frame reaches {reached} bytes of it, and it has {size}"));
        }
        if address.checked_add(reached as usize).is_none() {
            return mismatch("its strides reach beyond the end of memory".into());
        }
        Ok(Self { half, placed, channels: channels as usize, address })
    }

    fn bytes(&self) -> Range<usize> {
        self.address..self.address + (self.placed.reach * sample_bytes(self.half)) as usize
    }

    pub fn overlaps(&self, other: &Self) -> bool {
        let (one, two) = (self.bytes(), other.bytes());
        one.start < two.end && two.start < one.end
    }

    /// # Safety
    /// The memory is the caller's, initialised and not written during `'a`.
    pub unsafe fn plane<'a>(&self) -> CorePlane<'a> {
        let (layout, len) = (self.placed.layout, self.placed.reach as usize);
        // SAFETY: not null, aligned, within the caller's memory and shorter than 2^63 bytes, all of which `new`
        // checked.
        unsafe {
            match self.half {
                false => CorePlane::f32(slice::from_raw_parts(self.address as *const f32, len), layout),
                true => CorePlane::f16(slice::from_raw_parts(self.address as *const f16, len), layout),
            }
        }
    }

    /// # Safety
    /// As [`Memory::plane`], and nothing else reads it during `'a`.
    pub unsafe fn plane_mut<'a>(&self) -> CorePlaneMut<'a> {
        let (layout, len) = (self.placed.layout, self.placed.reach as usize);
        // SAFETY: as above.
        unsafe {
            match self.half {
                false => CorePlaneMut::f32(slice::from_raw_parts_mut(self.address as *mut f32, len), layout),
                true => CorePlaneMut::f16(slice::from_raw_parts_mut(self.address as *mut f16, len), layout),
            }
        }
    }

    /// Writes pixels of a packed plane of as many channels.
    ///
    /// # Safety
    /// The memory is the caller's, and nothing else reads or writes it meanwhile.
    pub unsafe fn store(&self, extent: Extent, region: Region, packed: &[f32]) {
        let layout = &self.placed.layout;
        for y in region.y as usize..region.bottom() as usize {
            for x in region.x as usize..region.right() as usize {
                let from = (y * extent.width as usize + x) * self.channels;
                let to = y * layout.row_stride + x * layout.pixel_stride;
                for (channel, value) in packed[from..from + self.channels].iter().enumerate() {
                    let at = to + channel * layout.channel_stride;
                    // SAFETY: within the plane's reach, as the region is within the frame.
                    unsafe {
                        match self.half {
                            false => (self.address as *mut f32).add(at).write(*value),
                            true => (self.address as *mut f16).add(at).write(half(*value)),
                        }
                    }
                }
            }
        }
    }
}

const fn sample_bytes(half: bool) -> u64 {
    if half { 2 } else { 4 }
}

/// As the library writes halves: clamped to the largest.
fn half(value: f32) -> f16 {
    f16::from_f32(value.min(f16::MAX.to_f32()))
}

/// # Safety
/// The plane is as its header says, or null.
pub unsafe fn input(
    plane: *const Plane,
    name: &'static str,
    extent: Extent,
    channels: u64,
) -> Result<Option<Memory>, Failure> {
    if plane.is_null() {
        return Ok(None);
    }
    // SAFETY: as the caller's.
    let plane = unsafe { descriptor::read(plane)? };
    reserved::<Plane>(plane.reserved)?;
    let strides = [plane.pixel_stride, plane.row_stride, plane.channel_stride];
    Memory::new(name, extent, channels, plane.samples as usize, plane.size, plane.format, strides).map(Some)
}

/// # Safety
/// The plane is as its header says, or null.
pub unsafe fn output(
    plane: *const PlaneMut,
    name: &'static str,
    extent: Extent,
    channels: u64,
) -> Result<Memory, Failure> {
    // SAFETY: as the caller's.
    let plane = unsafe { descriptor::read(plane)? };
    reserved::<PlaneMut>(plane.reserved)?;
    let strides = [plane.pixel_stride, plane.row_stride, plane.channel_stride];
    Memory::new(name, extent, channels, plane.samples as usize, plane.size, plane.format, strides)
}

//! The host path: frames in the caller's memory.

use crate::choice::choice;
use crate::denoiser::Denoiser;
use crate::descriptor::{self, descriptor, reserved};
use crate::frame_options::{self, FrameOptions};
use crate::handle;
use crate::layout::{Placed, SampleFormat, Strides, place};
use crate::status::{Failure, Status, guard};
use std::ffi::c_void;
use std::ops::Range;
use std::slice;
use vkdenoise::half::f16;
use vkdenoise::{
    Error, Exposure, Extent, Features, Layout, Noise, Plane as CorePlane, PlaneMut as CorePlaneMut, Region,
};

/// A plane to read: three channels (colour, albedo, normal) or one (depth, noise). Channels beyond those, such as
/// alpha, are skipped by the strides.
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
    /// A vkdenoise_sample_format.
    pub format: u32,
    /// Must be 0.
    pub reserved: u32,
}
descriptor!(Plane, "vkdenoise_plane", reserved: u32);

/// A plane to write, of three channels. The fields are those of vkdenoise_plane. It may overlap the frame's other
/// planes, or be one of them.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct PlaneMut {
    /// sizeof(vkdenoise_plane_mut).
    pub struct_size: usize,
    /// The first channel of the top left pixel.
    pub samples: *mut c_void,
    /// Bytes that may be written from there; 0: as many as the strides reach.
    pub size: usize,
    /// Bytes from a pixel to its right neighbour; 0: three channels, packed.
    pub pixel_stride: usize,
    /// Bytes from a pixel to the one below; 0: rows packed.
    pub row_stride: usize,
    /// Bytes from a channel to the next of the same pixel; 0: a sample.
    pub channel_stride: usize,
    /// A vkdenoise_sample_format.
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

/// A noisy frame in host memory, and where the denoised one goes. Every plane but colour and output may be NULL.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Frame {
    /// sizeof(vkdenoise_frame).
    pub struct_size: usize,
    /// Pixels in x.
    pub width: u32,
    /// Pixels in y.
    pub height: u32,
    /// Noisy colour: linear radiance, three channels.
    pub color: *const Plane,
    /// Albedo: three channels in [0, 1].
    pub albedo: *const Plane,
    /// Shading normal: three channels in [-1, 1], in world or camera space.
    pub normal: *const Plane,
    /// Depth: one channel, any unit, larger is farther; 0, below 0, not finite or at least 1e9 (in halves 65000) is
    /// background.
    pub depth: *const Plane,
    /// The colour's noise: one channel. Looked at only where squares are left out (vkdenoise_options.skip_below).
    pub noise: *const Plane,
    /// Where the denoised colour goes.
    pub output: *const PlaneMut,
    /// A vkdenoise_noise_kind.
    pub noise_kind: u32,
    /// Must be 0.
    pub reserved: u32,
}
descriptor!(Frame, "vkdenoise_frame", reserved: u32);

/// What a call of the host path did.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Report {
    /// sizeof(vkdenoise_report), set by the caller.
    pub struct_size: usize,
    /// Milliseconds of the device; below 0 where its queue has no timestamps.
    pub gpu_ms: f64,
    /// Milliseconds of the whole call.
    pub total_ms: f64,
    /// Share of the whole frame's work that was done, 0 to 1.
    pub work: f64,
    /// Bytes of device memory that the frame size takes.
    pub device_bytes: u64,
    /// The factor on the colour that was used.
    pub exposure: f32,
    /// 0.
    pub reserved: u32,
}
descriptor!(Report, "vkdenoise_report", reserved: u32);

/// A plane of the caller's memory, checked.
struct Memory {
    format: SampleFormat,
    placed: Placed,
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
        let format = SampleFormat::from_c(format, plane)?;
        let bytes = format.bytes();
        let mismatch = |reason: String| Err(Error::PlaneMismatch { plane, reason }.into());
        if address == 0 {
            return Err(Failure::argument(format!("the samples of the {plane} plane are NULL")));
        }
        if !(address as u64).is_multiple_of(bytes) {
            return mismatch(format!("its samples lie at {address:#x}, which is no multiple of their {bytes} bytes"));
        }
        let [pixel, row, channel] = strides.map(|stride| stride as u64);
        let placed = place(plane, extent, channels, format, 0, Strides { pixel, row, channel })?;
        let reached = placed.reach * bytes;
        if size != 0 && reached > size as u64 {
            return mismatch(format!("the frame reaches {reached} bytes of it, and it has {size}"));
        }
        if address.checked_add(reached as usize).is_none() {
            return mismatch("its strides reach beyond the end of memory".into());
        }
        Ok(Self { format, placed, address })
    }

    fn bytes(&self) -> Range<usize> {
        self.address..self.address + (self.placed.reach * self.format.bytes()) as usize
    }

    fn overlaps(&self, other: &Self) -> bool {
        let (one, two) = (self.bytes(), other.bytes());
        one.start < two.end && two.start < one.end
    }

    /// # Safety
    /// The memory is the caller's, initialised and not written during `'a`.
    unsafe fn plane<'a>(&self) -> CorePlane<'a> {
        let (layout, len) = (self.placed.layout, self.placed.reach as usize);
        // SAFETY: not null, aligned, within the caller's memory and shorter than 2^63 bytes, all of which `new`
        // checked.
        unsafe {
            match self.format {
                SampleFormat::F32 => CorePlane::f32(slice::from_raw_parts(self.address as *const f32, len), layout),
                SampleFormat::F16 => CorePlane::f16(slice::from_raw_parts(self.address as *const f16, len), layout),
            }
        }
    }

    /// # Safety
    /// As [`Memory::plane`], and nothing else reads it during `'a`.
    unsafe fn plane_mut<'a>(&self) -> CorePlaneMut<'a> {
        let (layout, len) = (self.placed.layout, self.placed.reach as usize);
        // SAFETY: as above.
        unsafe {
            match self.format {
                SampleFormat::F32 => {
                    CorePlaneMut::f32(slice::from_raw_parts_mut(self.address as *mut f32, len), layout)
                }
                SampleFormat::F16 => {
                    CorePlaneMut::f16(slice::from_raw_parts_mut(self.address as *mut f16, len), layout)
                }
            }
        }
    }

    /// Writes pixels of a packed plane of three channels.
    ///
    /// # Safety
    /// The memory is the caller's, and nothing else reads or writes it meanwhile.
    unsafe fn store(&self, extent: Extent, region: Region, packed: &[f32]) {
        let layout = &self.placed.layout;
        for y in region.y as usize..region.bottom() as usize {
            for x in region.x as usize..region.right() as usize {
                let from = (y * extent.width as usize + x) * 3;
                let to = y * layout.row_stride + x * layout.pixel_stride;
                for (channel, value) in packed[from..from + 3].iter().enumerate() {
                    let at = to + channel * layout.channel_stride;
                    // SAFETY: within the plane's reach, as the region is within the frame.
                    unsafe {
                        match self.format {
                            SampleFormat::F32 => (self.address as *mut f32).add(at).write(*value),
                            SampleFormat::F16 => (self.address as *mut f16).add(at).write(half(*value)),
                        }
                    }
                }
            }
        }
    }
}

/// As the library writes halves: clamped to the largest.
fn half(value: f32) -> f16 {
    f16::from_f32(value.min(f16::MAX.to_f32()))
}

/// Memory for a plane of the library's own.
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

/// # Safety
/// The plane is as its header says, or null.
unsafe fn input(
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
unsafe fn output(plane: *const PlaneMut, extent: Extent) -> Result<Memory, Failure> {
    // SAFETY: as the caller's.
    let plane = unsafe { descriptor::read(plane)? };
    reserved::<PlaneMut>(plane.reserved)?;
    let strides = [plane.pixel_stride, plane.row_stride, plane.channel_stride];
    Memory::new("output", extent, 3, plane.samples as usize, plane.size, plane.format, strides)
}

/// Denoises a frame in host memory and waits for the result, on a device of the library's own. What a frame size
/// needs is kept for the next call. Where it fails, the output is untouched.
///
/// @param options NULL: the defaults.
/// @param report NULL: none is wanted. Else set its struct_size; the rest is filled in.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_denoise(
    denoiser: *mut Denoiser,
    frame: *const Frame,
    options: *const FrameOptions,
    report: *mut Report,
) -> Status {
    guard(|| {
        // SAFETY: the caller's pointers are as the header says; the same below.
        let denoiser = unsafe { handle::borrow(denoiser, "denoiser")? };
        // SAFETY: as above.
        let (frame, options) = unsafe { (descriptor::read(frame)?, frame_options::read(options)?) };
        reserved::<Frame>(frame.reserved)?;
        if matches!(options.exposure, Exposure::Buffer(_)) || options.statistics.is_some() {
            return Err(Failure::argument(
                "exposure_buffer and statistics_buffer are for passes, not for the host path",
            ));
        }
        if !report.is_null() {
            // SAFETY: as above. A report of a wrong size is refused before the work.
            unsafe { descriptor::size_of_caller(report.cast_const())? };
        }
        let extent = Extent::new(frame.width, frame.height);
        extent.check()?;
        // SAFETY: as above.
        let (color, albedo, normal, depth, noise, output) = unsafe {
            (
                input(frame.color, "colour", extent, 3)?,
                input(frame.albedo, "albedo", extent, 3)?,
                input(frame.normal, "normal", extent, 3)?,
                input(frame.depth, "depth", extent, 1)?,
                input(frame.noise, "noise", extent, 1)?,
                output(frame.output, extent)?,
            )
        };
        let color = color.ok_or_else(|| Failure::argument("the colour plane is NULL"))?;
        let noise_kind = NoiseKind::from_c(frame.noise_kind)?;
        // SAFETY: the caller leaves the planes alone during the call.
        let plane = |memory: &Memory| unsafe { memory.plane() };
        let core = vkdenoise::Frame {
            extent,
            color: plane(&color),
            features: Features {
                albedo: albedo.as_ref().map(plane),
                normal: normal.as_ref().map(plane),
                depth: depth.as_ref().map(plane),
                noise: noise.as_ref().map(|memory| Noise { plane: plane(memory), kind: noise_kind }),
            },
        };
        let mut denoiser = denoiser.lock();
        denoiser.set_exposure(options.exposure)?;
        denoiser.set_blend(options.blend)?;
        denoiser.set_fireflies(options.fireflies);
        denoiser.set_region(options.region);
        denoiser.set_features_unchanged(options.features_unchanged);
        let inputs = [Some(&color), albedo.as_ref(), normal.as_ref(), depth.as_ref(), noise.as_ref()];
        let done = if inputs.into_iter().flatten().any(|input| input.overlaps(&output)) {
            // Rust's planes may not overlap what is written: the result is made apart, and stored when nothing reads
            // any more.
            let mut packed = zeros(3 * extent.pixels())?;
            let done = denoiser.denoise(&core, CorePlaneMut::f32(&mut packed, Layout::interleaved(extent, 3)))?;
            // SAFETY: the frame's planes are not used after this.
            unsafe { output.store(extent, options.region.unwrap_or(Region::all(extent)), &packed) };
            done
        } else {
            // SAFETY: it overlaps none of the planes that are read.
            denoiser.denoise(&core, unsafe { output.plane_mut() })?
        };
        if report.is_null() {
            return Ok(());
        }
        let told = Report {
            struct_size: size_of::<Report>(),
            gpu_ms: done.gpu_ms.unwrap_or(-1.0),
            total_ms: done.total_ms,
            work: done.work,
            device_bytes: done.device_bytes,
            exposure: done.exposure,
            reserved: 0,
        };
        // SAFETY: as above.
        unsafe { descriptor::write(report, &told) }
    })
}

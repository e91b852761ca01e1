//! The host path: frames in the caller's memory.

use crate::denoiser::Denoiser;
use crate::descriptor::{self, descriptor, reserved};
use crate::frame_options::{self, FrameOptions};
use crate::handle;
use crate::host_output::Output;
use crate::host_planes::{Memory, NoiseKind, Plane, PlaneMut, input, output};
use crate::signals::{Signal, host_signals};
use crate::status::{Failure, Status, guard};
use vkdenoise::{Exposure, Extent, Features, Noise, Progress, Region};

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
    /// Signals that go through the colour's kernels, one after the other in memory.
    pub signals: *const Signal,
    /// How many there are.
    pub signal_count: usize,
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
    /// Bytes of device memory that the library holds on the device, this frame size's and all else.
    pub device_bytes: u64,
    /// The factor on the colour that was used.
    pub exposure: f32,
    /// Tiles that the frame was cut into, as it did not fit the device or the budget in whole; 1: it did.
    pub tiles: u32,
}
descriptor!(Report, "vkdenoise_report", tiles: u32);

/// Denoises a frame in host memory and waits for the result, on a device of the library's own. What a frame size
/// needs is kept for the next call. Where it fails, the outputs are untouched; but where a frame is cut into tiles
/// (vkdenoise_report.tiles), those that were done are written.
///
/// Two outputs must not share samples; else any of the planes may overlap.
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
        let (frame, (options, progress)) = unsafe { (descriptor::read(frame)?, frame_options::read(options)?) };
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
        let (color, albedo, normal, depth, noise, output, signals) = unsafe {
            (
                input(frame.color, "colour", extent, 3)?,
                input(frame.albedo, "albedo", extent, 3)?,
                input(frame.normal, "normal", extent, 3)?,
                input(frame.depth, "depth", extent, 1)?,
                input(frame.noise, "noise", extent, 1)?,
                output(frame.output, "output", extent, 3)?,
                host_signals(frame.signals, frame.signal_count, extent)?,
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
        let (mut outputs, mut given) = (vec![(output, 3)], Vec::new());
        for signal in signals {
            given.push((signal.kind, signal.channels, signal.plane));
            outputs.push((signal.output, signal.channels as usize));
        }
        let inputs = [Some(&color), albedo.as_ref(), normal.as_ref(), depth.as_ref(), noise.as_ref()];
        let inputs: Vec<&Memory> = inputs.into_iter().flatten().chain(given.iter().map(|(.., plane)| plane)).collect();
        let mut outputs = Output::of_call(outputs, &inputs, extent)?;
        // SAFETY: the caller leaves the planes alone during the call.
        let mut written = outputs.iter_mut().map(|output| unsafe { output.plane(extent) });
        let target = written.next().ok_or_else(|| Failure::argument("the output plane is NULL"))?;
        let signal = |(output, (kind, channels, memory)): (_, &(_, u32, Memory))| vkdenoise::Signal {
            kind: *kind,
            channels: *channels,
            plane: plane(memory),
            output,
        };
        let mut signals: Vec<_> = written.zip(&given).map(signal).collect();
        let mut turn = denoiser.take()?;
        turn.set_exposure(options.exposure)?;
        turn.set_blend(options.blend)?;
        turn.set_fireflies(options.fireflies);
        turn.set_region(options.region);
        turn.set_features_unchanged(options.features_unchanged);
        let mut tell = progress.map(|progress| move |share: f32| denoiser.tell(progress, share));
        let progress = tell.as_mut().map(|tell| tell as &mut Progress);
        let done = turn.denoise_with(&core, target, &mut signals, progress)?;
        let region = options.region.unwrap_or(Region::all(extent));
        // SAFETY: the frame's planes are not used after this.
        outputs.iter().for_each(|output| unsafe { output.store(extent, region) });
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
            tiles: done.tiles.map_or(1, |tiles| u32::try_from(tiles.count).unwrap_or(u32::MAX)),
        };
        // SAFETY: as above.
        unsafe { descriptor::write(report, &told) }
    })
}

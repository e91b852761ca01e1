//! A network on a device.

use crate::choice::{choice, flag};
use crate::descriptor::{self, descriptor};
use crate::device::Device;
use crate::handle;
use crate::progress::Progress;
use crate::status::{Failure, Status, guard};
use std::ffi::c_char;
use std::ops::ControlFlow;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};
use vkdenoise::Weights;
use vkdenoise::{
    Converged, ConvergedMode, Extent, Options as CoreOptions, Precision as CorePrecision, Quality as CoreQuality,
};

/// A network on a device. Calls from several threads wait for each other.
pub struct Denoiser {
    denoiser: Mutex<vkdenoise::Denoiser>,
    precision: CorePrecision,
    /// The thread that is in a progress callback of this denoiser.
    calling: Mutex<Option<ThreadId>>,
}

impl Denoiser {
    fn new(denoiser: vkdenoise::Denoiser) -> Self {
        let precision = denoiser.precision();
        Self { denoiser: Mutex::new(denoiser), precision, calling: Mutex::default() }
    }

    /// Waits for its turn.
    ///
    /// # Errors
    /// From within a progress callback of it, where it would be waited for forever.
    pub fn take(&self) -> Result<MutexGuard<'_, vkdenoise::Denoiser>, Failure> {
        if *locked(&self.calling) == Some(thread::current().id()) {
            return Err(Failure::argument("a progress callback cannot use the denoiser that calls it"));
        }
        Ok(locked(&self.denoiser))
    }

    /// Calls a progress callback.
    pub fn tell(&self, progress: Progress, share: f32) -> ControlFlow<()> {
        *locked(&self.calling) = Some(thread::current().id());
        let answer = progress.tell(share);
        *locked(&self.calling) = None;
        answer
    }
}

/// After a panic too: what it left is replaced or refused by the library's own checks.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Run time against error.
#[repr(u32)]
pub enum Quality {
    /// The network that ships: the Hybrid, which predicts kernels.
    Balanced = 0,
    /// The same in half precision; what has converged is left as it is.
    Fast = 1,
    /// The network over the frame and over the frame turned by half a circle, averaged: twice the time for 0.05 to 0.15
    /// dB. Not with keep_aux; a frame in tiles is denoised once.
    High = 2,
}

/// Arithmetic and storage of the network.
#[repr(u32)]
pub enum Precision {
    /// As suits the device and the quality.
    Auto = 0,
    /// 32-bit floats throughout.
    F32 = 1,
    /// Feature maps in halves, arithmetic in 32-bit floats.
    F16 = 2,
    /// Feature maps in halves, products of halves on cooperative matrices.
    Matrix = 3,
}

/// How a denoiser works. All zeros but struct_size: the defaults.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Options {
    /// sizeof(vkdenoise_options).
    pub struct_size: usize,
    /// A vkdenoise_quality.
    pub quality: u32,
    /// A vkdenoise_precision.
    pub precision: u32,
    /// A safetensors file with a network of your own in place of the quality's; NULL: the quality's.
    pub weights_file: *const c_char,
    /// Most bytes of device memory that a frame may take; 0: what the device has. The host path cuts a frame that
    /// needs more into tiles (vkdenoise_report.tiles), a pass is refused.
    pub memory_budget: u64,
    /// Squares of 16x16 pixels whose relative noise is no more than this keep their colour. 0: as the quality has it;
    /// below 0: every square is denoised.
    pub skip_below: f32,
    /// 1: what depends on albedo, normal and depth alone is kept between frames, for
    /// vkdenoise_frame_options.aux_unchanged. It costs device memory.
    pub keep_aux: u32,
    /// 1: frames may come with signals (vkdenoise_frame.signals). For networks that predict kernels, as the one that
    /// ships does; it may cost device memory.
    pub signals: u32,
    /// 1: recordings label every kernel, and not the pass alone, for graphics debuggers (VK_EXT_debug_utils).
    pub label_kernels: u32,
    /// 1: albedo and normals are free of noise, or were denoised before, and are taken as they are. 0: albedo is
    /// filtered where it and the normals are noisy, as in glass and depth of field.
    pub clean_aux: u32,
    /// Must be 0.
    pub reserved: u32,
}
descriptor!(Options, "vkdenoise_options", keep_aux: u32);

/// Device memory that a frame size takes, in bytes.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Memory {
    /// sizeof(vkdenoise_memory), set by the caller.
    pub struct_size: usize,
    /// The feature maps between the kernels.
    pub arena: u64,
    /// The weights, shared by all sizes of a denoiser.
    pub weights: u64,
    /// Planes on their way in and out, in the host path alone.
    pub staging: u64,
    /// What outlives a recording, such as the maps of vkdenoise_options.keep_aux: a pass's own, in whatever arena.
    pub persistent: u64,
}
descriptor!(Memory, "vkdenoise_memory", staging: u64);

fn quality(number: u32) -> Result<CoreQuality, Failure> {
    let choices = [
        (Quality::Balanced as u32, CoreQuality::Balanced),
        (Quality::Fast as u32, CoreQuality::Fast),
        (Quality::High as u32, CoreQuality::High),
    ];
    choice(number, "quality", "vkdenoise_quality", &choices)
}

const PRECISIONS: [(u32, CorePrecision); 4] = [
    (Precision::Auto as u32, CorePrecision::Auto),
    (Precision::F32 as u32, CorePrecision::F32),
    (Precision::F16 as u32, CorePrecision::F16),
    (Precision::Matrix as u32, CorePrecision::Matrix),
];

/// Puts a network on a device. Nothing that depends on a frame's size is made yet.
///
/// @param options NULL: the defaults.
/// @param denoiser receives the denoiser; destroy it with vkdenoise_denoiser_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_denoiser_create(
    device: *const Device,
    options: *const Options,
    denoiser: *mut *mut Denoiser,
) -> Status {
    let make = || {
        // SAFETY: the caller's pointers are as the header says; the same below.
        let (device, options) = unsafe { (handle::borrow(device, "device")?, descriptor::read_or_default(options)?) };
        descriptor::reserved::<Options>(options.reserved)?;
        let (device, quality) = (&device.0, quality(options.quality)?);
        // SAFETY: as above.
        let weights = match unsafe { handle::text(options.weights_file, "weights_file")? } {
            Some(path) => Weights::from_file(path).map_err(vkdenoise::Error::from)?,
            None => quality.weights()?,
        };
        let precision = match choice(options.precision, "precision", "vkdenoise_precision", &PRECISIONS)? {
            CorePrecision::Auto => quality.precision(device),
            asked => asked,
        };
        let converged = match options.skip_below {
            0.0 => quality.converged(),
            below if below < 0.0 => None,
            threshold => Some(Converged { threshold, mode: ConvergedMode::default() }),
        };
        let options = CoreOptions {
            precision,
            converged,
            self_ensemble: quality.self_ensemble(),
            memory_budget: (options.memory_budget > 0).then_some(options.memory_budget),
            keep_features: flag(options.keep_aux, "keep_aux")?,
            signals: flag(options.signals, "signals")?,
            label_kernels: flag(options.label_kernels, "label_kernels")?,
            clean_aux: flag(options.clean_aux, "clean_aux")?,
            ..CoreOptions::default()
        };
        Ok(Denoiser::new(vkdenoise::Denoiser::new(device, &weights, &options)?))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(denoiser, make) })
}

/// Destroys a denoiser. Its passes can still be used and keep the network alive. NULL is nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_denoiser_destroy(denoiser: *mut Denoiser) {
    // SAFETY: as above.
    guard(|| {
        unsafe { handle::take(denoiser) };
        Ok(())
    });
}

/// The precision that the denoiser works in: a vkdenoise_precision, never VKDENOISE_PRECISION_AUTO but for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_denoiser_precision(denoiser: *const Denoiser) -> u32 {
    // SAFETY: as above.
    let precision = unsafe { denoiser.as_ref() }.map_or(CorePrecision::Auto, |denoiser| denoiser.precision);
    let found = PRECISIONS.iter().find(|(_, meaning)| *meaning == precision);
    found.map_or(Precision::Auto as u32, |(number, _)| *number)
}

/// Device memory that the denoiser holds now, in bytes: the weights, and what the host path keeps of the last size. Not
/// passes and arenas, which tell of theirs. 0 for NULL, and within a progress callback of the denoiser.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_denoiser_device_bytes(denoiser: *const Denoiser) -> u64 {
    // SAFETY: as above.
    let denoiser = unsafe { denoiser.as_ref() }.and_then(|denoiser| denoiser.take().ok());
    denoiser.map_or(0, |denoiser| denoiser.device_bytes())
}

/// The device memory that a frame size takes. Nothing is allocated. The host path takes all of it, a renderer's pass
/// all but staging.
///
/// @param memory set its struct_size; the rest is filled in.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_denoiser_memory_required(
    denoiser: *const Denoiser,
    width: u32,
    height: u32,
    memory: *mut Memory,
) -> Status {
    guard(|| {
        // SAFETY: as above.
        let denoiser = unsafe { handle::borrow(denoiser, "denoiser")? };
        let required = denoiser.take()?.memory_required(Extent::new(width, height))?;
        let filled = Memory {
            struct_size: size_of::<Memory>(),
            arena: required.arena,
            weights: required.weights,
            staging: required.staging,
            persistent: required.persistent,
        };
        // SAFETY: as above.
        unsafe { descriptor::write(memory, &filled) }
    })
}

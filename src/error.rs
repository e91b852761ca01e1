//! The crate's one error type.

use crate::net::weights::WeightsError;

/// Every way in which the library can fail. A message says what was wrong and what to do about it.
///
/// `#[non_exhaustive]`: later versions may add cases.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The Vulkan loader could not be opened.
    #[error(
        "no Vulkan loader found ({0}): install a Vulkan driver and its loader (Debian: libvulkan1, mesa-vulkan-drivers)"
    )]
    NoLoader(String),
    /// No Vulkan device can run the denoiser. Gives, for each device seen, what it lacks.
    #[error("no usable Vulkan device: {0}")]
    NoDevice(String),
    /// The device that was asked for by index or name is not there.
    #[error("no Vulkan device matches '{wanted}'; there are: {available}")]
    UnknownDevice {
        /// The index or part of a name that was asked for.
        wanted: String,
        /// The devices that exist, as `index: name`.
        available: String,
    },
    /// The device lacks a feature or a limit that the kernels need.
    #[error("device '{device}' cannot run the denoiser: it lacks {missing}")]
    Unsupported {
        /// The device's name.
        device: String,
        /// The features and limits that are missing, named as in the Vulkan specification.
        missing: String,
    },
    /// A Vulkan call failed.
    #[error("Vulkan call {call} failed: {result}")]
    Vulkan {
        /// The name of the call.
        call: &'static str,
        /// What it returned.
        result: ash::vk::Result,
    },
    /// The device was lost; make a new [`crate::Device`] and [`crate::Denoiser`].
    #[error("the Vulkan device was lost: make a new Device and Denoiser")]
    DeviceLost,
    /// Device or host memory could not be allocated.
    #[error("could not allocate {bytes} bytes for {what}: {reason}")]
    OutOfMemory {
        /// What the memory was for.
        what: String,
        /// How much was asked for, in bytes.
        bytes: u64,
        /// The allocator's own words.
        reason: String,
    },
    /// The frame is empty.
    #[error("the frame is empty ({width} x {height} pixels): both sides must be at least 1")]
    EmptyFrame {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
    },
    /// A plane does not fit the frame: too few samples, or strides that reach beyond its end.
    #[error("the {plane} plane does not fit the frame: {reason}")]
    PlaneMismatch {
        /// Which plane: colour, albedo, normal, depth or output.
        plane: &'static str,
        /// What does not fit.
        reason: String,
    },
    /// The frame is too large: for the device, for the budget, for the arena.
    #[error("a {width} x {height} frame does not fit: {reason}")]
    FrameTooLarge {
        /// Width in pixels.
        width: u32,
        /// Height in pixels.
        height: u32,
        /// The limit that is exceeded, with both values.
        reason: String,
    },
    /// A renderer's recording does not fit the pass that it was made for.
    #[error("this recording does not fit the pass: {0}")]
    Binding(String),
    /// An option is outside its range.
    #[error("option {option} is out of range: {reason}")]
    InvalidOption {
        /// The option's name.
        option: &'static str,
        /// The value found and the range allowed.
        reason: String,
    },
    /// The caller's progress callback answered that the call is to end ([`crate::Denoiser::denoise_with`]).
    #[error("cancelled")]
    Cancelled,
    /// A weights file could not be used.
    #[error("weights: {0}")]
    Weights(#[from] WeightsError),
    /// An OpenEXR file could not be read or written: an [`ExrError`](crate::exr_io::ExrError).
    #[cfg(feature = "exr")]
    #[error(transparent)]
    Exr(Box<dyn std::error::Error + Send + Sync>),
}

/// The crate's result type.
pub type Result<T, E = Error> = std::result::Result<T, E>;

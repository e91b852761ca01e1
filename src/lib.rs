//! A Vulkan compute denoiser for Monte Carlo renders: a noisy frame (linear radiance and, where the renderer has them,
//! albedo, normal and depth) in, the clean one out, in the renderer's own command buffer or from host memory.
//!
//! ```text
//! EXR file / host planes / renderer's buffers or images
//!    -> frame, renderer   views with strides, checked once
//!    -> net               architecture, weights, graph of typed operations
//!    -> plan              graph x size -> dispatches, buffers in an arena, barriers. Pure data
//!    -> record            plan -> one command buffer
//!    -> frame out
//! ```
//!
//! On the host:
//! ```no_run
//! use vkdenoise::{
//!     Denoiser, Device, DeviceSelector, Extent, Features, Frame, Layout, Options, Plane, PlaneMut, Weights,
//! };
//!
//! # fn main() -> vkdenoise::Result<()> {
//! # let (color, albedo) = (vec![0.0f32; 1920 * 1080 * 3], vec![0.0f32; 1920 * 1080 * 3]);
//! let device = Device::open(&DeviceSelector::Best)?;
//! let mut denoiser = Denoiser::new(&device, &Weights::hybrid_kernels()?, &Options::default())?;
//! let extent = Extent::new(1920, 1080);
//! let rgb = Layout::interleaved(extent, 3);
//! let features = Features { albedo: Some(Plane::f32(&albedo, rgb)), ..Features::default() };
//! let frame = Frame { extent, color: Plane::f32(&color, rgb), features };
//! let mut output = vec![0.0; color.len()];
//! let report = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb))?;
//! println!("{:?} ms on the device", report.gpu_ms);
//! # Ok(())
//! # }
//! ```
//!
//! In a renderer, on its device and in its command buffer, without a submit or a wait of the library's own:
//! ```no_run
//! # use vkdenoise::*;
//! # unsafe fn sketch(renderer: RendererDevice, frame: BufferFrame, commands: ash::vk::CommandBuffer) -> Result<()> {
//! // Once. `Device::requirements()` says what to enable when the device is created.
//! let device = unsafe { Device::from_renderer(renderer)? };
//! let denoiser = Denoiser::new(&device, &Weights::hybrid_kernels()?, &Options::default())?;
//! let pass = denoiser.pass(Extent::new(1920, 1080))?;
//! let binding = unsafe { pass.bind_buffers(&frame)? };
//! // Every frame.
//! unsafe { pass.record(commands, &binding, &FrameOptions::default())? };
//! # Ok(())
//! # }
//! ```
//!
//! | for | take |
//! |---|---|
//! | a device | [`Device::open`] with a [`DeviceSelector`], [`Device::open_with`] [`DeviceOptions`], where a [`Cache`] says where compiled kernels are kept; [`Device::list`] gives a [`DeviceInfo`] of each, with its [`DeviceKind`] |
//! | a renderer's own | [`Device::from_renderer`] with [`RendererDevice`], from raw handles [`RawDevice`] with [`EnabledFeatures`]; [`Device::requirements`] says what to enable: [`Requirements`] |
//! | a network | [`Quality`] picks the one that ships, [`Weights::from_file`] loads one; [`WeightsError`] says what a file lacks, [`ArchError`] what its network cannot be |
//! | a denoiser | [`Denoiser::new`] of device, weights and [`Options`] |
//! | choices | [`Options`] for a denoiser, [`FrameOptions`] for each frame: [`Precision`], [`Exposure`], [`Fireflies`], a [`Region`]; [`Converged`] leaves out what needs no denoising ([`ConvergedMode`], [`ConvergedMargins`]) |
//! | frames in memory | [`Denoiser::denoise`] of a [`Frame`] of some [`Extent`]: a [`Plane`] of colour, [`Features`] beside it ([`Noise`] too, of a [`NoiseKind`]), each of [`Samples`] with a [`Layout`], into a [`PlaneMut`] of [`SamplesMut`]; a [`Report`] comes back, with a [`TileReport`] where the frame was cut |
//! | light groups, layers, alpha | [`Denoiser::denoise_with`] for [`Signal`]s of a [`SignalKind`] beside the colour; on the GPU [`Pass::bind_buffers_with`] for [`BufferSignal`]s |
//! | progress, cancelling | [`Progress`] |
//! | frames on the GPU | [`Denoiser::pass`] makes a [`Pass`]; [`Pass::bind_buffers`] of a [`BufferFrame`] of [`BufferPlane`]s, or [`Pass::bind_images`] of an [`ImageFrame`] of [`ImagePlane`]s, a [`Binding`]; then [`Pass::record`] every frame. [`BufferAddress`]es say where the exposure comes from and [`FrameStatistics`] go |
//! | what planes hold | [`SampleFormat`] in buffers, [`ImageFormat`]; [`NormalEncoding`], [`DepthEncoding`] |
//! | memory | [`Denoiser::memory_required`]: a [`MemoryRequired`]; what passes share: [`Denoiser::arena_required`], an [`ArenaRequired`], an [`Arena`], in the caller's buffers of [`ArenaBlock`]s, [`Denoiser::pass_in`] |
//! | what was left out | [`Denoiser::active_tiles`], [`Pass::active_tiles`]: [`ActiveTiles`], a map of [`MapSize`] and each [`Part`] of the network |
//! | times of kernels | [`Pass::profiler`] makes a [`Profiler`], [`Pass::record_profiled`], a [`KernelRecord`] for each with its [`Stage`] of the network; more in [`profile`] |
//! | CUDA, OpenGL, other Vulkan devices | [`Device::interop`]: [`Interop`], [`MemoryHandle`], [`Transfer`]; `SharedBuffer`, `SharedMemory`, `TimelineSemaphore`, `TimelinePoint`, `RecordedPass` (on Unix) |
//! | the same result computed otherwise | [`ConvAlgorithm`] with its [`WinogradTile`], [`SeparableForm`], [`AttentionForm`], [`FfnForm`], [`Folds`]: fields of [`Options`] for who measures; else the device decides |
//! | what goes wrong | [`Error`], [`Result`]; [`ParseError`] of the text of [`Folds`] |
//! | EXR files, metrics | the modules below |
//!
//! The same input on the same device gives the same bits. Samples that are no light (NaN, infinite, negative) and
//! absurd lone pixels are mended and stay local; lamps and suns keep their energy; fireflies are a choice
//! ([`Fireflies`]). All types are `Send` and `Sync`; what records or runs takes `&self` or `&mut self` as its doc says.

/// Modules that are the library's own; the feature `internals` shows them to its tools and tests. They change without
/// notice.
macro_rules! internals {
    ($($name:ident)*) => {
        $(
            #[cfg(feature = "internals")]
            pub mod $name;
            #[cfg(not(feature = "internals"))]
            #[allow(dead_code, unused_imports, reason = "tools and tests use more of it than the library does")]
            mod $name;
        )*
    };
}

internals! { frame kernels microbench net options plan reference target testing vk }

mod arena;
mod denoise;
mod denoiser;
mod descriptors;
mod engine;
mod error;
#[cfg(feature = "exr")]
pub mod exr_io;
mod formats;
mod frame_statistics;
mod host;
mod host_signals;
mod memory;
pub mod metrics;
mod parallel;
mod pass;
mod pass_memory;
mod pipelines;
mod planes;
pub mod profile;
mod progress;
mod quality;
mod record;
#[cfg(unix)]
mod recorded;
mod renderer;
mod role;
mod signals;
mod tiled;
mod tiling;

pub use arena::{Arena, ArenaBlock, ArenaRequired};
/// Vulkan's types and functions, in the version that the library's signatures name.
pub use ash;
pub use denoiser::Denoiser;
pub use error::{Error, Result};
pub use formats::{DepthEncoding, ImageFormat, NormalEncoding, SampleFormat};
pub use frame::{Extent, Features, Frame, Layout, Noise, NoiseKind, Plane, PlaneMut, Region, Samples, SamplesMut};
/// 16-bit floats, in the version that [`Samples`] names.
pub use half;
pub use kernels::converged::MapSize;
pub use kernels::frame_io::Fireflies;
pub use kernels::winograd::WinogradTile;
pub use memory::MemoryRequired;
pub use net::weights::{Weights, WeightsError};
pub use net::{ArchError, Folds, ParseError, Stage};
pub use options::{
    AttentionForm, ConvAlgorithm, Converged, ConvergedMargins, ConvergedMode, Exposure, FfnForm, FrameOptions, Options,
    Precision, Report, SeparableForm, TileReport,
};
pub use pass::{Binding, Pass};
pub use plan::active::{ActiveTiles, Part};
pub use profile::{KernelRecord, Profiler};
pub use progress::Progress;
pub use quality::Quality;
#[cfg(unix)]
pub use recorded::RecordedPass;
pub use renderer::{BufferAddress, BufferFrame, BufferPlane, FrameStatistics, ImageFrame, ImagePlane};
pub use signals::{BufferSignal, Signal, SignalKind};
pub use vk::cache::Cache;
pub use vk::caps::{DeviceInfo, DeviceKind, Requirements};
pub use vk::device::{Device, DeviceOptions, RendererDevice};
pub use vk::interop::{Interop, MemoryHandle, Transfer};
pub use vk::raw::{EnabledFeatures, RawDevice};
pub use vk::selector::DeviceSelector;
#[cfg(unix)]
pub use vk::shared_buffer::{SharedBuffer, SharedMemory};
#[cfg(unix)]
pub use vk::timeline::{TimelinePoint, TimelineSemaphore};

/// The README's snippets, compiled.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

/// The guide's. Like the feature it is not in the published crate.
#[cfg(all(doctest, feature = "shaderc"))]
#[doc = include_str!("../docs/INTEGRATION.md")]
struct Guide;

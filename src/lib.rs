//! A Vulkan compute denoiser for Monte Carlo renders.

pub mod denoiser;
mod engine;
pub mod error;
#[cfg(feature = "exr")]
pub mod exr_io;
pub mod frame;
mod host;
pub mod kernels;
pub mod metrics;
pub mod net;
pub mod pass;
pub mod plan;
mod record;
pub mod reference;
pub mod renderer;
#[doc(hidden)]
pub mod testing;
pub mod vk;
mod weights;

pub use denoiser::{Denoiser, Exposure, Options, Precision, Report};
pub use error::{Error, Result};
pub use frame::{Extent, Features, Frame, Layout, Plane, PlaneMut, Samples, SamplesMut};
pub use net::weights::Weights;
pub use pass::{Binding, FrameOptions, Pass};
pub use renderer::{BufferFrame, BufferPlane, ImageFormat, ImageFrame, ImagePlane, SampleFormat};
pub use vk::caps::{DeviceInfo, DeviceKind, Requirements};
pub use vk::device::{Device, DeviceOptions, DeviceSelector, RendererDevice};

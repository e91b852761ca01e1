//! Signals beside a frame's colour that go through the kernels which were predicted for it: parts of its light, other
//! layers, alpha.
//!
//! The weights must predict kernels and nothing else ([`Weights::hybrid_kernels`](crate::Weights::hybrid_kernels)),
//! and the denoiser be made with [`Options::signals`](crate::Options::signals). `docs/signals.md` has the rules.

use crate::error::{Error, Result};
use crate::formats::SampleFormat;
use crate::frame::{Extent, Plane, PlaneMut};
pub use crate::kernels::signals::SignalKind;
use crate::kernels::signals::SignalRows;
use crate::net::Arch;
use crate::renderer::BufferPlane;
use crate::vk::device::Device;

/// A signal in host memory, and where it goes.
#[derive(Debug)]
pub struct Signal<'a> {
    /// What it is.
    pub kind: SignalKind,
    /// Channels of both planes: 3, or 1 but for [`SignalKind::Light`]; 1 for [`SignalKind::Alpha`].
    pub channels: u32,
    /// The noisy samples, of the frame's size. Those that are not finite are mended from those around.
    pub plane: Plane<'a>,
    /// Where the denoised ones go.
    pub output: PlaneMut<'a>,
}

impl Signal<'_> {
    pub(crate) fn check(&self, extent: Extent) -> Result<()> {
        self.kind.check(self.channels)?;
        self.plane.check("signal", extent, self.channels as usize)?;
        self.output.check("signal's output", extent, self.channels as usize)
    }
}

/// A signal in a renderer's buffers, beside a frame in its buffers or in its images.
#[derive(Clone, Copy, Debug)]
pub struct BufferSignal {
    /// What it is.
    pub kind: SignalKind,
    /// Channels, as [`Signal::channels`].
    pub channels: u32,
    /// The noisy samples.
    pub plane: BufferPlane,
    /// Where the denoised ones go, in samples of the same type as the frame's output has. It may be the same plane.
    pub output: BufferPlane,
}

impl BufferSignal {
    /// Checks the signal and finds its addresses.
    ///
    /// # Safety
    /// The buffers must be as their fields say.
    pub(crate) unsafe fn resolve(&self, device: &Device, extent: Extent, output_half: bool) -> Result<SignalRows> {
        self.kind.check(self.channels)?;
        let channels = self.channels as usize;
        let floats = [SampleFormat::F32, SampleFormat::F16];
        if let Some(other) = [&self.plane, &self.output].into_iter().find(|plane| !floats.contains(&plane.format)) {
            let reason = format!("a signal's samples are {:?}; they can be {floats:?}", other.format);
            return Err(Error::Binding(reason));
        }
        // SAFETY: the caller vouches for the buffers.
        let (plane, output) = unsafe {
            let plane = self.plane.resolve(device, "signal", extent, channels)?;
            (plane, self.output.resolve(device, "signal's output", extent, channels)?)
        };
        if output.format.is_half() != output_half {
            let reason = "a signal's output has samples of another type than the frame's output; give both the same";
            return Err(Error::Binding(reason.into()));
        }
        Ok(SignalRows { kind: self.kind, channels: self.channels, plane, output })
    }
}

/// What a denoiser says that was made for frames without signals.
pub(crate) fn not_asked_for() -> Error {
    let reason = "the denoiser was made without them; set Options::signals";
    Error::InvalidOption { option: "signals", reason: reason.into() }
}

/// What it says of a frame that would be cut into tiles.
pub(crate) fn not_in_tiles() -> Error {
    let reason = "the frame would be cut into tiles to fit the memory, and tiles take no signals; raise Options::memory_budget \
                  or leave the signals out";
    Error::InvalidOption { option: "signals", reason: reason.into() }
}

/// Refuses weights through whose kernels no signal can go.
pub(crate) fn check_head(arch: &Arch) -> Result<()> {
    let why = match arch.head.kernels() {
        Some(head) if !head.gated => return Ok(()),
        Some(_) => "mixes a residual of the colour alone into its result",
        None => "adds a residual to the colour and predicts no kernels",
    };
    let reason = format!("'{}' {why}; take the network that ships, which every quality has", arch.name);
    Err(Error::InvalidOption { option: "signals", reason })
}

//! The network that ships inside the library, and how the qualities take it.

use crate::error::{Error, Result};
use crate::kernels::contract::Need;
use crate::net::weights::{Weights, WeightsError};
use crate::options::{Converged, ConvergedMode, Precision};
use crate::vk::caps::DeviceKind;
use crate::vk::device::Device;
use std::fmt;
use std::str::FromStr;

#[cfg(feature = "weights")]
const HYBRID_KERNELS: Option<&[u8]> = Some(vkdenoise_weights_hybrid_kernels::WEIGHTS);
#[cfg(not(feature = "weights"))]
const HYBRID_KERNELS: Option<&[u8]> = None;

impl Weights {
    /// The trained Hybrid that predicts kernels, embedded in the library: every pixel of its result is an average of
    /// pixels of the frame, of five sizes of neighbourhood, so that flat frames stay flat and texture stays sharp. A
    /// predicted share of it is averaged after division by the albedo and multiplied by it again; the rest is light
    /// that does not show the texture, such as reflections.
    ///
    /// # Errors
    /// [`WeightsError::NotBuiltIn`] without the feature `weights`.
    pub fn hybrid_kernels() -> Result<Self> {
        Ok(Self::from_bytes(HYBRID_KERNELS.ok_or(WeightsError::NotBuiltIn)?)?)
    }
}

/// Run time against error: how the maps of the network that ships are stored, whether what has converged is left as it
/// is, and whether two results are averaged. A network of your own: [`Weights::from_file`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quality {
    /// [`Weights::hybrid_kernels`], in halves; squares of 16x16 pixels with a relative noise below 0.02 keep the
    /// caller's colour.
    Fast,
    /// [`Weights::hybrid_kernels`].
    #[default]
    Balanced,
    /// [`Weights::hybrid_kernels`] over the frame and over the frame turned by half a circle, averaged, in twice the
    /// time ([`Options::self_ensemble`](crate::Options::self_ensemble)).
    High,
}

impl Quality {
    /// All of them, the fastest first.
    pub const ALL: [Self; 3] = [Self::Fast, Self::Balanced, Self::High];

    /// Its network.
    ///
    /// # Errors
    /// [`WeightsError::NotBuiltIn`] without the feature `weights`.
    pub fn weights(self) -> Result<Weights> {
        match self {
            Self::Fast | Self::Balanced | Self::High => Weights::hybrid_kernels(),
        }
    }

    /// How the maps are stored on a device, for [`Options::precision`](crate::Options::precision): as suits it, and of
    /// the fastest quality as halves on CPUs too, which can be told from 32-bit floats by no measure of the picture
    /// (`docs/pareto.md`) and take less time (`docs/lavapipe.md`).
    pub fn precision(self, device: &Device) -> Precision {
        let caps = device.caps();
        let halves = self == Self::Fast && caps.kind == DeviceKind::Cpu && caps.meets(Need::Storage16);
        if halves { Precision::F16 } else { Precision::Auto }
    }

    /// Whether two results are averaged, for [`Options::self_ensemble`](crate::Options::self_ensemble).
    pub fn self_ensemble(self) -> bool {
        self == Self::High
    }

    /// What it leaves out, for [`Options::converged`](crate::Options::converged). Over the noisy test frames that took
    /// at most 2 % more time and changed nothing; where half of a frame has converged it saves about 0.4 of the time
    /// (`docs/pareto.md`, `docs/skip.md`). As frames are not cut into bands then, large ones take more memory.
    pub fn converged(self) -> Option<Converged> {
        (self == Self::Fast).then(|| Converged { threshold: 0.02, mode: ConvergedMode::default() })
    }
}

impl FromStr for Quality {
    type Err = Error;

    /// `fast`, `balanced` or `high`.
    fn from_str(text: &str) -> Result<Self> {
        Self::ALL.into_iter().find(|quality| quality.to_string() == text).ok_or_else(|| Error::InvalidOption {
            option: "quality",
            reason: format!("'{text}'; it can be fast, balanced or high"),
        })
    }
}

impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Fast => "fast",
            Self::Balanced => "balanced",
            Self::High => "high",
        })
    }
}

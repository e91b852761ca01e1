//! Leaving out what needs no denoising.

use crate::error::{Error, Result};
use crate::kernels::converged::BLEND_PIXELS;
use crate::net::op::Stage;
use std::str::FromStr;

/// Leaves out what needs no denoising: squares of 16x16 pixels whose noise is low get the caller's own colour, blended
/// beside what is denoised. The frame is not cut into bands then, so that it may take more device memory
/// ([`crate::Denoiser::memory_required`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Converged {
    /// The relative standard deviation of a pixel up to which it is left as it is, above 0. 0.02 is hardly visible.
    pub threshold: f32,
    /// How far beyond what is denoised the network computes.
    pub mode: ConvergedMode,
}

impl Converged {
    pub(crate) fn check(&self) -> Result<()> {
        if self.threshold.is_finite() && self.threshold > 0.0 {
            return Ok(());
        }
        let reason = format!("{}; it must be a number above 0", self.threshold);
        Err(Error::InvalidOption { option: "converged threshold", reason })
    }
}

/// How far beyond what is denoised the network computes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConvergedMode {
    /// As far as the denoised pixels depend on: they have the bits of the whole frame's pass. On matrices they are
    /// within the rounding of halves of it, as whole frames run more operations as one kernel there.
    Exact,
    /// As far as margins say. The means that FiLM takes of the whole frame are estimated from a sample of what is
    /// converged.
    Approximate(ConvergedMargins),
}

impl FromStr for ConvergedMode {
    type Err = Error;

    /// `exact` or `approximate`, with the margins of [`ConvergedMargins::default`].
    fn from_str(text: &str) -> Result<Self> {
        match text {
            "exact" => Ok(Self::Exact),
            "approximate" => Ok(Self::default()),
            other => {
                let reason = format!("'{other}'; it can be exact or approximate");
                Err(Error::InvalidOption { option: "converged mode", reason })
            }
        }
    }
}

impl Default for ConvergedMode {
    fn default() -> Self {
        Self::Approximate(ConvergedMargins::default())
    }
}

/// Pixels beyond the squares that are denoised that every part of the network computes in approximate mode; in whole
/// tiles. Input and output go at least as far as the blend. Stages are counted from the network's full resolution; the
/// last of an array stands for any after it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConvergedMargins {
    /// The output.
    pub output: u32,
    /// The decoder's stages.
    pub decoder: [u32; 3],
    /// The bottleneck.
    pub bottleneck: u32,
    /// The encoder's stages.
    pub encoder: [u32; 3],
    /// The input.
    pub input: u32,
}

impl ConvergedMargins {
    pub(crate) fn of(&self, stage: Stage) -> u32 {
        match stage {
            Stage::Output => self.output.max(BLEND_PIXELS),
            Stage::Decoder(i) => self.decoder[(i as usize).min(self.decoder.len() - 1)],
            Stage::Bottleneck => self.bottleneck,
            Stage::Encoder(i) => self.encoder[(i as usize).min(self.encoder.len() - 1)],
            Stage::Input => self.input.max(BLEND_PIXELS),
        }
    }
}

impl Default for ConvergedMargins {
    fn default() -> Self {
        Self { output: BLEND_PIXELS, decoder: [8, 0, 0], bottleneck: 0, encoder: [8, 0, 0], input: BLEND_PIXELS }
    }
}

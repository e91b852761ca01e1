//! How a network's last maps become the picture: by a residual that is added, or by kernels that average what is there.
//!
//! Its JSON form stands in the architecture of a weights file, shared with the training kit
//! (`tools/train/vkdn/arch.py`).

use std::str::FromStr;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

use super::ParseError;
use super::arch::{Arch, ArchError, Decoder, check};

/// Numbers of a pixel from which its kernels are predicted.
pub const HIDDEN: u32 = 32;
/// Side of a kernel over radiance.
pub const KERNEL_SIDE: u32 = 5;
/// Side of the kernel over albedo.
pub const ALBEDO_SIDE: u32 = 3;
/// Outputs of a pixel's Linear: a kernel's logits, reliability, three shares, the gate or the logit of the share that
/// is divided by the albedo, a kernel's over albedo.
pub const FULL_OUTPUTS: u32 = KERNEL_SIDE * KERNEL_SIDE + 1 + 3 + 1 + ALBEDO_SIDE * ALBEDO_SIDE;
/// The least logarithm of a pixel's reliability.
pub const LOWEST_RELIABILITY: f64 = -40.0;
/// Albedo below this counts as this, where there is any.
pub const LEAST_ALBEDO: f64 = 0.05;

/// How the last maps become the picture.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
#[serde(untagged)]
pub enum Head {
    /// The network's result is added to the logarithm of the colour.
    #[default]
    Residual,
    /// Every pixel is a mean of pixels.
    Kernels(KernelHead),
}

/// Kernels over the radiance, divided by the albedo, at full size and over means of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "kind", rename = "kernels")]
pub struct KernelHead {
    /// Sides in pixels of the squares whose means the kernels are over, the first being 1: 1, 2, 4, or these and 8, 16.
    pub levels: Vec<u32>,
    /// Whether the residual is mixed in by a predicted share.
    pub gated: bool,
    /// Whether a predicted share of every pixel is of the radiance averaged as it is, not divided by the albedo: a
    /// reflection does not show the texture of what reflects it. Not with a gate.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub gloss: bool,
}

/// A head as a file describes it.
#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum Described {
    Kernels {
        levels: Vec<u32>,
        gated: bool,
        #[serde(default)]
        gloss: bool,
    },
}

/// The levels that a head can have.
const LEVELS: [&[u32]; 2] = [&[1, 2, 4], &[1, 2, 4, 8, 16]];

impl Head {
    /// Kernels alone, over five levels: black stays black, a constant stays what it is.
    pub fn pure() -> Self {
        Self::Kernels(KernelHead { levels: LEVELS[1].to_vec(), gated: false, gloss: false })
    }

    /// Kernels alone, over the radiance divided by the albedo and over the radiance as it is.
    pub fn gloss() -> Self {
        Self::Kernels(KernelHead { levels: LEVELS[1].to_vec(), gated: false, gloss: true })
    }

    /// Kernels over three levels, the residual mixed in.
    pub fn gated() -> Self {
        Self::Kernels(KernelHead { levels: LEVELS[0].to_vec(), gated: true, gloss: false })
    }

    /// Whether there are no kernels.
    pub fn is_residual(&self) -> bool {
        *self == Self::Residual
    }

    /// The kernels, where there are any.
    pub fn kernels(&self) -> Option<&KernelHead> {
        match self {
            Self::Residual => None,
            Self::Kernels(head) => Some(head),
        }
    }

    /// Refuses what the engine cannot build.
    pub(super) fn validate(&self, arch: &Arch) -> Result<(), ArchError> {
        let Self::Kernels(KernelHead { levels, gated, gloss }) = self else { return Ok(()) };
        // One output of a pixel is for either.
        check(!(*gated && *gloss), || "head: kernels are gated or have gloss, not both".into())?;
        check(LEVELS.contains(&&levels[..]), || format!("head: levels {levels:?}, not one of {LEVELS:?}"))?;
        check(arch.patch == 2, || format!("head: kernels need tokens of 2x2 pixels, not patch {}", arch.patch))?;
        check(arch.channels == HIDDEN, || {
            format!("head: kernels need {HIDDEN} channels at stage 0, not {}", arch.channels)
        })?;
        check(arch.decoder == Decoder::Symmetric, || "head: kernels need the symmetric decoder".into())?;
        // A level's kernels come from the map of its size.
        check(levels.len() <= arch.stages.len() + 2, || {
            format!("head: {} levels need {} stages at least", levels.len(), levels.len() - 2)
        })
    }
}

impl FromStr for Head {
    type Err = ParseError;

    /// `residual`, `pure`, `gloss` or `gated`.
    fn from_str(text: &str) -> Result<Self, ParseError> {
        match text {
            "residual" => Ok(Self::Residual),
            "pure" => Ok(Self::pure()),
            "gloss" => Ok(Self::gloss()),
            "gated" => Ok(Self::gated()),
            other => {
                let reason = format!("'{other}'; it can be residual, pure, gloss or gated");
                Err(ParseError { what: "head", reason })
            }
        }
    }
}

impl<'de> Deserialize<'de> for Head {
    /// The word `"residual"`, or the kernels' description.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = serde_json::Value::deserialize(deserializer)?;
        if value.as_str() == Some("residual") {
            return Ok(Self::Residual);
        }
        let described = serde_json::from_value(value).map_err(|error| D::Error::custom(format!("head: {error}")))?;
        let Described::Kernels { levels, gated, gloss } = described;
        Ok(Self::Kernels(KernelHead { levels, gated, gloss }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with(levels: &[u32], gated: bool) -> Arch {
        Arch { head: Head::Kernels(KernelHead { levels: levels.to_vec(), gated, gloss: false }), ..Arch::hybrid() }
    }

    #[test]
    fn json_is_the_contract() {
        let pure = with(&[1, 2, 4, 8, 16], false);
        let json = serde_json::to_string(&pure).unwrap();
        assert!(json.ends_with(r#","head":{"kind":"kernels","levels":[1,2,4,8,16],"gated":false}}"#), "{json}");
        assert_eq!(serde_json::from_str::<Arch>(&json).unwrap(), pure);
        let gloss = Arch { head: Head::gloss(), ..Arch::hybrid() };
        let with_gloss = serde_json::to_string(&gloss).unwrap();
        assert!(with_gloss.ends_with(r#""levels":[1,2,4,8,16],"gated":false,"gloss":true}}"#), "{with_gloss}");
        assert_eq!(serde_json::from_str::<Arch>(&with_gloss).unwrap(), gloss);
        let without = serde_json::to_string(&Arch::hybrid()).unwrap();
        assert!(!without.contains("head\""), "{without}");
        let named = without.replace("}}}", r#"}},"head":"residual"}"#);
        assert_eq!(serde_json::from_str::<Arch>(&named).unwrap(), Arch::hybrid());
        for (from, to) in [("kernels", "kernel"), ("gated", "gates"), (",\"gated\":false", "")] {
            let error = serde_json::from_str::<Arch>(&json.replace(from, to)).unwrap_err().to_string();
            assert!(error.contains("head"), "{error}");
        }
    }

    #[test]
    fn nonsense_is_refused_with_its_reason() {
        assert!(with(&[1, 2, 4], true).validate().is_ok());
        let mut shallow = with(&[1, 2, 4, 8, 16], false);
        shallow.stages.truncate(2);
        let mut wide = with(&[1, 2, 4], false);
        wide.decoder = Decoder::Baseline;
        let both = Head::Kernels(KernelHead { levels: vec![1, 2, 4], gated: true, gloss: true });
        let cases = [
            ("gloss", Arch { head: both, ..Arch::hybrid() }),
            ("levels", with(&[], false)),
            ("levels", with(&[1, 2], false)),
            ("levels", with(&[1, 2, 4, 8], false)),
            ("patch", Arch { patch: 1, ..with(&[1, 2, 4], false) }),
            ("channels", Arch { channels: 16, ..with(&[1, 2, 4], false) }),
            ("symmetric", wide),
            ("3 stages", shallow),
        ];
        for (word, arch) in cases {
            let message = arch.validate().unwrap_err().to_string();
            assert!(message.contains(word), "{message} does not speak of {word}");
        }
    }
}

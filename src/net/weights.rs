//! The weights of a network: named tensors, checked to be just those that the architecture's graph reads.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::arch::{Arch, ArchError};
use super::graph::Graph;
use super::weights_file;

/// A tensor of weights.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Its extents, outermost first.
    pub shape: Vec<u32>,
    /// Its elements, the last axis running fastest.
    pub data: Vec<f32>,
}

/// How a network's inputs were made when it was trained, and so must be made when it runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Preprocessing {
    /// How colour is scaled.
    pub exposure: ExposureRule,
    /// How depth is brought to [0, 1].
    pub depth: DepthRule,
    /// Which version of the rules for single samples ([`Preprocessing::VERSION`]). They differ in samples that are no
    /// light and in lone bright pixels alone, so that weights of every version up to this library's are run by its own
    /// rules.
    #[serde(default = "first_version")]
    pub version: u32,
}

/// Of files that do not say.
fn first_version() -> u32 {
    1
}

impl Preprocessing {
    /// The version of the rules for single samples in this library. 1: a pixel with a sample that is negative or not
    /// finite, or absurdly bright, is missing, and what is brighter than the network's range is lost. 2:
    /// `docs/neutral.md`.
    pub const VERSION: u32 = 2;
}

/// How colour is scaled before the logarithm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ExposureRule {
    /// By one factor per frame that brings its key to 0.18.
    Auto,
    /// Not at all.
    None,
}

/// How depth is brought to [0, 1].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DepthRule {
    /// Divided by the frame's 99.9th percentile, then clamped.
    Percentile,
}

/// Why weights were refused.
#[derive(Debug, thiserror::Error)]
pub enum WeightsError {
    /// The library was built without the network that ships.
    #[error("this build has no network of its own: build with the feature `weights`, or load a file")]
    NotBuiltIn,
    /// The file could not be read.
    #[error("cannot read the weights {}: {source}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The bytes are no safetensors file, or a damaged one.
    #[error("not a sound safetensors file: {0}")]
    Malformed(String),
    /// A metadata entry is missing or not what it should be.
    #[error("weights metadata '{key}': {reason}")]
    Metadata {
        /// Which entry.
        key: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The architecture in the metadata is impossible.
    #[error(transparent)]
    Arch(#[from] ArchError),
    /// A tensor that the network reads is not there.
    #[error("the weights lack the tensor {0}")]
    Missing(String),
    /// A tensor that the network does not read.
    #[error("the weights hold a tensor {0} that the network does not have")]
    Extra(String),
    /// A tensor's shape is not the network's.
    #[error("tensor {name} has shape {found:?}, the network has {expected:?}")]
    Shape {
        /// Which tensor.
        name: String,
        /// Its shape in the graph.
        expected: Vec<u32>,
        /// Its shape in the weights.
        found: Vec<u32>,
    },
    /// A tensor is of a type that is not read: only f16 and f32 are.
    #[error("tensor {name} holds {found}, only F16 and F32 are read")]
    Type {
        /// Which tensor.
        name: String,
        /// Its type in safetensors' words.
        found: String,
    },
    /// A tensor holds a NaN or an infinity.
    #[error("tensor {name} holds {value} at element {index}")]
    NotFinite {
        /// Which tensor.
        name: String,
        /// The first bad element.
        index: usize,
        /// What it is.
        value: f32,
    },
    /// Two networks that cannot be averaged.
    #[error("these networks cannot be averaged: {0}")]
    Ensemble(String),
}

/// The weights of one network. Holds every tensor of its graph, of the right shape and finite, and no other.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    arch: Arch,
    preprocessing: Preprocessing,
    training: String,
    tensors: BTreeMap<String, Tensor>,
    /// Of the network of the turned frame, where that is another.
    turned: Option<Box<Weights>>,
}

impl Weights {
    /// Reads a safetensors file. See [`Weights::from_bytes`].
    ///
    /// # Errors
    /// [`WeightsError::Read`], and those of [`Weights::from_bytes`].
    pub fn from_file(path: impl AsRef<Path>) -> Result<Weights, WeightsError> {
        let path = path.as_ref();
        let read = |source| WeightsError::Read { path: path.into(), source };
        Weights::from_bytes(&weights_file::read(path).map_err(read)?)
    }

    /// Reads a safetensors file in memory. Its metadata: `format`, always `vkdenoise-1`; `architecture`, the JSON of
    /// the architecture; `preprocessing`, the JSON of the rules that it was trained by; and, if it likes, `training`,
    /// any JSON.
    ///
    /// The file need not be trusted: what is allocated stays in proportion to `bytes`.
    ///
    /// # Errors
    /// Anything but [`WeightsError::Read`].
    pub fn from_bytes(bytes: &[u8]) -> Result<Weights, WeightsError> {
        let file = weights_file::parse(bytes)?;
        let weights = Weights::from_parts(file.arch, file.preprocessing, file.tensors)?;
        Ok(Weights { training: file.training, ..weights })
    }

    /// Weights from tensors in memory, checked as a file's are. A Linear's tensor may also have the shape of a 1x1
    /// convolution, `[out, in, 1, 1]`; it is kept as `[out, in]`.
    ///
    /// # Errors
    /// [`WeightsError::Arch`], [`WeightsError::Missing`], [`WeightsError::Extra`], [`WeightsError::Shape`] (also when
    /// the data is not as long as the shape says), [`WeightsError::NotFinite`].
    #[cfg_attr(not(feature = "internals"), doc(hidden))]
    pub fn from_parts(
        arch: Arch,
        preprocessing: Preprocessing,
        mut tensors: BTreeMap<String, Tensor>,
    ) -> Result<Weights, WeightsError> {
        let mut checked = BTreeMap::new();
        for spec in Graph::new(&arch)?.tensors() {
            let Some(mut tensor) = tensors.remove(&spec.name) else {
                return Err(WeightsError::Missing(spec.name));
            };
            if spec.shape.len() == 2 && tensor.shape.ends_with(&[1, 1]) {
                tensor.shape.truncate(tensor.shape.len() - 2);
            }
            if tensor.shape != spec.shape || tensor.data.len() as u64 != spec.elements() {
                return Err(WeightsError::Shape { name: spec.name, expected: spec.shape, found: tensor.shape });
            }
            if let Some((index, &value)) = tensor.data.iter().enumerate().find(|(_, v)| !v.is_finite()) {
                return Err(WeightsError::NotFinite { name: spec.name, index, value });
            }
            checked.insert(spec.name, tensor);
        }
        match tensors.into_keys().next() {
            Some(name) => Err(WeightsError::Extra(weights_file::shown(&name))),
            None => Ok(Weights { arch, preprocessing, training: "{}".into(), tensors: checked, turned: None }),
        }
    }

    /// The same network and another: where [`Options::self_ensemble`](crate::Options::self_ensemble) asks for the
    /// average of two results, the other one's is that of the turned frame. Two networks differ in more of their errors
    /// than one does from itself. Elsewhere the other is not used.
    ///
    /// # Errors
    /// [`WeightsError::Ensemble`] where the two take their colour by different rules, and where `other` is of two
    /// networks itself.
    pub fn averaged_with(self, other: Weights) -> Result<Weights, WeightsError> {
        if other.turned.is_some() {
            return Err(WeightsError::Ensemble("the second one is of two networks itself".into()));
        }
        if self.preprocessing.exposure != other.preprocessing.exposure {
            let rules = [self.preprocessing.exposure, other.preprocessing.exposure];
            return Err(WeightsError::Ensemble(format!("they take their colour by different rules, {rules:?}")));
        }
        Ok(Weights { turned: Some(Box::new(other)), ..self })
    }

    /// The network of the turned frame, where that is another.
    #[cfg_attr(not(feature = "internals"), doc(hidden))]
    pub fn turned(&self) -> Option<&Weights> {
        self.turned.as_deref()
    }

    /// The network they are for.
    #[cfg_attr(not(feature = "internals"), doc(hidden))]
    pub fn arch(&self) -> &Arch {
        &self.arch
    }

    /// How its inputs must be made.
    #[cfg_attr(not(feature = "internals"), doc(hidden))]
    pub fn preprocessing(&self) -> Preprocessing {
        self.preprocessing
    }

    /// Where they come from: JSON in the words of the training kit, `{}` where nothing is known.
    pub fn training(&self) -> &str {
        &self.training
    }

    /// The tensor of this name: any that its network reads.
    ///
    /// # Errors
    /// [`WeightsError::Missing`] for any other name.
    #[cfg_attr(not(feature = "internals"), doc(hidden))]
    pub fn tensor(&self, name: &str) -> Result<&Tensor, WeightsError> {
        self.tensors.get(name).ok_or_else(|| WeightsError::Missing(name.into()))
    }
}

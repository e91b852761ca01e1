//! Which layers to read, and which were taken.

use super::Role;
use super::signals::SignalLayers;
use std::fmt;
use std::path::PathBuf;

/// Where a feature comes from.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum FeatureSource {
    /// The colour's file, if it has a layer of a known name.
    #[default]
    SameFile,
    /// A file of its own with the same data window. Its layer may have any name if it is the only one; depth, variance
    /// and samples are never taken from a colour.
    File(PathBuf),
    /// Nowhere: the feature is not used even if it is there.
    Unused,
}

/// Which layers to read.
#[derive(Clone, Debug, Default)]
pub struct LayerOptions {
    /// The colour layer: its full name, its part's name, its view layer's name, its view or the last section of its
    /// name. `None`: by the usual names.
    pub layer: Option<String>,
    /// The layer that the result is written into, by the same names, in place of the one that it was made from. `None`:
    /// that one.
    pub into: Option<String>,
    /// The view (`left`, `right`, a camera). `None`: all that there are ([`super::ExrFrame::read_views`]), or the
    /// first.
    pub view: Option<String>,
    /// Where the albedo comes from.
    pub albedo: FeatureSource,
    /// Where the normal comes from.
    pub normal: FeatureSource,
    /// Where the depth comes from.
    pub depth: FeatureSource,
    /// Where the variance comes from.
    pub variance: FeatureSource,
    /// Where the sample counts come from. Where there is a variance, that counts.
    pub samples: FeatureSource,
    /// What is denoised beside the colour, with its kernels.
    pub signals: SignalLayers,
}

impl LayerOptions {
    /// Colour alone, without features.
    pub fn color_only(layer: Option<String>) -> Self {
        use FeatureSource::Unused;
        let unused = Self { albedo: Unused, normal: Unused, depth: Unused, variance: Unused, ..Self::default() };
        Self { layer, samples: Unused, ..unused }
    }

    pub(super) fn features(&self) -> [(Role, &FeatureSource); 5] {
        [
            (Role::Albedo, &self.albedo),
            (Role::Normal, &self.normal),
            (Role::Depth, &self.depth),
            (Role::Variance, &self.variance),
            (Role::Samples, &self.samples),
        ]
    }
}

/// The channels that were taken for a role.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UsedLayer {
    /// The feature's own file; `None` for the colour's file.
    pub file: Option<PathBuf>,
    /// The part's name, in files of several parts; all of them, separated by commas, where the channels are in several.
    pub part: Option<String>,
    /// The channels' full names as they stand in the file: three, or one for depth and for grey colour, or two.
    pub channels: Vec<String>,
}

impl fmt::Display for UsedLayer {
    /// `ViewLayer.Combined.R/G/B`, `Z`, `part diffuse: R/G/B`, `Ns.X/Y/Z in normals.exr`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(part) = &self.part {
            write!(f, "part {part}: ")?;
        }
        let prefix = self.channels.first().and_then(|c| c.rfind('.').map(|dot| &c[..=dot])).unwrap_or("");
        for (i, channel) in self.channels.iter().enumerate() {
            let shared = if i == 0 { None } else { channel.strip_prefix(prefix) };
            write!(f, "{}{}", if i == 0 { "" } else { "/" }, shared.unwrap_or(channel))?;
        }
        self.file.as_ref().map_or(Ok(()), |file| write!(f, " in {}", file.display()))
    }
}

/// The layers that were taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// The view, in files that have views.
    pub view: Option<String>,
    /// Colour: three channels, or one that is grey, or two.
    pub color: UsedLayer,
    /// Where the result goes, if not into the colour.
    pub into: Option<UsedLayer>,
    /// Albedo, if there is one.
    pub albedo: Option<UsedLayer>,
    /// Normal, if there is one.
    pub normal: Option<UsedLayer>,
    /// Depth, if there is one.
    pub depth: Option<UsedLayer>,
    /// Variance, if there is one.
    pub variance: Option<UsedLayer>,
    /// Sample counts, if there are.
    pub samples: Option<UsedLayer>,
    /// What is denoised beside the colour.
    pub signals: Vec<UsedLayer>,
    /// What the user should know: layers that were there but could not be used, and why; what was taken for what; other
    /// versions of the picture; channels that a lossy compression rounds once more.
    pub notes: Vec<String>,
}

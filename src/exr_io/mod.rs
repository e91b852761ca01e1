//! OpenEXR files: [`Frame`](crate::Frame)s out of a file's layers, and the file again with new colour.
//!
//! [`ExrFrame::read`] finds colour, albedo, normal and depth by the names that renderers write, and
//! [`ExrFrame::selection`] says which it took; [`ExrFrame::read_views`] does so for every view of a stereo file.
//! [`ExrOutput`] writes the same file with the colours replaced: header (attributes, windows, compression, channel
//! types), block order, alpha, other layers and other parts stay as they were. Blocks that hold no colour are copied
//! bit for bit; those that do are compressed anew, which with a lossy compression (B44, DWA, PXR24) rounds the other
//! channels of that part a second time; a note of the selection says which. With a region it writes a part of the
//! pixels as a file of its own.
//!
//! [`LayerOptions::signals`] names layers that are denoised with the colour's kernels: light groups, other layers,
//! alpha.
//!
//! `docs/files.md` has the names by renderer. They are compared without case, spaces and punctuation; best first:
//!
//! * **Colour**: plain R, G, B or grey Y or V; Blender's `ViewLayer.Noisy Image` and `ViewLayer.Combined`; beauty,
//!   rgba, rgb, color, C, Ci, image, img, main, final, default; in a file of several parts the first; the only RGB
//!   layer, or the only one that has an alpha. Three parts with one channel each are one picture; Y, RY, BY of full
//!   resolution are luminance and chroma; where there are no others, one or two of R, G, B are a picture.
//! * **Albedo, normal, depth**: the tables of `names.rs`. Features come from the colour's own view, and there from its
//!   own view layer (`ViewLayer.` before the name) or from layers without one. Normals that are stored as n * 0.5 + 0.5
//!   are decoded, depths that are all negative lose their sign. Positions are not taken for depth: a file does not say
//!   whose space they are in, but for `Pz`, the depth along a camera's axis.
//! * **Variance** of a pixel's luminance, and **samples** of a pixel, for leaving out what has converged. Cycles'
//!   `Debug Sample Count` is a share, which its header gives the whole of.
//!
//! Blender's Composite is passed over where there is a view layer, and two view layers are an error that asks for a
//! name.
//!
//! Not supported: deep data, colour in subsampled (luminance-chroma) channels, mip maps as colour, HTJ2K compression,
//! integer colour, more than [`MAX_PIXELS`] pixels.

mod assemble;
mod codec;
mod coding;
mod container;
mod crop;
mod error;
mod features;
mod layers;
mod lossy;
mod names;
mod read;
mod replace;
mod samples;
mod select;
mod selection;
mod signals;
mod views;
mod write;

pub use codec::MAX_PIXELS;
pub use error::ExrError;
pub use read::ExrFrame;
pub use replace::{WriteCheck, replace_file};
pub use selection::{FeatureSource, LayerOptions, Selection, UsedLayer};
pub use signals::{AovLayer, ExrSignal, SignalLayers};
pub use write::ExrOutput;

use std::fmt;

/// What a layer is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Role {
    Albedo,
    Normal,
    Depth,
    Variance,
    Samples,
}

impl Role {
    /// Whether its plane has one channel.
    fn is_scalar(self) -> bool {
        matches!(self, Self::Depth | Self::Variance | Self::Samples)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Depth => "depth",
            Self::Variance => "variance",
            Self::Samples => "samples",
        })
    }
}

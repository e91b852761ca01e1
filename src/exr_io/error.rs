//! What can go wrong with an OpenEXR file. Every message names the file.

use std::path::{Path, PathBuf};

/// An OpenEXR file could not be read or written. Nothing is left half written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExrError {
    /// The file could not be opened or read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's own words.
        source: std::io::Error,
    },
    /// The file could not be written. The old file of that name, if any, is as it was.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's own words.
        source: std::io::Error,
    },
    /// The file does not begin as an OpenEXR file does.
    #[error("{} is not an OpenEXR file", path.display())]
    NotExr {
        /// The file.
        path: PathBuf,
    },
    /// The file ends before its pixels do.
    #[error("{} is incomplete ({reason}): render or copy it again", path.display())]
    Incomplete {
        /// The file.
        path: PathBuf,
        /// What is missing.
        reason: String,
    },
    /// The file contradicts itself or its compressed data cannot be decoded.
    #[error("{} is damaged: {reason}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was found.
        reason: String,
    },
    /// The file is valid, but of a kind that cannot be denoised.
    #[error("{} cannot be used: {reason}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What kind it is, and what to do.
        reason: String,
    },
    /// The file declares more pixels than the limit, or more than its size can hold.
    #[error("{} declares {width} x {height} pixels: {reason}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Declared width of the data window in pixels.
        width: u64,
        /// Declared height of the data window in pixels.
        height: u64,
        /// Which limit is exceeded.
        reason: String,
    },
    /// No layer of the wanted kind was found.
    #[error("{} has no {wanted} layer; it has: {found}", path.display())]
    NoLayer {
        /// The file.
        path: PathBuf,
        /// What was looked for: colour, albedo, normal, depth or a name.
        wanted: String,
        /// The layers that there are.
        found: String,
    },
    /// The file has no view of the name that was asked for.
    #[error("{} has no view '{wanted}'; it has: {found}", path.display())]
    NoView {
        /// The file.
        path: PathBuf,
        /// The name.
        wanted: String,
        /// The views that there are.
        found: String,
    },
    /// Several layers fit equally well.
    #[error("{} has several {wanted} layers ({found}): choose one by its name (--layer NAME)", path.display())]
    Ambiguous {
        /// The file.
        path: PathBuf,
        /// What was looked for.
        wanted: String,
        /// The layers that fit, and why each does.
        found: String,
    },
    /// A separate file does not cover the same pixels as the colour.
    #[error("{} covers {found}, but the colour covers {wanted}: render both with the same size and crop", path.display())]
    WindowMismatch {
        /// The separate file.
        path: PathBuf,
        /// Its data window.
        found: String,
        /// The data window of the colour.
        wanted: String,
    },
    /// The region to write has no pixels or leaves the colour's data window.
    #[error("{}: {reason}", path.display())]
    Region {
        /// The file that was read.
        path: PathBuf,
        /// What the region is, and what it may be.
        reason: String,
    },
    /// The colour to write has the wrong number of samples.
    #[error("{} needs {wanted} colour samples (3 a pixel), but was given {found}", path.display())]
    ColorLength {
        /// The file that was read.
        path: PathBuf,
        /// 3 x width x height.
        wanted: usize,
        /// The number given.
        found: usize,
    },
    /// What is to be written into one file was read from several, or is nothing.
    #[error("pictures are written together only if they were read from one file at once, and at least one")]
    Mixed,
}

impl ExrError {
    pub(super) fn damaged(path: &Path, reason: impl Into<String>) -> Self {
        Self::Damaged { path: path.into(), reason: reason.into() }
    }

    pub(super) fn incomplete(path: &Path, reason: impl Into<String>) -> Self {
        Self::Incomplete { path: path.into(), reason: reason.into() }
    }

    pub(super) fn unsupported(path: &Path, reason: impl Into<String>) -> Self {
        Self::Unsupported { path: path.into(), reason: reason.into() }
    }

    /// An error of the decoder, with the file's name.
    pub(super) fn decoder(path: &Path, error: exr::error::Error) -> Self {
        match error {
            exr::error::Error::NotSupported(reason) => Self::unsupported(path, reason),
            exr::error::Error::Invalid(reason) => Self::damaged(path, reason),
            exr::error::Error::Io(source) => Self::Read { path: path.into(), source },
            exr::error::Error::Aborted => Self::damaged(path, "reading was aborted"),
        }
    }
}

impl From<ExrError> for crate::Error {
    fn from(error: ExrError) -> Self {
        Self::Exr(Box::new(error))
    }
}

//! Sizes of frames, and parts of them.

use crate::error::{Error, Result};
use std::str::FromStr;

/// A frame's size in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Extent {
    /// Pixels in x, at least 1.
    pub width: u32,
    /// Pixels in y, at least 1.
    pub height: u32,
}

impl Extent {
    /// A size of `width` x `height` pixels.
    pub const fn new(width: u32, height: u32) -> Self {
        Self { width, height }
    }

    /// Number of pixels.
    pub const fn pixels(self) -> u64 {
        self.width as u64 * self.height as u64
    }

    /// Checks that neither side is zero.
    ///
    /// # Errors
    /// [`Error::EmptyFrame`].
    pub fn check(self) -> Result<()> {
        if self.width == 0 || self.height == 0 {
            return Err(Error::EmptyFrame { width: self.width, height: self.height });
        }
        Ok(())
    }
}

/// A rectangle of a frame's pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Region {
    /// First column.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Columns, at least 1.
    pub width: u32,
    /// Rows, at least 1.
    pub height: u32,
}

impl Region {
    /// The whole frame.
    pub const fn all(extent: Extent) -> Self {
        Self { x: 0, y: 0, width: extent.width, height: extent.height }
    }

    /// Column after the last.
    pub const fn right(&self) -> u32 {
        self.x.saturating_add(self.width)
    }

    /// Row after the last.
    pub const fn bottom(&self) -> u32 {
        self.y.saturating_add(self.height)
    }

    /// What lies in both; `None` where that is nothing.
    pub(crate) fn common(&self, other: &Self) -> Option<Self> {
        let (x, y) = (self.x.max(other.x), self.y.max(other.y));
        let (right, bottom) = (self.right().min(other.right()), self.bottom().min(other.bottom()));
        (x < right && y < bottom).then(|| Self { x, y, width: right - x, height: bottom - y })
    }

    /// Where it lies when the frame is turned by half a circle.
    pub(crate) const fn turned(&self, extent: Extent) -> Self {
        Self { x: extent.width - self.right(), y: extent.height - self.bottom(), ..*self }
    }

    /// Whether a pixel lies in it.
    pub const fn contains(&self, x: u32, y: u32) -> bool {
        self.x <= x && x < self.right() && self.y <= y && y < self.bottom()
    }

    /// Checks that it is not empty and lies within a frame.
    pub(crate) fn check(&self, extent: Extent) -> Result<()> {
        if self.width > 0 && self.height > 0 && self.right() <= extent.width && self.bottom() <= extent.height {
            return Ok(());
        }
        let Self { x, y, width, height } = self;
        let reason = format!(
            "{width} x {height} pixels from ({x}, {y}); it must have pixels and lie within the frame of {} x {}",
            extent.width, extent.height
        );
        Err(Error::InvalidOption { option: "region", reason })
    }
}

impl FromStr for Region {
    type Err = Error;

    /// `X,Y,W,H`: first column, first row, columns, rows.
    fn from_str(text: &str) -> Result<Self> {
        let numbers: Vec<u32> = text.split(',').map_while(|number| number.trim().parse().ok()).collect();
        match numbers[..] {
            [x, y, width, height] if width > 0 && height > 0 && text.split(',').count() == 4 => {
                Ok(Self { x, y, width, height })
            }
            _ => {
                let reason =
                    format!("'{text}'; give X,Y,W,H in pixels (left column, top row, width, height): 0,0,256,128");
                Err(Error::InvalidOption { option: "region", reason })
            }
        }
    }
}

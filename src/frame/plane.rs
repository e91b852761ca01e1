//! Planes of samples in host memory, with any strides.

use super::{Extent, Region};
use crate::error::{Error, Result};
use crate::role::Role;
use half::f16;

/// Where the samples of a plane lie, counted in samples (not bytes) of the plane's own type.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Index of the first channel of pixel (0, 0).
    pub offset: usize,
    /// Distance from a pixel to its right neighbour.
    pub pixel_stride: usize,
    /// Distance from a pixel to the one below it.
    pub row_stride: usize,
    /// Distance from a channel to the next of the same pixel. Not used by planes of one channel.
    pub channel_stride: usize,
}

impl Layout {
    /// Pixels one after another, channels side by side: `RGBRGB...`.
    pub const fn interleaved(extent: Extent, channels: usize) -> Self {
        Self { offset: 0, pixel_stride: channels, row_stride: channels * extent.width as usize, channel_stride: 1 }
    }

    /// One full plane per channel: `RR... GG... BB...`.
    pub const fn planar(extent: Extent) -> Self {
        let row = extent.width as usize;
        Self { offset: 0, pixel_stride: 1, row_stride: row, channel_stride: row * extent.height as usize }
    }

    /// Index of a sample. The caller has checked the layout with [`Layout::check`].
    pub(crate) const fn index(&self, x: usize, y: usize, channel: usize) -> usize {
        self.offset + y * self.row_stride + x * self.pixel_stride + channel * self.channel_stride
    }

    /// The layout of what begins at a pixel.
    pub(crate) const fn from(&self, x: u32, y: u32) -> Self {
        Self { offset: self.index(x as usize, y as usize, 0), ..*self }
    }

    /// Checks that the last sample of a frame lies within `len` samples.
    pub(crate) fn check(&self, plane: &'static str, extent: Extent, channels: usize, len: u64) -> Result<()> {
        let last = (|| {
            let x = (extent.width as u64 - 1).checked_mul(self.pixel_stride as u64)?;
            let y = (extent.height as u64 - 1).checked_mul(self.row_stride as u64)?;
            let c = (channels as u64 - 1).checked_mul(self.channel_stride as u64)?;
            (self.offset as u64).checked_add(x)?.checked_add(y)?.checked_add(c)
        })();
        match last {
            Some(last) if last < len => Ok(()),
            _ => Err(Error::PlaneMismatch {
                plane,
                reason: format!(
                    "{} x {} pixels of {channels} channel(s) with {self:?} reach sample {}, but there are only {len}",
                    extent.width,
                    extent.height,
                    last.map_or("2^64 or beyond".into(), |l| l.to_string()),
                ),
            }),
        }
    }
}

/// Samples to read, in 32- or 16-bit floats.
#[derive(Clone, Copy, Debug)]
pub enum Samples<'a> {
    /// 32-bit floats.
    F32(&'a [f32]),
    /// 16-bit floats.
    F16(&'a [f16]),
}

impl Samples<'_> {
    fn len(&self) -> u64 {
        match self {
            Self::F32(s) => s.len() as u64,
            Self::F16(s) => s.len() as u64,
        }
    }

    fn get(&self, index: usize) -> f32 {
        match self {
            Self::F32(s) => s[index],
            Self::F16(s) => s[index].to_f32(),
        }
    }
}

/// Samples to write, in 32- or 16-bit floats.
#[derive(Debug)]
pub enum SamplesMut<'a> {
    /// 32-bit floats.
    F32(&'a mut [f32]),
    /// 16-bit floats.
    F16(&'a mut [f16]),
}

/// A plane to read: three channels (colour, albedo, normal) or one (depth).
#[derive(Clone, Copy, Debug)]
pub struct Plane<'a> {
    /// The samples.
    pub samples: Samples<'a>,
    /// Where they lie.
    pub layout: Layout,
}

impl<'a> Plane<'a> {
    /// 32-bit samples in the given layout.
    pub const fn f32(samples: &'a [f32], layout: Layout) -> Self {
        Self { samples: Samples::F32(samples), layout }
    }

    /// 16-bit samples in the given layout.
    pub const fn f16(samples: &'a [f16], layout: Layout) -> Self {
        Self { samples: Samples::F16(samples), layout }
    }

    pub(crate) fn check(&self, plane: &'static str, extent: Extent, channels: usize) -> Result<()> {
        self.layout.check(plane, extent, channels, self.samples.len())
    }

    /// The plane from a pixel on.
    pub(crate) fn part(&self, x: u32, y: u32) -> Self {
        Self { layout: self.layout.from(x, y), ..*self }
    }

    /// Copies the plane into interleaved 32-bit floats.
    pub(crate) fn pack(&self, extent: Extent, channels: usize, out: &mut [f32]) {
        let mut out = out.iter_mut();
        for y in 0..extent.height as usize {
            for x in 0..extent.width as usize {
                for (c, value) in out.by_ref().take(channels).enumerate() {
                    *value = self.samples.get(self.layout.index(x, y, c));
                }
            }
        }
    }

    /// Copies the plane of a role, the background of depths kept.
    pub(crate) fn pack_as(&self, role: Role, extent: Extent, out: &mut [f32]) {
        self.pack(extent, role.channels(), out);
        if let (Role::Depth, Samples::F16(_)) = (role, &self.samples) {
            widen_half_depths(out);
        }
    }
}

/// Makes the background of depths that were halves the background of floats: halves cannot hold 1e9.
pub(crate) fn widen_half_depths(depths: &mut [f32]) {
    const HALF_BACKGROUND: f32 = 65000.0;
    depths.iter_mut().filter(|depth| **depth >= HALF_BACKGROUND).for_each(|depth| *depth = f32::INFINITY);
}

/// A plane to write, of three channels.
#[derive(Debug)]
pub struct PlaneMut<'a> {
    /// The samples.
    pub samples: SamplesMut<'a>,
    /// Where they lie.
    pub layout: Layout,
}

impl<'a> PlaneMut<'a> {
    /// 32-bit samples in the given layout.
    pub const fn f32(samples: &'a mut [f32], layout: Layout) -> Self {
        Self { samples: SamplesMut::F32(samples), layout }
    }

    /// 16-bit samples in the given layout. Values are clamped to ±65504, the largest halves.
    pub const fn f16(samples: &'a mut [f16], layout: Layout) -> Self {
        Self { samples: SamplesMut::F16(samples), layout }
    }

    fn as_samples(&self) -> Samples<'_> {
        match &self.samples {
            SamplesMut::F32(s) => Samples::F32(s),
            SamplesMut::F16(s) => Samples::F16(s),
        }
    }

    pub(crate) fn check(&self, plane: &'static str, extent: Extent, channels: usize) -> Result<()> {
        self.layout.check(plane, extent, channels, self.as_samples().len())
    }

    /// The plane from a pixel on.
    pub(crate) fn part(&mut self, x: u32, y: u32) -> PlaneMut<'_> {
        let layout = self.layout.from(x, y);
        match &mut self.samples {
            SamplesMut::F32(samples) => PlaneMut::f32(samples, layout),
            SamplesMut::F16(samples) => PlaneMut::f16(samples, layout),
        }
    }

    /// The plane, read as an input.
    pub(crate) fn as_plane(&self) -> Plane<'_> {
        Plane { samples: self.as_samples(), layout: self.layout }
    }

    /// Writes a region of interleaved 32-bit floats into the plane. All other samples stay as they are.
    pub(crate) fn unpack(&mut self, extent: Extent, region: Region, channels: usize, values: &[f32]) {
        let layout = self.layout;
        for y in region.y as usize..region.bottom() as usize {
            for x in region.x as usize..region.right() as usize {
                for c in 0..channels {
                    let from = (y * extent.width as usize + x) * channels + c;
                    let (index, value) = (layout.index(x, y, c), values.get(from).copied().unwrap_or(0.0));
                    match &mut self.samples {
                        SamplesMut::F32(s) => s[index] = value,
                        SamplesMut::F16(s) => {
                            s[index] = f16::from_f32(value.clamp(f16::MIN.to_f32(), f16::MAX.to_f32()))
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_end_at_the_largest_of_either_sign() {
        let extent = Extent::new(2, 1);
        let mut samples = [f16::ZERO; 2];
        let mut plane = PlaneMut::f16(&mut samples, Layout::interleaved(extent, 1));
        plane.unpack(extent, Region::all(extent), 1, &[-1e6, 1e6]);
        assert_eq!(samples, [f16::MIN, f16::MAX]);
    }
}

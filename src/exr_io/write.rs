//! Pictures back into their file.

use super::assemble;
use super::codec::NewColor;
use super::crop;
use super::error::ExrError;
use super::{ExrFrame, ExrSignal, replace_file};
use crate::frame::Region;
use std::io::{Seek, Write};
use std::path::Path;
use std::sync::Arc;

/// The file that pictures were read from, with new colours in their place: what is left to do is to write it.
///
/// The samples keep their type; halfs are clamped to +-65504. Grey colour takes the mean of the three.
pub struct ExrOutput<'a> {
    pictures: Vec<(&'a ExrFrame, &'a [f32])>,
    region: Option<Region>,
    /// Signals of the pictures, as red, green and blue.
    signals: Vec<(&'a ExrSignal, Vec<f32>)>,
}

impl<'a> ExrOutput<'a> {
    /// Pictures (views) of one file, each with its new colour: interleaved RGB of its whole data window.
    ///
    /// With a region, counted in pixels from the upper left corner of each data window, the file is cropped: the data
    /// window of what is written is that of the region, and every channel of every part keeps its samples there. Parts
    /// that lie outside are left out. The display window and all other attributes stay. What a colour has outside the
    /// region is not looked at.
    ///
    /// # Errors
    /// [`ExrError::ColorLength`]; [`ExrError::Mixed`] for no picture and for pictures of several files; as
    /// [`ExrFrame::check_region`], and where the views' data windows differ with a region.
    pub fn new(pictures: &[(&'a ExrFrame, &'a [f32])], region: Option<Region>) -> Result<Self, ExrError> {
        let Some((first, _)) = pictures.first() else { return Err(ExrError::Mixed) };
        let window = |frame: &ExrFrame| frame.container.header(frame.target.channels[0].part).data_window();
        for (frame, color) in pictures {
            if !Arc::ptr_eq(&frame.container, &first.container) {
                return Err(ExrError::Mixed);
            }
            frame.check_color(color)?;
            region.map_or(Ok(()), |region| frame.check_region(region))?;
            if region.is_some() && window(frame) != window(first) {
                let reason = "its views have several data windows; choose one of them to write a region".into();
                return Err(ExrError::Region { path: frame.container.path.clone(), reason });
            }
        }
        Ok(Self { pictures: pictures.to_vec(), region, signals: Vec::new() })
    }

    /// With the results of a picture's signals in their places, in their order: the samples of each interleaved.
    ///
    /// # Errors
    /// [`ExrError::Mixed`] where the picture is none of these; [`ExrError::ColorLength`].
    pub fn with_signals(mut self, frame: &'a ExrFrame, results: &[Vec<f32>]) -> Result<Self, ExrError> {
        if !self.pictures.iter().any(|(picture, _)| std::ptr::eq(*picture, frame))
            || results.len() != frame.signals.len()
        {
            return Err(ExrError::Mixed);
        }
        for (signal, result) in frame.signals.iter().zip(results) {
            let (wanted, found) = (signal.samples().len(), result.len());
            if wanted != found {
                return Err(ExrError::ColorLength { path: frame.container.path.clone(), wanted, found });
            }
            self.signals.push((signal, signal.colors(result)));
        }
        Ok(self)
    }

    /// Writes the file beside `path` and renames it (see [`replace_file`]), so `path` may be the file that was read.
    ///
    /// # Errors
    /// [`ExrError::Write`].
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), ExrError> {
        replace_file(path.as_ref(), |out| self.write_to(out))
    }

    /// Writes the file to anything else.
    ///
    /// # Errors
    /// Those of `out`, and blocks of the file that was read that turn out to be damaged.
    pub fn write_to(&self, out: &mut (impl Write + Seek)) -> std::io::Result<()> {
        let new = |(frame, color): &(&'a ExrFrame, &'a [f32])| NewColor {
            channels: &frame.target.channels,
            coding: frame.target.coding,
            color,
        };
        let mut colors: Vec<NewColor> = self.pictures.iter().map(new).collect();
        colors.extend(self.signals.iter().map(|(signal, color)| NewColor {
            channels: &signal.channels,
            coding: signal.coding(),
            color,
        }));
        let Some((first, _)) = self.pictures.first() else { return Ok(()) };
        match self.region {
            None => assemble::assemble(&first.container, &colors, out),
            Some(region) => {
                let window = crop::window_of(&first.container, first.target.channels[0].part, region);
                crop::write(&first.container, &colors, window, out)
            }
        }
    }
}

impl ExrFrame {
    /// Writes the file that was read with `color` (interleaved RGB of the whole data window) in place of its colour, as
    /// [`ExrOutput`] does.
    ///
    /// # Errors
    /// [`ExrError::ColorLength`], [`ExrError::Write`].
    pub fn write_with_color(&self, path: impl AsRef<Path>, color: &[f32]) -> Result<(), ExrError> {
        ExrOutput::new(&[(self, color)], None)?.write(path)
    }

    /// The same cropped to a region, as [`ExrOutput`] does.
    ///
    /// # Errors
    /// As [`ExrFrame::check_region`]; [`ExrError::ColorLength`], [`ExrError::Write`].
    pub fn write_region(&self, path: impl AsRef<Path>, color: &[f32], region: Region) -> Result<(), ExrError> {
        ExrOutput::new(&[(self, color)], Some(region))?.write(path)
    }

    /// Checks that a region of the colour's data window, counted in pixels from its upper left corner, can be written
    /// as a file of its own.
    ///
    /// # Errors
    /// [`ExrError::Region`] where it is empty or leaves the data window; [`ExrError::Unsupported`] where a part that it
    /// meets is a mip map or has subsampled channels.
    pub fn check_region(&self, region: Region) -> Result<(), ExrError> {
        region
            .check(self.extent())
            .map_err(|error| ExrError::Region { path: self.container.path.clone(), reason: error.to_string() })?;
        crop::check(&self.container, crop::window_of(&self.container, self.target.channels[0].part, region))
    }

    fn check_color(&self, color: &[f32]) -> Result<(), ExrError> {
        let (wanted, found) = (self.color().len(), color.len());
        if found != wanted {
            return Err(ExrError::ColorLength { path: self.container.path.clone(), wanted, found });
        }
        Ok(())
    }
}

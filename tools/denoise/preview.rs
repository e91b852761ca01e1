//! `--png`: images side by side as a screen shows them.

use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::borrow::Cow;
use std::path::Path;
use vkdenoise::exr_io::{ExrError, replace_file};
use vkdenoise::kernels::converged::MAP_TILE;
use vkdenoise::{ActiveTiles, Extent, Region};

/// The pixels of a region of an image of `extent`, interleaved RGB; all of them without one.
pub fn cut(extent: Extent, region: Option<Region>, image: &[f32]) -> Cow<'_, [f32]> {
    let Some(region) = region else { return image.into() };
    let row = 3 * extent.width as usize;
    let (first, length) = (3 * region.x as usize, 3 * region.width as usize);
    let rows = region.y as usize..region.bottom() as usize;
    rows.flat_map(|y| &image[y * row + first..][..length]).copied().collect::<Vec<_>>().into()
}

/// An image of `extent` with what was left out darkened.
pub fn dim(extent: Extent, active: &ActiveTiles, image: &[f32]) -> Vec<f32> {
    let columns = active.size.columns as usize;
    let square =
        |i: usize| (i % extent.width as usize / MAP_TILE as usize, i / extent.width as usize / MAP_TILE as usize);
    let share = |(x, y): (usize, usize)| if active.map[y * columns + x] { 1.0 } else { DIMMED };
    image.iter().enumerate().map(|(i, sample)| sample * share(square(i / 3))).collect()
}

/// What is left of the light where nothing was denoised.
const DIMMED: f32 = 0.1;

/// Writes images of one size (interleaved RGB) side by side: times `exposure`, gamma 2.2, 8 bits.
pub fn write(path: &Path, extent: Extent, exposure: f32, images: &[&[f32]]) -> Result<(), ExrError> {
    let row = 3 * extent.width as usize;
    let mut pixels = Vec::with_capacity(images.len() * row * extent.height as usize);
    for y in 0..extent.height as usize {
        for image in images {
            pixels.extend(image[y * row..][..row].iter().map(|c| shown(c * exposure)));
        }
    }
    let width = extent.width.saturating_mul(images.len() as u32);
    replace_file(path, |out| {
        let encoder = PngEncoder::new(out);
        encoder.write_image(&pixels, width, extent.height, ExtendedColorType::Rgb8).map_err(std::io::Error::other)
    })
}

/// NaN and what is negative are black.
fn shown(linear: f32) -> u8 {
    (255.0 * linear.max(0.0).powf(1.0 / 2.2).min(1.0)).round() as u8
}

//! `--png`: images side by side as a screen shows them.

use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use std::path::Path;
use vkdenoise::Extent;
use vkdenoise::exr_io::{ExrError, replace_file};

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

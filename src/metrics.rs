//! How close an image is to a reference: PSNR, SSIM, relMSE, NMSE and tone-mapped dB, all computed in f64.
//!
//! Images are interleaved RGB of linear radiance. PSNR and SSIM compare them as they are shown, in 8 bits:
//! `trunc(255 * clip(c^(1/2.2), 0, 1))`, where a negative or NaN sample counts as 0.

use crate::error::{Error, Result};
use crate::frame::Extent;

/// Side of the SSIM window in pixels. A frame that is smaller on either side has no SSIM.
pub const SSIM_WINDOW: usize = 11;

const SSIM_SIGMA: f64 = 1.5;

/// An image beside its reference, checked to be of one size.
///
/// ```
/// use vkdenoise::{Extent, metrics::Comparison};
/// let (image, reference) = ([0.5; 12], [0.25; 12]);
/// let comparison = Comparison::new(Extent::new(2, 2), &image, &reference)?;
/// assert!((comparison.rel_mse() - 0.0625 / 0.0725).abs() < 1e-12);
/// # Ok::<(), vkdenoise::Error>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Comparison<'a> {
    extent: Extent,
    image: &'a [f32],
    reference: &'a [f32],
}

impl<'a> Comparison<'a> {
    /// Compares `image` with `reference`, both interleaved RGB of `extent`.
    ///
    /// # Errors
    /// [`Error::EmptyFrame`]; [`Error::PlaneMismatch`] if a slice does not have 3 samples for each pixel.
    pub fn new(extent: Extent, image: &'a [f32], reference: &'a [f32]) -> Result<Self> {
        extent.check()?;
        for (plane, samples) in [("image", image), ("reference", reference)] {
            check_len(plane, samples.len(), extent.pixels().saturating_mul(3))?;
        }
        Ok(Self { extent, image, reference })
    }

    /// Peak signal-to-noise ratio in dB over all pixels and channels of the 8-bit images. Infinite if they are equal.
    pub fn psnr(&self) -> f64 {
        let square = |(a, b): (&f32, &f32)| (display(*a) - display(*b)).powi(2);
        decibel(255.0, self.image.iter().zip(self.reference).map(square).sum::<f64>() / self.image.len() as f64)
    }

    /// Structural similarity of the 8-bit images, at most 1: Gaussian window of 11 x 11 pixels and sigma 1.5, only
    /// where it fits whole, biased variances, `K1` 0.01, `K2` 0.03, mean over pixels and channels.
    ///
    /// `None` if a side is below [`SSIM_WINDOW`]: a shrunken window would give figures that compare with no others.
    pub fn ssim(&self) -> Option<f64> {
        let (width, height) = (self.extent.width as usize, self.extent.height as usize);
        if width < SSIM_WINDOW || height < SSIM_WINDOW {
            return None;
        }
        let sum: f64 = (0..3).map(|channel| self.ssim_sum(channel, width, height)).sum();
        Some(sum / (3 * (width - SSIM_WINDOW + 1) * (height - SSIM_WINDOW + 1)) as f64)
    }

    /// Relative mean squared error on linear colour: `mean((a - b)^2 / (b^2 + 0.01))`, b the reference.
    pub fn rel_mse(&self) -> f64 {
        let term = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).powi(2) / (f64::from(*b).powi(2) + 0.01);
        self.image.iter().zip(self.reference).map(term).sum::<f64>() / self.image.len() as f64
    }

    /// Difference as shown, in dB: both times `exposure`, gamma 2.2, clipped to [0, 1] but not rounded, peak 1. For
    /// comparing two outputs with each other, where rounding to 8 bits would hide what is above 60 dB.
    pub fn tone_mapped_db(&self, exposure: f32) -> f64 {
        let shown = |c: f32| gamma(f64::from(c) * f64::from(exposure));
        let square = |(a, b): (&f32, &f32)| (shown(*a) - shown(*b)).powi(2);
        decibel(1.0, self.image.iter().zip(self.reference).map(square).sum::<f64>() / self.image.len() as f64)
    }

    /// Sum of the SSIM of one channel over all whole windows. The window is separable: first down the columns, one
    /// output row at a time, then along that row.
    fn ssim_sum(&self, channel: usize, width: usize, height: usize) -> f64 {
        let shown = |samples: &[f32]| -> Vec<f64> { samples.chunks_exact(3).map(|p| display(p[channel])).collect() };
        let (a, b) = (shown(self.image), shown(self.reference));
        let window = gaussian();
        let mut columns = vec![[0.0; 5]; width];
        let mut total = 0.0;
        for top in 0..=height - SSIM_WINDOW {
            columns.fill([0.0; 5]);
            for (weight, row) in window.iter().zip(top..) {
                let rows = a[row * width..][..width].iter().zip(&b[row * width..][..width]);
                for (sums, (&x, &y)) in columns.iter_mut().zip(rows) {
                    for (sum, value) in sums.iter_mut().zip([x, y, x * x, y * y, x * y]) {
                        *sum += weight * value;
                    }
                }
            }
            for neighbours in columns.windows(SSIM_WINDOW) {
                let mut means = [0.0; 5];
                for (weight, sums) in window.iter().zip(neighbours) {
                    means.iter_mut().zip(sums).for_each(|(mean, sum)| *mean += weight * sum);
                }
                total += similarity(means);
            }
        }
        total
    }
}

/// Normalised mean squared error `sum((a - b)^2) / sum(b^2)` of any samples, b the reference. For two slices that are
/// all zero it is 0; for a zero reference alone, infinite.
///
/// # Errors
/// [`Error::PlaneMismatch`] if the lengths differ.
pub fn nmse(samples: &[f32], reference: &[f32]) -> Result<f64> {
    check_len("image", samples.len(), reference.len() as u64)?;
    let square = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).powi(2);
    let error: f64 = samples.iter().zip(reference).map(square).sum();
    let energy: f64 = reference.iter().map(|b| f64::from(*b).powi(2)).sum();
    Ok(if error == 0.0 { 0.0 } else { error / energy })
}

fn check_len(plane: &'static str, found: usize, wanted: u64) -> Result<()> {
    if found as u64 == wanted {
        return Ok(());
    }
    Err(Error::PlaneMismatch { plane, reason: format!("it has {found} samples, but {wanted} are needed") })
}

/// Gamma 2.2, clipped to [0, 1]. `max` turns NaN into 0.
fn gamma(linear: f64) -> f64 {
    linear.max(0.0).powf(1.0 / 2.2).min(1.0)
}

/// A sample as an 8-bit screen shows it, 0 to 255.
fn display(linear: f32) -> f64 {
    (255.0 * gamma(f64::from(linear))).trunc()
}

fn decibel(peak: f64, mean_square: f64) -> f64 {
    10.0 * (peak * peak / mean_square).log10()
}

fn gaussian() -> [f64; SSIM_WINDOW] {
    let centre = (SSIM_WINDOW / 2) as f64;
    let mut window = std::array::from_fn(|i| (-0.5 * ((i as f64 - centre) / SSIM_SIGMA).powi(2)).exp());
    let sum: f64 = window.iter().sum();
    window.iter_mut().for_each(|w| *w /= sum);
    window
}

/// SSIM of one window from its weighted means of a, b, a^2, b^2 and ab.
fn similarity([a, b, aa, bb, ab]: [f64; 5]) -> f64 {
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    let (var_a, var_b, covariance) = (aa - a * a, bb - b * b, ab - a * b);
    (2.0 * a * b + c1) * (2.0 * covariance + c2) / ((a * a + b * b + c1) * (var_a + var_b + c2))
}

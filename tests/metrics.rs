//! The metrics against slow formulations of their definitions and against figures of scikit-image.

use vkdenoise::metrics::{Comparison, SSIM_WINDOW, nmse};
use vkdenoise::{Error, Extent};

/// Numbers in [0, 1) that any language can make: x' = 1664525 x + 1013904223 mod 2^32, of which the upper 24 bits.
fn numbers(seed: u32, count: usize) -> Vec<f32> {
    let mut x = seed;
    let mut next = || {
        x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (x >> 8) as f32 / (1 << 24) as f32
    };
    (0..count).map(|_| next()).collect()
}

/// An image with noise, and its reference, which goes above 1.
fn pair(extent: Extent) -> (Vec<f32>, Vec<f32>) {
    let count = 3 * extent.pixels() as usize;
    let reference: Vec<f32> = numbers(1, count).iter().map(|v| v * 1.5).collect();
    let image = numbers(2, count).iter().zip(&reference).map(|(n, r)| r + (n - 0.5) * 0.5).collect();
    (image, reference)
}

fn close(found: f64, wanted: f64, tolerance: f64) {
    assert!((found - wanted).abs() <= tolerance * wanted.abs(), "{found}, not {wanted}");
}

/// scikit-image 0.26: structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
/// data_range=255, channel_axis=2) and peak_signal_noise_ratio on the 8-bit images; NumPy for the others.
#[test]
fn figures_of_scikit_image() {
    let extent = Extent::new(29, 17);
    let (image, reference) = pair(extent);
    let comparison = Comparison::new(extent, &image, &reference).unwrap();
    close(comparison.ssim().unwrap(), 0.9004496657792558, 1e-9);
    close(comparison.psnr(), 19.112048060473455, 1e-12);
    close(comparison.rel_mse(), 0.2176692267531604, 1e-12);
    close(nmse(&image, &reference).unwrap(), 0.027688635727180916, 1e-12);
    close(comparison.tone_mapped_db(0.5), 21.386491489236388, 1e-12);
}

/// SSIM by its definition: for each window the weighted means, then the central moments.
fn slow_ssim(extent: Extent, image: &[f32], reference: &[f32]) -> f64 {
    let (width, height) = (extent.width as usize, extent.height as usize);
    let shown = |v: f32| (255.0 * f64::from(v).max(0.0).powf(1.0 / 2.2).min(1.0)).trunc();
    let weight = |x: usize, y: usize| {
        let square = (x as f64 - 5.0).powi(2) + (y as f64 - 5.0).powi(2);
        (-square / (2.0 * 1.5 * 1.5)).exp()
    };
    let places: Vec<(usize, usize)> = (0..121).map(|i| (i % 11, i / 11)).collect();
    let total: f64 = places.iter().map(|&(x, y)| weight(x, y)).sum();
    let (mut sum, mut count) = (0.0, 0.0);
    for channel in 0..3 {
        for (left, top) in (0..=height - 11).flat_map(|y| (0..=width - 11).map(move |x| (x, y))) {
            let at = |samples: &[f32], x: usize, y: usize| shown(samples[3 * ((top + y) * width + left + x) + channel]);
            let mean = |f: &dyn Fn(usize, usize) -> f64| -> f64 {
                places.iter().map(|&(x, y)| weight(x, y) / total * f(x, y)).sum()
            };
            let (a, b) = (mean(&|x, y| at(image, x, y)), mean(&|x, y| at(reference, x, y)));
            let moment =
                |p: &dyn Fn(usize, usize) -> f64, q: &dyn Fn(usize, usize) -> f64| mean(&|x, y| p(x, y) * q(x, y));
            let (da, db) = (|x, y| at(image, x, y) - a, |x, y| at(reference, x, y) - b);
            let (c1, c2) = (2.55 * 2.55, 7.65 * 7.65);
            sum += (2.0 * a * b + c1) * (2.0 * moment(&da, &db) + c2)
                / ((a * a + b * b + c1) * (moment(&da, &da) + moment(&db, &db) + c2));
            count += 1.0;
        }
    }
    sum / count
}

#[test]
fn ssim_is_its_definition() {
    for (width, height) in [(11, 11), (12, 11), (11, 30), (40, 23)] {
        let extent = Extent::new(width, height);
        let (image, reference) = pair(extent);
        let ssim = Comparison::new(extent, &image, &reference).unwrap().ssim().unwrap();
        close(ssim, slow_ssim(extent, &image, &reference), 1e-9);
    }
}

#[test]
fn flat_images_have_figures_by_hand() {
    let extent = Extent::new(16, 12);
    let flat = |value: f32| vec![value; 3 * 16 * 12];
    // 0.25^(1/2.2) * 255 = 135.8 and 0.5^(1/2.2) * 255 = 186.1, truncated.
    let (a, b) = (flat(0.25), flat(0.5));
    let comparison = Comparison::new(extent, &a, &b).unwrap();
    close(comparison.psnr(), 20.0 * (255.0f64 / 51.0).log10(), 1e-12);
    let ssim = (2.0 * 135.0 * 186.0 + 6.5025) / (135.0 * 135.0 + 186.0 * 186.0 + 6.5025);
    close(comparison.ssim().unwrap(), ssim, 1e-9);
    close(comparison.rel_mse(), 0.0625 / 0.26, 1e-12);
    close(nmse(&a, &b).unwrap(), 0.25, 1e-12);
    let shown = |v: f64| v.powf(1.0 / 2.2);
    close(comparison.tone_mapped_db(1.0), -20.0 * (shown(0.5) - shown(0.25)).log10(), 1e-9);
    // Both above 1 after exposure: equal on the screen.
    assert_eq!(comparison.tone_mapped_db(8.0), f64::INFINITY);
}

#[test]
fn equal_negative_and_bad_samples() {
    let extent = Extent::new(11, 11);
    let (image, _) = pair(extent);
    let same = Comparison::new(extent, &image, &image).unwrap();
    assert_eq!((same.psnr(), same.rel_mse(), nmse(&image, &image).unwrap()), (f64::INFINITY, 0.0, 0.0));
    close(same.ssim().unwrap(), 1.0, 1e-12);
    // On the screen, negative and NaN samples are black and infinite ones white.
    let black = vec![0.0; image.len()];
    for bad in [-3.0, f32::NAN, f32::NEG_INFINITY] {
        let bad = vec![bad; image.len()];
        assert_eq!(Comparison::new(extent, &bad, &black).unwrap().psnr(), f64::INFINITY);
    }
    let white = vec![f32::INFINITY; image.len()];
    assert_eq!(Comparison::new(extent, &white, &black).unwrap().psnr(), 0.0);
    assert_eq!(nmse(&black, &black).unwrap(), 0.0);
    assert_eq!(nmse(&image, &black).unwrap(), f64::INFINITY);
}

#[test]
fn sizes_are_checked() {
    let small = Extent::new(SSIM_WINDOW as u32, SSIM_WINDOW as u32 - 1);
    let (image, reference) = pair(small);
    let comparison = Comparison::new(small, &image, &reference).unwrap();
    assert_eq!(comparison.ssim(), None);
    assert!(comparison.psnr().is_finite());
    let mismatch = |result| matches!(result, Err(Error::PlaneMismatch { .. }));
    assert!(mismatch(Comparison::new(small, &image[1..], &reference).map(|_| 0.0)));
    assert!(mismatch(Comparison::new(small, &image, &reference[1..]).map(|_| 0.0)));
    assert!(mismatch(nmse(&image, &reference[1..])));
    assert!(matches!(Comparison::new(Extent::new(0, 4), &[], &[]), Err(Error::EmptyFrame { .. })));
}

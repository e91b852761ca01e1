//! What a program that adds the published crate does first: a noisy grey is denoised.

use vkdenoise::{Cache, Denoiser, Device, DeviceOptions, DeviceSelector, Extent, Features, Frame, Layout, Options};
use vkdenoise::{Plane, PlaneMut, Quality};

fn main() -> vkdenoise::Result<()> {
    let options = DeviceOptions {
        selector: DeviceSelector::from_env().unwrap_or_default(),
        cache: Cache::Off,
        ..DeviceOptions::default()
    };
    let device = Device::open_with(&options)?;
    let extent = Extent::new(64, 48);
    let rgb = Layout::interleaved(extent, 3);
    let mut state = 1u32;
    let noisy: Vec<f32> = (0..3 * extent.pixels())
        .map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            0.5 * (state >> 8) as f32 / (1 << 23) as f32
        })
        .collect();
    let error = |samples: &[f32]| samples.iter().map(|s| (s - 0.5).abs()).sum::<f32>() / samples.len() as f32;
    for quality in [Quality::Balanced, Quality::Fast] {
        let options = Options { precision: quality.precision(&device), ..Options::default() };
        let mut denoiser = Denoiser::new(&device, &quality.weights()?, &options)?;
        let frame = Frame { extent, color: Plane::f32(&noisy, rgb), features: Features::default() };
        let mut output = vec![0.0; noisy.len()];
        denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb))?;
        println!("{quality} on {}: mean error {} -> {}", device.info().name, error(&noisy), error(&output));
        assert!(error(&output) < error(&noisy) / 3.0, "it was not denoised");
    }
    Ok(())
}

//! The host path as a caller sees it: sizes, strides, formats, exposure, determinism, and what is refused.

mod common;

use common::compare::assert_same_bits;
use common::device::{assert_no_validation_messages, device};
use common::random::Random;
use half::f16;
use vkdenoise::kernels::stats::STATS_FLOATS;
use vkdenoise::testing::Bench;
use vkdenoise::{
    Arena, Binding, Denoiser, Device, DeviceOptions, DeviceSelector, Error, Exposure, Extent, Features, Frame,
    FrameOptions, Layout, Options, Pass, Plane, PlaneMut, Weights,
};

fn denoiser() -> Denoiser {
    Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap()
}

/// A smooth picture with noise and edges: colour, albedo, normal, depth.
struct Scene {
    extent: Extent,
    color: Vec<f32>,
    albedo: Vec<f32>,
    normal: Vec<f32>,
    depth: Vec<f32>,
}

impl Scene {
    fn new(extent: Extent, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut scene = Self { extent, color: vec![], albedo: vec![], normal: vec![], depth: vec![] };
        for y in 0..extent.height {
            for x in 0..extent.width {
                let wall = if (x / 13 + y / 11) % 2 == 0 { 0.8 } else { 0.2 };
                let light = 0.1 + 2.0 * (x as f32 / extent.width as f32);
                for c in 0..3 {
                    let noise = random.uniform(0.0, 2.0);
                    scene.color.push(wall * light * noise * (1.0 + 0.2 * c as f32));
                    scene.albedo.push(wall);
                    scene.normal.push(if c == 2 { 1.0 } else { 0.0 });
                }
                scene.depth.push(2.0 + y as f32 * 0.1);
            }
        }
        scene
    }

    fn rgb(&self) -> Layout {
        Layout::interleaved(self.extent, 3)
    }

    fn frame(&self) -> Frame<'_> {
        let features = Features {
            albedo: Some(Plane::f32(&self.albedo, self.rgb())),
            normal: Some(Plane::f32(&self.normal, self.rgb())),
            depth: Some(Plane::f32(&self.depth, Layout::interleaved(self.extent, 1))),
            noise: None,
        };
        Frame { extent: self.extent, color: Plane::f32(&self.color, self.rgb()), features }
    }

    fn denoise(&self, denoiser: &mut Denoiser) -> Vec<f32> {
        let mut output = vec![f32::NAN; self.color.len()];
        denoiser.denoise(&self.frame(), PlaneMut::f32(&mut output, self.rgb())).unwrap();
        output
    }
}

#[test]
fn every_size_works_and_results_are_the_same_bits_again() {
    let mut denoiser = denoiser();
    let sizes = [(1, 1), (1, 7), (127, 65), (128, 128), (129, 257)];
    let mut first = Vec::new();
    for (width, height) in sizes {
        let scene = Scene::new(Extent::new(width, height), 7);
        let output = scene.denoise(&mut denoiser);
        assert!(output.iter().all(|v| v.is_finite() && *v >= 0.0), "{width}x{height}");
        assert_same_bits(&scene.denoise(&mut denoiser), &output, "the second time");
        first.push(output);
    }
    // After runs at other sizes, and from another denoiser.
    let scene = Scene::new(Extent::new(127, 65), 7);
    assert_same_bits(&scene.denoise(&mut denoiser), &first[2], "after other sizes");
    assert_same_bits(&scene.denoise(&mut self::denoiser()), &first[2], "from a new denoiser");
    assert_no_validation_messages();
}

#[test]
fn it_denoises() {
    // Constant reference under multiplicative noise: the error must fall to well under half.
    let extent = Extent::new(128, 128);
    let mut random = Random::new(3);
    let color: Vec<f32> = (0..extent.pixels()).flat_map(|_| [0.5 * random.uniform(0.0, 2.0); 3]).collect();
    let rgb = Layout::interleaved(extent, 3);
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features: Features::default() };
    let mut output = vec![0.0; color.len()];
    denoiser().denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
    let error = |values: &[f32]| values.iter().map(|v| f64::from(v - 0.5).powi(2)).sum::<f64>();
    assert!(error(&output) < 0.25 * error(&color), "{} of {}", error(&output), error(&color));
}

#[test]
fn strides_formats_and_in_place_give_the_same() {
    let extent = Extent::new(37, 21);
    let scene = Scene::new(extent, 11);
    let mut denoiser = denoiser();
    let expected = scene.denoise(&mut denoiser);
    let pixels = extent.pixels() as usize;

    // Planar colour, written to rows with a gap; what lies between stays.
    let planar: Vec<f32> =
        (0..3).flat_map(|c| (0..pixels).map(move |p| (p, c))).map(|(p, c)| scene.color[3 * p + c]).collect();
    let gapped = Layout { offset: 3, pixel_stride: 4, row_stride: 4 * 37 + 9, channel_stride: 1 };
    let mut output = vec![-7.0; 3 + (4 * 37 + 9) * 21];
    let frame = Frame { color: Plane::f32(&planar, Layout::planar(extent)), ..scene.frame() };
    denoiser.denoise(&frame, PlaneMut::f32(&mut output, gapped)).unwrap();
    let mut untouched = vec![true; output.len()];
    let mut found = Vec::new();
    for y in 0..21 {
        for x in 0..37 {
            for c in 0..3 {
                let at = 3 + y * (4 * 37 + 9) + 4 * x + c;
                untouched[at] = false;
                found.push(output[at]);
            }
        }
    }
    assert_same_bits(&found, &expected, "planar to gapped");
    assert!(output.iter().zip(untouched).all(|(v, untouched)| !untouched || *v == -7.0));

    let mut in_place = scene.color.clone();
    let report =
        denoiser.denoise_in_place(extent, PlaneMut::f32(&mut in_place, scene.rgb()), &scene.frame().features).unwrap();
    assert_same_bits(&in_place, &expected, "in place");
    assert!(report.exposure > 0.0 && report.device_bytes > 0 && report.total_ms > 0.0);

    let halves: Vec<f16> = scene.color.iter().map(|v| f16::from_f32(*v)).collect();
    let mut half_output = vec![f16::ZERO; halves.len()];
    let frame = Frame { color: Plane::f16(&halves, scene.rgb()), ..scene.frame() };
    denoiser.denoise(&frame, PlaneMut::f16(&mut half_output, scene.rgb())).unwrap();
    for (found, expected) in half_output.iter().zip(&expected) {
        assert!((found.to_f32() - expected).abs() < 0.02 * expected + 1e-3, "{found} for {expected}");
    }
}

#[test]
fn scaled_radiance_gives_the_scaled_picture() {
    let scene = Scene::new(Extent::new(96, 80), 5);
    let mut denoiser = denoiser();
    let expected = scene.denoise(&mut denoiser);
    let rgb = scene.rgb();
    let mut exposures = Vec::new();
    for scale in [1.0f32, 1e-4, 1e4] {
        let color: Vec<f32> = scene.color.iter().map(|v| v * scale).collect();
        let mut output = vec![0.0; color.len()];
        let frame = Frame { color: Plane::f32(&color, rgb), ..scene.frame() };
        let report = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
        exposures.push(report.exposure);
        let key = 0.18 / f64::from(report.exposure) / f64::from(scale);
        for (found, expected) in output.iter().zip(&expected) {
            let (a, b) = (f64::from(*found) / f64::from(scale), f64::from(*expected));
            assert!((a - b).abs() <= 1e-3 * (b + 1e-3 * key), "{a} for {b} at {scale}");
        }
    }
    // A given exposure is used as it is.
    denoiser.set_exposure(Exposure::Fixed(exposures[0])).unwrap();
    assert_same_bits(&scene.denoise(&mut denoiser), &expected, "the exposure that the frame had anyway");
    denoiser.set_exposure(Exposure::Fixed(4.0 * exposures[0])).unwrap();
    assert_ne!(scene.denoise(&mut denoiser), expected);
}

#[test]
fn blend_mixes_the_noisy_colour_in() {
    let scene = Scene::new(Extent::new(40, 24), 9);
    let denoise = |blend| {
        let options = Options { blend, ..Options::default() };
        scene.denoise(&mut Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), &options).unwrap())
    };
    let clean = denoise(0.0);
    for (found, noisy) in denoise(1.0).iter().zip(&scene.color) {
        assert!((found - noisy).abs() <= 1e-5 * noisy + 1e-6, "{found} for {noisy}");
    }
    for ((found, noisy), clean) in denoise(0.25).iter().zip(&scene.color).zip(&clean) {
        let expected = 0.75 * clean + 0.25 * noisy;
        assert!((found - expected).abs() <= 1e-5 * expected + 1e-6, "{found} for {expected}");
    }
}

#[test]
fn bad_pixels_are_mended_and_stay_local() {
    let extent = Extent::new(256, 128);
    let mut scene = Scene::new(extent, 13);
    let mut denoiser = denoiser();
    let clean = scene.denoise(&mut denoiser);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 1e30, f32::MAX] {
        let at = 3 * (60 * 256 + 40);
        let kept = scene.color[at];
        scene.color[at] = bad;
        let output = scene.denoise(&mut denoiser);
        scene.color[at] = kept;
        assert!(output.iter().all(|v| v.is_finite() && *v >= 0.0), "{bad}");
        let far = |i: usize| (i / 3 % 256).abs_diff(40).max((i / 3 / 256).abs_diff(60)) > 64;
        let key = clean.iter().sum::<f32>() / clean.len() as f32;
        for (i, (found, expected)) in output.iter().zip(&clean).enumerate().filter(|(i, _)| far(*i)) {
            assert!((found - expected).abs() <= 0.01 * (expected + 1e-3 * key), "{bad}: {found} for {expected} at {i}");
        }
    }
    // Nothing but bad pixels is still an image.
    scene.color.fill(f32::NAN);
    assert!(scene.denoise(&mut denoiser).iter().all(|v| v.is_finite() && *v >= 0.0));
}

#[test]
fn what_is_refused() {
    let mut denoiser = denoiser();
    let extent = Extent::new(16, 8);
    let scene = Scene::new(extent, 1);
    let mut output = vec![0.5; 3 * 128];
    let mut run = |frame: &Frame, len: usize| denoiser.denoise(frame, PlaneMut::f32(&mut output[..len], scene.rgb()));
    let frame = scene.frame();
    let empty = Frame { extent: Extent::new(0, 8), ..frame };
    assert!(matches!(run(&empty, 384), Err(Error::EmptyFrame { width: 0, height: 8 })));
    let short = Frame { color: Plane::f32(&scene.color[..383], scene.rgb()), ..frame };
    assert!(matches!(run(&short, 384), Err(Error::PlaneMismatch { plane: "colour", .. })));
    let mut features = frame.features;
    features.depth = Some(Plane::f32(&scene.depth[1..], Layout::interleaved(extent, 1)));
    assert!(matches!(run(&Frame { features, ..frame }, 384), Err(Error::PlaneMismatch { plane: "depth", .. })));
    let huge = Layout { row_stride: usize::MAX / 2, ..scene.rgb() };
    let overflowing = Frame { color: Plane::f32(&scene.color, huge), ..frame };
    assert!(matches!(run(&overflowing, 384), Err(Error::PlaneMismatch { plane: "colour", .. })));
    assert!(matches!(run(&frame, 383), Err(Error::PlaneMismatch { plane: "output", .. })));
    assert!(output.iter().all(|v| *v == 0.5), "a refused call wrote");

    assert!(matches!(denoiser.pass(Extent::new(1 << 20, 1)), Err(Error::FrameTooLarge { .. })));
    assert!(matches!(denoiser.pass(Extent::new(60_000, 60_000)), Err(Error::FrameTooLarge { .. })));
    for factor in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let result = denoiser.set_exposure(Exposure::Fixed(factor));
        assert!(matches!(result, Err(Error::InvalidOption { option: "exposure", .. })));
    }
    let options = Options { blend: -0.1, ..Options::default() };
    let result = Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), &options);
    assert!(matches!(result, Err(Error::InvalidOption { option: "blend", .. })));
    assert!(matches!("fp8".parse::<vkdenoise::Precision>(), Err(Error::InvalidOption { option: "precision", .. })));

    let unknown = Device::open(&DeviceSelector::Name("no such device".into()));
    assert!(
        matches!(unknown, Err(Error::UnknownDevice { wanted, available }) if wanted.contains("no such") && !available.is_empty())
    );
    assert!(matches!(Device::open(&DeviceSelector::Index(99)), Err(Error::UnknownDevice { .. })));

    let loader = Some("no/such/libvulkan.so".into());
    let options = DeviceOptions { loader, ..DeviceOptions::default() };
    assert!(matches!(Device::open_with(&options), Err(Error::NoLoader(message)) if message.contains("no/such")));
    // A device without validation: the layer would object before the driver does.
    let plain = Device::open(&DeviceSelector::from_env().unwrap_or_default()).unwrap();
    let mut bench = Bench::new(&plain, Bench::default_target(&plain)).unwrap();
    let refused = bench.buffer("too much", 1 << 46);
    assert!(matches!(refused, Err(Error::OutOfMemory { what, bytes, .. }) if what == "too much" && bytes >= 1 << 46));

    let missing = Weights::from_file("no/such/file.safetensors");
    assert!(missing.is_err_and(|e| Error::from(e).to_string().contains("no/such/file")));
    let garbage = Weights::from_bytes(b"not weights");
    assert!(matches!(garbage.map_err(Error::from), Err(Error::Weights(_))));
}

#[test]
fn memory_returns_when_a_denoiser_goes() {
    // Other tests of this binary allocate at the same time: a device of its own.
    let device = Device::open(&DeviceSelector::from_env().unwrap_or_default()).unwrap();
    assert_eq!(device.memory_bytes(), 0);
    let mut denoiser = Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let weights_only = device.memory_bytes();
    Scene::new(Extent::new(20, 20), 2).denoise(&mut denoiser);
    let small = device.memory_bytes();
    assert!(small > weights_only);
    let pass = denoiser.pass(Extent::new(64, 64)).unwrap();
    assert!(device.memory_bytes() > small);
    drop(pass);
    assert_eq!(device.memory_bytes(), small);
    drop(denoiser);
    assert_eq!(device.memory_bytes(), 0);
}

#[test]
fn threads() {
    fn send_and_sync<T: Send + Sync>() {}
    send_and_sync::<Device>();
    send_and_sync::<Denoiser>();
    send_and_sync::<Pass>();
    send_and_sync::<Arena>();
    send_and_sync::<Binding>();
    send_and_sync::<Weights>();
    send_and_sync::<FrameOptions>();
    send_and_sync::<Error>();
}

/// Known before it is allocated, and refused where a budget says so.
#[test]
fn memory_is_known_and_bounded() {
    let (weights, extent) = (Weights::hybrid_kernels().unwrap(), Extent::new(300, 200));
    let denoiser = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    let needed = denoiser.memory_required(extent).unwrap();
    assert_eq!(needed.staging, 300 * 200 * (40 + 12) + 4 * STATS_FLOATS);
    assert_eq!(needed.pass(), denoiser.pass(extent).unwrap().plan().bytes());
    let (color, rgb) = (vec![0.5; 3 * extent.pixels() as usize], Layout::interleaved(extent, 3));
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features: Features::default() };
    let denoise = |budget| {
        let options = Options { memory_budget: Some(budget), ..Options::default() };
        let mut denoiser = Denoiser::new(device(), &weights, &options).unwrap();
        let mut output = vec![-1.0; color.len()];
        let result = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb));
        (result.map(|_| ()), denoiser.pass(extent).map(|_| ()), output)
    };
    let (denoised, pass, _) = denoise(needed.host());
    assert!(denoised.is_ok() && pass.is_ok());
    // A renderer's pass has no staging.
    assert!(denoise(needed.host() - 1).1.is_ok());
    // A little less costs some work alone (tests/tiles.rs).
    assert!(denoise(needed.host() - 1).0.is_ok());
    let budget = needed.weights + 1000;
    let (refused, _, output) = denoise(budget);
    let words = refused.unwrap_err().to_string();
    for part in [needed.host(), budget] {
        assert!(words.contains(&part.to_string()), "{words}");
    }
    assert!(output.iter().all(|&v| v == -1.0));
    let (_, pass, _) = denoise(needed.pass() - 1);
    assert!(matches!(pass, Err(Error::FrameTooLarge { .. })));
}

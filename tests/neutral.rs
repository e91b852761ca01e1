//! What goes in comes out: frames of holes, lamps, suns and stars through the whole network, on the host and in a
//! renderer. The cases with bounds are in `tools/bench/stress/neutral.rs`, which `tests/stress.rs` runs.

mod common;

use common::compare::assert_same_bits;
use common::device::{assert_no_validation_messages, device};
use common::random::Random;
use common::vulkan::{Renderer, RendererBuffer};
use vkdenoise::kernels::stats::{EXPOSURE, KEY};
use vkdenoise::net::Graph;
use vkdenoise::plan::plan;
use vkdenoise::reference::Reference;
use vkdenoise::target::Target;
use vkdenoise::testing::Bench;
use vkdenoise::{
    BufferAddress, BufferFrame, BufferPlane, Converged, ConvergedMode, Denoiser, Device, DeviceKind, Error, Exposure,
    Extent, Features, Fireflies, Frame, FrameOptions, FrameStatistics, Layout, Options, Plane, PlaneMut, Precision,
    Region, SampleFormat, Weights,
};

const EXTENT: Extent = Extent::new(150, 100);

/// Noise on the right, none on the left, and of everything that a broken or a bright renderer writes something.
fn harsh(seed: u64) -> Vec<f32> {
    let mut random = Random::new(seed);
    let (width, height) = (EXTENT.width as usize, EXTENT.height as usize);
    let mut color = Vec::new();
    for i in 0..3 * width * height {
        let noise = if i / 3 % width < 80 { 1.0 } else { -random.uniform(1e-6, 1.0).ln() };
        color.push((0.2 + 0.001 * (i / 3 / width) as f32) * noise);
    }
    let mut fill = |left: usize, top: usize, side: usize, value: [f32; 3]| {
        for y in top..top + side {
            for x in left..left + side {
                color[3 * (y * width + x)..][..3].copy_from_slice(&value);
            }
        }
    };
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    fill(5, 5, 24, [nan; 3]);
    fill(100, 60, 20, [nan, -0.1, 0.4]);
    fill(40, 10, 5, [inf; 3]);
    fill(60, 20, 6, [1.6e9, 1e9, 3e8]);
    fill(110, 20, 6, [1e6; 3]);
    fill(120, 85, 1, [inf, 1.0, nan]);
    for at in 0..8 {
        fill(5 + 17 * at, 40 + 5 * (at % 3), 1, [500.0, 300.0, 20.0]);
        fill(8 + 17 * at, 75 + 2 * at, 1 + at % 2, [0.1, -0.02, 1e4]);
    }
    fill(20, 90, 2, [1e30; 3]);
    fill(30, 90, 1, [f32::MAX; 3]);
    color
}

fn rgb() -> Layout {
    Layout::interleaved(EXTENT, 3)
}

fn denoise(denoiser: &mut Denoiser, color: &[f32]) -> Vec<f32> {
    let frame = Frame { extent: EXTENT, color: Plane::f32(color, rgb()), features: Features::default() };
    let mut output = vec![-1.0; color.len()];
    denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb())).unwrap();
    output
}

#[test]
fn harsh_frames_are_the_reference_twice() {
    let weights = Weights::hybrid_kernels().unwrap();
    let color = harsh(1);
    let frame = Frame { extent: EXTENT, color: Plane::f32(&color, rgb()), features: Features::default() };
    let plan = plan(&Graph::new(weights.arch()).unwrap(), EXTENT, &Target::default()).unwrap();
    let mut kept = Vec::new();
    for (fireflies, blend) in [(Fireflies::Auto, 0.0), (Fireflies::Keep, 0.25), (Fireflies::Mend, 0.0)] {
        let options = Options { fireflies, blend, ..Options::default() };
        let mut denoiser = Denoiser::new(device(), &weights, &options).unwrap();
        let found = denoise(&mut denoiser, &color);
        assert_same_bits(&denoise(&mut denoiser, &color), &found, "another run");
        let mut reference = Reference::new(&plan, &weights).unwrap();
        reference.set_frame(&frame, None, blend.into()).unwrap();
        reference.set_fireflies(fireflies);
        reference.run();
        let key = reference.buffer(plan.stats)[KEY];
        for (i, (&found, &expected)) in found.iter().zip(reference.output()).enumerate() {
            let (x, y) = (i / 3 % 150, i / 450);
            let error = (f64::from(found) - expected).abs();
            let bound = 2e-4 * (expected + key);
            assert!(error <= bound, "{fireflies:?}: pixel ({x}, {y}) is {found:e}, not {expected:e}");
        }
        kept.push(found);
    }
    // A star where it is clean, one where it is noisy; a lamp in any case.
    let at = |x: usize, y: usize| 3 * (y * 150 + x);
    let (clean, noisy, sun) = (at(22, 45), at(124, 45), at(62, 22));
    assert_eq!([0, 1, 2].map(|i| kept[i][clean] > 400.0), [true, true, false], "a star where it is clean");
    assert_eq!([0, 1, 2].map(|i| kept[i][noisy] > 400.0), [false, true, false], "a firefly where it is noisy");
    assert!(kept.iter().all(|output| (output[sun] / 1.6e9 - 1.0).abs() < 1e-3), "a sun");
    assert_no_validation_messages();
}

/// Maps of halves and matrices of halves: the rules are the same, and the network's rounding all that differs.
#[test]
fn tiers_with_halves_keep_the_rules() {
    let weights = Weights::hybrid_kernels().unwrap();
    let color = harsh(1);
    let run = |precision| {
        let options = Options { precision, ..Options::default() };
        denoise(&mut Denoiser::new(device(), &weights, &options).unwrap(), &color)
    };
    let single = run(Precision::F32);
    let halves = Bench::can_store_halves(device()).then_some(Precision::F16);
    // A CPU driver takes minutes to compile a network on matrices.
    let matrices = device().has_matrices() && device().info().kind != DeviceKind::Cpu;
    for precision in halves.into_iter().chain(matrices.then_some(Precision::Matrix)) {
        let found = run(precision);
        let mut worst = 0.0f32;
        for (i, (found, single)) in found.iter().zip(&single).enumerate() {
            let apart = (found - single).abs() / (single + 0.2);
            assert!(apart <= 0.02, "{precision}: sample {i} is {found:e}, not {single:e}");
            worst = worst.max(apart);
        }
        println!("{precision}: at most {worst:.1e} of value and key from 32-bit floats");
    }
    assert_no_validation_messages();
}

#[test]
fn regions_of_harsh_frames_have_the_bits_of_the_whole() {
    let weights = Weights::hybrid_kernels().unwrap();
    let color = harsh(2);
    let mut random = Random::new(3);
    for converged in [None, Some(Converged { threshold: 0.02, mode: ConvergedMode::Exact })] {
        let options = Options { converged, ..Options::default() };
        let mut denoiser = Denoiser::new(device(), &weights, &options).unwrap();
        let whole = denoise(&mut denoiser, &color);
        assert!(whole.iter().all(|v| v.is_finite() && *v >= 0.0), "{converged:?}");
        for _ in 0..6 {
            let (x, y) = (random.integer(0, 120), random.integer(0, 80));
            let (width, height) = (random.integer(1, 150 - x), random.integer(1, 100 - y));
            let region = Region { x, y, width, height };
            denoiser.set_region(None);
            denoise(&mut denoiser, &harsh(4));
            denoiser.set_region(Some(region));
            for (i, (part, whole)) in denoise(&mut denoiser, &color).iter().zip(&whole).enumerate() {
                let inside = region.contains(i as u32 / 3 % 150, i as u32 / 450);
                // Converged pixels beside what is denoised are blended with it, and outside of a region nothing is.
                if inside && converged.is_none() {
                    assert_eq!(part.to_bits(), whole.to_bits(), "{region:?}: sample {i} is {part}, not {whole}");
                }
                assert!(inside || *part == -1.0, "{region:?}: sample {i} was written");
            }
        }
    }
    assert_no_validation_messages();
}

fn plane(buffer: &RendererBuffer) -> BufferPlane {
    BufferPlane { buffer: buffer.raw, size: buffer.size, format: SampleFormat::F32, layout: rgb() }
}

fn depth_plane(buffer: &RendererBuffer) -> BufferPlane {
    BufferPlane { layout: Layout::interleaved(EXTENT, 1), ..plane(buffer) }
}

/// In the caller's own plane, exposed by a buffer of the caller's, and told what was used.
#[test]
fn a_renderer_gives_the_exposure_and_is_told_it() {
    let renderer = Renderer::new();
    let weights = Weights::hybrid_kernels().unwrap();
    // SAFETY: the handles are the renderer's, which outlives the device.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let denoiser = Denoiser::new(&device, &weights, &Options::default()).unwrap();
    let pass = denoiser.pass(EXTENT).unwrap();
    let (color, depth) = (harsh(5), Random::new(6).values(EXTENT.pixels() as usize, 2.0, 8.0));
    let bytes = 12 * EXTENT.pixels();
    let [input, output] = [bytes; 2].map(|bytes| renderer.buffer(bytes));
    let (depths, numbers) = (renderer.buffer(4 * EXTENT.pixels()), renderer.buffer(64));
    depths.write(bytemuck::cast_slice(&depth));
    let bind = |output: &RendererBuffer, with_depth: bool| {
        let depth = with_depth.then(|| depth_plane(&depths));
        let (color, output) = (plane(&input), plane(output));
        let mut frame = BufferFrame::new(color, output);
        frame.depth = depth;
        // SAFETY: the buffers live to the end of the test.
        unsafe { pass.bind_buffers(&frame) }.unwrap()
    };
    let run = |binding, options: &FrameOptions| {
        input.write(bytemuck::cast_slice(&color));
        let fence = renderer.submit(|commands| {
            // SAFETY: everything bound lives until the fence is waited for.
            unsafe { pass.record(commands, binding, options) }.unwrap();
            renderer.barrier_to_host(commands);
        });
        renderer.wait(fence);
    };
    let floats = |buffer: &RendererBuffer| bytemuck::cast_slice::<u8, f32>(&buffer.read()).to_vec();
    let place = |offset| BufferAddress { buffer: numbers.raw, offset };
    let told = || bytemuck::pod_read_unaligned::<FrameStatistics>(&numbers.read()[16..32]);
    let options = FrameOptions { statistics: Some(place(16)), ..FrameOptions::default() };

    let (apart, in_place) = (bind(&output, false), bind(&input, false));
    run(&apart, &options);
    let expected = floats(&output);
    let own = told();
    assert!((own.exposure * own.key / 0.18 - 1.0).abs() < 1e-6 && own.depth_scale == 0.0, "{own:?}");
    assert!(own.noise > 0.2 && own.noise < 0.6, "{own:?}");
    run(&in_place, &options);
    assert_same_bits(&floats(&input), &expected, "in the colour's place");

    // A number in a buffer is that number.
    run(&apart, &FrameOptions { exposure: Exposure::Fixed(0.4), ..options });
    let fixed = floats(&output);
    assert_eq!(told(), FrameStatistics { exposure: 0.4, ..own });
    numbers.write(bytemuck::cast_slice(&[0.0f32, 0.4, 7.0]));
    let given = FrameOptions { exposure: Exposure::Buffer(place(4)), ..options };
    run(&apart, &given);
    assert_same_bits(&floats(&output), &fixed, "by a buffer");
    // What is no exposure leaves the frame its own.
    for nothing in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        numbers.write(bytemuck::cast_slice(&[0.0f32, nothing]));
        run(&apart, &given);
        assert_same_bits(&floats(&output), &expected, "no exposure");
        assert_eq!(told(), own);
    }
    let all = floats(&numbers);
    assert!(all[2] == 7.0 && all[3] == 0.0 && all[8..].iter().all(|v| *v == 0.0), "{all:?}");

    let with_depth = bind(&output, true);
    run(&with_depth, &options);
    let scale = told().depth_scale;
    assert!((7.9..8.0).contains(&scale), "{scale}");

    renderer.record_only(|commands| {
        for odd in [
            FrameOptions { statistics: Some(place(2)), ..FrameOptions::default() },
            FrameOptions { exposure: Exposure::Buffer(place(6)), ..FrameOptions::default() },
        ] {
            // SAFETY: nothing of it is submitted.
            let refused = unsafe { pass.record(commands, &apart, &odd) };
            assert!(matches!(refused, Err(Error::InvalidOption { option: "statistics" | "exposure", .. })));
        }
    });
    drop((apart, in_place, with_depth, pass, denoiser, device));
    renderer.assert_silent();
}

/// What the host path cannot have, and what it says it used.
#[test]
fn the_host_path_refuses_buffers() {
    let weights = Weights::hybrid_kernels().unwrap();
    let exposure = Exposure::Buffer(BufferAddress { buffer: Default::default(), offset: 0 });
    let options = Options { exposure, ..Options::default() };
    let refused = Denoiser::new(device(), &weights, &options);
    assert!(matches!(refused, Err(Error::InvalidOption { option: "exposure", .. })));
    let mut denoiser = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    assert!(matches!(denoiser.set_exposure(exposure), Err(Error::InvalidOption { option: "exposure", .. })));
    assert!(matches!("all".parse::<Fireflies>(), Err(Error::InvalidOption { option: "fireflies", .. })));
    let color = harsh(7);
    let frame = Frame { extent: EXTENT, color: Plane::f32(&color, rgb()), features: Features::default() };
    let mut output = vec![0.0; color.len()];
    let report = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb())).unwrap();
    let plan = plan(&Graph::new(weights.arch()).unwrap(), EXTENT, &Target::default()).unwrap();
    let mut reference = Reference::new(&plan, &weights).unwrap();
    reference.set_frame(&frame, None, 0.0).unwrap();
    reference.run();
    let expected = reference.buffer(plan.stats)[EXPOSURE];
    assert!((f64::from(report.exposure) / expected - 1.0).abs() < 1e-5, "{} for {expected}", report.exposure);
}

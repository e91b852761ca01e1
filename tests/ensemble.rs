//! The average of a frame's result and of what the frame turned by half a circle gives: the bits of the mean of two
//! runs, whatever goes with a frame, in buffers and images.

mod common;

use common::case::{small, small_hybrid};
use common::compare::{assert_same_bits, nmse};
use common::device::{assert_no_validation_messages, device};
use common::image::RendererImage;
use common::random::Random;
use common::vulkan::Renderer;
use std::ops::ControlFlow;
use std::sync::LazyLock;
use vkdenoise::kernels::Call;
use vkdenoise::net::{Arch, Head};
use vkdenoise::reference::Reference;
use vkdenoise::testing::{Bench, cut_into_tiles, overwrite_memory};
use vkdenoise::{
    BufferFrame, BufferPlane, BufferSignal, Converged, ConvergedMode, Denoiser, Device, Error, Extent, Features, Frame,
    FrameOptions, FrameStatistics, ImageFormat, ImageFrame, Layout, Options, Plane, PlaneMut, Precision, Progress,
    Region, SampleFormat, Signal, SignalKind, Weights, WeightsError,
};

/// No multiple of a tile, so that these lie elsewhere in the turned frame.
const EXTENT: Extent = Extent::new(70, 45);
const PIXELS: usize = 70 * 45;
const UNTOUCHED: f32 = -7.0;

fn ensemble() -> Options {
    Options { self_ensemble: true, signals: true, ..Options::default() }
}

/// One network for both frames, and one for each.
static ONE: LazyLock<Weights> = LazyLock::new(|| small_hybrid(Head::gloss()));
static TWO: LazyLock<Weights> = LazyLock::new(|| {
    let other = Arch { head: Head::gloss(), ..Arch::expanded_patch() };
    ONE.clone().averaged_with(small(other, 5)).unwrap()
});

fn denoiser(weights: &Weights, options: &Options) -> Denoiser {
    Denoiser::new(device(), weights, options).unwrap()
}

/// Of the frame and of the turned frame alone.
fn alone(weights: &Weights, options: &Options) -> [Denoiser; 2] {
    let options = Options { self_ensemble: false, ..*options };
    [weights, weights.turned().unwrap_or(weights)].map(|weights| denoiser(weights, &options))
}

/// Planes of a frame and of what goes with it, interleaved.
#[derive(Clone)]
struct Picture {
    color: Vec<f32>,
    albedo: Vec<f32>,
    normal: Vec<f32>,
    depth: Vec<f32>,
    light: Vec<f32>,
    alpha: Vec<f32>,
}

impl Picture {
    /// Noise on the right, a flat wall on the left, a lamp and samples that are not finite.
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let mut color = random.values(3 * PIXELS, 0.05, 2.0);
        for (i, sample) in color.iter_mut().enumerate() {
            if i / 3 % 70 < 32 {
                *sample = 0.5;
            }
        }
        let light = color.iter().map(|sample| 0.25 * sample).collect();
        color[3 * 1000..3 * 1003].fill(1e6);
        color[600] = f32::NAN;
        color[3 * 2000..3 * 2004].fill(f32::INFINITY);
        Self {
            color,
            albedo: random.values(3 * PIXELS, 0.0, 1.0),
            normal: random.values(3 * PIXELS, -1.0, 1.0),
            depth: random.values(PIXELS, 1.0, 9.0),
            light,
            alpha: random.values(PIXELS, 0.0, 1.0),
        }
    }

    fn turned(&self) -> Self {
        let [color, albedo, normal, light] = [&self.color, &self.albedo, &self.normal, &self.light].map(|p| turn(p, 3));
        Self { color, albedo, normal, light, depth: turn(&self.depth, 1), alpha: turn(&self.alpha, 1) }
    }

    fn frame(&self) -> Frame<'_> {
        let (rgb, one) = (Layout::interleaved(EXTENT, 3), Layout::interleaved(EXTENT, 1));
        let features = Features {
            albedo: Some(Plane::f32(&self.albedo, rgb)),
            normal: Some(Plane::f32(&self.normal, rgb)),
            depth: Some(Plane::f32(&self.depth, one)),
            noise: None,
        };
        Frame { extent: EXTENT, color: Plane::f32(&self.color, rgb), features }
    }
}

/// A plane turned by half a circle.
fn turn(plane: &[f32], channels: usize) -> Vec<f32> {
    plane.chunks_exact(channels).rev().flatten().copied().collect()
}

/// Colour, a part of the light, alpha.
type Results = [Vec<f32>; 3];
const CHANNELS: [usize; 3] = [3, 3, 1];

fn denoise(denoiser: &mut Denoiser, picture: &Picture, progress: Option<&mut Progress>) -> Results {
    let (rgb, one) = (Layout::interleaved(EXTENT, 3), Layout::interleaved(EXTENT, 1));
    let mut results = CHANNELS.map(|channels| vec![UNTOUCHED; channels * PIXELS]);
    let [color, light, alpha] = &mut results;
    let mut signals = [
        Signal {
            kind: SignalKind::Light,
            channels: 3,
            plane: Plane::f32(&picture.light, rgb),
            output: PlaneMut::f32(light, rgb),
        },
        Signal {
            kind: SignalKind::Alpha,
            channels: 1,
            plane: Plane::f32(&picture.alpha, one),
            output: PlaneMut::f32(alpha, one),
        },
    ];
    denoiser.denoise_with(&picture.frame(), PlaneMut::f32(color, rgb), &mut signals, progress).unwrap();
    results
}

/// The mean of what the frame and the turned frame give by themselves.
fn mean(weights: &Weights, options: &Options, picture: &Picture) -> Results {
    let [mut own, mut other] = alone(weights, options);
    let upright = denoise(&mut own, picture, None);
    let turned = denoise(&mut other, &picture.turned(), None);
    let mut means = upright;
    for ((mean, turned), channels) in means.iter_mut().zip(&turned).zip(CHANNELS) {
        let turned = turn(turned, channels);
        mean.iter_mut().zip(turned).for_each(|(mean, turned)| *mean = 0.5 * *mean + 0.5 * turned);
    }
    means
}

fn assert_same(found: &Results, expected: &Results, what: &str) {
    for ((found, expected), name) in found.iter().zip(expected).zip(["colour", "light", "alpha"]) {
        assert_same_bits(found, expected, &format!("{what}, {name}"));
    }
}

#[test]
fn it_is_the_mean_of_two_runs() {
    let picture = Picture::new(1);
    let converged = Some(Converged { threshold: 0.05, mode: ConvergedMode::default() });
    let mut cases = vec![("floats", ensemble()), ("converged squares", Options { converged, ..ensemble() })];
    if Bench::can_store_halves(device()) {
        cases.push(("halves, blended", Options { precision: Precision::F16, blend: 0.25, ..ensemble() }));
    }
    for ((what, options), weights) in cases.into_iter().flat_map(|case| [(case, &*ONE), (case, &*TWO)]) {
        let what = &format!("{what}, {}", if weights.turned().is_some() { "two networks" } else { "one" });
        let expected = mean(weights, &options, &picture);
        let mut denoiser = denoiser(weights, &options);
        assert_same(&denoise(&mut denoiser, &picture, None), &expected, what);
        // Again, with what is left of the last run in memory.
        assert_same(&denoise(&mut denoiser, &picture, None), &expected, what);
        let mut told = Vec::new();
        let watched = denoise(
            &mut denoiser,
            &picture,
            Some(&mut |done| {
                told.push(done);
                ControlFlow::Continue(())
            }),
        );
        assert_same(&watched, &expected, what);
        assert!(told.is_sorted() && told.len() > 3 && told.last() == Some(&1.0), "{told:?}");

        let region = Region { x: 37, y: 3, width: 20, height: 9 };
        denoiser.set_region(Some(region));
        // What memory still holds of the whole must not stand in for what the region fails to compute.
        overwrite_memory(&mut denoiser, EXTENT).unwrap();
        for ((found, expected), channels) in denoise(&mut denoiser, &picture, None).iter().zip(&expected).zip(CHANNELS)
        {
            for (i, (found, expected)) in found.iter().zip(expected).enumerate() {
                let (x, y) = ((i / channels % 70) as u32, (i / channels / 70) as u32);
                let inside = (37..57).contains(&x) && (3..12).contains(&y);
                // Converged squares next to a region are those of the region (docs/skip.md).
                if inside && options.converged.is_none() {
                    assert_eq!(found.to_bits(), expected.to_bits(), "{what}, ({x}, {y})");
                }
                assert!(inside || *found == UNTOUCHED, "{what}, ({x}, {y}) was written");
            }
        }
    }
    assert_no_validation_messages();
}

/// In one piece, and in five bands to the picture.
#[test]
fn a_frame_of_colour_alone() {
    for (extent, max_chain_bytes, weights) in
        [(EXTENT, None, &ONE), (Extent::new(70, 517), Some(1 << 14), &ONE), (Extent::new(70, 517), Some(1 << 14), &TWO)]
    {
        let color = Random::new(2).values(3 * extent.pixels() as usize, 0.0, 2.0);
        let rgb = Layout::interleaved(extent, 3);
        let run = |denoiser: &mut Denoiser, color: &[f32]| {
            let frame = Frame { extent, color: Plane::f32(color, rgb), features: Features::default() };
            let mut output = vec![UNTOUCHED; color.len()];
            denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
            output
        };
        let options = Options { max_chain_bytes, ..Options::default() };
        let [mut own, mut other] = alone(weights, &options);
        let turned = turn(&run(&mut other, &turn(&color, 3)), 3);
        let expected: Vec<f32> = run(&mut own, &color).iter().zip(turned).map(|(a, b)| 0.5 * a + 0.5 * b).collect();
        let mut averaging = denoiser(weights, &Options { self_ensemble: true, ..options });
        assert_same_bits(&run(&mut averaging, &color), &expected, &format!("{extent:?}"));
        let pass = averaging.pass(extent).unwrap();
        let outputs = pass.plan().dispatches.iter().filter(|dispatch| matches!(dispatch.call, Call::Output(_)));
        assert_eq!(outputs.count(), if max_chain_bytes.is_some() { 10 } else { 2 });
    }
}

#[test]
fn the_f64_twin_agrees() {
    [&*ONE, &*TWO].into_iter().for_each(agrees_with_its_twin);
}

fn agrees_with_its_twin(weights: &Weights) {
    let picture = Picture::new(3);
    let mut denoiser = denoiser(weights, &ensemble());
    let [color, light, _] = denoise(&mut denoiser, &picture, None);
    let pass = denoiser.pass(EXTENT).unwrap();
    let mut reference = Reference::new(pass.plan(), weights).unwrap();
    let plane = Plane::f32(&picture.light, Layout::interleaved(EXTENT, 3));
    reference.set_signal(SignalKind::Light, 3, &plane).unwrap();
    reference.set_frame(&picture.frame(), None, 0.0).unwrap();
    reference.run();
    // By the logarithm, as the lamps must not hide the rest; infinite ones are themselves in both.
    let log = |value: f64| value.min(1e9).ln_1p();
    for (found, expected) in [(color, reference.output()), (light, reference.signal())] {
        let found: Vec<f32> = found.iter().map(|&value| log(f64::from(value)) as f32).collect();
        let expected: Vec<f64> = expected.iter().map(|&value| log(value)).collect();
        let error = nmse(&found, &expected);
        assert!(error <= 1e-9, "NMSE {error:.1e}");
    }
}

/// In its own place, with a signal in its own place, and what is told of the frame.
#[test]
fn in_a_renderers_buffers() {
    let renderer = Renderer::new();
    // SAFETY: the renderer outlives it.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let denoiser = Denoiser::new(&device, &TWO, &ensemble()).unwrap();
    let pass = denoiser.pass(EXTENT).unwrap();
    let picture = Picture::new(4);
    let filled = |samples: &[f32]| {
        let buffer = renderer.buffer(4 * samples.len() as u64);
        buffer.write(bytemuck::cast_slice(samples));
        buffer
    };
    let told = renderer.buffer(size_of::<FrameStatistics>() as u64);
    let buffers = [&picture.color, &picture.albedo, &picture.normal, &picture.depth, &picture.light, &picture.alpha]
        .map(|samples| filled(samples));
    let plane = |at: usize, channels: usize| BufferPlane {
        buffer: buffers[at].raw,
        size: buffers[at].size,
        format: SampleFormat::F32,
        layout: Layout::interleaved(EXTENT, channels),
    };
    let mut frame = BufferFrame::new(plane(0, 3), plane(0, 3));
    frame.albedo = Some(plane(1, 3));
    frame.normal = Some(plane(2, 3));
    frame.depth = Some(plane(3, 1));
    let signal = |kind, channels: u32, at| BufferSignal {
        kind,
        channels,
        plane: plane(at, channels as usize),
        output: plane(at, channels as usize),
    };
    let signals = [signal(SignalKind::Light, 3, 4), signal(SignalKind::Alpha, 1, 5)];
    // SAFETY: the buffers live to the end of the test.
    let binding = unsafe { pass.bind_buffers_with(&frame, &signals) }.unwrap();
    let statistics = Some(vkdenoise::BufferAddress { buffer: told.raw, offset: 0 });
    let fence = renderer.submit(|commands| {
        let options = FrameOptions { statistics, ..FrameOptions::default() };
        // SAFETY: everything bound lives until the fence is waited for.
        unsafe { pass.record(commands, &binding, &options) }.unwrap();
        renderer.barrier_to_host(commands);
    });
    renderer.wait(fence);
    let found = [0, 4, 5].map(|at: usize| bytemuck::cast_slice::<u8, f32>(&buffers[at].read()).to_vec());
    assert_same(&found, &mean(&TWO, &ensemble(), &picture), "in a renderer's buffers");
    let told: FrameStatistics = *bytemuck::from_bytes(&told.read());
    let mut host = self::denoiser(&TWO, &ensemble());
    let mut output = vec![0.0; 3 * PIXELS];
    let plane = PlaneMut::f32(&mut output, Layout::interleaved(EXTENT, 3));
    assert_eq!(told.exposure, host.denoise(&picture.frame(), plane).unwrap().exposure);
    drop((binding, pass, denoiser, device));
    renderer.assert_silent();
}

#[test]
fn in_a_renderers_images() {
    let renderer = Renderer::new();
    // SAFETY: the renderer outlives it.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let denoiser = Denoiser::new(&device, &ONE, &ensemble()).unwrap();
    let pass = denoiser.pass(EXTENT).unwrap();
    let picture = Picture::new(5);
    let image =
        |values: &[f32], channels| RendererImage::new(&renderer, EXTENT, ImageFormat::Rgba32F, values, channels);
    let (color, albedo) = (image(&picture.color, 3), image(&picture.albedo, 3));
    let (normal, output) = (image(&picture.normal, 3), image(&[], 3));
    let depth = RendererImage::new(&renderer, EXTENT, ImageFormat::R32F, &picture.depth, 1);
    let mut frame = ImageFrame::new(color.plane(), output.plane());
    frame.albedo = Some(albedo.plane());
    frame.normal = Some(normal.plane());
    frame.depth = Some(depth.plane());
    // SAFETY: the images live to the end of the test.
    let binding = unsafe { pass.bind_images(&frame) }.unwrap();
    let fence = renderer.submit(|commands| {
        // SAFETY: as above; the fence is waited for.
        unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
    });
    renderer.wait(fence);
    assert_same_bits(&output.read_rgb(), &mean(&ONE, &ensemble(), &picture)[0], "in a renderer's images");
    drop((binding, pass, denoiser, device));
    renderer.assert_silent();
}

#[test]
fn what_it_takes() {
    let averaging = Options { signals: false, ..ensemble() };
    let (once, twice) = (denoiser(&ONE, &Options::default()), denoiser(&ONE, &averaging));
    let required = |denoiser: &Denoiser| denoiser.memory_required(EXTENT).unwrap();
    let more = required(&twice).pass() - required(&once).pass();
    assert!((12 * PIXELS as u64..12 * PIXELS as u64 + 1024).contains(&more), "{more} bytes more");
    let flops = |denoiser: &Denoiser| {
        let pass = denoiser.pass(EXTENT).unwrap();
        pass.plan().dispatches.iter().map(|dispatch| dispatch.flops).sum::<u64>()
    };
    assert_eq!(flops(&twice), 2 * flops(&once));

    // Of two networks the weights of both, and the memory of the larger one; without an ensemble one of them.
    let [own, other] = alone(&TWO, &averaging);
    let both = denoiser(&TWO, &averaging);
    assert_eq!(flops(&both), flops(&own) + flops(&other));
    assert_eq!(both.device_bytes(), own.device_bytes() + other.device_bytes());
    let larger = required(&own).arena.max(required(&other).arena);
    let more = required(&both).arena.abs_diff(larger);
    assert!(more <= 12 * PIXELS as u64 + 1024, "{more} bytes from {larger}");
    let unused = denoiser(&TWO, &Options::default());
    assert_eq!((flops(&unused), unused.device_bytes()), (flops(&own), own.device_bytes()));

    let refused = Denoiser::new(device(), &ONE, &Options { keep_features: true, ..ensemble() });
    assert!(matches!(refused, Err(Error::InvalidOption { option: "self_ensemble", .. })), "{refused:?}");
    // Signals ask for kernels of every network that is used.
    let with_residual = ONE.clone().averaged_with(small(Arch::expanded_patch(), 6)).unwrap();
    let refused = Denoiser::new(device(), &with_residual, &ensemble());
    assert!(matches!(refused, Err(Error::InvalidOption { option: "signals", .. })), "{refused:?}");
    denoiser(&with_residual, &averaging);
    denoiser(&with_residual, &Options { self_ensemble: false, ..ensemble() });
    let refused = ONE.clone().averaged_with(TWO.clone());
    assert!(matches!(refused, Err(WeightsError::Ensemble(_))), "{refused:?}");
}

/// A frame in tiles is denoised once.
#[test]
fn frames_in_tiles() {
    let extent = Extent::new(640, 100);
    let color = Random::new(6).values(3 * extent.pixels() as usize, 0.0, 2.0);
    let rgb = Layout::interleaved(extent, 3);
    let run = |options: &Options| {
        let mut denoiser = denoiser(&TWO, options);
        cut_into_tiles(&mut denoiser, extent, [384, 128], 128).unwrap();
        let frame = Frame { extent, color: Plane::f32(&color, rgb), features: Features::default() };
        let mut output = vec![UNTOUCHED; color.len()];
        denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
        output
    };
    let expected = run(&Options::default());
    assert_same_bits(&run(&Options { signals: false, ..ensemble() }), &expected, "in tiles");
}

//! Signals in a renderer's command buffer: beside buffers and beside images, of floats and of halves, in their own
//! place, and refusals.

mod common;

use common::compare::assert_same_bits;
use common::image::RendererImage;
use common::random::Random;
use common::vulkan::{Renderer, RendererBuffer};
use half::f16;
use vkdenoise::{
    BufferFrame, BufferPlane, BufferSignal, Denoiser, Device, Error, Extent, Features, Frame, FrameOptions,
    ImageFormat, ImageFrame, Layout, Options, Plane, PlaneMut, SampleFormat, Signal, SignalKind, Weights,
};

const EXTENT: Extent = Extent::new(70, 45);
const PIXELS: usize = 70 * 45;

fn options() -> Options {
    Options { signals: true, ..Options::default() }
}

fn denoiser(renderer: &Renderer, options: &Options) -> Denoiser {
    // SAFETY: the handles are the renderer's, which the caller keeps alive.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), options).unwrap()
}

/// Samples that halves hold too.
fn samples(seed: u64, count: usize) -> Vec<f32> {
    Random::new(seed).values(count, 0.0, 2.0).into_iter().map(|value| f16::from_f32(value).to_f32()).collect()
}

/// Kind, channels and samples of a signal.
type Given = (SignalKind, u32, Vec<f32>);

/// A colour, and the signals: a part of the light, a value, coverage.
fn scene() -> (Vec<f32>, [Given; 3]) {
    let coverage = samples(3, PIXELS).into_iter().map(|value| value / 2.0).collect();
    let signals = [
        (SignalKind::Light, 3, samples(2, 3 * PIXELS)),
        (SignalKind::Alpha, 1, coverage),
        (SignalKind::Value, 3, samples(4, 3 * PIXELS)),
    ];
    (samples(1, 3 * PIXELS), signals)
}

/// What the host path makes of the signals.
fn on_host() -> Vec<Vec<f32>> {
    let (color, signals) = scene();
    let weights = Weights::hybrid_kernels().unwrap();
    let mut denoiser = Denoiser::new(common::device::device(), &weights, &options()).unwrap();
    let rgb = Layout::interleaved(EXTENT, 3);
    let frame = Frame { extent: EXTENT, color: Plane::f32(&color, rgb), features: Features::default() };
    let mut denoised = vec![0.0; color.len()];
    let mut outputs: Vec<Vec<f32>> = signals.iter().map(|(.., samples)| vec![0.0; samples.len()]).collect();
    let mut given: Vec<Signal> = signals
        .iter()
        .zip(&mut outputs)
        .map(|((kind, channels, samples), output)| {
            let layout = Layout::interleaved(EXTENT, *channels as usize);
            let (plane, output) = (Plane::f32(samples, layout), PlaneMut::f32(output, layout));
            Signal { kind: *kind, channels: *channels, plane, output }
        })
        .collect();
    denoiser.denoise_with(&frame, PlaneMut::f32(&mut denoised, rgb), &mut given, None).unwrap();
    outputs
}

fn plane(buffer: &RendererBuffer, format: SampleFormat, channels: u32) -> BufferPlane {
    let layout = Layout { offset: 1, ..Layout::interleaved(EXTENT, channels as usize) };
    BufferPlane { buffer: buffer.raw, size: buffer.size, format, layout }
}

/// Samples of a format behind one that belongs to nobody.
fn bytes(format: SampleFormat, samples: &[f32]) -> Vec<u8> {
    let samples = std::iter::once(&9.0).chain(samples);
    match format {
        SampleFormat::F32 => samples.flat_map(|sample| sample.to_ne_bytes()).collect(),
        _ => samples.flat_map(|sample| f16::from_f32(*sample).to_ne_bytes()).collect(),
    }
}

fn floats(format: SampleFormat, bytes: &[u8]) -> Vec<f32> {
    match format {
        SampleFormat::F32 => bytes.chunks_exact(4).map(|b| f32::from_ne_bytes([b[0], b[1], b[2], b[3]])).collect(),
        _ => bytes.chunks_exact(2).map(|b| f16::from_ne_bytes([b[0], b[1]]).to_f32()).collect(),
    }
}

fn filled(renderer: &Renderer, format: SampleFormat, samples: &[f32]) -> RendererBuffer {
    let bytes = bytes(format, samples);
    let buffer = renderer.buffer(bytes.len() as u64);
    buffer.write(&bytes);
    buffer
}

fn assert_near(format: SampleFormat, found: &[f32], expected: &[f32], what: &str) {
    if format == SampleFormat::F32 {
        return assert_same_bits(found, expected, what);
    }
    for (found, expected) in found.iter().zip(expected) {
        assert!((found - expected).abs() <= expected.abs() * 1e-3 + 1e-6, "{what}: {found} for {expected}");
    }
}

/// Each in its own place, two recordings of a frame, beside colour that is denoised in its place too.
#[test]
fn signals_in_buffers() {
    let renderer = Renderer::new();
    let denoiser = denoiser(&renderer, &options());
    let pass = denoiser.pass(EXTENT).unwrap();
    let (color, signals) = scene();
    let expected = on_host();
    for format in [SampleFormat::F32, SampleFormat::F16] {
        if format == SampleFormat::F16 && !renderer.storage16 {
            println!("not tested: the device cannot store halves");
            continue;
        }
        let color = filled(&renderer, format, &color);
        let buffers: Vec<_> = signals.iter().map(|(.., samples)| filled(&renderer, format, samples)).collect();
        let own = plane(&color, format, 3);
        let frame = BufferFrame::new(own, own);
        let given: Vec<BufferSignal> = signals
            .iter()
            .zip(&buffers)
            .map(|((kind, channels, _), buffer)| {
                let plane = plane(buffer, format, *channels);
                BufferSignal { kind: *kind, channels: *channels, plane, output: plane }
            })
            .collect();
        // SAFETY: the buffers live to the end of the loop.
        let binding = unsafe { pass.bind_buffers_with(&frame, &given) }.unwrap();
        let fence = renderer.submit(|commands| {
            // SAFETY: as above; the fence is waited for.
            unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
            renderer.barrier_to_host(commands);
        });
        renderer.wait(fence);
        for (i, (buffer, expected)) in buffers.iter().zip(&expected).enumerate() {
            let found = floats(format, &buffer.read());
            assert_eq!(found[0], 9.0, "written before the first sample");
            assert_near(format, &found[1..=expected.len()], expected, &format!("signal {i} of {format:?}"));
        }
        drop(binding);
    }
    drop((pass, denoiser));
    renderer.assert_silent();
}

#[test]
fn signals_beside_images() {
    let renderer = Renderer::new();
    let denoiser = denoiser(&renderer, &options());
    let pass = denoiser.pass(EXTENT).unwrap();
    let (color, signals) = scene();
    let color = RendererImage::new(&renderer, EXTENT, ImageFormat::Rgba32F, &color, 3);
    let output = RendererImage::new(&renderer, EXTENT, ImageFormat::Rgba32F, &[], 3);
    let (albedo, normal, depth, noise) = (None, None, None, None);
    let mut frame = ImageFrame::new(color.plane(), output.plane());
    frame.albedo = albedo;
    frame.normal = normal;
    frame.depth = depth;
    frame.noise = noise;
    let buffers: Vec<_> = signals.iter().map(|(.., samples)| filled(&renderer, SampleFormat::F32, samples)).collect();
    let results: Vec<_> = signals.iter().map(|(.., s)| renderer.buffer(4 * (s.len() as u64 + 1))).collect();
    let given: Vec<BufferSignal> = signals
        .iter()
        .zip(buffers.iter().zip(&results))
        .map(|((kind, channels, _), (buffer, result))| {
            let [plane, output] = [buffer, result].map(|buffer| plane(buffer, SampleFormat::F32, *channels));
            BufferSignal { kind: *kind, channels: *channels, plane, output }
        })
        .collect();
    // SAFETY: images and buffers live to the end of the test.
    let binding = unsafe { pass.bind_images_with(&frame, &given) }.unwrap();
    for _ in 0..2 {
        let fence = renderer.submit(|commands| {
            // SAFETY: as above; the fence is waited for.
            unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
            renderer.barrier_to_host(commands);
        });
        renderer.wait(fence);
        for (i, (result, expected)) in results.iter().zip(&on_host()).enumerate() {
            assert_same_bits(&floats(SampleFormat::F32, &result.read())[1..], expected, &format!("signal {i}"));
        }
    }
    drop((binding, pass, denoiser));
    renderer.assert_silent();
}

#[test]
fn signals_that_do_not_fit_are_refused() {
    let renderer = Renderer::new();
    let with = denoiser(&renderer, &options());
    let without = denoiser(&renderer, &Options::default());
    let buffer = renderer.buffer(12 * EXTENT.pixels() + 4);
    let color = plane(&buffer, SampleFormat::F32, 3);
    let frame = BufferFrame::new(color, color);
    let good = BufferSignal { kind: SignalKind::Light, channels: 3, plane: color, output: color };
    let bind = |denoiser: &Denoiser, signal: BufferSignal| {
        let pass = denoiser.pass(EXTENT).unwrap();
        // SAFETY: the buffer lives to the end of the test.
        unsafe { pass.bind_buffers_with(&frame, &[signal]) }.map(drop)
    };
    bind(&with, good).unwrap();
    assert!(matches!(bind(&without, good), Err(Error::InvalidOption { option: "signals", .. })));
    let one = BufferSignal { channels: 1, ..good };
    assert!(matches!(bind(&with, one), Err(Error::InvalidOption { option: "signal", .. })));
    let mut beyond = good;
    beyond.plane.layout.offset += 1;
    assert!(matches!(bind(&with, beyond), Err(Error::PlaneMismatch { plane: "signal", .. })));
    let mut halves = good;
    halves.output.format = SampleFormat::F16;
    assert!(matches!(bind(&with, halves), Err(Error::Binding(message)) if message.contains("type")));
    drop((with, without));
    renderer.assert_silent();
}

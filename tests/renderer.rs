//! Plays a renderer: a device, buffers and images of its own, the denoiser's pass inside its command buffers, two
//! frames in flight. What comes out must be the host path's bits.

mod common;

use ash::vk;
use common::image::RendererImage;
use common::vulkan::{Renderer, RendererBuffer};
use half::f16;
use vkdenoise::{
    BufferFrame, BufferPlane, Denoiser, Device, Error, Extent, Features, Frame, FrameOptions, ImageFormat, ImageFrame,
    Layout, Options, Plane, PlaneMut, SampleFormat, Weights,
};

const EXTENT: Extent = Extent::new(70, 45);

struct Picture {
    color: Vec<f32>,
    albedo: Vec<f32>,
    normal: Vec<f32>,
    depth: Vec<f32>,
}

/// Half-representable values, so that f16 and f32 planes hold the same.
fn picture(seed: u32) -> Picture {
    let pixels = EXTENT.pixels() as usize;
    let value = |i: usize, salt: u32| {
        let hash = (i as u32 ^ seed.wrapping_mul(0x9e37_79b9) ^ salt).wrapping_mul(2_654_435_761);
        f16::from_f32((hash >> 16) as f32 / 65536.0).to_f32()
    };
    Picture {
        color: (0..3 * pixels).map(|i| value(i, 1) * 2.0).collect(),
        albedo: (0..3 * pixels).map(|i| value(i / 30, 2)).collect(),
        normal: (0..3 * pixels).map(|i| value(i / 9, 3) * 2.0 - 1.0).collect(),
        depth: (0..pixels).map(|i| 1.0 + value(i / 50, 4)).collect(),
    }
}

fn on_host(picture: &Picture) -> Vec<f32> {
    let weights = Weights::hybrid_kernels().unwrap();
    let mut denoiser = Denoiser::new(common::device::device(), &weights, &Options::default()).unwrap();
    let rgb = Layout::interleaved(EXTENT, 3);
    let frame = Frame {
        extent: EXTENT,
        color: Plane::f32(&picture.color, rgb),
        features: Features {
            albedo: Some(Plane::f32(&picture.albedo, rgb)),
            normal: Some(Plane::f32(&picture.normal, rgb)),
            depth: Some(Plane::f32(&picture.depth, Layout::interleaved(EXTENT, 1))),
            noise: None,
        },
    };
    let mut output = vec![0.0; picture.color.len()];
    denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
    output
}

fn denoiser(renderer: &Renderer) -> Denoiser {
    // SAFETY: the handles are the renderer's, which the caller keeps alive.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap()
}

fn plane(buffer: &RendererBuffer, offset: usize, channels: usize) -> BufferPlane {
    let layout = Layout { offset, ..Layout::interleaved(EXTENT, channels) };
    BufferPlane { buffer: buffer.raw, size: buffer.size, format: SampleFormat::F32, layout }
}

#[test]
fn two_frames_in_flight_in_the_renderers_buffers() {
    let renderer = Renderer::new();
    let denoiser = denoiser(&renderer);
    let pass = denoiser.pass(EXTENT).unwrap();
    let pictures = [picture(1), picture(2)];
    let pixels = EXTENT.pixels() as usize;
    let mut frames = Vec::new();
    for picture in &pictures {
        // All planes in one buffer, the output in another behind an odd offset.
        let input = renderer.buffer(40 * EXTENT.pixels());
        let output = renderer.buffer(12 * EXTENT.pixels() + 20);
        let all: Vec<f32> =
            [&picture.color, &picture.albedo, &picture.normal, &picture.depth].into_iter().flatten().copied().collect();
        input.write(bytemuck::cast_slice(&all));
        let mut frame = BufferFrame::new(plane(&input, 0, 3), plane(&output, 5, 3));
        frame.albedo = Some(plane(&input, 3 * pixels, 3));
        frame.normal = Some(plane(&input, 6 * pixels, 3));
        frame.depth = Some(plane(&input, 9 * pixels, 1));
        // SAFETY: the buffers live to the end of the test.
        let binding = unsafe { pass.bind_buffers(&frame) }.unwrap();
        frames.push((binding, input, output));
    }
    // Both are submitted before either is waited for: they share the pass's arena.
    let fences: Vec<_> = frames
        .iter()
        .map(|(binding, ..)| {
            renderer.submit(|commands| {
                // SAFETY: everything bound lives until the fences are waited for.
                unsafe { pass.record(commands, binding, &FrameOptions::default()) }.unwrap();
                renderer.barrier_to_host(commands);
            })
        })
        .collect();
    fences.into_iter().for_each(|fence| renderer.wait(fence));
    for ((_, _, output), picture) in frames.iter().zip(&pictures) {
        let bytes = output.read();
        let found: &[f32] = bytemuck::cast_slice(&bytes[20..]);
        assert!(bytes[..20].iter().all(|b| *b == 0), "written before the output's first sample");
        common::compare::assert_same_bits(found, &on_host(picture), "buffers");
    }
    drop(frames);
    drop(pass);
    drop(denoiser);
    renderer.assert_silent();
}

#[test]
fn the_renderers_images() {
    let renderer = Renderer::new();
    let denoiser = denoiser(&renderer);
    let pass = denoiser.pass(EXTENT).unwrap();
    let picture = picture(3);
    let expected = on_host(&picture);
    for format in [ImageFormat::Rgba32F, ImageFormat::Rgba16F] {
        let image = |values: &[f32], channels, format| RendererImage::new(&renderer, EXTENT, format, values, channels);
        let color = image(&picture.color, 3, format);
        let albedo = image(&picture.albedo, 3, format);
        let normal = image(&picture.normal, 3, format);
        let depth = image(&picture.depth, 1, ImageFormat::R32F);
        let output = image(&[], 3, format);
        let mut frame = ImageFrame::new(color.plane(), output.plane());
        frame.albedo = Some(albedo.plane());
        frame.normal = Some(normal.plane());
        frame.depth = Some(depth.plane());
        // SAFETY: the images live to the end of the loop.
        let binding = unsafe { pass.bind_images(&frame) }.unwrap();
        for _ in 0..2 {
            let fence = renderer.submit(|commands| {
                // SAFETY: as above; the fence is waited for.
                unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
            });
            renderer.wait(fence);
        }
        let found = output.read_rgb();
        match format {
            ImageFormat::Rgba32F => common::compare::assert_same_bits(&found, &expected, "images"),
            _ => {
                for (found, expected) in found.iter().zip(&expected) {
                    assert!((found - expected).abs() <= expected * 1e-3 + 1e-6, "{found} for {expected}");
                }
            }
        }
        drop(binding);
    }
    drop(pass);
    drop(denoiser);
    renderer.assert_silent();
}

#[test]
fn half_planes_in_buffers() {
    let renderer = Renderer::new();
    let denoiser = denoiser(&renderer);
    let pass = denoiser.pass(EXTENT).unwrap();
    let picture = picture(4);
    // RGBA halves that begin at an odd half.
    let rgba = Layout { offset: 1, pixel_stride: 4, row_stride: 4 * EXTENT.width as usize, channel_stride: 1 };
    let halves: Vec<f16> = std::iter::once(f16::ZERO)
        .chain(picture.color.chunks_exact(3).flat_map(|c| [c[0], c[1], c[2], 1.0].map(f16::from_f32)))
        .collect();
    let input = renderer.buffer(2 * halves.len() as u64);
    let output = renderer.buffer(2 * halves.len() as u64);
    input.write(bytemuck::cast_slice(&halves));
    let plane = |buffer: &RendererBuffer| BufferPlane {
        buffer: buffer.raw,
        size: buffer.size,
        format: SampleFormat::F16,
        layout: rgba,
    };
    let frame = BufferFrame::new(plane(&input), plane(&output));
    // SAFETY: the buffers live to the end of the test.
    let binding = unsafe { pass.bind_buffers(&frame) };
    if !renderer.storage16 {
        assert!(matches!(binding, Err(Error::Unsupported { .. })));
        return;
    }
    let binding = binding.unwrap();
    let fence = renderer.submit(|commands| {
        // SAFETY: as above; the fence is waited for.
        unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
        renderer.barrier_to_host(commands);
    });
    renderer.wait(fence);
    let rgb = Layout::interleaved(EXTENT, 3);
    let host = Frame { extent: EXTENT, color: Plane::f32(&picture.color, rgb), features: Features::default() };
    let mut expected = vec![0.0; picture.color.len()];
    let mut on_host =
        Denoiser::new(common::device::device(), &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    on_host.denoise(&host, PlaneMut::f32(&mut expected, rgb)).unwrap();
    let bytes = output.read();
    let found: Vec<f16> = bytemuck::cast_slice(&bytes).to_vec();
    for (pixel, expected) in found[1..].chunks(4).zip(expected.chunks_exact(3)) {
        assert_eq!(pixel.get(3).copied().unwrap_or(f16::ZERO), f16::ZERO, "the alpha between the pixels was written");
        for (found, expected) in pixel.iter().zip(expected) {
            assert!((found.to_f32() - expected).abs() <= expected * 1e-3 + 1e-6, "{found} for {expected}");
        }
    }
    drop(binding);
    drop(pass);
    drop(denoiser);
    renderer.assert_silent();
}

#[test]
fn what_does_not_fit_is_refused_before_recording() {
    let renderer = Renderer::new();
    let denoiser = denoiser(&renderer);
    let pass = denoiser.pass(EXTENT).unwrap();
    let buffer = renderer.buffer(12 * EXTENT.pixels());
    let good = plane(&buffer, 0, 3);
    let frame = BufferFrame::new(good, good);
    // SAFETY: the buffer lives to the end of the test; the same below.
    let bind = |frame: &BufferFrame| unsafe { pass.bind_buffers(frame) };
    assert!(bind(&frame).is_ok());
    let mut beyond = frame;
    beyond.color = plane(&buffer, 1, 3);
    assert!(matches!(bind(&beyond), Err(Error::PlaneMismatch { plane: "colour", .. })));
    let mut beyond = frame;
    beyond.depth = Some(plane(&buffer, 3 * EXTENT.pixels() as usize, 1));
    assert!(matches!(bind(&beyond), Err(Error::PlaneMismatch { plane: "depth", .. })));

    let (other, twin) = (denoiser.pass(Extent::new(8, 8)).unwrap(), denoiser.pass(EXTENT).unwrap());
    let binding = bind(&frame).unwrap();
    renderer.record_only(|commands| {
        let record = |options: &FrameOptions, pass: &vkdenoise::Pass| {
            // SAFETY: nothing of it is submitted.
            unsafe { pass.record(commands, &binding, options) }
        };
        assert!(matches!(record(&FrameOptions::default(), &other), Err(Error::Binding(_))));
        // Not even one of the same size: its arena lies elsewhere.
        assert!(matches!(record(&FrameOptions::default(), &twin), Err(Error::Binding(_))));
        let options = FrameOptions { blend: 1.5, ..FrameOptions::default() };
        assert!(matches!(record(&options, &pass), Err(Error::InvalidOption { option: "blend", .. })));
    });

    let image = RendererImage::new(&renderer, EXTENT, ImageFormat::R32F, &vec![0.0; EXTENT.pixels() as usize], 1);
    let images = ImageFrame::new(image.plane(), image.plane());
    // SAFETY: the image lives to the end of the test.
    let bound = unsafe { pass.bind_images(&images) };
    assert!(matches!(bound, Err(Error::Binding(message)) if message.contains("R32F")));
    let mut small = images;
    small.color.extent = Extent::new(1, 1);
    // SAFETY: as above.
    let bound = unsafe { pass.bind_images(&small) };
    assert!(matches!(bound, Err(Error::PlaneMismatch { .. })));
    // SAFETY: as above.
    let mut bad_layout = images;
    bad_layout.color.format = ImageFormat::Rgba32F;
    bad_layout.color.layout = vk::ImageLayout::UNDEFINED;
    // SAFETY: as above.
    let bound = unsafe { pass.bind_images(&bad_layout) };
    assert!(matches!(bound, Err(Error::Binding(message)) if message.contains("UNDEFINED")));

    // A family that is not there.
    let mut handles = renderer.handles();
    handles.queue_family = 99;
    // SAFETY: the other handles are the renderer's.
    let refused = unsafe { Device::from_renderer(handles) };
    assert!(matches!(refused, Err(Error::Unsupported { missing, .. }) if missing.contains("99")));

    // The host path needs a queue, which a renderer keeps.
    let mut denoiser = denoiser;
    let mut color = vec![0.5; 3 * EXTENT.pixels() as usize];
    let result = denoiser.denoise_in_place(
        EXTENT,
        PlaneMut::f32(&mut color, Layout::interleaved(EXTENT, 3)),
        &Features::default(),
    );
    assert!(matches!(result, Err(Error::Binding(_))));
    assert!(color.iter().all(|c| *c == 0.5));
    drop((binding, other, twin, pass, denoiser));
    renderer.assert_silent();
}

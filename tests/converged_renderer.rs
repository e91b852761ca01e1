//! Converged squares in a renderer's buffers and images, with its plane of sample counts: the host path's bits, and
//! what was active, read back by the renderer itself.

mod common;

use ash::vk;
use common::compare::assert_same_bits;
use common::image::RendererImage;
use common::vulkan::Renderer;
use vkdenoise::{
    ActiveTiles, BufferFrame, BufferPlane, Converged, ConvergedMode, Denoiser, Device, Extent, Features, Frame,
    FrameOptions, ImageFormat, ImageFrame, Layout, Noise, NoiseKind, Options, Pass, Plane, PlaneMut, SampleFormat,
    Weights,
};

/// Five squares in three rows, the last ones cut off.
const EXTENT: Extent = Extent::new(70, 45);
/// Columns with few samples: two squares.
const NOISY: usize = 32;

fn options() -> Options {
    Options { converged: Some(Converged { threshold: 0.05, mode: ConvergedMode::Exact }), ..Options::default() }
}

/// Colour and sample counts, RGB and one channel.
fn frame() -> (Vec<f32>, Vec<f32>) {
    let (width, pixels) = (EXTENT.width as usize, EXTENT.pixels() as usize);
    let color = (0..3 * pixels as u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 8) as f32 / (1 << 24) as f32);
    let samples = (0..pixels).map(|i| if i % width < NOISY { 4.0 } else { 1e6 });
    (color.collect(), samples.collect())
}

fn on_host(color: &[f32], samples: &[f32]) -> (Vec<f32>, ActiveTiles) {
    let mut denoiser =
        Denoiser::new(common::device::device(), &Weights::hybrid_kernels().unwrap(), &options()).unwrap();
    let rgb = Layout::interleaved(EXTENT, 3);
    let plane = Plane::f32(samples, Layout::interleaved(EXTENT, 1));
    let noise = Some(Noise { plane, kind: NoiseKind::Samples });
    let frame =
        Frame { extent: EXTENT, color: Plane::f32(color, rgb), features: Features { noise, ..Features::default() } };
    let mut output = vec![0.0; color.len()];
    denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
    (output, denoiser.active_tiles().unwrap().clone())
}

fn denoiser(renderer: &Renderer) -> Denoiser {
    // SAFETY: the handles are the renderer's, which the caller keeps alive.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &options()).unwrap()
}

/// Runs a recording, and copies what was active out of it as a renderer would.
fn run(renderer: &Renderer, pass: &Pass, record: impl FnOnce(vk::CommandBuffer)) -> ActiveTiles {
    let (source, offset, size) = pass.activity_buffer().unwrap();
    let copy = renderer.buffer(size);
    let fence = renderer.submit(|commands| {
        record(commands);
        let barrier = [vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::SHADER_WRITE)
            .dst_access_mask(vk::AccessFlags::TRANSFER_READ)];
        let (from, to) = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::PipelineStageFlags::TRANSFER);
        let regions = [vk::BufferCopy { src_offset: offset, dst_offset: 0, size }];
        // SAFETY: the command buffer is recording, and both buffers live until the fence is waited for.
        unsafe {
            let flags = vk::DependencyFlags::empty();
            renderer.device.cmd_pipeline_barrier(commands, from, to, flags, &barrier, &[], &[]);
            renderer.device.cmd_copy_buffer(commands, source, copy.raw, &regions);
        }
        renderer.barrier_to_host(commands);
    });
    renderer.wait(fence);
    pass.active_tiles(bytemuck::cast_slice(&copy.read())).unwrap()
}

fn assert_half_was_active(active: &ActiveTiles, expected: &ActiveTiles) {
    let denoised = active.denoised(EXTENT);
    assert!((denoised - 2.0 / 5.0).abs() < 1e-9, "{denoised} of the squares");
    assert_eq!(active, expected);
}

#[test]
fn in_buffers() {
    let renderer = Renderer::new();
    let denoiser = denoiser(&renderer);
    let pass = denoiser.pass(EXTENT).unwrap();
    let (color, samples) = frame();
    let (expected, expected_active) = on_host(&color, &samples);
    let [input, counts, output] = [12, 4, 12].map(|bytes| renderer.buffer(bytes * EXTENT.pixels()));
    input.write(bytemuck::cast_slice(&color));
    counts.write(bytemuck::cast_slice(&samples));
    let plane = |buffer: &common::vulkan::RendererBuffer, channels| BufferPlane {
        buffer: buffer.raw,
        size: buffer.size,
        format: SampleFormat::F32,
        layout: Layout::interleaved(EXTENT, channels),
    };
    let noise = Some(Noise { plane: plane(&counts, 1), kind: NoiseKind::Samples });
    let (color, output_plane) = (plane(&input, 3), plane(&output, 3));
    let mut frame = BufferFrame::new(color, output_plane);
    frame.noise = noise;
    // SAFETY: the buffers live to the end of the test.
    let binding = unsafe { pass.bind_buffers(&frame) }.unwrap();
    let active = run(&renderer, &pass, |commands| {
        // SAFETY: everything bound lives until the fence was waited for.
        unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
    });
    assert_same_bits(bytemuck::cast_slice(&output.read()), &expected, "buffers");
    assert_half_was_active(&active, &expected_active);
    drop(binding);
    drop(pass);
    drop(denoiser);
    renderer.assert_silent();
}

#[test]
fn in_images() {
    let renderer = Renderer::new();
    let denoiser = denoiser(&renderer);
    let pass = denoiser.pass(EXTENT).unwrap();
    let (color, samples) = frame();
    let (expected, expected_active) = on_host(&color, &samples);
    let image = |values: &[f32], channels, format| RendererImage::new(&renderer, EXTENT, format, values, channels);
    let input = image(&color, 3, ImageFormat::Rgba32F);
    let counts = image(&samples, 1, ImageFormat::R32F);
    let output = image(&[], 3, ImageFormat::Rgba32F);
    let noise = Some(Noise { plane: counts.plane(), kind: NoiseKind::Samples });
    let (color, output_plane) = (input.plane(), output.plane());
    let mut frame = ImageFrame::new(color, output_plane);
    frame.noise = noise;
    // SAFETY: the images live to the end of the test.
    let binding = unsafe { pass.bind_images(&frame) }.unwrap();
    let active = run(&renderer, &pass, |commands| {
        // SAFETY: everything bound lives until the fence was waited for.
        unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
    });
    assert_same_bits(&output.read_rgb(), &expected, "images");
    assert_half_was_active(&active, &expected_active);
    drop(binding);
    drop(pass);
    drop(denoiser);
    renderer.assert_silent();
}

//! Planes of a renderer in every format that they can have, in buffers and in images: the bits, or nearly, that planes
//! of floats give which hold the same.

mod common;
#[path = "formats/images.rs"]
mod images;

use common::case::small_hybrid;
use common::compare::assert_same_bits;
use common::image::RendererImage;
use common::random::Random;
use common::trained::residual_hybrid;
use common::vulkan::{Renderer, RendererBuffer};
use half::f16;
use vkdenoise::net::Head;
use vkdenoise::{
    Binding, BufferFrame, BufferPlane, Denoiser, DepthEncoding, Device, Error, Extent, FrameOptions, ImageFormat,
    ImageFrame, Layout, NormalEncoding, Options, Pass, SampleFormat, Weights,
};

const EXTENT: Extent = Extent::new(41, 27);
const PIXELS: usize = EXTENT.pixels() as usize;
/// Between planes whose decoding may round otherwise: octahedral normals, and what a driver's texture unit decodes.
const NEAR: f32 = 2e-5;
/// The same of sRGB, whose curve drivers approach.
const NEAR_SRGB: f32 = 5e-4;

const PERSPECTIVES: [DepthEncoding; 5] = [
    DepthEncoding::Perspective { near: 0.5, far: 80.0, reversed: false },
    DepthEncoding::Perspective { near: 0.5, far: 80.0, reversed: true },
    DepthEncoding::Perspective { near: 0.5, far: f32::INFINITY, reversed: true },
    DepthEncoding::Orthographic { near: 2.0, far: 9.0, reversed: false },
    DepthEncoding::Orthographic { near: 0.0, far: 9.0, reversed: true },
];

/// A sample of a format, or of packed ones a pixel: its bytes, and what they stand for.
fn sample(format: SampleFormat, random: &mut Random) -> (Vec<u8>, Vec<f32>) {
    let bits = random.bits() as u32;
    // Now and then the ends.
    let pick = |largest: u32| match bits >> 28 {
        0 => 0,
        1 => largest,
        _ => bits & largest,
    };
    match format {
        SampleFormat::F32 => {
            let value = random.uniform(-1.0, 1.0);
            (value.to_le_bytes().into(), vec![value])
        }
        SampleFormat::F16 => {
            let value = f16::from_f32(random.uniform(-1.0, 1.0));
            (value.to_le_bytes().into(), vec![value.to_f32()])
        }
        SampleFormat::Unorm8 => (vec![pick(255) as u8], vec![pick(255) as f32 / 255.0]),
        SampleFormat::Unorm16 => ((pick(65535) as u16).to_le_bytes().into(), vec![pick(65535) as f32 / 65535.0]),
        SampleFormat::Snorm16 => {
            let value = pick(65535) as u16 as i16;
            (value.to_le_bytes().into(), vec![(f32::from(value) / 32767.0).max(-1.0)])
        }
        SampleFormat::Rgb10A2Unorm => {
            let word = bits | if bits.is_multiple_of(5) { 0x3fff_ffff } else { 0 };
            (word.to_le_bytes().into(), [0, 10, 20].map(|at| (word >> at & 1023) as f32 / 1023.0).into())
        }
        other => panic!("no samples of {other:?}"),
    }
}

fn is_unsigned(format: SampleFormat) -> bool {
    matches!(format, SampleFormat::Unorm8 | SampleFormat::Unorm16 | SampleFormat::Rgb10A2Unorm)
}

/// The normal that samples of a format stand for.
fn normal_of(format: SampleFormat, encoding: NormalEncoding, samples: &[f32]) -> [f32; 3] {
    let octahedral = encoding == NormalEncoding::Octahedral;
    let halved = is_unsigned(format) || encoding == NormalEncoding::Unsigned;
    let nothing = !octahedral && samples.iter().all(|sample| *sample == 0.0);
    let value = |i: usize| if halved && !nothing { samples[i] * 2.0 - 1.0 } else { samples[i] };
    if !octahedral {
        return [0, 1, 2].map(value);
    }
    let (x, y) = (f64::from(value(0)), f64::from(value(1)));
    let z = 1.0 - x.abs() - y.abs();
    let sign = |v: f64| if v >= 0.0 { 1.0 } else { -1.0 };
    let (x, y) = if z < 0.0 { ((1.0 - y.abs()) * sign(x), (1.0 - x.abs()) * sign(y)) } else { (x, y) };
    let length = (x * x + y * y + z * z).sqrt();
    [x, y, z].map(|v| (v / length) as f32)
}

/// The distance that a number of a depth buffer stands for; the far plane's is background.
fn distance(encoding: DepthEncoding, number: f32) -> f32 {
    let (near, far, reversed) = match encoding {
        DepthEncoding::Perspective { near, far, reversed } | DepthEncoding::Orthographic { near, far, reversed } => {
            (near, far, reversed)
        }
        _ => return number,
    };
    if if reversed { number <= 0.0 } else { number >= 1.0 } {
        return 0.0;
    }
    let linear = |near: f32, far: f32| {
        let (at_zero, at_one) = if reversed { (far, near) } else { (near, far) };
        at_zero + number * (at_one - at_zero)
    };
    if matches!(encoding, DepthEncoding::Orthographic { .. }) {
        linear(near, far)
    } else {
        1.0 / linear(1.0 / near, 1.0 / far)
    }
}

/// A renderer with a pass, and a frame of floats.
struct Rig {
    pass: Pass,
    renderer: Renderer,
    color: Vec<f32>,
    albedo: Vec<f32>,
    normal: Vec<f32>,
    depth: Vec<f32>,
}

impl Rig {
    fn new() -> Self {
        Self::of(&small_hybrid(Head::pure()))
    }

    fn of(weights: &Weights) -> Self {
        let renderer = Renderer::new();
        // SAFETY: the handles are the renderer's, which is dropped last.
        let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
        let denoiser = Denoiser::new(&device, weights, &Options::default()).unwrap();
        let mut random = Random::new(7);
        Self {
            pass: denoiser.pass(EXTENT).unwrap(),
            renderer,
            color: random.values(3 * PIXELS, 0.1, 2.0),
            albedo: random.values(3 * PIXELS, 0.0, 1.0),
            normal: random.values(3 * PIXELS, -1.0, 1.0),
            depth: random.values(PIXELS, 0.5, 10.0),
        }
    }

    fn buffer(&self, bytes: &[u8]) -> RendererBuffer {
        let buffer = self.renderer.buffer(bytes.len().next_multiple_of(4) as u64);
        buffer.write(bytes);
        buffer
    }

    fn run(&self, binding: &Binding) {
        let fence = self.renderer.submit(|commands| {
            // SAFETY: everything bound lives until the fence was waited for.
            unsafe { self.pass.record(commands, binding, &FrameOptions::default()) }.unwrap();
            self.renderer.barrier_to_host(commands);
        });
        self.renderer.wait(fence);
    }

    /// The result of the frame in buffers of floats, as `change` has it.
    fn in_buffers(&self, change: impl FnOnce(&mut BufferFrame)) -> Vec<f32> {
        let planes = [&self.color, &self.albedo, &self.normal, &self.depth].map(|plane| {
            let buffer = self.buffer(bytemuck::cast_slice(plane));
            let layout = Layout::interleaved(EXTENT, plane.len() / PIXELS);
            (BufferPlane { buffer: buffer.raw, size: buffer.size, format: SampleFormat::F32, layout }, buffer)
        });
        let output = self.renderer.buffer(12 * PIXELS as u64);
        let to = BufferPlane { buffer: output.raw, size: output.size, ..planes[0].0 };
        let mut frame = BufferFrame::new(planes[0].0, to);
        [frame.albedo, frame.normal, frame.depth] = [1, 2, 3].map(|i: usize| Some(planes[i].0));
        change(&mut frame);
        // SAFETY: the buffers live to the end, when the fence was waited for.
        self.run(&unsafe { self.pass.bind_buffers(&frame) }.unwrap());
        bytemuck::cast_slice(&output.read()).to_vec()
    }

    /// The result of the frame in images of floats, as `change` has it.
    fn in_images(&self, change: impl FnOnce(&mut ImageFrame)) -> Vec<f32> {
        let image =
            |values: &[f32], channels, format| RendererImage::new(&self.renderer, EXTENT, format, values, channels);
        let [color, albedo, normal] =
            [&self.color, &self.albedo, &self.normal].map(|values| image(values, 3, ImageFormat::Rgba32F));
        let (depth, output) = (image(&self.depth, 1, ImageFormat::R32F), image(&[], 3, ImageFormat::Rgba32F));
        let mut frame = ImageFrame::new(color.plane(), output.plane());
        (frame.albedo, frame.normal, frame.depth) = (Some(albedo.plane()), Some(normal.plane()), Some(depth.plane()));
        change(&mut frame);
        // SAFETY: the images live to the end, when the fence was waited for.
        self.run(&unsafe { self.pass.bind_images(&frame) }.unwrap());
        output.read_rgb()
    }
}

/// Random pixels of a plane: bytes packed, and the samples of every pixel.
fn pixels(format: SampleFormat, channels: usize, seed: u64) -> (Vec<u8>, Vec<Vec<f32>>) {
    let mut random = Random::new(seed);
    let samples = if format == SampleFormat::Rgb10A2Unorm { 1 } else { channels };
    let mut bytes = Vec::new();
    let mut values = Vec::new();
    for _ in 0..PIXELS {
        let mut pixel = Vec::new();
        // The first pixel is of zeros.
        let zeros = values.is_empty();
        for (sample, numbers) in (0..samples).map(|_| sample(format, &mut random)) {
            if zeros {
                bytes.extend(vec![0; sample.len()]);
                pixel.extend(vec![0.0; numbers.len()]);
                continue;
            }
            bytes.extend(sample);
            pixel.extend(numbers);
        }
        values.push(pixel);
    }
    (bytes, values)
}

/// Packed pixels with gaps before, between and after their samples, of all ones: NaN, white.
fn spread(format: SampleFormat, channels: usize, packed: &[u8]) -> (Vec<u8>, Layout) {
    let (bytes, samples) = (format.bytes() as usize, if format == SampleFormat::Rgb10A2Unorm { 1 } else { channels });
    let (width, height) = (EXTENT.width as usize, EXTENT.height as usize);
    let pixel_stride = 2 * samples + 1;
    let layout = Layout { offset: 5, pixel_stride, row_stride: width * pixel_stride + 3, channel_stride: 2 };
    let mut spread = vec![0xff; bytes * (5 + height * layout.row_stride)];
    for (i, sample) in packed.chunks_exact(bytes).enumerate() {
        let (pixel, channel) = (i / samples, i % samples);
        let index = layout.offset + pixel / width * layout.row_stride + pixel % width * pixel_stride + channel * 2;
        spread[index * bytes..][..bytes].copy_from_slice(sample);
    }
    (spread, layout)
}

/// Both ways to lay out pixels in a buffer.
fn layouts(format: SampleFormat, channels: usize, packed: &[u8]) -> [(Vec<u8>, Layout); 2] {
    let samples = if format == SampleFormat::Rgb10A2Unorm { 1 } else { channels };
    [(packed.to_vec(), Layout::interleaved(EXTENT, samples)), spread(format, channels, packed)]
}

fn assert_near(limit: f32, found: &[f32], expected: &[f32], what: &str) {
    for (at, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found - expected).abs() <= limit * (1.0 + expected), "{what}: {found} for {expected} at {at}");
    }
}

#[test]
fn albedo_in_buffers() {
    let mut rig = Rig::new();
    for (seed, format) in (0..).zip([SampleFormat::F32, SampleFormat::F16, SampleFormat::Unorm8, SampleFormat::Unorm16])
    {
        let (packed, values) = pixels(format, 3, seed);
        rig.albedo = values.concat();
        let expected = rig.in_buffers(|_| ());
        for (bytes, layout) in layouts(format, 3, &packed) {
            let buffer = rig.buffer(&bytes);
            let plane = BufferPlane { buffer: buffer.raw, size: buffer.size, format, layout };
            let found = rig.in_buffers(|frame| frame.albedo = Some(plane));
            assert_same_bits(&found, &expected, &format!("{format:?}, {layout:?}"));
        }
    }
    rig.renderer.assert_silent();
}

#[test]
fn normals_in_buffers() {
    let mut rig = Rig::new();
    let formats = [
        SampleFormat::F32,
        SampleFormat::F16,
        SampleFormat::Unorm8,
        SampleFormat::Unorm16,
        SampleFormat::Snorm16,
        SampleFormat::Rgb10A2Unorm,
    ];
    for (seed, format) in (10..).zip(formats) {
        for encoding in [NormalEncoding::Vector, NormalEncoding::Unsigned, NormalEncoding::Octahedral] {
            let channels = if encoding == NormalEncoding::Octahedral { 2 } else { 3 };
            let (packed, values) = pixels(format, channels, seed);
            rig.normal = values.iter().flat_map(|pixel| normal_of(format, encoding, pixel)).collect();
            let expected = rig.in_buffers(|_| ());
            for (bytes, layout) in layouts(format, channels, &packed) {
                let buffer = rig.buffer(&bytes);
                let plane = BufferPlane { buffer: buffer.raw, size: buffer.size, format, layout };
                let found = rig.in_buffers(|frame| (frame.normal, frame.normal_encoding) = (Some(plane), encoding));
                let what = format!("{format:?}, {encoding:?}, {layout:?}");
                match encoding {
                    NormalEncoding::Octahedral => assert_near(NEAR, &found, &expected, &what),
                    _ => assert_same_bits(&found, &expected, &what),
                }
            }
        }
    }
    rig.renderer.assert_silent();
}

#[test]
fn depths_in_buffers() {
    let mut rig = Rig::new();
    for (seed, format) in (20..).zip([SampleFormat::F32, SampleFormat::F16, SampleFormat::Unorm16]) {
        let (packed, values) = pixels(format, 1, seed);
        let linear = (format != SampleFormat::Unorm16).then_some(DepthEncoding::Linear);
        for encoding in PERSPECTIVES.into_iter().chain(linear) {
            rig.depth = values.iter().map(|pixel| distance(encoding, pixel[0])).collect();
            let expected = rig.in_buffers(|_| ());
            for (bytes, layout) in layouts(format, 1, &packed) {
                let buffer = rig.buffer(&bytes);
                let plane = BufferPlane { buffer: buffer.raw, size: buffer.size, format, layout };
                let found = rig.in_buffers(|frame| (frame.depth, frame.depth_encoding) = (Some(plane), encoding));
                assert_same_bits(&found, &expected, &format!("{format:?}, {encoding:?}, {layout:?}"));
            }
        }
    }
    rig.renderer.assert_silent();
}

#[test]
fn a_projection_is_undone() {
    let [near, far] = [0.5f32, 80.0];
    for i in 1..1000 {
        let distance_wanted = near + (far - near) * i as f32 / 1000.0;
        let [n, f, d] = [near, far, distance_wanted].map(f64::from);
        // The third row of a projection matrix for depths from 0 to 1, over w.
        let perspective = f / (f - n) - f * n / (f - n) / d;
        for (encoding, number) in [
            (DepthEncoding::Perspective { near, far, reversed: false }, perspective),
            (DepthEncoding::Perspective { near, far, reversed: true }, 1.0 - perspective),
            (DepthEncoding::Perspective { near, far: f32::INFINITY, reversed: true }, n / d),
            (DepthEncoding::Orthographic { near, far, reversed: false }, (d - n) / (f - n)),
            (DepthEncoding::Orthographic { near, far, reversed: true }, 1.0 - (d - n) / (f - n)),
        ] {
            let found = f64::from(distance(encoding, number as f32));
            assert!((found - d).abs() <= 2e-5 * d, "{encoding:?}: {found} for {d}");
        }
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let rig = Rig::new();
    let buffer = rig.renderer.buffer(16 * PIXELS as u64);
    let plane = |format| {
        let layout = Layout::interleaved(EXTENT, 3);
        BufferPlane { buffer: buffer.raw, size: buffer.size, format, layout }
    };
    let floats = plane(SampleFormat::F32);
    let refused = |change: &dyn Fn(&mut BufferFrame), words: &[&str]| {
        let mut frame = BufferFrame::new(floats, floats);
        change(&mut frame);
        // SAFETY: the buffer lives to the end of the test.
        let error = unsafe { rig.pass.bind_buffers(&frame) }.err().expect("a binding");
        assert!(matches!(error, Error::Binding(_) | Error::InvalidOption { .. }), "{error:?}");
        words.iter().for_each(|word| assert!(error.to_string().contains(word), "{error}"));
    };
    refused(&|f| f.color = plane(SampleFormat::Unorm8), &["colour", "Unorm8", "F32, F16"]);
    refused(&|f| f.output = plane(SampleFormat::Unorm16), &["output", "Unorm16"]);
    refused(&|f| f.albedo = Some(plane(SampleFormat::Rgb10A2Unorm)), &["albedo", "Rgb10A2Unorm", "Unorm8"]);
    refused(&|f| f.depth = Some(plane(SampleFormat::Snorm16)), &["depth", "Snorm16", "Unorm16"]);
    refused(&|f| f.depth = Some(plane(SampleFormat::Unorm16)), &["depth_encoding", "Linear", "Perspective"]);
    for (near, far) in [(0.0, 1.0), (2.0, 1.0), (-1.0, 1.0), (f32::NAN, 1.0), (1.0, f32::NAN), (f32::INFINITY, 1.0)] {
        let of = |encoding| move |f: &mut BufferFrame| (f.depth, f.depth_encoding) = (Some(floats), encoding);
        refused(&of(DepthEncoding::Perspective { near, far, reversed: true }), &["depth_encoding", "near"]);
        if near != 0.0 {
            refused(&of(DepthEncoding::Orthographic { near, far, reversed: false }), &["depth_encoding", "near"]);
        }
    }

    let image = |format| RendererImage::of_bytes(&rig.renderer, EXTENT, format, &vec![0; 16 * PIXELS]);
    let color = image(ImageFormat::Rgba32F);
    let [output, small, deep, packed] =
        [ImageFormat::Rgba32F, ImageFormat::Rg16F, ImageFormat::D32F, ImageFormat::Rgb10A2Unorm].map(image);
    let refused = |change: &dyn Fn(&mut ImageFrame), words: &[&str]| {
        let mut frame = ImageFrame::new(color.plane(), output.plane());
        change(&mut frame);
        // SAFETY: the images live to the end of the test.
        let error = unsafe { rig.pass.bind_images(&frame) }.err().expect("a binding");
        assert!(matches!(error, Error::Binding(_) | Error::InvalidOption { .. }), "{error:?}");
        words.iter().for_each(|word| assert!(error.to_string().contains(word), "{error}"));
    };
    refused(&|f| f.color = packed.plane(), &["colour", "Rgb10A2Unorm", "B10G11R11F"]);
    refused(&|f| f.depth = Some(packed.plane()), &["depth", "Rgb10A2Unorm", "D32F"]);
    refused(&|f| f.normal = Some(small.plane()), &["normal", "Rg16F", "Octahedral"]);
    refused(&|f| f.depth = Some(deep.plane()), &["depth_encoding", "Linear", "Perspective"]);
    rig.renderer.assert_silent();
}

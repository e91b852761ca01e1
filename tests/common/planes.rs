//! Planes of a frame that exist twice: as the library's callers hand them over, and in a bench's buffers.

use super::random::Random;
use half::f16;
use vkdenoise::frame::{Extent, Features, Frame, Layout, Plane};
use vkdenoise::kernels::planes::{Format, PlaneArgs, Role};
use vkdenoise::testing::Bench;

/// Samples of a plane.
#[derive(Clone)]
pub enum Samples {
    /// 32-bit floats.
    F32(Vec<f32>),
    /// 16-bit floats.
    F16(Vec<f16>),
}

/// A plane with its layout.
#[derive(Clone)]
pub struct TestPlane {
    /// The samples.
    pub samples: Samples,
    /// Where they lie.
    pub layout: Layout,
}

/// A layout with gaps before, between and after the pixels, and the samples that it needs.
pub fn odd_layout(extent: Extent, channels: usize) -> (Layout, usize) {
    let (width, height) = (extent.width as usize, extent.height as usize);
    let pixel_stride = 2 * channels + 1;
    let row_stride = width * pixel_stride + 3;
    let layout = Layout { offset: 5, pixel_stride, row_stride, channel_stride: 2 };
    (layout, 5 + height * row_stride)
}

impl TestPlane {
    /// Interleaved 32-bit samples.
    pub fn packed(extent: Extent, channels: usize, samples: Vec<f32>) -> Self {
        Self { samples: Samples::F32(samples), layout: Layout::interleaved(extent, channels) }
    }

    /// The same values in [`odd_layout`], as halves if `half`; NaN in the gaps.
    pub fn spread(&self, extent: Extent, channels: usize, half: bool) -> Self {
        let (layout, len) = odd_layout(extent, channels);
        let mut samples = vec![f32::NAN; len];
        for y in 0..extent.height as usize {
            for x in 0..extent.width as usize {
                for channel in 0..channels {
                    let at = |l: &Layout| l.offset + y * l.row_stride + x * l.pixel_stride + channel * l.channel_stride;
                    samples[at(&layout)] = self.get(at(&self.layout));
                }
            }
        }
        let halves = || samples.iter().copied().map(f16::from_f32).collect();
        Self { samples: if half { Samples::F16(halves()) } else { Samples::F32(samples.clone()) }, layout }
    }

    /// A sample.
    pub fn sample(&self, x: usize, y: usize, channel: usize) -> f32 {
        let Layout { offset, pixel_stride, row_stride, channel_stride } = self.layout;
        self.get(offset + y * row_stride + x * pixel_stride + channel * channel_stride)
    }

    fn get(&self, index: usize) -> f32 {
        match &self.samples {
            Samples::F32(samples) => samples[index],
            Samples::F16(samples) => samples[index].to_f32(),
        }
    }

    /// For the library's callers.
    pub fn plane(&self) -> Plane<'_> {
        match &self.samples {
            Samples::F32(samples) => Plane::f32(samples, self.layout),
            Samples::F16(samples) => Plane::f16(samples, self.layout),
        }
    }

    /// In a buffer of a bench.
    pub fn upload(&self, bench: &mut Bench, used: &mut Vec<u64>) -> PlaneArgs {
        let floats: Vec<f32> = match &self.samples {
            Samples::F32(samples) => samples.clone(),
            Samples::F16(samples) => {
                let bits = |i: usize| u32::from(samples.get(i).copied().unwrap_or(f16::NAN).to_bits());
                (0..samples.len().div_ceil(2)).map(|i| f32::from_bits(bits(2 * i) | bits(2 * i + 1) << 16)).collect()
            }
        };
        let bytes = 4 * floats.len() as u64;
        let id = bench.buffer("plane", bytes).unwrap();
        used.push(bytes);
        bench.upload(id, &floats);
        let Layout { offset, pixel_stride, row_stride, channel_stride } = self.layout;
        let args = bench.plane(id, pixel_stride as u32, row_stride as u32, channel_stride as u32);
        let format = if matches!(self.samples, Samples::F16(_)) { Format::F16 } else { Format::F32 };
        PlaneArgs { offset: offset as u32, format, ..args }
    }
}

/// A frame.
#[derive(Clone)]
pub struct TestFrame {
    /// Size.
    pub extent: Extent,
    /// Colour.
    pub color: TestPlane,
    /// Albedo.
    pub albedo: Option<TestPlane>,
    /// Normal.
    pub normal: Option<TestPlane>,
    /// Depth.
    pub depth: Option<TestPlane>,
}

impl TestFrame {
    /// Colour alone, interleaved.
    pub fn of_color(extent: Extent, color: Vec<f32>) -> Self {
        let color = TestPlane::packed(extent, 3, color);
        Self { extent, color, albedo: None, normal: None, depth: None }
    }

    /// Noise over many stops of light, with all features.
    pub fn random(extent: Extent, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let pixels = extent.pixels() as usize;
        let color = random.values(3 * pixels, -8.0, 5.0).into_iter().map(f32::exp2).collect();
        let albedo = random.values(3 * pixels, -0.1, 1.2);
        let normal = random.values(3 * pixels, -1.1, 1.1);
        let depth = random.values(pixels, 0.5, 80.0);
        Self {
            albedo: Some(TestPlane::packed(extent, 3, albedo)),
            normal: Some(TestPlane::packed(extent, 3, normal)),
            depth: Some(TestPlane::packed(extent, 1, depth)),
            ..Self::of_color(extent, color)
        }
    }

    /// The same frame in [`odd_layout`]s.
    pub fn spread(&self, half: bool) -> Self {
        let spread = |plane: &TestPlane, channels| plane.spread(self.extent, channels, half);
        Self {
            extent: self.extent,
            color: spread(&self.color, 3),
            albedo: self.albedo.as_ref().map(|plane| spread(plane, 3)),
            normal: self.normal.as_ref().map(|plane| spread(plane, 3)),
            depth: self.depth.as_ref().map(|plane| spread(plane, 1)),
        }
    }

    /// For the library's callers.
    pub fn frame(&self) -> Frame<'_> {
        Frame {
            extent: self.extent,
            color: self.color.plane(),
            features: Features {
                albedo: self.albedo.as_ref().map(TestPlane::plane),
                normal: self.normal.as_ref().map(TestPlane::plane),
                depth: self.depth.as_ref().map(TestPlane::plane),
                noise: None,
            },
        }
    }

    /// In buffers of a bench, as the frame that its calls read.
    pub fn upload(&self, bench: &mut Bench, used: &mut Vec<u64>) {
        let mut present = |bench: &mut Bench, plane: &Option<TestPlane>| {
            plane.as_ref().map_or_else(PlaneArgs::default, |plane| plane.upload(bench, used))
        };
        bench.planes[Role::Albedo] = present(bench, &self.albedo);
        bench.planes[Role::Normal] = present(bench, &self.normal);
        bench.planes[Role::Depth] = present(bench, &self.depth);
        bench.planes[Role::Color] = self.color.upload(bench, used);
    }
}

//! What a renderer hands in: its buffers or its images.

use crate::error::{Error, Result};
use crate::frame::{Extent, Layout, Noise};
use crate::kernels::PlaneArgs;
use crate::vk::device::Device;
use ash::vk;

/// Sample format of a plane in a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleFormat {
    /// 32-bit floats.
    F32,
    /// 16-bit floats. Writing them needs `storageBuffer16BitAccess`.
    F16,
}

impl SampleFormat {
    fn bytes(self) -> u64 {
        match self {
            Self::F32 => 4,
            Self::F16 => 2,
        }
    }
}

/// A plane in a `VkBuffer`: three channels (colour, albedo, normal, output) or one (depth, noise).
#[derive(Clone, Copy, Debug)]
pub struct BufferPlane {
    /// The buffer, created with `VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT` and `VK_BUFFER_USAGE_STORAGE_BUFFER_BIT`
    /// and bound to memory.
    pub buffer: vk::Buffer,
    /// Size of the buffer in bytes.
    pub size: u64,
    /// Sample format.
    pub format: SampleFormat,
    /// Where the samples lie, counted in samples from the start of the buffer.
    pub layout: Layout,
}

/// A place in a `VkBuffer`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferAddress {
    /// The buffer, created with `VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT` and `VK_BUFFER_USAGE_STORAGE_BUFFER_BIT`
    /// and bound to memory.
    pub buffer: vk::Buffer,
    /// Bytes from its start, a multiple of 4.
    pub offset: u64,
}

impl BufferAddress {
    pub(crate) fn check(&self, option: &'static str) -> Result<()> {
        if self.offset.is_multiple_of(4) {
            return Ok(());
        }
        let reason = format!("byte {} of a buffer; the offset must be a multiple of 4", self.offset);
        Err(Error::InvalidOption { option, reason })
    }

    /// # Safety
    /// The buffer is valid, as its field says, and of the device.
    pub(crate) unsafe fn resolve(&self, device: &Device) -> u64 {
        // SAFETY: the caller vouches for the buffer.
        unsafe { device.buffer_address(self.buffer) + self.offset }
    }
}

/// What a recording tells of its frame ([`crate::FrameOptions::statistics`]).
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct FrameStatistics {
    /// The factor on the colour that was used.
    pub exposure: f32,
    /// What depths were divided by, in the renderer's own unit; 0 where there is no depth.
    pub depth_scale: f32,
    /// The frame's key: its robust log-mean luminance. The frame's own exposure is 0.18 over it.
    pub key: f32,
    /// The share of the lit pixels that differ from the mean of their left and right neighbours by more than 8 % of
    /// what the three have; 1 where nothing is lit.
    pub noise: f32,
}

/// A frame in the renderer's buffers. Output and colour may be the same plane.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct BufferFrame {
    /// Noisy colour, linear radiance.
    pub color: BufferPlane,
    /// Albedo.
    pub albedo: Option<BufferPlane>,
    /// Shading normal.
    pub normal: Option<BufferPlane>,
    /// Depth.
    pub depth: Option<BufferPlane>,
    /// The colour's noise ([`Features::noise`](crate::Features::noise)).
    pub noise: Option<Noise<BufferPlane>>,
    /// Where the denoised colour goes.
    pub output: BufferPlane,
}

impl BufferFrame {
    /// A frame of colour alone; its other fields say what else there is.
    pub fn new(color: BufferPlane, output: BufferPlane) -> Self {
        Self { color, albedo: None, normal: None, depth: None, noise: None, output }
    }
}

/// Format of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// `VK_FORMAT_R16G16B16A16_SFLOAT`: colour, albedo, normal, output.
    Rgba16F,
    /// `VK_FORMAT_R32G32B32A32_SFLOAT`: colour, albedo, normal, output.
    Rgba32F,
    /// `VK_FORMAT_R32_SFLOAT`: depth, noise.
    R32F,
}

/// A two-dimensional image.
#[derive(Clone, Copy, Debug)]
pub struct ImagePlane {
    /// A view of one 2D level. Inputs need the usage `VK_IMAGE_USAGE_SAMPLED_BIT`, the output
    /// `VK_IMAGE_USAGE_STORAGE_BIT`.
    pub view: vk::ImageView,
    /// Its format.
    pub format: ImageFormat,
    /// Its size in pixels.
    pub extent: Extent,
    /// The layout it will be in when the commands run: `GENERAL` or `SHADER_READ_ONLY_OPTIMAL` for inputs, `GENERAL`
    /// for the output.
    pub layout: vk::ImageLayout,
}

/// A frame in the renderer's images. The output's alpha becomes the colour's. Output and colour must be two images.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct ImageFrame {
    /// Noisy colour, linear radiance.
    pub color: ImagePlane,
    /// Albedo.
    pub albedo: Option<ImagePlane>,
    /// Shading normal.
    pub normal: Option<ImagePlane>,
    /// Depth.
    pub depth: Option<ImagePlane>,
    /// The colour's noise ([`Features::noise`](crate::Features::noise)).
    pub noise: Option<Noise<ImagePlane>>,
    /// Where the denoised colour goes.
    pub output: ImagePlane,
}

impl ImageFrame {
    /// A frame of colour alone; its other fields say what else there is.
    pub fn new(color: ImagePlane, output: ImagePlane) -> Self {
        Self { color, albedo: None, normal: None, depth: None, noise: None, output }
    }
}

impl BufferPlane {
    /// Checks the plane and finds its address.
    ///
    /// # Safety
    /// The buffer must be as its field says.
    pub(crate) unsafe fn resolve(
        &self,
        device: &Device,
        name: &'static str,
        extent: Extent,
        channels: usize,
    ) -> Result<PlaneArgs> {
        let bytes = self.format.bytes();
        self.layout.check(name, extent, channels, self.size / bytes)?;
        // The shader counts from the first sample in 32 bits.
        let from_first = Layout { offset: 0, ..self.layout };
        from_first.check(name, extent, channels, u64::from(u32::MAX))?;
        // SAFETY: the caller vouches for the buffer.
        let base = unsafe { device.buffer_address(self.buffer) };
        let first = base + self.layout.offset as u64 * bytes;
        // Shaders load whole words: an odd half begins in the middle of one.
        let address = first & !3;
        Ok(PlaneArgs {
            address,
            offset: ((first - address) / bytes) as u32,
            pixel: self.layout.pixel_stride as u32,
            row: self.layout.row_stride as u32,
            channel: self.layout.channel_stride as u32,
            half: self.format == SampleFormat::F16,
            present: true,
        })
    }
}

impl ImageFrame {
    /// Checks formats, sizes and layouts.
    pub(crate) fn check(&self, extent: Extent) -> Result<()> {
        let rgba: &[ImageFormat] = &[ImageFormat::Rgba16F, ImageFormat::Rgba32F];
        let sampled: &[vk::ImageLayout] = &[vk::ImageLayout::GENERAL, vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL];
        let planes = [
            ("colour", Some(&self.color), rgba, sampled),
            ("albedo", self.albedo.as_ref(), rgba, sampled),
            ("normal", self.normal.as_ref(), rgba, sampled),
            ("depth", self.depth.as_ref(), &[ImageFormat::R32F], sampled),
            ("noise", self.noise.as_ref().map(|noise| &noise.plane), &[ImageFormat::R32F], sampled),
            ("output", Some(&self.output), rgba, &[vk::ImageLayout::GENERAL]),
        ];
        for (name, plane, formats, layouts) in planes {
            let Some(plane) = plane else { continue };
            if plane.extent != extent {
                let (has, wants) = (plane.extent, extent);
                return Err(Error::PlaneMismatch {
                    plane: name,
                    reason: format!(
                        "the image is {} x {}, the pass {} x {}",
                        has.width, has.height, wants.width, wants.height
                    ),
                });
            }
            if !formats.contains(&plane.format) {
                return Err(Error::Binding(format!("the {name} image is {:?}; it can be {formats:?}", plane.format)));
            }
            if !layouts.contains(&plane.layout) {
                return Err(Error::Binding(format!(
                    "the {name} image is in {:?}; it can be in {layouts:?}",
                    plane.layout
                )));
            }
        }
        if self.color.view == self.output.view {
            return Err(Error::Binding("colour and output must be two images".into()));
        }
        Ok(())
    }
}

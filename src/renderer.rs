//! What a renderer hands in: its buffers or its images.

use crate::error::{Error, Result};
use crate::formats::{DepthEncoding, ImageFormat, NormalEncoding, SampleFormat};
use crate::frame::{Extent, Layout, Noise};
use crate::kernels::planes::{PlaneArgs, Planes, Role};
use crate::vk::device::Device;
use ash::vk;

/// A plane in a `VkBuffer`: three channels (colour, albedo, normal, output), two (octahedral normals) or one (depth,
/// noise).
#[derive(Clone, Copy, Debug)]
pub struct BufferPlane {
    /// The buffer, created with `VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT` and `VK_BUFFER_USAGE_STORAGE_BUFFER_BIT`
    /// and bound to memory.
    pub buffer: vk::Buffer,
    /// Size of the buffer in bytes.
    pub size: u64,
    /// Sample format, one of those that its variants name for the plane.
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
    /// How its samples tell it.
    pub normal_encoding: NormalEncoding,
    /// Depth.
    pub depth: Option<BufferPlane>,
    /// How its samples tell it.
    pub depth_encoding: DepthEncoding,
    /// The colour's noise ([`Features::noise`](crate::Features::noise)).
    pub noise: Option<Noise<BufferPlane>>,
    /// Where the denoised colour goes.
    pub output: BufferPlane,
}

impl BufferFrame {
    /// A frame of colour alone; its other fields say what else there is.
    pub fn new(color: BufferPlane, output: BufferPlane) -> Self {
        let (normal_encoding, depth_encoding) = Default::default();
        let (albedo, normal, depth, noise) = (None, None, None, None);
        Self { color, albedo, normal, normal_encoding, depth, depth_encoding, noise, output }
    }

    fn plane(&self, role: Role) -> Option<&BufferPlane> {
        match role {
            Role::Color => Some(&self.color),
            Role::Albedo => self.albedo.as_ref(),
            Role::Normal => self.normal.as_ref(),
            Role::Depth => self.depth.as_ref(),
            Role::Noise => self.noise.as_ref().map(|noise| &noise.plane),
            Role::Output => Some(&self.output),
        }
    }

    /// Checks the planes and finds their addresses.
    ///
    /// # Safety
    /// The buffers must be as their fields say.
    pub(crate) unsafe fn resolve(&self, device: &Device, extent: Extent) -> Result<Planes> {
        let mut planes = Planes::default();
        for role in Role::ALL {
            let Some(plane) = self.plane(role) else { continue };
            let formats = SampleFormat::choices(role);
            if !formats.contains(&plane.format) {
                let (name, has) = (role.name(), plane.format);
                return Err(Error::Binding(format!("the {name} plane's samples are {has:?}; they can be {formats:?}")));
            }
            let channels = if role == Role::Normal { self.normal_encoding.channels() } else { role.channels() };
            // SAFETY: the caller vouches for the buffers.
            let mut row = unsafe { plane.resolve(device, role.name(), extent, channels)? };
            match role {
                Role::Normal => self.normal_encoding.tell(&mut row),
                Role::Depth => self.depth_encoding.tell(false, &mut row)?,
                _ => {}
            }
            planes[role] = row;
        }
        self.noise.iter().for_each(|noise| planes.tell_noise(noise.kind));
        Ok(planes)
    }
}

/// A two-dimensional image.
#[derive(Clone, Copy, Debug)]
pub struct ImagePlane {
    /// A view of one 2D level. Inputs need the usage `VK_IMAGE_USAGE_SAMPLED_BIT`, the output
    /// `VK_IMAGE_USAGE_STORAGE_BIT`.
    pub view: vk::ImageView,
    /// Its format, one of those that its variants name for the plane.
    pub format: ImageFormat,
    /// Its size in pixels.
    pub extent: Extent,
    /// The layout it will be in when the commands run: `GENERAL` or `SHADER_READ_ONLY_OPTIMAL` for inputs, of depth
    /// buffers also `DEPTH_STENCIL_READ_ONLY_OPTIMAL` or `DEPTH_READ_ONLY_OPTIMAL`; `GENERAL` for the output.
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
    /// How its samples tell it.
    pub normal_encoding: NormalEncoding,
    /// Depth.
    pub depth: Option<ImagePlane>,
    /// How its samples tell it.
    pub depth_encoding: DepthEncoding,
    /// The colour's noise ([`Features::noise`](crate::Features::noise)).
    pub noise: Option<Noise<ImagePlane>>,
    /// Where the denoised colour goes.
    pub output: ImagePlane,
}

impl ImageFrame {
    /// A frame of colour alone; its other fields say what else there is.
    pub fn new(color: ImagePlane, output: ImagePlane) -> Self {
        let (normal_encoding, depth_encoding) = Default::default();
        let (albedo, normal, depth, noise) = (None, None, None, None);
        Self { color, albedo, normal, normal_encoding, depth, depth_encoding, noise, output }
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
        // All channels are in one sample then.
        let channels = if self.format.is_packed() { 1 } else { channels };
        self.layout.check(name, extent, channels, self.size / bytes)?;
        // The shader counts in 32 bits, from the first sample or one of the three before it in its word.
        let from_first = Layout { offset: 0, ..self.layout };
        from_first.check(name, extent, channels, u64::from(u32::MAX - 3))?;
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
            channel: if channels == 1 { 0 } else { self.layout.channel_stride as u32 },
            format: self.format.as_read(),
            ..PlaneArgs::default()
        })
    }
}

impl ImageFrame {
    /// The image of a plane.
    pub(crate) fn plane(&self, role: Role) -> Option<&ImagePlane> {
        match role {
            Role::Color => Some(&self.color),
            Role::Albedo => self.albedo.as_ref(),
            Role::Normal => self.normal.as_ref(),
            Role::Depth => self.depth.as_ref(),
            Role::Noise => self.noise.as_ref().map(|noise| &noise.plane),
            Role::Output => Some(&self.output),
        }
    }

    /// Checks formats, sizes and layouts, and gives the rows of the planes.
    pub(crate) fn resolve(&self, extent: Extent) -> Result<Planes> {
        let mut planes = Planes::default();
        for role in Role::ALL {
            let Some(plane) = self.plane(role) else { continue };
            let (name, formats) = (role.name(), ImageFormat::choices(role));
            let layouts: &[vk::ImageLayout] = match role {
                Role::Output => &[vk::ImageLayout::GENERAL],
                Role::Depth if plane.format.is_depth() => &[
                    vk::ImageLayout::GENERAL,
                    vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
                    vk::ImageLayout::DEPTH_STENCIL_READ_ONLY_OPTIMAL,
                    vk::ImageLayout::DEPTH_READ_ONLY_OPTIMAL,
                ],
                _ => &[vk::ImageLayout::GENERAL, vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL],
            };
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
            let row = &mut planes[role];
            *row = PlaneArgs::of_image(plane.format.as_read());
            match role {
                Role::Normal => {
                    self.normal_encoding.check(plane.format)?;
                    self.normal_encoding.tell(row);
                }
                Role::Depth => self.depth_encoding.tell(plane.format.is_depth(), row)?,
                _ => {}
            }
        }
        if self.color.view == self.output.view {
            return Err(Error::Binding("colour and output must be two images".into()));
        }
        self.noise.iter().for_each(|noise| planes.tell_noise(noise.kind));
        Ok(planes)
    }
}

//! A frame in a renderer's buffers or images.

use crate::choice::choice;
use crate::descriptor::{self, descriptor, reserved};
use crate::host_planes::NoiseKind;
use crate::layout::{SampleFormat, Strides, place};
use crate::signals::{BufferSignal, buffer_signals};
use crate::status::Failure;
use vkdenoise::ash::vk::{self, Handle};
use vkdenoise::{DepthEncoding as CoreDepth, NormalEncoding as CoreNormal};
use vkdenoise::{Error, Extent, ImageFormat, Noise};

/// How a plane of normals tells them. Formats without a sign hold numbers in [-1, 1] as x * 0.5 + 0.5.
#[repr(u32)]
pub enum NormalEncoding {
    /// Three channels in [-1, 1]; zeros, as they are stored, are no normal.
    Vector = 0,
    /// The same as n * 0.5 + 0.5, in floats too.
    Unsigned = 1,
    /// Two channels in [-1, 1]: the octahedron's map (Cigolle et al. 2014, "oct" there).
    Octahedral = 2,
}

impl NormalEncoding {
    fn from_c(encoding: u32) -> Result<CoreNormal, Failure> {
        let choices = [
            (Self::Vector as u32, CoreNormal::Vector),
            (Self::Unsigned as u32, CoreNormal::Unsigned),
            (Self::Octahedral as u32, CoreNormal::Octahedral),
        ];
        choice(encoding, "normal_encoding", "vkdenoise_normal_encoding", &choices)
    }
}

/// How a plane of depths tells them.
#[repr(u32)]
pub enum DepthEncoding {
    /// The distance itself, along the ray or the view axis, in any unit. Depth buffers and unsigned formats are
    /// refused.
    Linear = 0,
    /// A perspective projection's depth buffer, from 0 at depth_near to 1 at depth_far, which may be INFINITY. What lies
    /// there is background.
    Perspective = 1,
    /// The same with 1 at depth_near and 0 at depth_far.
    PerspectiveReversed = 2,
    /// The same of an orthographic projection; also distances that were scaled to [0, 1].
    Orthographic = 3,
    /// The same with 1 at depth_near and 0 at depth_far.
    OrthographicReversed = 4,
}

impl DepthEncoding {
    fn from_c(encoding: u32, near: f32, far: f32) -> Result<CoreDepth, Failure> {
        let perspective = |reversed| CoreDepth::Perspective { near, far, reversed };
        let orthographic = |reversed| CoreDepth::Orthographic { near, far, reversed };
        let choices = [
            (Self::Linear as u32, CoreDepth::Linear),
            (Self::Perspective as u32, perspective(false)),
            (Self::PerspectiveReversed as u32, perspective(true)),
            (Self::Orthographic as u32, orthographic(false)),
            (Self::OrthographicReversed as u32, orthographic(true)),
        ];
        choice(encoding, "depth_encoding", "vkdenoise_depth_encoding", &choices)
    }
}

/// A plane in a VkBuffer: three channels (colour, albedo, normal, output), two (octahedral normals) or one (depth,
/// noise).
#[repr(C)]
#[derive(Clone, Copy)]
pub struct BufferPlane {
    /// sizeof(vkdenoise_buffer_plane).
    pub struct_size: usize,
    /// The VkBuffer, made with VK_BUFFER_USAGE_SHADER_DEVICE_ADDRESS_BIT and VK_BUFFER_USAGE_STORAGE_BUFFER_BIT,
    /// bound to memory.
    pub buffer: u64,
    /// Its size in bytes.
    pub size: u64,
    /// Bytes from its start to the first channel of the top left pixel.
    pub offset: u64,
    /// Bytes from a pixel to its right neighbour; 0: the plane's channels, packed.
    pub pixel_stride: u64,
    /// Bytes from a pixel to the one below; 0: rows packed.
    pub row_stride: u64,
    /// Bytes from a channel to the next of the same pixel; 0: a sample.
    pub channel_stride: u64,
    /// A vkdenoise_sample_format. Writing halves needs VKDENOISE_FEATURE_STORAGE16.
    pub format: u32,
    /// Must be 0.
    pub reserved: u32,
}
descriptor!(BufferPlane, "vkdenoise_buffer_plane", reserved: u32);

/// A frame in a renderer's buffers. Every plane but colour and output may be NULL; output and colour may be the same.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct BufferFrame {
    /// sizeof(vkdenoise_buffer_frame).
    pub struct_size: usize,
    /// Noisy colour: linear radiance.
    pub color: *const BufferPlane,
    /// Albedo in [0, 1].
    pub albedo: *const BufferPlane,
    /// Shading normal in world or camera space, as normal_encoding says.
    pub normal: *const BufferPlane,
    /// Depth, as depth_encoding says.
    pub depth: *const BufferPlane,
    /// The colour's noise.
    pub noise: *const BufferPlane,
    /// Where the denoised colour goes.
    pub output: *const BufferPlane,
    /// A vkdenoise_noise_kind.
    pub noise_kind: u32,
    /// Must be 0.
    pub reserved: u32,
    /// Signals in buffers that go through the colour's kernels, one after the other in memory.
    pub signals: *const BufferSignal,
    /// How many there are.
    pub signal_count: usize,
    /// A vkdenoise_normal_encoding.
    pub normal_encoding: u32,
    /// A vkdenoise_depth_encoding.
    pub depth_encoding: u32,
    /// Distance of a projection's near plane.
    pub depth_near: f32,
    /// Distance of its far plane.
    pub depth_far: f32,
}
descriptor!(BufferFrame, "vkdenoise_buffer_frame", reserved: u32);

/// A two-dimensional image.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct ImagePlane {
    /// sizeof(vkdenoise_image_plane).
    pub struct_size: usize,
    /// A VkImageView of one 2D level. Inputs need VK_IMAGE_USAGE_SAMPLED_BIT, the output VK_IMAGE_USAGE_STORAGE_BIT.
    pub view: u64,
    /// Its VkFormat, each VK_FORMAT_...: every plane but depth and noise R16G16B16A16_SFLOAT, R32G32B32A32_SFLOAT;
    /// colour and albedo B10G11R11_UFLOAT_PACK32; albedo R8G8B8A8_UNORM, R8G8B8A8_SRGB; normal R8G8B8A8_UNORM,
    /// A2B10G10R10_UNORM_PACK32, R16G16B16A16_SNORM, and where it is octahedral R16G16_SNORM, R16G16_SFLOAT,
    /// R32G32_SFLOAT; depth and noise R32_SFLOAT, R16_SFLOAT; depth D32_SFLOAT, D16_UNORM.
    pub format: u32,
    /// The VkImageLayout that it is in when the commands run: VK_IMAGE_LAYOUT_GENERAL, or for inputs
    /// VK_IMAGE_LAYOUT_SHADER_READ_ONLY_OPTIMAL, for depth buffers also VK_IMAGE_LAYOUT_DEPTH_READ_ONLY_OPTIMAL or
    /// VK_IMAGE_LAYOUT_DEPTH_STENCIL_READ_ONLY_OPTIMAL.
    pub layout: u32,
    /// Its pixels in x.
    pub width: u32,
    /// Its pixels in y.
    pub height: u32,
}
descriptor!(ImagePlane, "vkdenoise_image_plane", height: u32);

/// A frame in a renderer's images. Every plane but colour and output may be NULL; output and colour must be two
/// images. The output's alpha becomes the colour's.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct ImageFrame {
    /// sizeof(vkdenoise_image_frame).
    pub struct_size: usize,
    /// Noisy colour: linear radiance.
    pub color: *const ImagePlane,
    /// Albedo in [0, 1].
    pub albedo: *const ImagePlane,
    /// Shading normal in world or camera space, as normal_encoding says.
    pub normal: *const ImagePlane,
    /// Depth, as depth_encoding says.
    pub depth: *const ImagePlane,
    /// The colour's noise.
    pub noise: *const ImagePlane,
    /// Where the denoised colour goes.
    pub output: *const ImagePlane,
    /// A vkdenoise_noise_kind.
    pub noise_kind: u32,
    /// Must be 0.
    pub reserved: u32,
    /// Signals in buffers that go through the colour's kernels, one after the other in memory.
    pub signals: *const BufferSignal,
    /// How many there are.
    pub signal_count: usize,
    /// A vkdenoise_normal_encoding.
    pub normal_encoding: u32,
    /// A vkdenoise_depth_encoding.
    pub depth_encoding: u32,
    /// Distance of a projection's near plane.
    pub depth_near: f32,
    /// Distance of its far plane.
    pub depth_far: f32,
}
descriptor!(ImageFrame, "vkdenoise_image_frame", reserved: u32);

/// A plane that a frame cannot do without.
pub fn needed<P>(plane: Option<P>, name: &str) -> Result<P, Failure> {
    plane.ok_or_else(|| Failure::argument(format!("the {name} plane is NULL")))
}

/// # Safety
/// The plane is as its header says, or null.
pub unsafe fn buffer(
    plane: *const BufferPlane,
    name: &'static str,
    extent: Extent,
    channels: u64,
) -> Result<Option<vkdenoise::BufferPlane>, Failure> {
    if plane.is_null() {
        return Ok(None);
    }
    // SAFETY: as the caller's.
    let plane = unsafe { descriptor::read(plane)? };
    reserved::<BufferPlane>(plane.reserved)?;
    if plane.buffer == 0 {
        return Err(Failure::argument(format!("the buffer of the {name} plane is VK_NULL_HANDLE")));
    }
    let format = SampleFormat::from_c(plane.format, name)?;
    let channels = if format == vkdenoise::SampleFormat::Rgb10A2Unorm { 1 } else { channels };
    let strides = Strides { pixel: plane.pixel_stride, row: plane.row_stride, channel: plane.channel_stride };
    let placed = place(name, extent, channels, format.bytes(), plane.offset, strides)?;
    let reached = placed.reach * format.bytes();
    if reached > plane.size {
        let reason = format!("the frame reaches byte {reached} of the buffer, and it has {}", plane.size);
        return Err(Error::PlaneMismatch { plane: name, reason }.into());
    }
    Ok(Some(vkdenoise::BufferPlane {
        buffer: vk::Buffer::from_raw(plane.buffer),
        size: plane.size,
        format,
        layout: placed.layout,
    }))
}

const IMAGE_FORMATS: [(vk::Format, ImageFormat); 14] = [
    (vk::Format::R16G16B16A16_SFLOAT, ImageFormat::Rgba16F),
    (vk::Format::R32G32B32A32_SFLOAT, ImageFormat::Rgba32F),
    (vk::Format::R32_SFLOAT, ImageFormat::R32F),
    (vk::Format::R16_SFLOAT, ImageFormat::R16F),
    (vk::Format::B10G11R11_UFLOAT_PACK32, ImageFormat::B10G11R11F),
    (vk::Format::R8G8B8A8_UNORM, ImageFormat::Rgba8Unorm),
    (vk::Format::R8G8B8A8_SRGB, ImageFormat::Rgba8Srgb),
    (vk::Format::A2B10G10R10_UNORM_PACK32, ImageFormat::Rgb10A2Unorm),
    (vk::Format::R16G16B16A16_SNORM, ImageFormat::Rgba16Snorm),
    (vk::Format::R16G16_SNORM, ImageFormat::Rg16Snorm),
    (vk::Format::R16G16_SFLOAT, ImageFormat::Rg16F),
    (vk::Format::R32G32_SFLOAT, ImageFormat::Rg32F),
    (vk::Format::D32_SFLOAT, ImageFormat::D32F),
    (vk::Format::D16_UNORM, ImageFormat::D16Unorm),
];

/// # Safety
/// The plane is as its header says, or null.
unsafe fn image(plane: *const ImagePlane, name: &'static str) -> Result<Option<vkdenoise::ImagePlane>, Failure> {
    if plane.is_null() {
        return Ok(None);
    }
    // SAFETY: as the caller's.
    let plane = unsafe { descriptor::read(plane)? };
    if plane.view == 0 {
        return Err(Failure::argument(format!("the view of the {name} plane is VK_NULL_HANDLE")));
    }
    // Numbers beyond Vulkan's own i32 are no format and no layout.
    let number = |value: u32| i32::try_from(value).unwrap_or(-1);
    let has = vk::Format::from_raw(number(plane.format));
    let known = IMAGE_FORMATS.iter().find(|(format, _)| *format == has);
    let Some((_, format)) = known.copied() else {
        let known = IMAGE_FORMATS.map(|(format, _)| format);
        return Err(Failure::argument(format!("the {name} image has the format {has:?}; images can be {known:?}")));
    };
    Ok(Some(vkdenoise::ImagePlane {
        view: vk::ImageView::from_raw(plane.view),
        format,
        extent: Extent::new(plane.width, plane.height),
        layout: vk::ImageLayout::from_raw(number(plane.layout)),
    }))
}

fn noise<P>(plane: Option<P>, kind: u32) -> Result<Option<Noise<P>>, Failure> {
    let kind = NoiseKind::from_c(kind)?;
    Ok(plane.map(|plane| Noise { plane, kind }))
}

/// # Safety
/// The frame is as its header says, or null.
pub unsafe fn buffer_frame(
    frame: *const BufferFrame,
    extent: Extent,
) -> Result<(vkdenoise::BufferFrame, Vec<vkdenoise::BufferSignal>), Failure> {
    // SAFETY: as the caller's; the same below.
    let frame = unsafe { descriptor::read(frame)? };
    reserved::<BufferFrame>(frame.reserved)?;
    // SAFETY: as above.
    let signals = unsafe { buffer_signals(frame.signals, frame.signal_count, extent)? };
    // SAFETY: as above.
    unsafe {
        let mut planes = vkdenoise::BufferFrame::new(
            needed(buffer(frame.color, "colour", extent, 3)?, "colour")?,
            needed(buffer(frame.output, "output", extent, 3)?, "output")?,
        );
        planes.albedo = buffer(frame.albedo, "albedo", extent, 3)?;
        planes.normal_encoding = NormalEncoding::from_c(frame.normal_encoding)?;
        planes.depth_encoding = DepthEncoding::from_c(frame.depth_encoding, frame.depth_near, frame.depth_far)?;
        let normal_channels = if planes.normal_encoding == CoreNormal::Octahedral { 2 } else { 3 };
        planes.normal = buffer(frame.normal, "normal", extent, normal_channels)?;
        planes.depth = buffer(frame.depth, "depth", extent, 1)?;
        planes.noise = noise(buffer(frame.noise, "noise", extent, 1)?, frame.noise_kind)?;
        Ok((planes, signals))
    }
}

/// # Safety
/// The frame is as its header says, or null.
pub unsafe fn image_frame(
    frame: *const ImageFrame,
    extent: Extent,
) -> Result<(vkdenoise::ImageFrame, Vec<vkdenoise::BufferSignal>), Failure> {
    // SAFETY: as the caller's; the same below.
    let frame = unsafe { descriptor::read(frame)? };
    reserved::<ImageFrame>(frame.reserved)?;
    // SAFETY: as above.
    let signals = unsafe { buffer_signals(frame.signals, frame.signal_count, extent)? };
    // SAFETY: as above.
    unsafe {
        let mut planes = vkdenoise::ImageFrame::new(
            needed(image(frame.color, "colour")?, "colour")?,
            needed(image(frame.output, "output")?, "output")?,
        );
        planes.albedo = image(frame.albedo, "albedo")?;
        planes.normal_encoding = NormalEncoding::from_c(frame.normal_encoding)?;
        planes.depth_encoding = DepthEncoding::from_c(frame.depth_encoding, frame.depth_near, frame.depth_far)?;
        planes.normal = image(frame.normal, "normal")?;
        planes.depth = image(frame.depth, "depth")?;
        planes.noise = noise(image(frame.noise, "noise")?, frame.noise_kind)?;
        Ok((planes, signals))
    }
}

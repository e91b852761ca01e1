//! An image of the renderer that the tests play.

use super::vulkan::Renderer;
use ash::vk;
use half::f16;
use vkdenoise::{Extent, ImageFormat, ImagePlane};

/// An image in GENERAL layout, filled through a buffer.
pub struct RendererImage<'a> {
    renderer: &'a Renderer,
    raw: vk::Image,
    view: vk::ImageView,
    format: ImageFormat,
    extent: Extent,
}

fn vk_format(format: ImageFormat) -> vk::Format {
    match format {
        ImageFormat::Rgba16F => vk::Format::R16G16B16A16_SFLOAT,
        ImageFormat::Rgba32F => vk::Format::R32G32B32A32_SFLOAT,
        ImageFormat::R32F => vk::Format::R32_SFLOAT,
        ImageFormat::R16F => vk::Format::R16_SFLOAT,
        ImageFormat::B10G11R11F => vk::Format::B10G11R11_UFLOAT_PACK32,
        ImageFormat::Rgba8Unorm => vk::Format::R8G8B8A8_UNORM,
        ImageFormat::Rgba8Srgb => vk::Format::R8G8B8A8_SRGB,
        ImageFormat::Rgb10A2Unorm => vk::Format::A2B10G10R10_UNORM_PACK32,
        ImageFormat::Rgba16Snorm => vk::Format::R16G16B16A16_SNORM,
        ImageFormat::Rg16Snorm => vk::Format::R16G16_SNORM,
        ImageFormat::Rg16F => vk::Format::R16G16_SFLOAT,
        ImageFormat::Rg32F => vk::Format::R32G32_SFLOAT,
        ImageFormat::D32F => vk::Format::D32_SFLOAT,
        ImageFormat::D16Unorm => vk::Format::D16_UNORM,
        other => panic!("{other:?} has no Vulkan format here"),
    }
}

fn aspect(format: ImageFormat) -> vk::ImageAspectFlags {
    match format {
        ImageFormat::D32F | ImageFormat::D16Unorm => vk::ImageAspectFlags::DEPTH,
        _ => vk::ImageAspectFlags::COLOR,
    }
}

fn whole(format: ImageFormat) -> vk::ImageSubresourceRange {
    vk::ImageSubresourceRange::default().aspect_mask(aspect(format)).level_count(1).layer_count(1)
}

impl<'a> RendererImage<'a> {
    /// An image with `values` of `channels` channels, alpha 1; zeroes where there are none.
    pub fn new(renderer: &'a Renderer, extent: Extent, format: ImageFormat, values: &[f32], channels: usize) -> Self {
        let pixels = extent.pixels() as usize;
        let texels: Vec<f32> = match (format, values) {
            (ImageFormat::R32F, []) => vec![0.0; pixels],
            (ImageFormat::R32F, values) => values.to_vec(),
            (_, []) => vec![0.0; 4 * pixels],
            (_, values) => values.chunks_exact(channels).flat_map(|c| [c[0], c[1], c[2], 1.0]).collect(),
        };
        let halves: Vec<f16> = texels.iter().map(|v| f16::from_f32(*v)).collect();
        let bytes: &[u8] = match format {
            ImageFormat::Rgba16F => bytemuck::cast_slice(&halves),
            _ => bytemuck::cast_slice(&texels),
        };
        Self::of_bytes(renderer, extent, format, bytes)
    }

    /// An image of these texels.
    pub fn of_bytes(renderer: &'a Renderer, extent: Extent, format: ImageFormat, bytes: &[u8]) -> Self {
        let vk_format = vk_format(format);
        let is_output = matches!(format, ImageFormat::Rgba16F | ImageFormat::Rgba32F);
        let usage = if is_output {
            vk::ImageUsageFlags::STORAGE | vk::ImageUsageFlags::TRANSFER_SRC
        } else {
            vk::ImageUsageFlags::empty()
        };
        let staging = renderer.buffer(bytes.len() as u64);
        staging.write(bytes);
        let info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(vk_format)
            .extent(vk::Extent3D { width: extent.width, height: extent.height, depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::TYPE_1)
            .usage(usage | vk::ImageUsageFlags::SAMPLED | vk::ImageUsageFlags::TRANSFER_DST);
        // SAFETY: plain image on our device.
        let (raw, view) = unsafe {
            let device = &renderer.device;
            let raw = device.create_image(&info, None).unwrap();
            let requirements = device.get_image_memory_requirements(raw);
            let memory = renderer.allocate(requirements, vk::MemoryPropertyFlags::DEVICE_LOCAL);
            device.bind_image_memory(raw, memory, 0).unwrap();
            let info = vk::ImageViewCreateInfo::default()
                .image(raw)
                .view_type(vk::ImageViewType::TYPE_2D)
                .format(vk_format)
                .subresource_range(whole(format));
            (raw, device.create_image_view(&info, None).unwrap())
        };
        let image = Self { renderer, raw, view, format, extent };
        let fence = renderer.submit(|commands| {
            let undefined = vk::ImageLayout::UNDEFINED;
            let transfer = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_WRITE);
            image.transition(
                commands,
                undefined,
                (vk::PipelineStageFlags::TOP_OF_PIPE, vk::AccessFlags::empty()),
                transfer,
            );
            // SAFETY: the command buffer is recording; image and staging live until the fence.
            unsafe {
                let copy = [image.region()];
                renderer.device.cmd_copy_buffer_to_image(commands, staging.raw, raw, vk::ImageLayout::GENERAL, &copy);
            }
            let compute =
                (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE);
            image.transition(commands, vk::ImageLayout::GENERAL, transfer, compute);
        });
        renderer.wait(fence);
        image
    }

    pub fn plane(&self) -> ImagePlane {
        ImagePlane { view: self.view, format: self.format, extent: self.extent, layout: vk::ImageLayout::GENERAL }
    }

    /// The image's RGB, read after the last compute work.
    pub fn read_rgb(&self) -> Vec<f32> {
        let bytes = if self.format == ImageFormat::Rgba16F { 8 } else { 16 };
        let staging = self.renderer.buffer(bytes * self.extent.pixels());
        let fence = self.renderer.submit(|commands| {
            let compute = (vk::PipelineStageFlags::COMPUTE_SHADER, vk::AccessFlags::SHADER_WRITE);
            let transfer = (vk::PipelineStageFlags::TRANSFER, vk::AccessFlags::TRANSFER_READ);
            self.transition(commands, vk::ImageLayout::GENERAL, compute, transfer);
            // SAFETY: the command buffer is recording; image and staging live until the fence.
            unsafe {
                let layout = vk::ImageLayout::GENERAL;
                let copy = [self.region()];
                self.renderer.device.cmd_copy_image_to_buffer(commands, self.raw, layout, staging.raw, &copy);
            }
            self.renderer.barrier_to_host(commands);
        });
        self.renderer.wait(fence);
        let bytes = staging.read();
        let texels: Vec<f32> = match self.format {
            ImageFormat::Rgba16F => bytemuck::cast_slice::<u8, f16>(&bytes).iter().map(|h| h.to_f32()).collect(),
            _ => bytemuck::cast_slice(&bytes).to_vec(),
        };
        assert!(texels.chunks_exact(4).all(|t| t[3] == 1.0), "the colour's alpha was not kept");
        texels.chunks_exact(4).flat_map(|t| [t[0], t[1], t[2]]).collect()
    }

    fn region(&self) -> vk::BufferImageCopy {
        vk::BufferImageCopy::default()
            .image_subresource(vk::ImageSubresourceLayers {
                aspect_mask: aspect(self.format),
                mip_level: 0,
                base_array_layer: 0,
                layer_count: 1,
            })
            .image_extent(vk::Extent3D { width: self.extent.width, height: self.extent.height, depth: 1 })
    }

    /// To GENERAL, with a barrier between the two uses.
    fn transition(
        &self,
        commands: vk::CommandBuffer,
        from_layout: vk::ImageLayout,
        (from, from_access): (vk::PipelineStageFlags, vk::AccessFlags),
        (to, to_access): (vk::PipelineStageFlags, vk::AccessFlags),
    ) {
        let barrier = [vk::ImageMemoryBarrier::default()
            .src_access_mask(from_access)
            .dst_access_mask(to_access)
            .old_layout(from_layout)
            .new_layout(vk::ImageLayout::GENERAL)
            .image(self.raw)
            .subresource_range(whole(self.format))];
        // SAFETY: the command buffer is recording.
        unsafe {
            let flags = vk::DependencyFlags::empty();
            self.renderer.device.cmd_pipeline_barrier(commands, from, to, flags, &[], &[], &barrier);
        }
    }
}

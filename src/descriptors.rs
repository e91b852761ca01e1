//! Descriptor sets of a pass: the renderer's images, and texel buffers over the arena and the weights for the kernels
//! of CPU drivers. Written once, before anything is recorded; never updated.

use crate::error::Result;
use crate::kernels::contract::{BindingType, Contract};
use crate::kernels::planes::Role;
use crate::kernels::{Storage, TexelRange};
use crate::plan::Dispatch;
use crate::renderer::{ImageFrame, ImagePlane};
use crate::vk::Checked;
use crate::vk::device::Device;
use crate::vk::pipeline::{Pipeline, descriptor_type};
use ash::vk;

/// Where a range of texels lies: buffer, first byte, bytes.
pub(crate) type Location = (vk::Buffer, u64, u64);

/// One set for each dispatch that has descriptors.
pub(crate) struct DescriptorSets {
    device: Device,
    pool: vk::DescriptorPool,
    views: Vec<vk::BufferView>,
    /// One for each dispatch; null where the kernel has no descriptors.
    sets: Vec<vk::DescriptorSet>,
}

/// What the descriptors name.
pub(crate) struct Resources<'a> {
    /// The renderer's images, where the variants read images.
    pub images: Option<&'a ImageFrame>,
    /// Where the texels of a range lie.
    pub texels: &'a dyn Fn(&TexelRange) -> Location,
}

impl DescriptorSets {
    /// Makes and writes the sets of `dispatches`, whose pipelines are `pipelines`.
    ///
    /// # Safety
    /// Images and buffers are valid and belong to the device; they and the pipelines live as long as the sets.
    pub unsafe fn new(
        device: &Device,
        dispatches: &[Dispatch],
        pipelines: &[Pipeline],
        resources: &Resources,
    ) -> Result<Self> {
        let mut made = Self {
            device: device.clone(),
            pool: vk::DescriptorPool::null(),
            views: Vec::new(),
            sets: vec![vk::DescriptorSet::null(); dispatches.len()],
        };
        let contracts: Vec<_> = dispatches.iter().map(|dispatch| dispatch.variant.contract).collect();
        let Some(pool) = make_pool(device, &contracts)? else { return Ok(made) };
        made.pool = pool;
        for (i, contract) in contracts.iter().enumerate().filter(|(_, contract)| !contract.bindings().is_empty()) {
            let layouts = [pipelines[i].set_layout];
            let info = vk::DescriptorSetAllocateInfo::default().descriptor_pool(pool).set_layouts(&layouts);
            // SAFETY: pool and layout are of this device; nobody else uses the pool.
            let sets = unsafe { device.raw().allocate_descriptor_sets(&info) }.called("vkAllocateDescriptorSets")?;
            made.sets[i] = sets.first().copied().unwrap_or_default();
            let mut ranges = dispatches[i].call.kernel().texels().into_iter();
            for (at, binding) in (0..).zip(contract.bindings()) {
                let mut write = vk::WriteDescriptorSet::default()
                    .dst_set(made.sets[i])
                    .dst_binding(at)
                    .descriptor_count(1)
                    .descriptor_type(descriptor_type(binding.ty));
                let (image, view);
                match binding.ty {
                    BindingType::TexelBuffer => {
                        let Some(range) = ranges.next() else { continue };
                        // SAFETY: the caller vouches for the buffer.
                        view = [unsafe { made.view((resources.texels)(&range), range.storage) }?];
                        write = write.texel_buffer_view(&view);
                    }
                    BindingType::SampledImage | BindingType::StorageImage => {
                        let Some(plane) = resources.images.map(|frame| image_of(frame, binding.name)) else { continue };
                        image = [vk::DescriptorImageInfo::default().image_view(plane.view).image_layout(plane.layout)];
                        write = write.image_info(&image);
                    }
                }
                // SAFETY: the set is new, so not in flight; the caller vouches for what it names.
                unsafe { device.raw().update_descriptor_sets(&[write], &[]) };
            }
        }
        Ok(made)
    }

    /// The set of a dispatch, null where its kernel has no descriptors.
    pub fn of(&self, dispatch: usize) -> vk::DescriptorSet {
        self.sets.get(dispatch).copied().unwrap_or_default()
    }

    /// A view of four elements a texel.
    ///
    /// # Safety
    /// The buffer is valid and of the device.
    unsafe fn view(&mut self, (buffer, offset, bytes): Location, storage: Storage) -> Result<vk::BufferView> {
        let format = match storage {
            Storage::F32 => vk::Format::R32G32B32A32_SFLOAT,
            Storage::F16 => vk::Format::R16G16B16A16_SFLOAT,
        };
        let info = vk::BufferViewCreateInfo::default().buffer(buffer).format(format).offset(offset).range(bytes);
        // SAFETY: the caller vouches for the buffer.
        let view = unsafe { self.device.raw().create_buffer_view(&info, None) }.called("vkCreateBufferView")?;
        self.views.push(view);
        Ok(view)
    }
}

/// A pool for one set of each contract; `None` where none has descriptors.
fn make_pool(device: &Device, contracts: &[&Contract]) -> Result<Option<vk::DescriptorPool>> {
    let count = |ty| contracts.iter().flat_map(|c| c.bindings()).filter(|binding| binding.ty == ty).count() as u32;
    let sizes: Vec<_> = [BindingType::SampledImage, BindingType::StorageImage, BindingType::TexelBuffer]
        .into_iter()
        .map(|ty| vk::DescriptorPoolSize::default().ty(descriptor_type(ty)).descriptor_count(count(ty)))
        .filter(|size| size.descriptor_count > 0)
        .collect();
    if sizes.is_empty() {
        return Ok(None);
    }
    let sets = contracts.iter().filter(|contract| !contract.bindings().is_empty()).count();
    let info = vk::DescriptorPoolCreateInfo::default().max_sets(sets as u32).pool_sizes(&sizes);
    // SAFETY: the device is alive.
    unsafe { device.raw().create_descriptor_pool(&info, None) }.called("vkCreateDescriptorPool").map(Some)
}

/// The image that a shader knows by `name`. A missing plane is never read, but its descriptor must be valid: the colour
/// stands in.
fn image_of(frame: &ImageFrame, name: &str) -> ImagePlane {
    let role = Role::ALL.into_iter().find(|role| role.image() == name);
    *role.and_then(|role| frame.plane(role)).unwrap_or(&frame.color)
}

impl Drop for DescriptorSets {
    fn drop(&mut self) {
        let device = self.device.raw();
        // SAFETY: the owner outlives the commands that use the sets; sets go with their pool, null handles are allowed.
        unsafe {
            device.destroy_descriptor_pool(self.pool, None);
            self.views.iter().for_each(|view| device.destroy_buffer_view(*view, None));
        }
    }
}

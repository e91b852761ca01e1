//! Compute pipelines, one for each kernel variant and specialisation that a plan uses.

use super::Checked;
use super::device::Device;
use crate::error::Result;
use crate::kernels::contract::{BindingType, Contract, Specialisation};
use ash::vk;
use std::collections::HashMap;

/// A variant's name, and what its pipeline is specialised for.
pub(crate) type Specialised = (&'static str, Specialisation);

/// The pipelines of a device, which destroys them when it goes.
pub(crate) type MadePipelines = HashMap<Specialised, Pipeline>;

/// A compiled kernel: handles of the device's.
#[derive(Clone, Copy, Default)]
pub(crate) struct Pipeline {
    pub raw: vk::Pipeline,
    pub layout: vk::PipelineLayout,
    /// Layout of set 0; null for kernels without descriptors.
    pub set_layout: vk::DescriptorSetLayout,
}

impl Pipeline {
    /// Builds the variant that `contract` describes, specialised.
    pub fn new(device: &Device, contract: &Contract, special: Specialisation) -> Result<Self> {
        let mut pipeline = Self::default();
        let made = pipeline.make(device, contract, special);
        if made.is_err() {
            // SAFETY: it is of this device, and nobody has it yet.
            unsafe { pipeline.destroy(device.raw()) };
        }
        made.map(|()| pipeline)
    }

    /// Fills in one handle after the other.
    fn make(&mut self, device: &Device, contract: &Contract, special: Specialisation) -> Result<()> {
        let vk_device = device.raw();
        let bindings: Vec<_> = contract
            .bindings()
            .iter()
            .zip(0..)
            .map(|(binding, at)| {
                vk::DescriptorSetLayoutBinding::default()
                    .binding(at)
                    .descriptor_type(descriptor_type(binding.ty))
                    .descriptor_count(1)
                    .stage_flags(vk::ShaderStageFlags::COMPUTE)
            })
            .collect();
        let mut set_layouts = Vec::new();
        if !bindings.is_empty() {
            let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
            // SAFETY: the device is alive and `info` outlives the call.
            self.set_layout =
                unsafe { vk_device.create_descriptor_set_layout(&info, None) }.called("vkCreateDescriptorSetLayout")?;
            set_layouts.push(self.set_layout);
        }
        let ranges =
            [vk::PushConstantRange::default().stage_flags(vk::ShaderStageFlags::COMPUTE).size(contract.push_size())];
        let info = vk::PipelineLayoutCreateInfo::default().set_layouts(&set_layouts).push_constant_ranges(&ranges);
        // SAFETY: as above.
        self.layout = unsafe { vk_device.create_pipeline_layout(&info, None) }.called("vkCreatePipelineLayout")?;

        let words = crate::kernels::spirv::words(&contract.module(device.caps().sharing()));
        let info = vk::ShaderModuleCreateInfo::default().code(words);
        // SAFETY: `words` is SPIR-V that the build compiled and validated.
        let module = unsafe { vk_device.create_shader_module(&info, None) }.called("vkCreateShaderModule")?;
        let values: Vec<u32> = contract.constants.iter().map(|c| device.caps().constant(c.value, special)).collect();
        let entries: Vec<_> = (0..values.len() as u32)
            .map(|id| vk::SpecializationMapEntry::default().constant_id(id).offset(4 * id).size(4))
            .collect();
        let constants = vk::SpecializationInfo::default().map_entries(&entries).data(bytemuck::cast_slice(&values));
        let mut size = vk::PipelineShaderStageRequiredSubgroupSizeCreateInfo::default();
        let mut stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(vk::ShaderStageFlags::COMPUTE)
            .module(module)
            .specialization_info(&constants)
            .name(c"main");
        if let Some(shape) = device.caps().matrix.filter(|_| contract.needs_matrix()) {
            size.required_subgroup_size = shape.subgroup;
            stage = stage.flags(vk::PipelineShaderStageCreateFlags::REQUIRE_FULL_SUBGROUPS).push_next(&mut size);
        }
        let flags = match device.executables() {
            Some(_) => vk::PipelineCreateFlags::CAPTURE_STATISTICS_KHR,
            None => vk::PipelineCreateFlags::empty(),
        };
        let info = vk::ComputePipelineCreateInfo::default().flags(flags).stage(stage).layout(self.layout);
        // SAFETY: module, layout and cache are alive.
        let made = unsafe { vk_device.create_compute_pipelines(device.pipeline_cache().raw, &[info], None) };
        // SAFETY: a module may go once its pipelines are made.
        unsafe { vk_device.destroy_shader_module(module, None) };
        self.raw =
            made.map_err(|(_, result)| result).called("vkCreateComputePipelines")?.first().copied().unwrap_or_default();
        device.name(self.raw, &format!("{}{special}", contract.name));
        Ok(())
    }

    /// Destroys what there is of it.
    ///
    /// # Safety
    /// It is of this device, no recording that uses it is pending, and nobody uses it afterwards.
    pub unsafe fn destroy(self, device: &ash::Device) {
        // SAFETY: the caller vouches for the handles; destroying null is allowed.
        unsafe {
            device.destroy_pipeline(self.raw, None);
            device.destroy_pipeline_layout(self.layout, None);
            device.destroy_descriptor_set_layout(self.set_layout, None);
        }
    }
}

pub(crate) fn descriptor_type(ty: BindingType) -> vk::DescriptorType {
    match ty {
        BindingType::SampledImage => vk::DescriptorType::SAMPLED_IMAGE,
        BindingType::StorageImage => vk::DescriptorType::STORAGE_IMAGE,
        BindingType::TexelBuffer => vk::DescriptorType::UNIFORM_TEXEL_BUFFER,
    }
}

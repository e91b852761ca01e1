//! Cooperative matrices (`VK_KHR_cooperative_matrix`): whether a device has those that the kernels use, and what must
//! be enabled for them.

use ash::{ext, khr, vk};
use std::ffi::CStr;

/// Sides that the kernels' blocks of 16 tokens or channels and rows of 16 halves can be cut into.
const SIDES: [u32; 2] = [8, 16];
const DEPTHS: [u32; 2] = [8, 16];

/// Device extensions that matrix kernels need.
pub(crate) const EXTENSIONS: [&CStr; 2] = [khr::cooperative_matrix::NAME, ext::subgroup_size_control::NAME];

/// Features that they need.
pub(crate) const FEATURES: [&str; 7] = [
    "cooperativeMatrix",
    "subgroupSizeControl",
    "computeFullSubgroups",
    "storageBuffer16BitAccess",
    "shaderFloat16",
    "vulkanMemoryModel",
    // Where the model is on, atomics of the other kernels need this too.
    "vulkanMemoryModelDeviceScope",
];

/// Size of a device's matrices: rows x depth halves times depth x columns halves, added to rows x columns 32-bit
/// floats, by the invocations of one subgroup.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MatrixShape {
    /// Rows of the first factor and of the sum.
    pub rows: u32,
    /// Columns of the second factor and of the sum.
    pub columns: u32,
    /// Columns of the first factor, rows of the second.
    pub depth: u32,
    /// Invocations of a subgroup, which the kernels' pipelines ask for.
    pub subgroup: u32,
    /// Subgroups that share a tile's tokens in dense kernels, 1 or 2: more hold less each.
    pub halves: u32,
    /// The same where a dispatch has few workgroups ([`crate::kernels::contract::Specialisation::few`]): then a tile
    /// takes as long as the whole map.
    pub halves_of_few: u32,
}

/// Those of the features that are not of Vulkan 1.2, to be enabled when a device is made.
pub(crate) struct Features {
    pub matrix: vk::PhysicalDeviceCooperativeMatrixFeaturesKHR<'static>,
    pub subgroup: vk::PhysicalDeviceSubgroupSizeControlFeatures<'static>,
}

impl Features {
    /// All of them.
    pub fn all() -> Self {
        Self {
            matrix: vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default().cooperative_matrix(true),
            subgroup: vk::PhysicalDeviceSubgroupSizeControlFeatures::default()
                .subgroup_size_control(true)
                .compute_full_subgroups(true),
        }
    }
}

/// The matrices of a device of Vulkan 1.2 or later; `None` where it lacks an extension, a feature or a shape that fits.
pub(crate) fn shape(
    loader: &khr::cooperative_matrix::Instance,
    instance: &ash::Instance,
    physical: vk::PhysicalDevice,
) -> Option<MatrixShape> {
    // SAFETY: `physical` comes from `instance`, of which `loader` is; the same below.
    let extensions = unsafe { instance.enumerate_device_extension_properties(physical) }.ok()?;
    let has = |name: &CStr| extensions.iter().any(|extension| extension.extension_name_as_c_str() == Ok(name));
    if !EXTENSIONS.into_iter().all(has) {
        return None;
    }
    let (mut features11, mut features12) =
        (vk::PhysicalDeviceVulkan11Features::default(), vk::PhysicalDeviceVulkan12Features::default());
    let mut found = Features {
        matrix: vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default(),
        subgroup: vk::PhysicalDeviceSubgroupSizeControlFeatures::default(),
    };
    let mut features = vk::PhysicalDeviceFeatures2::default()
        .push_next(&mut features11)
        .push_next(&mut features12)
        .push_next(&mut found.matrix)
        .push_next(&mut found.subgroup);
    // SAFETY: as above; the chained structs are of extensions that the device has.
    unsafe { instance.get_physical_device_features2(physical, &mut features) };
    let wanted = [
        found.matrix.cooperative_matrix,
        found.subgroup.subgroup_size_control,
        found.subgroup.compute_full_subgroups,
        features11.storage_buffer16_bit_access,
        features12.shader_float16,
        features12.vulkan_memory_model,
        features12.vulkan_memory_model_device_scope,
    ];
    if wanted.contains(&vk::FALSE) {
        return None;
    }
    let mut matrix = vk::PhysicalDeviceCooperativeMatrixPropertiesKHR::default();
    let mut control = vk::PhysicalDeviceSubgroupSizeControlProperties::default();
    let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
    let mut properties = vk::PhysicalDeviceProperties2::default()
        .push_next(&mut matrix)
        .push_next(&mut control)
        .push_next(&mut subgroup);
    // SAFETY: as above.
    unsafe { instance.get_physical_device_properties2(physical, &mut properties) };
    let compute = vk::ShaderStageFlags::COMPUTE;
    let size = subgroup.subgroup_size;
    if !matrix.cooperative_matrix_supported_stages.contains(compute)
        || !control.required_subgroup_size_stages.contains(compute)
        || !(control.min_subgroup_size..=control.max_subgroup_size).contains(&size)
    {
        return None;
    }
    // SAFETY: as above.
    let shapes = unsafe { loader.get_physical_device_cooperative_matrix_properties(physical) }.ok()?;
    choose(&shapes, size)
}

/// The largest of the shapes that fit: halves in, 32-bit floats out, by a subgroup.
fn choose(shapes: &[vk::CooperativeMatrixPropertiesKHR], subgroup: u32) -> Option<MatrixShape> {
    use vk::ComponentTypeKHR as Type;
    let halves = |s: &&vk::CooperativeMatrixPropertiesKHR| {
        (s.a_type, s.b_type, s.c_type, s.result_type) == (Type::FLOAT16, Type::FLOAT16, Type::FLOAT32, Type::FLOAT32)
            && s.scope == vk::ScopeKHR::SUBGROUP
    };
    shapes
        .iter()
        .filter(halves)
        .filter(|s| SIDES.contains(&s.m_size) && SIDES.contains(&s.n_size) && DEPTHS.contains(&s.k_size))
        .map(|s| MatrixShape {
            rows: s.m_size,
            columns: s.n_size,
            depth: s.k_size,
            subgroup,
            // CPU drivers, which have the small ones, compile half as much code in a fraction of the time.
            halves: if s.m_size < 16 { 2 } else { 1 },
            halves_of_few: 2,
        })
        .max_by_key(|s| s.rows * s.columns * s.depth)
}

#[cfg(test)]
mod tests {
    use super::*;

    type Type = vk::ComponentTypeKHR;

    fn listed((m, n, k): (u32, u32, u32), factors: Type, sum: Type) -> vk::CooperativeMatrixPropertiesKHR<'static> {
        vk::CooperativeMatrixPropertiesKHR::default()
            .m_size(m)
            .n_size(n)
            .k_size(k)
            .a_type(factors)
            .b_type(factors)
            .c_type(sum)
            .result_type(sum)
            .scope(vk::ScopeKHR::SUBGROUP)
    }

    #[test]
    fn the_largest_shape_of_halves_and_floats_is_taken() {
        let (half, float) = (Type::FLOAT16, Type::FLOAT32);
        let mut shapes = vec![
            listed((16, 16, 16), half, half),
            listed((16, 16, 32), Type::SINT8, Type::SINT32),
            listed((64, 16, 16), half, float),
            listed((16, 16, 16), half, float).scope(vk::ScopeKHR::WORKGROUP),
        ];
        assert_eq!(choose(&shapes, 32), None);
        shapes.extend([(16, 8, 8), (16, 16, 16), (16, 8, 16)].map(|size| listed(size, half, float)));
        assert_eq!(
            choose(&shapes, 32),
            Some(MatrixShape { rows: 16, columns: 16, depth: 16, subgroup: 32, halves: 1, halves_of_few: 2 })
        );
    }
}

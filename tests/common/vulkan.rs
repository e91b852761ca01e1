//! A renderer's own Vulkan: instance with validation, device, queue, buffers, images. Written with ash alone, as a
//! renderer would.

use ash::vk::Handle;
use ash::{ext, khr, vk};
use std::ffi::{CStr, c_void};
use std::sync::Mutex;
use vkdenoise::{Cache, Device, EnabledFeatures, RawDevice, RendererDevice};

pub struct Renderer {
    entry: ash::Entry,
    pub instance: ash::Instance,
    pub physical_device: vk::PhysicalDevice,
    pub device: ash::Device,
    pub queue_family: u32,
    pub storage16: bool,
    pub int64: bool,
    broadcast_dynamic_id: bool,
    pub host_query_reset: bool,
    matrices: bool,
    /// Where the device has it.
    pub external_memory: Option<khr::external_memory_fd::Device>,
    pub queue: vk::Queue,
    pool: vk::CommandPool,
    memory: vk::PhysicalDeviceMemoryProperties,
    messages: Box<Mutex<Vec<String>>>,
}

unsafe extern "system" fn on_message(
    _: vk::DebugUtilsMessageSeverityFlagsEXT,
    _: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid data; the user pointer is the renderer's boxed list.
    unsafe {
        let text = (*data).message_as_c_str().unwrap_or(c"").to_string_lossy().into_owned();
        (*user.cast::<Mutex<Vec<String>>>()).lock().unwrap().push(text);
    }
    vk::FALSE
}

impl Renderer {
    /// A renderer on the device that the tests run on. It leaks its Vulkan objects when the process ends.
    pub fn new() -> Self {
        // SAFETY: plain Vulkan set-up; every pointer outlives its call.
        unsafe {
            let entry = ash::Entry::load().unwrap();
            let app = vk::ApplicationInfo::default().api_version(vk::API_VERSION_1_2);
            let layers = [c"VK_LAYER_KHRONOS_validation".as_ptr()];
            let extensions = [ext::debug_utils::NAME.as_ptr(), ext::validation_features::NAME.as_ptr()];
            let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
            let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
            let info = vk::InstanceCreateInfo::default()
                .application_info(&app)
                .enabled_layer_names(&layers)
                .enabled_extension_names(&extensions)
                .push_next(&mut features);
            let instance = entry.create_instance(&info, None).unwrap();
            let mut messages = Box::new(Mutex::new(Vec::new()));
            let info = vk::DebugUtilsMessengerCreateInfoEXT::default()
                .message_severity(
                    vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
                )
                .message_type(vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION)
                .pfn_user_callback(Some(on_message))
                .user_data((&raw mut *messages).cast());
            let loader = ext::debug_utils::Instance::new(&entry, &instance);
            loader.create_debug_utils_messenger(&info, None).unwrap();

            let wanted = super::device::device().info().name.clone();
            let physical_device = *instance
                .enumerate_physical_devices()
                .unwrap()
                .iter()
                .find(|p| {
                    let properties = instance.get_physical_device_properties(**p);
                    properties.device_name_as_c_str().map(CStr::to_string_lossy).is_ok_and(|name| name == wanted)
                })
                .unwrap();
            let families = instance.get_physical_device_queue_family_properties(physical_device);
            let compute = |f: &vk::QueueFamilyProperties| f.queue_flags.contains(vk::QueueFlags::COMPUTE);
            let queue_family = families.iter().position(compute).unwrap() as u32;

            let mut available11 = vk::PhysicalDeviceVulkan11Features::default();
            let mut available12 = vk::PhysicalDeviceVulkan12Features::default();
            let mut available =
                vk::PhysicalDeviceFeatures2::default().push_next(&mut available11).push_next(&mut available12);
            instance.get_physical_device_features2(physical_device, &mut available);
            let storage16 = available11.storage_buffer16_bit_access == vk::TRUE;
            let broadcast_dynamic_id = available12.subgroup_broadcast_dynamic_id == vk::TRUE;
            let host_query_reset = available12.host_query_reset == vk::TRUE;
            let int64 = instance.get_physical_device_features(physical_device).shader_int64 == vk::TRUE;
            assert_eq!(Device::requirements().features, ["bufferDeviceAddress"]);
            assert!(Device::requirements().extensions.is_empty());
            let matrices = super::device::device().has_matrices();
            let mut features12 = vk::PhysicalDeviceVulkan12Features::default()
                .buffer_device_address(true)
                .host_query_reset(host_query_reset)
                .subgroup_broadcast_dynamic_id(broadcast_dynamic_id)
                .shader_float16(matrices)
                .vulkan_memory_model(matrices)
                .vulkan_memory_model_device_scope(matrices);
            let mut matrix = vk::PhysicalDeviceCooperativeMatrixFeaturesKHR::default().cooperative_matrix(true);
            let mut subgroup = vk::PhysicalDeviceSubgroupSizeControlFeatures::default()
                .subgroup_size_control(true)
                .compute_full_subgroups(true);
            let known = instance.enumerate_device_extension_properties(physical_device).unwrap();
            let has_fds = known.iter().any(|e| e.extension_name_as_c_str() == Ok(khr::external_memory_fd::NAME));
            let mut names = Vec::new();
            if matrices {
                names.extend([khr::cooperative_matrix::NAME, ext::subgroup_size_control::NAME].map(CStr::as_ptr));
            }
            if has_fds {
                names.push(khr::external_memory_fd::NAME.as_ptr());
            }
            let mut features11 = vk::PhysicalDeviceVulkan11Features::default().storage_buffer16_bit_access(storage16);
            let queues =
                [vk::DeviceQueueCreateInfo::default().queue_family_index(queue_family).queue_priorities(&[1.0])];
            let features = vk::PhysicalDeviceFeatures::default().shader_int64(int64);
            let mut info = vk::DeviceCreateInfo::default()
                .queue_create_infos(&queues)
                .enabled_features(&features)
                .enabled_extension_names(&names)
                .push_next(&mut features12)
                .push_next(&mut features11);
            if matrices {
                info = info.push_next(&mut matrix).push_next(&mut subgroup);
            }
            let device = instance.create_device(physical_device, &info, None).unwrap();
            let queue = device.get_device_queue(queue_family, 0);
            let info = vk::CommandPoolCreateInfo::default().queue_family_index(queue_family);
            let pool = device.create_command_pool(&info, None).unwrap();
            let memory = instance.get_physical_device_memory_properties(physical_device);
            let external_memory = has_fds.then(|| khr::external_memory_fd::Device::new(&instance, &device));
            Self {
                entry,
                instance,
                physical_device,
                device,
                queue_family,
                storage16,
                int64,
                broadcast_dynamic_id,
                host_query_reset,
                matrices,
                external_memory,
                queue,
                pool,
                memory,
                messages,
            }
        }
    }

    /// What the denoiser is handed.
    pub fn handles(&self) -> RendererDevice {
        let (instance, device) = (self.instance.clone(), self.device.clone());
        let mut handles = RendererDevice::new(instance, self.physical_device, device, self.queue_family);
        handles.storage_buffer_16bit = self.storage16;
        handles.shader_int64 = self.int64;
        handles.subgroup_broadcast_dynamic_id = self.broadcast_dynamic_id;
        handles.host_query_reset = self.host_query_reset;
        handles.cooperative_matrix =
            self.matrices.then(|| khr::cooperative_matrix::Instance::new(&self.entry, &self.instance));
        handles.debug_utils = true;
        handles.cache = Cache::Off;
        handles
    }

    /// The same as numbers.
    pub fn raw(&self) -> RawDevice {
        let mut raw = RawDevice::new(
            self.entry.static_fn().get_instance_proc_addr as *const c_void,
            self.instance.handle().as_raw(),
            self.physical_device.as_raw(),
            self.device.handle().as_raw(),
            self.queue_family,
        );
        raw.enabled = EnabledFeatures {
            storage_buffer_16bit: self.storage16,
            shader_int64: self.int64,
            subgroup_broadcast_dynamic_id: self.broadcast_dynamic_id,
            host_query_reset: self.host_query_reset,
            cooperative_matrix: self.matrices,
            debug_utils: true,
        };
        raw
    }

    pub fn assert_silent(&self) {
        let messages = self.messages.lock().unwrap();
        assert!(messages.is_empty(), "validation: {messages:#?}");
    }

    fn commands(&self, record: impl FnOnce(vk::CommandBuffer)) -> vk::CommandBuffer {
        // SAFETY: pool and device are ours, used by one thread.
        unsafe {
            let info = vk::CommandBufferAllocateInfo::default().command_pool(self.pool).command_buffer_count(1);
            let commands = self.device.allocate_command_buffers(&info).unwrap()[0];
            self.device.begin_command_buffer(commands, &vk::CommandBufferBeginInfo::default()).unwrap();
            record(commands);
            self.device.end_command_buffer(commands).unwrap();
            commands
        }
    }

    /// Records without submitting.
    pub fn record_only(&self, record: impl FnOnce(vk::CommandBuffer)) {
        self.commands(record);
    }

    pub fn submit(&self, record: impl FnOnce(vk::CommandBuffer)) -> vk::Fence {
        let buffers = [self.commands(record)];
        // SAFETY: the command buffer is recorded; queue and fence are ours.
        unsafe {
            let fence = self.device.create_fence(&vk::FenceCreateInfo::default(), None).unwrap();
            let info = [vk::SubmitInfo::default().command_buffers(&buffers)];
            self.device.queue_submit(self.queue, &info, fence).unwrap();
            fence
        }
    }

    pub fn wait(&self, fence: vk::Fence) {
        // SAFETY: the fence is ours and was submitted.
        unsafe {
            self.device.wait_for_fences(&[fence], true, u64::MAX).unwrap();
            self.device.destroy_fence(fence, None);
        }
    }

    pub fn barrier_to_host(&self, commands: vk::CommandBuffer) {
        let barrier = [vk::MemoryBarrier::default()
            .src_access_mask(vk::AccessFlags::SHADER_WRITE | vk::AccessFlags::TRANSFER_WRITE)
            .dst_access_mask(vk::AccessFlags::HOST_READ)];
        let from = vk::PipelineStageFlags::COMPUTE_SHADER | vk::PipelineStageFlags::TRANSFER;
        let to = vk::PipelineStageFlags::HOST;
        // SAFETY: the command buffer is recording.
        unsafe {
            self.device.cmd_pipeline_barrier(commands, from, to, vk::DependencyFlags::empty(), &barrier, &[], &[]);
        }
    }

    pub fn allocate(&self, requirements: vk::MemoryRequirements, wanted: vk::MemoryPropertyFlags) -> vk::DeviceMemory {
        let fits = |(i, ty): &(usize, &vk::MemoryType)| {
            requirements.memory_type_bits & (1 << i) != 0 && ty.property_flags.contains(wanted)
        };
        let (index, _) = self.memory.memory_types_as_slice().iter().enumerate().find(fits).unwrap();
        let mut flags = vk::MemoryAllocateFlagsInfo::default().flags(vk::MemoryAllocateFlags::DEVICE_ADDRESS);
        let info = vk::MemoryAllocateInfo::default()
            .allocation_size(requirements.size)
            .memory_type_index(index as u32)
            .push_next(&mut flags);
        // SAFETY: plain allocation on our device.
        unsafe { self.device.allocate_memory(&info, None) }.unwrap()
    }

    pub fn buffer(&self, size: u64) -> RendererBuffer {
        let usage = vk::BufferUsageFlags::STORAGE_BUFFER
            | vk::BufferUsageFlags::SHADER_DEVICE_ADDRESS
            | vk::BufferUsageFlags::TRANSFER_SRC
            | vk::BufferUsageFlags::TRANSFER_DST;
        self.buffer_for(size, usage)
    }

    pub fn buffer_for(&self, size: u64, usage: vk::BufferUsageFlags) -> RendererBuffer {
        let info = vk::BufferCreateInfo::default().size(size).usage(usage);
        // SAFETY: plain buffer on our device, mapped for good.
        unsafe {
            let raw = self.device.create_buffer(&info, None).unwrap();
            let host = vk::MemoryPropertyFlags::HOST_VISIBLE | vk::MemoryPropertyFlags::HOST_COHERENT;
            let memory = self.allocate(self.device.get_buffer_memory_requirements(raw), host);
            self.device.bind_buffer_memory(raw, memory, 0).unwrap();
            let mapped = self.device.map_memory(memory, 0, size, vk::MemoryMapFlags::empty()).unwrap();
            mapped.cast::<u8>().write_bytes(0, size as usize);
            RendererBuffer { raw, size, mapped: mapped.cast() }
        }
    }
}

pub struct RendererBuffer {
    pub raw: vk::Buffer,
    pub size: u64,
    mapped: *mut u8,
}

impl RendererBuffer {
    pub fn write(&self, bytes: &[u8]) {
        assert!(bytes.len() as u64 <= self.size);
        // SAFETY: the memory is mapped and at least that long.
        unsafe { self.mapped.copy_from_nonoverlapping(bytes.as_ptr(), bytes.len()) };
    }

    pub fn read(&self) -> Vec<u8> {
        // SAFETY: the memory is mapped and that long.
        unsafe { std::slice::from_raw_parts(self.mapped, self.size as usize).to_vec() }
    }
}

//! Calls of the driver that fail: every one ends in an error, nothing leaks, and a new denoiser works afterwards.

mod common;

use ash::{DeviceFnV1_0, vk};
use common::compare::assert_same_bits;
use common::planes::TestFrame;
use std::sync::{Mutex, PoisonError};
use vkdenoise::testing::open_patched;
use vkdenoise::{
    Cache, Denoiser, Device, DeviceOptions, DeviceSelector, Error, Extent, Layout, Options, PlaneMut, Result, Weights,
};

/// What shall fail from some time on: the call's name, how many go well before, and how.
struct Fault {
    call: &'static str,
    wait: usize,
    result: vk::Result,
    /// Whether it has come to that.
    met: bool,
}

static FAULT: Mutex<Option<Fault>> = Mutex::new(None);
/// The functions of the device that was opened last: with the last instance, driver and layers are unloaded.
static DRIVER: Mutex<Option<DeviceFnV1_0>> = Mutex::new(None);

fn driver() -> DeviceFnV1_0 {
    DRIVER.lock().unwrap_or_else(PoisonError::into_inner).clone().unwrap()
}

/// The failure of this call, once it has come to that. It stays: an allocator may try elsewhere.
fn failure(call: &str) -> Option<vk::Result> {
    let mut fault = FAULT.lock().unwrap_or_else(PoisonError::into_inner);
    let fault = fault.as_mut().filter(|fault| fault.call == call)?;
    if fault.wait > 0 {
        fault.wait -= 1;
        return None;
    }
    fault.met = true;
    Some(fault.result)
}

/// Functions that fail when it has come to that and else are the driver's.
macro_rules! failing {
    ($($field:ident($($argument:ident: $ty:ty),*);)*) => {
        $(unsafe extern "system" fn $field($($argument: $ty),*) -> vk::Result {
            // SAFETY: the arguments are the caller's.
            failure(stringify!($field)).unwrap_or_else(|| unsafe { (driver().$field)($($argument),*) })
        })*

        fn patched(own: &DeviceFnV1_0) -> DeviceFnV1_0 {
            *DRIVER.lock().unwrap_or_else(PoisonError::into_inner) = Some(own.clone());
            DeviceFnV1_0 { $($field,)* ..own.clone() }
        }
    };
}

failing! {
    allocate_memory(d: vk::Device, i: *const vk::MemoryAllocateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::DeviceMemory);
    bind_buffer_memory(d: vk::Device, b: vk::Buffer, m: vk::DeviceMemory, o: vk::DeviceSize);
    create_buffer(d: vk::Device, i: *const vk::BufferCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::Buffer);
    create_buffer_view(d: vk::Device, i: *const vk::BufferViewCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::BufferView);
    create_shader_module(d: vk::Device, i: *const vk::ShaderModuleCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::ShaderModule);
    create_descriptor_set_layout(d: vk::Device, i: *const vk::DescriptorSetLayoutCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::DescriptorSetLayout);
    create_pipeline_layout(d: vk::Device, i: *const vk::PipelineLayoutCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::PipelineLayout);
    create_compute_pipelines(d: vk::Device, c: vk::PipelineCache, n: u32, i: *const vk::ComputePipelineCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::Pipeline);
    create_descriptor_pool(d: vk::Device, i: *const vk::DescriptorPoolCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::DescriptorPool);
    allocate_descriptor_sets(d: vk::Device, i: *const vk::DescriptorSetAllocateInfo<'_>, o: *mut vk::DescriptorSet);
    create_command_pool(d: vk::Device, i: *const vk::CommandPoolCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::CommandPool);
    allocate_command_buffers(d: vk::Device, i: *const vk::CommandBufferAllocateInfo<'_>, o: *mut vk::CommandBuffer);
    create_fence(d: vk::Device, i: *const vk::FenceCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::Fence);
    create_query_pool(d: vk::Device, i: *const vk::QueryPoolCreateInfo<'_>, a: *const vk::AllocationCallbacks<'_>, o: *mut vk::QueryPool);
    begin_command_buffer(c: vk::CommandBuffer, i: *const vk::CommandBufferBeginInfo<'_>);
    end_command_buffer(c: vk::CommandBuffer);
    reset_fences(d: vk::Device, n: u32, f: *const vk::Fence);
    queue_submit(q: vk::Queue, n: u32, s: *const vk::SubmitInfo<'_>, f: vk::Fence);
    wait_for_fences(d: vk::Device, n: u32, f: *const vk::Fence, all: vk::Bool32, timeout: u64);
}

/// Calls that run out of memory, and which of them to let fail: the first ones, and some later ones.
const HUNGRY: [&str; 16] = [
    "allocate_memory",
    "bind_buffer_memory",
    "create_buffer",
    "create_buffer_view",
    "create_shader_module",
    "create_descriptor_set_layout",
    "create_pipeline_layout",
    "create_compute_pipelines",
    "create_descriptor_pool",
    "allocate_descriptor_sets",
    "create_command_pool",
    "allocate_command_buffers",
    "create_fence",
    "create_query_pool",
    "begin_command_buffer",
    "end_command_buffer",
];

/// Those of them that make a kernel.
const COMPILING: [&str; 4] =
    ["create_shader_module", "create_descriptor_set_layout", "create_pipeline_layout", "create_compute_pipelines"];

/// Calls that notice a lost device.
const LOSING: [&str; 2] = ["queue_submit", "wait_for_fences"];

fn set(fault: Option<Fault>) -> Option<Fault> {
    std::mem::replace(&mut *FAULT.lock().unwrap_or_else(PoisonError::into_inner), fault)
}

fn open() -> Device {
    let selector = DeviceSelector::from_env().unwrap_or_default();
    let options = DeviceOptions { selector, validation: true, cache: Cache::Off, ..DeviceOptions::default() };
    // SAFETY: the patched functions fail before they do anything, as Vulkan allows.
    unsafe { open_patched(&options, patched) }.unwrap()
}

struct Rig {
    weights: Weights,
    frame: TestFrame,
}

impl Rig {
    fn new() -> Self {
        Self { weights: Weights::hybrid_kernels().unwrap(), frame: TestFrame::random(Extent::new(31, 17), 1) }
    }

    fn denoiser(&self, device: &Device) -> Result<Denoiser> {
        Denoiser::new(device, &self.weights, &Options::default())
    }

    fn denoise(&self, denoiser: &mut Denoiser) -> Result<Vec<f32>> {
        let mut output = vec![-7.0; 3 * 31 * 17];
        let result = denoiser
            .denoise(&self.frame.frame(), PlaneMut::f32(&mut output, Layout::interleaved(self.frame.extent, 3)));
        assert!(result.is_ok() || output.iter().all(|v| *v == -7.0), "a failed call wrote");
        result.map(|_| output)
    }
}

fn assert_silent(device: &Device) {
    let messages = device.validation_messages();
    assert!(messages.is_empty(), "{messages:#?}");
}

/// Nothing of the driver's is global: one test after another.
static TURN: Mutex<()> = Mutex::new(());

#[test]
fn allocations_that_fail_are_errors_and_leave_nothing_behind() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let (rig, mut device) = (Rig::new(), open());
    let expected = rig.denoise(&mut rig.denoiser(&device).unwrap()).unwrap();
    let mut failures = 0;
    for call in HUNGRY {
        for wait in [0, 3] {
            let compiling = COMPILING.contains(&call);
            if compiling {
                // What a device has compiled it keeps.
                assert_silent(&device);
                drop(device);
                device = open();
            }
            set(Some(Fault { call, wait, result: vk::Result::ERROR_OUT_OF_DEVICE_MEMORY, met: false }));
            let outcome = rig.denoiser(&device).and_then(|mut denoiser| rig.denoise(&mut denoiser));
            let met = set(None).is_some_and(|fault| fault.met);
            match outcome {
                Ok(output) => {
                    assert!(!met, "{call} failed and nobody noticed");
                    assert_same_bits(&output, &expected, call);
                    break;
                }
                Err(Error::OutOfMemory { .. } | Error::Vulkan { .. }) if met => failures += 1,
                Err(error) => panic!("{call} {wait}: {error}"),
            }
            assert_eq!(device.memory_bytes(), 0, "{call} {wait}: memory is left");
            if compiling {
                let again = rig.denoise(&mut rig.denoiser(&device).unwrap()).unwrap();
                assert_same_bits(&again, &expected, "with what was compiled before the failure");
            }
        }
    }
    assert!(failures > HUNGRY.len(), "{failures} failures only");
    assert_same_bits(&rig.denoise(&mut rig.denoiser(&device).unwrap()).unwrap(), &expected, "after all failures");
    assert_silent(&device);
}

#[test]
fn a_second_denoiser_compiles_nothing() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let (rig, device) = (Rig::new(), open());
    let expected = rig.denoise(&mut rig.denoiser(&device).unwrap()).unwrap();
    for call in COMPILING {
        set(Some(Fault { call, wait: 0, result: vk::Result::ERROR_OUT_OF_DEVICE_MEMORY, met: false }));
        let found = rig.denoiser(&device).and_then(|mut denoiser| rig.denoise(&mut denoiser));
        assert!(set(None).is_some_and(|fault| !fault.met), "{call}");
        assert_same_bits(&found.unwrap(), &expected, call);
    }
    assert_silent(&device);
}

/// The same denoiser goes on after what was no loss for good.
#[test]
fn a_call_that_failed_can_be_made_again() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let (rig, device) = (Rig::new(), open());
    let mut denoiser = rig.denoiser(&device).unwrap();
    let calls =
        ["create_buffer_view", "allocate_descriptor_sets", "begin_command_buffer", "queue_submit", "wait_for_fences"];
    let mut expected = None;
    for call in calls {
        set(Some(Fault { call, wait: 0, result: vk::Result::ERROR_OUT_OF_HOST_MEMORY, met: false }));
        let outcome = rig.denoise(&mut denoiser);
        let met = set(None).is_some_and(|fault| fault.met);
        assert!(outcome.is_err() || !met, "{call} failed and nobody noticed");
        let output = rig.denoise(&mut denoiser).unwrap();
        assert_same_bits(&output, expected.get_or_insert_with(|| output.clone()), call);
    }
    assert_silent(&device);
}

#[test]
fn a_lost_device_is_named_and_a_new_one_works() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let rig = Rig::new();
    for call in LOSING {
        let device = open();
        let mut denoiser = rig.denoiser(&device).unwrap();
        set(Some(Fault { call, wait: 0, result: vk::Result::ERROR_DEVICE_LOST, met: false }));
        let outcome = rig.denoise(&mut denoiser);
        assert!(set(None).is_some_and(|fault| fault.met), "{call} was not called");
        assert!(matches!(outcome, Err(Error::DeviceLost)), "{call}: {outcome:?}");
        drop(denoiser);
        assert_eq!(device.memory_bytes(), 0);
        drop(device);
        let device = open();
        let output = rig.denoise(&mut rig.denoiser(&device).unwrap()).unwrap();
        assert!(output.iter().all(|v| v.is_finite() && *v >= 0.0));
    }
}

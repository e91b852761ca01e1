//! A renderer's device handed over as raw handles is the same device; the queue that it lends is used for weights
//! alone.

mod common;

use common::vulkan::Renderer;
use std::ffi::{c_char, c_void};
use std::ptr;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use vkdenoise::ash::vk;
use vkdenoise::{
    BufferFrame, BufferPlane, Cache, Denoiser, Device, Error, Extent, FrameOptions, Layout, Options, RawDevice,
    RendererDevice, SampleFormat, Weights,
};

const EXTENT: Extent = Extent::new(24, 17);

/// What a pass on the device of these handles makes of a frame.
fn denoised(renderer: &Renderer, handles: RendererDevice) -> Vec<u8> {
    // SAFETY: the handles are the renderer's, which outlives all that is made here.
    let device = unsafe { Device::from_renderer(handles) }.unwrap();
    let denoiser = Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let pass = denoiser.pass(EXTENT).unwrap();
    let samples: Vec<f32> = (0..3 * EXTENT.pixels()).map(|i| ((i * 37) % 101) as f32 / 50.0).collect();
    let (input, output) = (renderer.buffer(12 * EXTENT.pixels()), renderer.buffer(12 * EXTENT.pixels()));
    input.write(bytemuck::cast_slice(&samples));
    let plane = |buffer: &common::vulkan::RendererBuffer| BufferPlane {
        buffer: buffer.raw,
        size: buffer.size,
        format: SampleFormat::F32,
        layout: Layout::interleaved(EXTENT, 3),
    };
    let frame = BufferFrame::new(plane(&input), plane(&output));
    // SAFETY: the buffers live until the fence was waited for.
    let binding = unsafe { pass.bind_buffers(&frame) }.unwrap();
    renderer.wait(renderer.submit(|commands| {
        // SAFETY: as above.
        unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
        renderer.barrier_to_host(commands);
    }));
    output.read()
}

/// What a renderer says of its device.
fn told(device: &RendererDevice) -> (vk::Instance, vk::PhysicalDevice, vk::Device, u32, Option<vk::Queue>, [bool; 6]) {
    let features = [
        device.storage_buffer_16bit,
        device.shader_int64,
        device.subgroup_broadcast_dynamic_id,
        device.host_query_reset,
        device.cooperative_matrix.is_some(),
        device.debug_utils,
    ];
    let (instance, logical) = (device.instance.handle(), device.device.handle());
    (instance, device.physical_device, logical, device.queue_family, device.upload_queue, features)
}

#[test]
fn the_same_bits_as_through_ash() {
    let renderer = Renderer::new();
    let by_ash = denoised(&renderer, renderer.handles());
    // SAFETY: the handles are the renderer's.
    let mut raw = unsafe { RendererDevice::from_raw(&renderer.raw()) }.unwrap();
    assert_eq!(told(&raw), told(&renderer.handles()));
    raw.cache = Cache::Off;
    let by_numbers = denoised(&renderer, raw);
    assert!(by_ash.iter().any(|byte| *byte != 0));
    assert!(by_ash == by_numbers, "the results differ");
    renderer.assert_silent();
}

/// Vulkan's own `vkQueueSubmit`, and how often the library has called it.
static SUBMIT: OnceLock<vk::PFN_vkQueueSubmit> = OnceLock::new();
static SUBMISSIONS: AtomicU32 = AtomicU32::new(0);

unsafe extern "system" fn counted_submit(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo<'_>,
    fence: vk::Fence,
) -> vk::Result {
    SUBMISSIONS.fetch_add(1, Ordering::Relaxed);
    // SAFETY: the caller's promises are Vulkan's.
    unsafe { SUBMIT.get().unwrap()(queue, count, submits, fence) }
}

#[test]
fn weights_are_copied_once_on_the_queue_that_is_lent() {
    let renderer = Renderer::new();
    SUBMIT.get_or_init(|| renderer.device.fp_v1_0().queue_submit);
    let mut handles = renderer.handles();
    let (logical, instance) = (renderer.device.handle(), &renderer.instance);
    // SAFETY: the device's own functions, but for one that calls it.
    handles.device = unsafe {
        vkdenoise::ash::Device::load_with(
            |name| match name == c"vkQueueSubmit" {
                true => counted_submit as *const c_void,
                false => std::mem::transmute::<vk::PFN_vkVoidFunction, *const c_void>(
                    instance.get_device_proc_addr(logical, name.as_ptr()),
                ),
            },
            logical,
        )
    };
    let kept = denoised(&renderer, handles.clone());
    assert_eq!(SUBMISSIONS.load(Ordering::Relaxed), 0, "the library submitted without a queue");
    handles.upload_queue = Some(renderer.queue);
    let copied = denoised(&renderer, handles);
    assert_eq!(SUBMISSIONS.load(Ordering::Relaxed), 1);
    assert!(kept.iter().any(|byte| *byte != 0));
    assert!(kept == copied, "the results differ");

    let mut raw = renderer.raw();
    raw.upload_queue = vk::Handle::as_raw(renderer.queue);
    // SAFETY: the handles are the renderer's.
    let mut by_numbers = unsafe { RendererDevice::from_raw(&raw) }.unwrap();
    assert_eq!(by_numbers.upload_queue, Some(renderer.queue));
    by_numbers.cache = Cache::Off;
    assert!(denoised(&renderer, by_numbers) == copied, "the results differ");
    renderer.assert_silent();
}

/// Nothing of the copy stays: a denoiser holds the weights once, wherever they lie.
#[test]
fn the_weights_are_held_once() {
    let renderer = Renderer::new();
    let held = [None, Some(renderer.queue)].map(|queue| {
        let mut handles = renderer.handles();
        handles.upload_queue = queue;
        // SAFETY: the handles are the renderer's, which outlives the device.
        let device = unsafe { Device::from_renderer(handles) }.unwrap();
        let denoiser = Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
        assert_eq!(device.memory_bytes(), denoiser.device_bytes());
        device.memory_bytes()
    });
    assert_eq!(held[0], held[1]);
    renderer.assert_silent();
}

unsafe extern "system" fn finds_nothing(_: vk::Instance, _: *const c_char) -> vk::PFN_vkVoidFunction {
    None
}

#[test]
fn what_is_null_or_too_old_is_refused() {
    let renderer = Renderer::new();
    let good = renderer.raw();
    let refused = |raw: RawDevice, wanted: &str| {
        // SAFETY: what is not the renderer's is null, or a function that finds nothing.
        match unsafe { RendererDevice::from_raw(&raw) } {
            Err(Error::InvalidOption { option, .. }) => assert_eq!(option, wanted),
            other => panic!("{wanted}: {:?}", other.err()),
        }
    };
    let with = |change: &dyn Fn(&mut RawDevice)| {
        let mut raw = good;
        change(&mut raw);
        raw
    };
    refused(with(&|raw| raw.get_instance_proc_addr = ptr::null()), "get_instance_proc_addr");
    refused(with(&|raw| raw.instance = 0), "instance");
    refused(with(&|raw| raw.physical_device = 0), "physical_device");
    refused(with(&|raw| raw.device = 0), "device");
    refused(with(&|raw| raw.get_instance_proc_addr = finds_nothing as *const c_void), "instance");
}

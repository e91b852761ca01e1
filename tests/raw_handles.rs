//! A renderer's device handed over as raw handles is the same device.

mod common;

use common::vulkan::Renderer;
use std::ffi::{c_char, c_void};
use std::ptr;
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
fn told(device: &RendererDevice) -> (vk::Instance, vk::PhysicalDevice, vk::Device, u32, [bool; 6]) {
    let features = [
        device.storage_buffer_16bit,
        device.shader_int64,
        device.subgroup_broadcast_dynamic_id,
        device.host_query_reset,
        device.cooperative_matrix.is_some(),
        device.debug_utils,
    ];
    (device.instance.handle(), device.physical_device, device.device.handle(), device.queue_family, features)
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
    refused(RawDevice { get_instance_proc_addr: ptr::null(), ..good }, "get_instance_proc_addr");
    refused(RawDevice { instance: 0, ..good }, "instance");
    refused(RawDevice { physical_device: 0, ..good }, "physical_device");
    refused(RawDevice { device: 0, ..good }, "device");
    let finds_nothing = finds_nothing as *const c_void;
    refused(RawDevice { get_instance_proc_addr: finds_nothing, ..good }, "instance");
}

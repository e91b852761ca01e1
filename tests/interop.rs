//! What the library's own device shares with another: memory by file descriptors with a renderer's device in the same
//! process, timeline semaphores by file descriptors with a second device of the library's, and on one device the pass
//! between two values of a semaphore. What a driver lacks is refused, and said to be not run.
#![cfg(unix)]

mod common;

use common::compare::assert_same_bits;
use common::device::{assert_no_validation_messages, device};
use common::random::Random;
use common::vulkan::{Renderer, RendererBuffer};
use std::fs::File;
use std::os::fd::{FromRawFd, IntoRawFd, OwnedFd};
use std::sync::Arc;
use std::time::{Duration, Instant};
use vkdenoise::ash::vk;
use vkdenoise::{
    BufferFrame, BufferPlane, Denoiser, Device, DeviceOptions, DeviceSelector, Error, Extent, Features, Frame,
    FrameOptions, Layout, MemoryHandle, Options, Plane, PlaneMut, RecordedPass, SampleFormat, SharedBuffer,
    SharedMemory, TimelinePoint, TimelineSemaphore, Weights,
};

const EXTENT: Extent = Extent::new(70, 45);
const BYTES: u64 = 12 * EXTENT.pixels();
const LONG: Duration = Duration::from_secs(600);
const SHORT: Duration = Duration::from_millis(50);

fn color(seed: u64) -> Vec<f32> {
    Random::new(seed).values(3 * EXTENT.pixels() as usize, 0.0, 3.0)
}

fn denoiser() -> Denoiser {
    Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap()
}

fn on_host(denoiser: &mut Denoiser, color: &[f32]) -> Vec<f32> {
    let (rgb, mut output) = (Layout::interleaved(EXTENT, 3), vec![0.0; color.len()]);
    let frame = Frame { extent: EXTENT, color: Plane::f32(color, rgb), features: Features::default() };
    denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
    output
}

fn recorded(denoiser: &Denoiser, color: &SharedBuffer, output: &SharedBuffer) -> RecordedPass {
    let pass = Arc::new(denoiser.pass(EXTENT).unwrap());
    let plane = |buffer: &SharedBuffer| BufferPlane {
        buffer: buffer.raw(),
        size: buffer.size(),
        format: SampleFormat::F32,
        layout: Layout::interleaved(EXTENT, 3),
    };
    // SAFETY: the recording keeps the buffers.
    unsafe {
        let binding = Arc::new(pass.bind_buffers(&BufferFrame::new(plane(color), plane(output))).unwrap());
        RecordedPass::new(pass, binding, &FrameOptions::default(), &[color.clone(), output.clone()]).unwrap()
    }
}

/// The renderer's side of shared memory.
struct Theirs {
    buffer: vk::Buffer,
    memory: vk::DeviceMemory,
    requirements: vk::MemoryRequirements,
    memory_type: u32,
}

impl Theirs {
    /// Memory of its own, to be exported, or the library's.
    fn new(renderer: &Renderer, handle: MemoryHandle, imported: Option<SharedMemory>) -> Self {
        let device = &renderer.device;
        let raw = match handle {
            MemoryHandle::OpaqueFd => vk::ExternalMemoryHandleTypeFlags::OPAQUE_FD,
            MemoryHandle::DmaBuf => vk::ExternalMemoryHandleTypeFlags::DMA_BUF_EXT,
        };
        let mut external = vk::ExternalMemoryBufferCreateInfo::default().handle_types(raw);
        let usage = vk::BufferUsageFlags::TRANSFER_SRC | vk::BufferUsageFlags::TRANSFER_DST;
        // As the library makes its own.
        let usage = usage | vk::BufferUsageFlags::STORAGE_BUFFER | vk::BufferUsageFlags::SHADER_DEVICE_ADDRESS;
        let info = vk::BufferCreateInfo::default().size(BYTES).usage(usage).push_next(&mut external);
        // SAFETY: plain Vulkan on the renderer's device; every pointer outlives its call.
        unsafe {
            let buffer = device.create_buffer(&info, None).unwrap();
            let requirements = device.get_buffer_memory_requirements(buffer);
            let mut flags = vk::MemoryAllocateFlagsInfo::default().flags(vk::MemoryAllocateFlags::DEVICE_ADDRESS);
            let info = vk::MemoryAllocateInfo::default().push_next(&mut flags);
            let (memory, memory_type) = match imported {
                Some(SharedMemory { fd, bytes, memory_type, .. }) => {
                    // The driver takes the descriptor.
                    let mut import = vk::ImportMemoryFdInfoKHR::default().handle_type(raw).fd(fd.into_raw_fd());
                    let info = info.allocation_size(bytes).memory_type_index(memory_type).push_next(&mut import);
                    (device.allocate_memory(&info, None).unwrap(), memory_type)
                }
                None => {
                    let mut export = vk::ExportMemoryAllocateInfo::default().handle_types(raw);
                    let memory_type = requirements.memory_type_bits.trailing_zeros();
                    let info = info.allocation_size(requirements.size).memory_type_index(memory_type);
                    (device.allocate_memory(&info.push_next(&mut export), None).unwrap(), memory_type)
                }
            };
            device.bind_buffer_memory(buffer, memory, 0).unwrap();
            Self { buffer, memory, requirements, memory_type }
        }
    }

    fn export(&self, renderer: &Renderer) -> SharedMemory {
        let handle_type = vk::ExternalMemoryHandleTypeFlags::OPAQUE_FD;
        let info = vk::MemoryGetFdInfoKHR::default().memory(self.memory).handle_type(handle_type);
        // SAFETY: the memory was allocated to be exported; the descriptor is new.
        let fd =
            unsafe { OwnedFd::from_raw_fd(renderer.external_memory.as_ref().unwrap().get_memory_fd(&info).unwrap()) };
        let (bytes, memory_type) = (self.requirements.size, self.memory_type);
        SharedMemory { fd, handle: MemoryHandle::OpaqueFd, bytes, memory_type }
    }

    /// Hands the memory over to the library, or takes it back.
    fn hand_over(&self, renderer: &Renderer, commands: vk::CommandBuffer, to_library: bool) {
        let (own, other) = (renderer.queue_family, vk::QUEUE_FAMILY_EXTERNAL);
        let (from, to) = if to_library { (own, other) } else { (other, own) };
        let access = vk::AccessFlags::TRANSFER_READ | vk::AccessFlags::TRANSFER_WRITE;
        let none = vk::AccessFlags::empty();
        let barrier = [vk::BufferMemoryBarrier::default()
            .src_access_mask(if to_library { access } else { none })
            .dst_access_mask(if to_library { none } else { access })
            .src_queue_family_index(from)
            .dst_queue_family_index(to)
            .buffer(self.buffer)
            .size(vk::WHOLE_SIZE)];
        let all = vk::PipelineStageFlags::ALL_COMMANDS;
        // SAFETY: the command buffer is recording.
        unsafe {
            renderer.device.cmd_pipeline_barrier(commands, all, all, vk::DependencyFlags::empty(), &[], &barrier, &[])
        };
    }

    fn write(&self, renderer: &Renderer, from: &RendererBuffer) {
        renderer.wait(renderer.submit(|commands| {
            // SAFETY: the command buffer is recording; both buffers live until the fence is waited for.
            unsafe {
                let copy = [vk::BufferCopy::default().size(BYTES)];
                renderer.device.cmd_copy_buffer(commands, from.raw, self.buffer, &copy);
            }
            self.hand_over(renderer, commands, true);
        }));
    }

    fn read(&self, renderer: &Renderer, to: &RendererBuffer) {
        renderer.wait(renderer.submit(|commands| {
            self.hand_over(renderer, commands, false);
            // SAFETY: as above.
            unsafe {
                let copy = [vk::BufferCopy::default().size(BYTES)];
                renderer.device.cmd_copy_buffer(commands, self.buffer, to.raw, &copy);
            }
            renderer.barrier_to_host(commands);
        }));
    }

    fn destroy(self, renderer: &Renderer) {
        // SAFETY: what used it was waited for.
        unsafe {
            renderer.device.destroy_buffer(self.buffer, None);
            renderer.device.free_memory(self.memory, None);
        }
    }
}

/// Another device writes the colour and reads the result: the colour's memory is its own, the output's the library's.
#[test]
fn memory_goes_both_ways() {
    let (renderer, handle) = (Renderer::new(), MemoryHandle::OpaqueFd);
    let transfer = device().interop().opaque_fd;
    println!("{:?}", device().interop());
    if !(transfer.import && transfer.export) || transfer.dedicated {
        println!("not run here: the driver does not share plain memory by opaque file descriptors");
        return;
    }
    let before = device().memory_bytes();
    let output = SharedBuffer::new(device(), BYTES, handle).unwrap();
    let exported = output.export().unwrap();
    assert_eq!(device().memory_bytes(), before + exported.bytes);
    let theirs_out = Theirs::new(&renderer, handle, Some(exported));
    let theirs_in = Theirs::new(&renderer, handle, None);
    // SAFETY: the memory is the renderer's, on the same driver and device.
    let input = unsafe { SharedBuffer::import(device(), theirs_in.export(&renderer), BYTES) }.unwrap();
    assert_eq!(device().memory_bytes(), before + output.export().unwrap().bytes, "imported memory is another's");
    assert!(matches!(input.export(), Err(Error::Unsupported { .. })));

    let mut denoiser = denoiser();
    let mut pass = recorded(&denoiser, &input, &output);
    let (staging, back) = (renderer.buffer(BYTES), renderer.buffer(BYTES));
    for seed in [1, 2] {
        staging.write(bytemuck::cast_slice(&color(seed)));
        theirs_in.write(&renderer, &staging);
        pass.submit(None, None).unwrap();
        assert!(pass.wait(LONG).unwrap());
        theirs_out.read(&renderer, &back);
        let found = back.read();
        assert_same_bits(bytemuck::cast_slice(&found), &on_host(&mut denoiser, &color(seed)), &format!("frame {seed}"));
    }

    // Memory that a buffer does not fit in, and a type that none can have.
    let refused = |bytes: u64, memory_type: Option<u32>| {
        let mut memory = theirs_in.export(&renderer);
        memory.bytes = bytes;
        memory.memory_type = memory_type.unwrap_or(memory.memory_type);
        // SAFETY: it is refused before it is used.
        let refused = unsafe { SharedBuffer::import(device(), memory, BYTES) };
        assert!(matches!(refused, Err(Error::InvalidOption { option: "shared memory", .. })));
    };
    refused(BYTES - 1, None);
    refused(u64::MAX, Some(77));
    assert!(matches!(SharedBuffer::new(device(), 0, handle), Err(Error::InvalidOption { option: "size", .. })));
    drop((pass, input, output));
    theirs_in.destroy(&renderer);
    theirs_out.destroy(&renderer);
    renderer.assert_silent();
    assert_no_validation_messages();
}

/// Kinds of descriptors that a driver does not have are refused by name, and so is a renderer's device.
#[test]
fn what_a_device_cannot_share_is_refused() {
    let interop = device().interop();
    for handle in [MemoryHandle::OpaqueFd, MemoryHandle::DmaBuf] {
        let made = SharedBuffer::new(device(), BYTES, handle);
        match interop.memory(handle).export {
            true => assert_eq!(made.unwrap().export().unwrap().handle, handle),
            false => {
                println!("not run here: export of memory by {handle:?}");
                assert!(
                    matches!(made, Err(Error::Unsupported { missing, .. }) if missing.contains("external_memory_fd"))
                );
            }
        }
    }
    let renderer = Renderer::new();
    // SAFETY: the renderer lives to the end of the test.
    let theirs = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    assert!(!theirs.interop().opaque_fd.export);
    let made = SharedBuffer::new(&theirs, BYTES, MemoryHandle::OpaqueFd);
    assert!(matches!(made, Err(Error::Unsupported { .. })));
    assert!(matches!(TimelineSemaphore::new(&theirs, 0), Err(Error::Binding(_))));
    assert_no_validation_messages();
}

/// The pass runs when its value has come, and not before.
#[test]
fn a_pass_between_two_values() {
    let mut denoiser = denoiser();
    let transfer = device().interop().opaque_fd;
    if !transfer.export {
        println!("not run here: the driver does not export memory");
        return;
    }
    let [input, output] = [(); 2].map(|()| SharedBuffer::new(device(), BYTES, MemoryHandle::OpaqueFd).unwrap());
    let renderer = Renderer::new();
    let handle = MemoryHandle::OpaqueFd;
    let theirs = [&input, &output].map(|ours| Theirs::new(&renderer, handle, Some(ours.export().unwrap())));
    let staging = renderer.buffer(BYTES);
    staging.write(bytemuck::cast_slice(&color(3)));
    let mut pass = recorded(&denoiser, &input, &output);
    let semaphore = TimelineSemaphore::new(device(), 5).unwrap();
    let point = |value| TimelinePoint { semaphore: semaphore.clone(), value };
    // As long as it takes to run thrice, whatever else the machine does.
    let clock = Instant::now();
    pass.submit(None, None).unwrap();
    assert!(pass.wait(LONG).unwrap());
    let thrice = 3 * clock.elapsed() + SHORT;
    pass.submit(Some(&point(6)), Some(&point(7))).unwrap();
    // Again, while the first waits.
    pass.submit(Some(&point(7)), Some(&point(8))).unwrap();
    assert!(!pass.wait(thrice).unwrap() && !semaphore.wait(7, SHORT).unwrap());
    assert_eq!(semaphore.value().unwrap(), 5);
    theirs[0].write(&renderer, &staging);
    semaphore.signal(6).unwrap();
    assert!(semaphore.wait(8, LONG).unwrap() && pass.wait(LONG).unwrap());
    let back = renderer.buffer(BYTES);
    theirs[1].read(&renderer, &back);
    assert_same_bits(bytemuck::cast_slice(&back.read()), &on_host(&mut denoiser, &color(3)), "after the wait");

    for value in [8, 3] {
        let refused = pass.submit(None, Some(&point(value)));
        assert!(matches!(refused, Err(Error::InvalidOption { option: "timeline value", .. })), "{refused:?}");
        assert!(matches!(semaphore.signal(value), Err(Error::InvalidOption { .. })));
    }
    let other = Device::open(&DeviceSelector::from_env().unwrap_or_default()).unwrap();
    let elsewhere = TimelineSemaphore::new(&other, 0).unwrap();
    let refused = pass.submit(Some(&TimelinePoint { semaphore: elsewhere, value: 1 }), None);
    assert!(matches!(refused, Err(Error::Binding(_))), "{refused:?}");
    drop((pass, input, output));
    theirs.into_iter().for_each(|theirs| theirs.destroy(&renderer));
    renderer.assert_silent();
    assert_no_validation_messages();
}

/// A second device raises and watches the first one's semaphore.
#[test]
fn a_timeline_semaphore_of_two_devices() {
    let semaphore = TimelineSemaphore::new(device(), 1).unwrap();
    let transfer = device().interop().timeline_fd;
    let other = Device::open_with(&DeviceOptions {
        selector: DeviceSelector::from_env().unwrap_or_default(),
        validation: true,
        ..DeviceOptions::default()
    })
    .unwrap();
    if !(transfer.import && transfer.export) {
        println!("not run here: the driver does not share timeline semaphores by opaque file descriptors");
        let refused = semaphore.export();
        assert!(matches!(refused, Err(Error::Unsupported { missing, .. }) if missing.contains("semaphore_fd")));
        // SAFETY: it is refused before it is looked at.
        let refused = unsafe { TimelineSemaphore::import(&other, File::open("/dev/null").unwrap().into()) };
        assert!(matches!(refused, Err(Error::Unsupported { missing, .. }) if missing.contains("semaphore_fd")));
        return;
    }
    // SAFETY: the descriptor is of the same driver and device.
    let theirs = unsafe { TimelineSemaphore::import(&other, semaphore.export().unwrap()) }.unwrap();
    assert_eq!(theirs.value().unwrap(), 1);
    let [input, output] = [(); 2].map(|()| SharedBuffer::new(device(), BYTES, MemoryHandle::OpaqueFd).unwrap());
    let denoiser = denoiser();
    let mut pass = recorded(&denoiser, &input, &output);
    let point = |value| TimelinePoint { semaphore: semaphore.clone(), value };
    pass.submit(Some(&point(2)), Some(&point(3))).unwrap();
    assert!(!theirs.wait(3, SHORT).unwrap());
    theirs.signal(2).unwrap();
    assert!(theirs.wait(3, LONG).unwrap() && pass.wait(LONG).unwrap());
    assert_eq!(other.validation_messages(), [""; 0]);
    assert_no_validation_messages();
}

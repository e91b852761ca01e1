//! The renderer's path: passes of one frame size, recorded into the renderer's command buffers.

use crate::denoiser::Denoiser;
use crate::frame_options::{self, FrameOptions};
use crate::handle;
use crate::renderer_planes::{BufferFrame, ImageFrame, buffer_frame, image_frame};
use crate::status::{Failure, Status, guard};
use std::sync::Arc;
use vkdenoise::Extent;
use vkdenoise::ash::vk::{self, Handle};

/// The denoiser for one frame size, with the memory of its feature maps. Frames in flight may share it as long as
/// they are submitted to one queue.
pub struct Pass {
    pass: Arc<vkdenoise::Pass>,
    extent: Extent,
}

impl Pass {
    pub fn new(pass: vkdenoise::Pass, extent: Extent) -> Self {
        Self { pass: Arc::new(pass), extent }
    }

    /// The pass, to be kept.
    pub fn shared(&self) -> Arc<vkdenoise::Pass> {
        Arc::clone(&self.pass)
    }
}

/// A renderer's planes, resolved for a pass.
pub struct Binding(pub(crate) Arc<vkdenoise::Binding>);

/// Vulkan's.
#[repr(C)]
pub struct VkCommandBuffer_T([u8; 0]);

/// Prepares a frame size for a renderer: plans it and allocates its memory.
///
/// @param pass receives the pass; destroy it with vkdenoise_pass_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_pass_create(
    denoiser: *const Denoiser,
    width: u32,
    height: u32,
    pass: *mut *mut Pass,
) -> Status {
    let make = || {
        // SAFETY: the caller's pointers are as the header says; the same below.
        let denoiser = unsafe { handle::borrow(denoiser, "denoiser")? };
        let extent = Extent::new(width, height);
        Ok(Pass::new(denoiser.take()?.pass(extent)?, extent))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(pass, make) })
}

/// Device memory that the pass alone holds, in bytes: what outlives its recordings, and its arena, where that was made
/// for it; 0 for NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_pass_device_bytes(pass: *const Pass) -> u64 {
    // SAFETY: as above.
    unsafe { pass.as_ref() }.map_or(0, |pass| pass.pass.device_bytes())
}

/// Destroys a pass. The GPU must have finished with it. NULL is nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_pass_destroy(pass: *mut Pass) {
    // SAFETY: as above.
    guard(|| {
        unsafe { handle::take(pass) };
        Ok(())
    });
}

/// Resolves a frame in the renderer's buffers, once for many recordings: it may compile kernels. The buffers must
/// live as long as what is recorded with the binding runs.
///
/// @param binding receives the binding; destroy it with vkdenoise_binding_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_pass_bind_buffers(
    pass: *const Pass,
    frame: *const BufferFrame,
    binding: *mut *mut Binding,
) -> Status {
    // SAFETY: as above.
    let make = || unsafe {
        let Pass { pass, extent } = handle::borrow(pass, "pass")?;
        let (frame, signals) = buffer_frame(frame, *extent)?;
        Ok(Binding(Arc::new(pass.bind_buffers_with(&frame, &signals)?)))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(binding, make) })
}

/// Resolves a frame in the renderer's images, once for many recordings: it may compile kernels and makes descriptor
/// sets. The views must live as long as the binding.
///
/// @param binding receives the binding; destroy it with vkdenoise_binding_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_pass_bind_images(
    pass: *const Pass,
    frame: *const ImageFrame,
    binding: *mut *mut Binding,
) -> Status {
    // SAFETY: as above.
    let make = || unsafe {
        let Pass { pass, extent } = handle::borrow(pass, "pass")?;
        let (frame, signals) = image_frame(frame, *extent)?;
        Ok(Binding(Arc::new(pass.bind_images_with(&frame, &signals)?)))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(binding, make) })
}

/// Destroys a binding. The GPU must have finished with what was recorded with it. NULL is nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_binding_destroy(binding: *mut Binding) {
    // SAFETY: as above.
    guard(|| {
        unsafe { handle::take(binding) };
        Ok(())
    });
}

/// Records the pass into a command buffer that is recording, outside a render pass. It does not submit, wait or
/// allocate.
///
/// Before it the renderer makes its writes to the input planes (signals with them; and to an exposure_buffer) visible to
/// VK_PIPELINE_STAGE_COMPUTE_SHADER_BIT with VK_ACCESS_SHADER_READ_BIT, and orders earlier uses of the output (and of
/// a statistics_buffer) before that stage. After it the output was written in that stage with
/// VK_ACCESS_SHADER_WRITE_BIT; the renderer puts the barrier that its next use needs. The bound compute pipeline,
/// compute descriptor set 0 and push constants have changed. Several frames may be in flight on one queue: the pass's
/// own memory is guarded by a barrier of its own.
///
/// Pass, binding and what it names live until the commands have run.
///
/// @param options NULL: the defaults.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_pass_record(
    pass: *const Pass,
    commands: *mut VkCommandBuffer_T,
    binding: *const Binding,
    options: *const FrameOptions,
) -> Status {
    guard(|| {
        // SAFETY: as above.
        let (pass, binding) = unsafe { (handle::borrow(pass, "pass")?, handle::borrow(binding, "binding")?) };
        if commands.is_null() {
            return Err(Failure::argument("the command buffer is NULL"));
        }
        // SAFETY: as above.
        let (options, progress) = unsafe { frame_options::read(options)? };
        if progress.is_some() {
            return Err(Failure::argument("progress is for the host path, not for passes: the renderer submits them"));
        }
        let commands = vk::CommandBuffer::from_raw(commands as u64);
        // SAFETY: the caller promises what the header asks for.
        unsafe { pass.pass.record(commands, &binding.0, &options)? };
        Ok(())
    })
}

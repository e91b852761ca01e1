//! A pass on the queue of a device of our own, between what other APIs and devices do: it waits for a value of a
//! timeline semaphore and signals one.

use crate::error::{Error, Result};
use crate::options::FrameOptions;
use crate::pass::{Binding, Pass};
use crate::vk::Checked;
use crate::vk::device::Device;
use crate::vk::shared_buffer::SharedBuffer;
use crate::vk::timeline::{TimelinePoint, TimelineSemaphore};
use ash::vk;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

/// A [`Pass`] recorded for the queue of a device that the library opened, to be submitted any number of times. It keeps
/// what it uses; when dropped it waits until all that was submitted has run.
pub struct RecordedPass {
    device: Device,
    pool: vk::CommandPool,
    commands: vk::CommandBuffer,
    /// Counts the submissions that have run.
    done: TimelineSemaphore,
    submitted: u64,
    /// Semaphores of submissions that may still run, by their number.
    pending: Vec<(u64, TimelineSemaphore)>,
    shared: Vec<SharedBuffer>,
    _binding: Arc<Binding>,
    _pass: Arc<Pass>,
}

impl RecordedPass {
    /// Records a pass. Where planes lie in shared buffers, `shared` names these: the pass takes them over from the
    /// other side when it begins (`VK_QUEUE_FAMILY_EXTERNAL`) and hands them back when it ends.
    ///
    /// # Errors
    /// [`Error::Binding`] on a renderer's device, where [`Pass::record`] is for, and for a buffer of another device; as
    /// [`Pass::record`]; [`Error::Vulkan`].
    ///
    /// # Safety
    /// What the binding and the options name is valid as long as this.
    pub unsafe fn new(
        pass: Arc<Pass>,
        binding: Arc<Binding>,
        options: &FrameOptions,
        shared: &[SharedBuffer],
    ) -> Result<Self> {
        let device = pass.device().clone();
        if shared.iter().any(|buffer| buffer.device().raw().handle() != device.raw().handle()) {
            return Err(Error::Binding("a shared buffer is of another device: import it on the pass's own".into()));
        }
        let mut recorded = Self {
            done: TimelineSemaphore::new(&device, 0)?,
            device,
            pool: vk::CommandPool::null(),
            commands: vk::CommandBuffer::null(),
            submitted: 0,
            pending: Vec::new(),
            shared: shared.to_vec(),
            _binding: Arc::clone(&binding),
            _pass: Arc::clone(&pass),
        };
        let Self { device, .. } = &recorded;
        let raw = device.raw().clone();
        let (own, other) = (device.queue_family(), vk::QUEUE_FAMILY_EXTERNAL);
        let info = vk::CommandPoolCreateInfo::default().queue_family_index(own);
        // SAFETY: the device is alive; the pool is used by this thread alone.
        recorded.pool = unsafe { raw.create_command_pool(&info, None) }.called("vkCreateCommandPool")?;
        let info = vk::CommandBufferAllocateInfo::default().command_pool(recorded.pool).command_buffer_count(1);
        // SAFETY: as above.
        let buffers = unsafe { raw.allocate_command_buffers(&info) }.called("vkAllocateCommandBuffers")?;
        recorded.commands = buffers.first().copied().unwrap_or_default();
        let commands = recorded.commands;
        let info = vk::CommandBufferBeginInfo::default().flags(vk::CommandBufferUsageFlags::SIMULTANEOUS_USE);
        let shader = vk::AccessFlags::SHADER_READ | vk::AccessFlags::SHADER_WRITE;
        let (outside, none) = (vk::PipelineStageFlags::ALL_COMMANDS, vk::AccessFlags::empty());
        let inside = vk::PipelineStageFlags::COMPUTE_SHADER;
        // SAFETY: the command buffer is ours; the caller vouches for what binding and options name.
        unsafe {
            raw.begin_command_buffer(commands, &info).called("vkBeginCommandBuffer")?;
            recorded.hand_over((outside, none, other), (inside, shader, own));
            pass.record(commands, &binding, options)?;
            recorded.hand_over((inside, shader, own), (outside, none, other));
            raw.end_command_buffer(commands).called("vkEndCommandBuffer")?;
        }
        Ok(recorded)
    }

    /// Records the shared buffers' way from one side to the other: stage, access, queue family.
    ///
    /// # Safety
    /// The command buffer is recording.
    unsafe fn hand_over(
        &self,
        (from, wrote, source): (vk::PipelineStageFlags, vk::AccessFlags, u32),
        (to, reads, target): (vk::PipelineStageFlags, vk::AccessFlags, u32),
    ) {
        let barrier = |buffer: &SharedBuffer| {
            vk::BufferMemoryBarrier::default()
                .src_access_mask(wrote)
                .dst_access_mask(reads)
                .src_queue_family_index(source)
                .dst_queue_family_index(target)
                .buffer(buffer.raw())
                .size(vk::WHOLE_SIZE)
        };
        let barriers: Vec<_> = self.shared.iter().map(barrier).collect();
        if !barriers.is_empty() {
            let flags = vk::DependencyFlags::empty();
            // SAFETY: the caller vouches for the command buffer; the buffers are kept.
            unsafe { self.device.raw().cmd_pipeline_barrier(self.commands, from, to, flags, &[], &barriers, &[]) };
        }
    }

    /// Submits the pass, which begins when `wait` is reached, and reaches `signal` when it has run. Returns at once.
    ///
    /// # Errors
    /// [`Error::InvalidOption`] where the semaphore has passed the value to signal; [`Error::Binding`] for a semaphore
    /// of another device; [`Error::DeviceLost`], [`Error::Vulkan`].
    pub fn submit(&mut self, wait: Option<&TimelinePoint>, signal: Option<&TimelinePoint>) -> Result<()> {
        for point in wait.iter().chain(&signal) {
            if point.semaphore.device().raw().handle() != self.device.raw().handle() {
                return Err(Error::Binding("a semaphore is of another device: import it on the pass's own".into()));
            }
        }
        signal.map_or(Ok(()), |point| point.semaphore.check(point.value))?;
        let ended = self.done.value()?;
        self.pending.retain(|(number, _)| *number > ended);
        let number = self.submitted + 1;
        let own = TimelinePoint { semaphore: self.done.clone(), value: number };
        let raw = |points: &[&TimelinePoint]| -> (Vec<vk::Semaphore>, Vec<u64>) {
            points.iter().map(|point| (point.semaphore.raw(), point.value)).unzip()
        };
        let (waits, wait_values) = raw(wait.as_slice());
        let (signals, signal_values) = raw(&[signal.as_slice(), &[&own]].concat());
        let stages = vec![vk::PipelineStageFlags::ALL_COMMANDS; waits.len()];
        let commands = [self.commands];
        let mut values = vk::TimelineSemaphoreSubmitInfo::default()
            .wait_semaphore_values(&wait_values)
            .signal_semaphore_values(&signal_values);
        let info = vk::SubmitInfo::default()
            .wait_semaphores(&waits)
            .wait_dst_stage_mask(&stages)
            .command_buffers(&commands)
            .signal_semaphores(&signals)
            .push_next(&mut values);
        let queue = self.device.queue().ok_or_else(|| Error::Binding("the device has no queue of ours".into()))?;
        let queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the queue is locked; commands and semaphores are kept until they have run.
        unsafe { self.device.raw().queue_submit(*queue, &[info], vk::Fence::null()) }.called("vkQueueSubmit")?;
        self.submitted = number;
        self.pending.extend(wait.iter().chain(&signal).map(|point| (number, point.semaphore.clone())));
        Ok(())
    }

    /// Waits on the host until all that was submitted has run, and says whether it did within the time.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], [`Error::Vulkan`].
    pub fn wait(&self, timeout: Duration) -> Result<bool> {
        self.done.wait(self.submitted, timeout)
    }
}

impl Drop for RecordedPass {
    fn drop(&mut self) {
        // It must have ended before what it uses goes. On a lost device it has.
        let _ = self.wait(Duration::MAX);
        // SAFETY: nothing is pending; a null pool is allowed.
        unsafe { self.device.raw().destroy_command_pool(self.pool, None) };
    }
}

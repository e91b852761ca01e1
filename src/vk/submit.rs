//! A command buffer of our own, submitted and waited for: the headless path.

use super::Checked;
use super::device::Device;
use crate::error::{Error, Result};
use ash::vk;
use std::sync::{Mutex, PoisonError};

/// Records a global memory barrier.
///
/// # Safety
/// `commands` is recording and of this device.
pub(crate) unsafe fn barrier(
    device: &Device,
    commands: vk::CommandBuffer,
    (from, from_access): (vk::PipelineStageFlags, vk::AccessFlags),
    (to, to_access): (vk::PipelineStageFlags, vk::AccessFlags),
) {
    let barrier = [vk::MemoryBarrier::default().src_access_mask(from_access).dst_access_mask(to_access)];
    let flags = vk::DependencyFlags::empty();
    // SAFETY: the caller vouches for `commands`.
    unsafe { device.raw().cmd_pipeline_barrier(commands, from, to, flags, &barrier, &[], &[]) };
}

/// One primary command buffer with its fence and a pair of timestamps around it.
pub(crate) struct Submission {
    device: Device,
    pool: vk::CommandPool,
    raw: vk::CommandBuffer,
    fence: vk::Fence,
    /// Null where the queue has no timestamps.
    queries: vk::QueryPool,
}

impl Submission {
    /// Makes the command buffer on our own device.
    pub fn new(device: &Device) -> Result<Self> {
        let vk_device = device.raw();
        let mut submission = Self {
            device: device.clone(),
            pool: vk::CommandPool::null(),
            raw: vk::CommandBuffer::null(),
            fence: vk::Fence::null(),
            queries: vk::QueryPool::null(),
        };
        let info = vk::CommandPoolCreateInfo::default()
            .queue_family_index(device.queue_family())
            .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER);
        // SAFETY: the device is alive; the same for the calls below.
        submission.pool = unsafe { vk_device.create_command_pool(&info, None) }.called("vkCreateCommandPool")?;
        let info = vk::CommandBufferAllocateInfo::default().command_pool(submission.pool).command_buffer_count(1);
        // SAFETY: the pool is ours and used by one thread at a time (`&mut self`).
        let buffers = unsafe { vk_device.allocate_command_buffers(&info) }.called("vkAllocateCommandBuffers")?;
        submission.raw = buffers.first().copied().unwrap_or_default();
        // SAFETY: as above.
        submission.fence =
            unsafe { vk_device.create_fence(&vk::FenceCreateInfo::default(), None) }.called("vkCreateFence")?;
        if device.caps().timestamp_period > 0.0 {
            let info = vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(2);
            // SAFETY: as above.
            submission.queries = unsafe { vk_device.create_query_pool(&info, None) }.called("vkCreateQueryPool")?;
        }
        Ok(submission)
    }

    /// Records the commands that `commands` adds, for any number of submissions.
    pub fn record(&mut self, commands: impl FnOnce(vk::CommandBuffer) -> Result<()>) -> Result<()> {
        self.record_between(|_| (), commands, |_| ())
    }

    /// The same, with commands before and after those that the timestamps are around.
    pub fn record_between(
        &mut self,
        before: impl FnOnce(vk::CommandBuffer),
        timed: impl FnOnce(vk::CommandBuffer) -> Result<()>,
        after: impl FnOnce(vk::CommandBuffer),
    ) -> Result<()> {
        let device = self.device.raw();
        // SAFETY: the command buffer is ours and not pending: `run` waits for its fence.
        unsafe {
            let info = vk::CommandBufferBeginInfo::default();
            device.begin_command_buffer(self.raw, &info).called("vkBeginCommandBuffer")?;
            if self.queries != vk::QueryPool::null() {
                device.cmd_reset_query_pool(self.raw, self.queries, 0, 2);
            }
            before(self.raw);
            if self.queries != vk::QueryPool::null() {
                // Of what comes before all must have ended.
                device.cmd_write_timestamp(self.raw, vk::PipelineStageFlags::BOTTOM_OF_PIPE, self.queries, 0);
            }
        }
        if let Err(error) = timed(self.raw) {
            // Half a recording must not be begun again. A buffer that cannot be reset is of a device that is lost.
            // SAFETY: as above, and its pool allows it.
            let _ = unsafe { device.reset_command_buffer(self.raw, vk::CommandBufferResetFlags::empty()) };
            return Err(error);
        }
        // SAFETY: as above.
        unsafe {
            if self.queries != vk::QueryPool::null() {
                device.cmd_write_timestamp(self.raw, vk::PipelineStageFlags::BOTTOM_OF_PIPE, self.queries, 1);
            }
            after(self.raw);
            device.end_command_buffer(self.raw).called("vkEndCommandBuffer")
        }
    }

    /// Submits the recording, waits for it, and returns the device's milliseconds where it has timestamps.
    pub fn run(&mut self) -> Result<Option<f64>> {
        let device = self.device.clone();
        let queue = device.queue().ok_or_else(|| {
            Error::Binding("a renderer's device has no queue of ours: record into its command buffer instead".into())
        })?;
        self.run_on(queue)
    }

    /// The same on a queue of the device's family.
    pub fn run_on(&mut self, queue: &Mutex<vk::Queue>) -> Result<Option<f64>> {
        let device = self.device.raw();
        let buffers = [self.raw];
        let info = [vk::SubmitInfo::default().command_buffers(&buffers)];
        // Before the run and not after it: a run that failed may have left it signalled.
        // SAFETY: the fence is ours and not pending, as no run returns while its work is.
        unsafe { device.reset_fences(&[self.fence]) }.called("vkResetFences")?;
        {
            let queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
            // SAFETY: the queue is locked, the command buffer recorded, the fence unsignalled.
            unsafe { device.queue_submit(*queue, &info, self.fence) }.called("vkQueueSubmit")?;
        }
        // SAFETY: the fence is ours.
        let waited = unsafe { device.wait_for_fences(&[self.fence], true, u64::MAX) }.called("vkWaitForFences");
        if let Err(error) = waited {
            let queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
            // The work must have ended before the caller drops what it uses. On a lost device it has.
            // SAFETY: the queue is locked.
            let _ = unsafe { device.queue_wait_idle(*queue) };
            return Err(error);
        }
        if self.queries == vk::QueryPool::null() {
            return Ok(None);
        }
        let mut ticks = [0u64; 2];
        // SAFETY: both queries were written by the work just waited for.
        unsafe { device.get_query_pool_results(self.queries, 0, &mut ticks, vk::QueryResultFlags::TYPE_64) }
            .called("vkGetQueryPoolResults")?;
        let period = f64::from(self.device.caps().timestamp_period);
        Ok(Some(ticks[1].saturating_sub(ticks[0]) as f64 * period * 1e-6))
    }
}

impl Drop for Submission {
    fn drop(&mut self) {
        let device = self.device.raw();
        // SAFETY: `run` waits for the work, so nothing is pending; null handles are allowed.
        unsafe {
            device.destroy_query_pool(self.queries, None);
            device.destroy_fence(self.fence, None);
            device.destroy_command_pool(self.pool, None);
        }
    }
}

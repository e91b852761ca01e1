//! A pool of timestamp queries.

use super::Checked;
use super::device::Device;
use crate::error::{Error, Result};
use ash::vk;

/// Timestamps of the device's queue. Destroyed when dropped.
pub(crate) struct Timestamps {
    device: Device,
    pool: vk::QueryPool,
}

impl Timestamps {
    /// Refuses a device whose kernels cannot be timed.
    ///
    /// # Errors
    /// [`Error::Unsupported`].
    pub fn check(device: &Device) -> Result<()> {
        let missing = device.caps().lacks_for_timestamps().join(", ");
        if missing.is_empty() {
            return Ok(());
        }
        Err(Error::Unsupported { device: device.info().name.clone(), missing })
    }

    /// A pool of `count` timestamps, none of them written yet.
    ///
    /// # Errors
    /// As [`Timestamps::check`]; [`Error::Vulkan`].
    pub fn new(device: &Device, count: u32) -> Result<Self> {
        Self::check(device)?;
        let info = vk::QueryPoolCreateInfo::default().query_type(vk::QueryType::TIMESTAMP).query_count(count);
        // SAFETY: the device is alive.
        let pool = unsafe { device.raw().create_query_pool(&info, None) }.called("vkCreateQueryPool")?;
        // A query that was never reset is undefined, and must not be asked for.
        // SAFETY: the pool is new, so nothing in flight uses it; `check` has seen that the feature is enabled.
        unsafe { device.raw().reset_query_pool(pool, 0, count) };
        Ok(Self { device: device.clone(), pool })
    }

    /// Records that `count` timestamps from `first` on will be written anew.
    ///
    /// # Safety
    /// `commands` is recording, outside a render pass, and of this device; the pool lives until it has run.
    pub unsafe fn reset(&self, commands: vk::CommandBuffer, first: u32, count: u32) {
        // SAFETY: the caller vouches for `commands`.
        unsafe { self.device.raw().cmd_reset_query_pool(commands, self.pool, first, count) };
    }

    /// Records a timestamp, taken when all commands before it are done.
    ///
    /// # Safety
    /// As [`Timestamps::reset`], which was recorded for this one before.
    pub unsafe fn write(&self, commands: vk::CommandBuffer, at: u32) {
        let stage = vk::PipelineStageFlags::BOTTOM_OF_PIPE;
        // SAFETY: the caller vouches for `commands`.
        unsafe { self.device.raw().cmd_write_timestamp(commands, stage, self.pool, at) };
    }

    /// Microseconds since the first of `count` timestamps from `first` on; `None` where they are not all written yet.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], [`Error::Vulkan`].
    pub fn read(&self, first: u32, count: u32) -> Result<Option<Vec<f64>>> {
        let mut ticks = vec![0u64; count as usize];
        // SAFETY: the pool is ours and all its queries were reset when it was made. Without WAIT the call returns at
        // once.
        let read = unsafe {
            self.device.raw().get_query_pool_results(self.pool, first, &mut ticks, vk::QueryResultFlags::TYPE_64)
        };
        if read == Err(vk::Result::NOT_READY) {
            return Ok(None);
        }
        read.called("vkGetQueryPoolResults")?;
        let caps = self.device.caps();
        // Counters of fewer than 64 bits wrap.
        let mask = u64::MAX >> (64 - caps.timestamp_bits.clamp(1, 64));
        let start = ticks.first().copied().unwrap_or_default();
        let microseconds =
            |tick: &u64| (tick.wrapping_sub(start) & mask) as f64 * f64::from(caps.timestamp_period) * 1e-3;
        Ok(Some(ticks.iter().map(microseconds).collect()))
    }
}

impl Drop for Timestamps {
    fn drop(&mut self) {
        // SAFETY: owners wait for the device to be done before they drop the pool.
        unsafe { self.device.raw().destroy_query_pool(self.pool, None) };
    }
}

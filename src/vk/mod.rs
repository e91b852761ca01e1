//! Everything that touches Vulkan: devices, memory, pipelines, submission. `unsafe` lives here and where commands are
//! recorded or a caller's handles are taken (`record.rs`, `recorded.rs`, `pass.rs`, `arena.rs`, `renderer.rs`,
//! `host.rs`).

pub(crate) mod cache;
pub mod caps;
pub(crate) mod debug;
pub mod device;
pub mod instance;
pub(crate) mod interop;
pub mod matrix;
pub mod memory;
pub mod pipeline;
pub mod pipeline_cache;
pub mod raw;
pub mod selector;
#[cfg(unix)]
pub(crate) mod shared_buffer;
pub mod statistics;
pub mod submit;
#[cfg(unix)]
pub(crate) mod timeline;
pub mod timestamps;

use crate::error::{Error, Result};
use ash::vk;

/// Turns a failed Vulkan call into the crate's error, with the name of the call.
pub(crate) trait Checked<T> {
    fn called(self, call: &'static str) -> Result<T>;
}

impl<T> Checked<T> for Result<T, vk::Result> {
    fn called(self, call: &'static str) -> Result<T> {
        self.map_err(|result| match result {
            vk::Result::ERROR_DEVICE_LOST => Error::DeviceLost,
            result => Error::Vulkan { call, result },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_device_is_told_from_other_failures() {
        let failed = |result: vk::Result| Err::<(), _>(result).called("vkQueueSubmit");
        assert!(matches!(failed(vk::Result::ERROR_DEVICE_LOST), Err(Error::DeviceLost)));
        let other = failed(vk::Result::ERROR_INITIALIZATION_FAILED);
        assert!(matches!(other, Err(Error::Vulkan { call: "vkQueueSubmit", .. })));
    }
}

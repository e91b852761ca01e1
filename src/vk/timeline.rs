//! Timeline semaphores, on a device of our own.

use super::Checked;
use super::device::Device;
use crate::error::{Error, Result};
use ash::{khr, vk};
use std::os::fd::{AsRawFd, FromRawFd, IntoRawFd, OwnedFd};
use std::sync::Arc;
use std::time::Duration;

/// A number that grows, and that queues and hosts wait for and raise: `VkSemaphore` of the type
/// `VK_SEMAPHORE_TYPE_TIMELINE`, on a device that the library opened. `Send` and `Sync`; cheap to clone: clones are the
/// same semaphore.
#[derive(Clone)]
pub struct TimelineSemaphore(Arc<Inner>);

struct Inner {
    device: Device,
    raw: vk::Semaphore,
}

/// A value of a semaphore, to wait for or to signal.
#[derive(Clone)]
pub struct TimelinePoint {
    /// The semaphore.
    pub semaphore: TimelineSemaphore,
    /// The value: what waits goes on when the semaphore's is at least as large.
    pub value: u64,
}

impl TimelineSemaphore {
    /// Makes a semaphore. It can be exported where [`Interop::timeline_fd`](crate::Interop::timeline_fd) says so.
    ///
    /// # Errors
    /// [`Error::Binding`] on a renderer's device, which has semaphores of its own; [`Error::Vulkan`].
    pub fn new(device: &Device, value: u64) -> Result<Self> {
        if device.queue().is_none() {
            return Err(Error::Binding("the device is a renderer's: it makes its semaphores itself".into()));
        }
        let handle = vk::ExternalSemaphoreHandleTypeFlags::OPAQUE_FD;
        let mut export = vk::ExportSemaphoreCreateInfo::default().handle_types(handle);
        let mut ty = vk::SemaphoreTypeCreateInfo::default()
            .semaphore_type(vk::SemaphoreType::TIMELINE)
            .initial_value(value);
        let mut info = vk::SemaphoreCreateInfo::default().push_next(&mut ty);
        if device.interop().timeline_fd.export {
            info = info.push_next(&mut export);
        }
        // SAFETY: the device is alive; the chained structs live until the call returns.
        let raw = unsafe { device.raw().create_semaphore(&info, None) }.called("vkCreateSemaphore")?;
        device.name(raw, "timeline");
        Ok(Self(Arc::new(Inner { device: device.clone(), raw })))
    }

    /// Another's semaphore, by an opaque file descriptor.
    ///
    /// # Errors
    /// As [`TimelineSemaphore::new`]; [`Error::Unsupported`] where the device cannot take it.
    ///
    /// # Safety
    /// `fd` was exported as `VK_EXTERNAL_SEMAPHORE_HANDLE_TYPE_OPAQUE_FD_BIT` from a timeline semaphore, by the same
    /// driver ([`Interop::driver_uuid`](crate::Interop::driver_uuid)) for the same device.
    pub unsafe fn import(device: &Device, fd: OwnedFd) -> Result<Self> {
        let semaphore = Self::new(device, 0)?;
        let functions = functions(device, device.interop().timeline_fd.import, "import of timeline semaphores")?;
        let info = vk::ImportSemaphoreFdInfoKHR::default()
            .semaphore(semaphore.0.raw)
            .handle_type(vk::ExternalSemaphoreHandleTypeFlags::OPAQUE_FD)
            .fd(fd.as_raw_fd());
        // SAFETY: the semaphore is new; the caller vouches for the descriptor.
        unsafe { functions.import_semaphore_fd(&info) }.called("vkImportSemaphoreFdKHR")?;
        // It is the driver's from now on.
        let _ = fd.into_raw_fd();
        Ok(semaphore)
    }

    /// An opaque file descriptor of the semaphore, for another API or device.
    ///
    /// # Errors
    /// [`Error::Unsupported`] where the device cannot; [`Error::Vulkan`].
    pub fn export(&self) -> Result<OwnedFd> {
        let Inner { device, raw } = &*self.0;
        let functions = functions(device, device.interop().timeline_fd.export, "export of timeline semaphores")?;
        let info = vk::SemaphoreGetFdInfoKHR::default()
            .semaphore(*raw)
            .handle_type(vk::ExternalSemaphoreHandleTypeFlags::OPAQUE_FD);
        // SAFETY: the semaphore was made to be exported.
        let fd = unsafe { functions.get_semaphore_fd(&info) }.called("vkGetSemaphoreFdKHR")?;
        // SAFETY: the descriptor is new and the caller's.
        Ok(unsafe { OwnedFd::from_raw_fd(fd) })
    }

    /// The value now.
    ///
    /// # Errors
    /// [`Error::DeviceLost`], [`Error::Vulkan`].
    pub fn value(&self) -> Result<u64> {
        let Inner { device, raw } = &*self.0;
        // SAFETY: the semaphore is a timeline of this device; the same below.
        unsafe { device.raw().get_semaphore_counter_value(*raw) }.called("vkGetSemaphoreCounterValue")
    }

    /// Raises the value from the host.
    ///
    /// # Errors
    /// [`Error::InvalidOption`] where it is no larger than the value now; as [`TimelineSemaphore::value`].
    pub fn signal(&self, value: u64) -> Result<()> {
        self.check(value)?;
        let Inner { device, raw } = &*self.0;
        let info = vk::SemaphoreSignalInfo::default().semaphore(*raw).value(value);
        // SAFETY: as above.
        unsafe { device.raw().signal_semaphore(&info) }.called("vkSignalSemaphore")
    }

    /// Waits on the host, and says whether the value came within the time.
    ///
    /// # Errors
    /// As [`TimelineSemaphore::value`].
    pub fn wait(&self, value: u64, timeout: Duration) -> Result<bool> {
        let Inner { device, raw } = &*self.0;
        let (semaphores, values) = ([*raw], [value]);
        let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        let nanoseconds = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        // SAFETY: as above.
        match unsafe { device.raw().wait_semaphores(&info, nanoseconds) } {
            Err(vk::Result::TIMEOUT) => Ok(false),
            waited => waited.called("vkWaitSemaphores").map(|()| true),
        }
    }

    /// Refuses a value that the semaphore has passed.
    pub(crate) fn check(&self, value: u64) -> Result<()> {
        let now = self.value()?;
        if value > now {
            return Ok(());
        }
        let reason = format!("{value}; the semaphore is at {now}, and what is signalled must be larger");
        Err(Error::InvalidOption { option: "timeline value", reason })
    }

    pub(crate) fn raw(&self) -> vk::Semaphore {
        self.0.raw
    }

    pub(crate) fn device(&self) -> &Device {
        &self.0.device
    }
}

fn functions(device: &Device, can: bool, what: &str) -> Result<khr::external_semaphore_fd::Device> {
    match device.instance().filter(|_| can) {
        Some(instance) => Ok(khr::external_semaphore_fd::Device::new(instance, device.raw())),
        None => Err(Error::Unsupported {
            device: device.info().name.clone(),
            missing: format!("{what} (VK_KHR_external_semaphore_fd, OPAQUE_FD)"),
        }),
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        // SAFETY: submissions keep the semaphores that they wait for and signal, so none is pending.
        unsafe { self.device.raw().destroy_semaphore(self.raw, None) };
    }
}

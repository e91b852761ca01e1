//! Names of objects and labels in command buffers, for graphics debuggers and the validation layer
//! (`VK_EXT_debug_utils`).

use super::device::Device;
use ash::vk::Handle;
use ash::{ext, vk};
use std::ffi::{CStr, CString};

/// The functions of a device; `None` where they are not all there, as the instance was made without the extension.
pub(crate) fn load(instance: &ash::Instance, device: &ash::Device) -> Option<ext::debug_utils::Device> {
    let names = [c"vkSetDebugUtilsObjectNameEXT", c"vkCmdBeginDebugUtilsLabelEXT", c"vkCmdEndDebugUtilsLabelEXT"];
    // SAFETY: the device is of the instance.
    let found = |name: &CStr| unsafe { instance.get_device_proc_addr(device.handle(), name.as_ptr()) }.is_some();
    names.into_iter().all(found).then(|| ext::debug_utils::Device::new(instance, device))
}

/// A text without zeros in it.
pub(crate) fn text(text: &str) -> CString {
    CString::new(text.replace('\0', "?")).unwrap_or_default()
}

impl Device {
    /// Names an object of this device; nothing where nobody sees it.
    pub(crate) fn name(&self, object: impl Handle, name: &str) {
        let Some(debug) = self.debug() else { return };
        let name = text(&format!("vkdenoise: {name}"));
        let info = vk::DebugUtilsObjectNameInfoEXT::default().object_handle(object).object_name(&name);
        // Without its name an object is as good.
        // SAFETY: the object was just made, so that no other thread uses it.
        let _ = unsafe { debug.set_debug_utils_object_name(&info) };
    }

    /// Begins a label; nothing where nobody sees it.
    ///
    /// # Safety
    /// `commands` is recording and of this device; [`Device::end_label`] follows in it.
    pub(crate) unsafe fn begin_label(&self, commands: vk::CommandBuffer, name: &CStr) {
        if let Some(debug) = self.debug() {
            let label = vk::DebugUtilsLabelEXT::default().label_name(name);
            // SAFETY: the caller vouches for `commands`.
            unsafe { debug.cmd_begin_debug_utils_label(commands, &label) };
        }
    }

    /// Ends the last label that was begun.
    ///
    /// # Safety
    /// As [`Device::begin_label`], which was recorded before.
    pub(crate) unsafe fn end_label(&self, commands: vk::CommandBuffer) {
        if let Some(debug) = self.debug() {
            // SAFETY: the caller vouches for `commands`.
            unsafe { debug.cmd_end_debug_utils_label(commands) };
        }
    }
}

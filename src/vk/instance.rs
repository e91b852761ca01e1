//! The Vulkan loader, an instance of our own, and the validation layer's messages.

use super::Checked;
use crate::error::{Error, Result};
use ash::{ext, vk};
use std::ffi::{CStr, c_void};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// What to do where the loader finds no driver.
pub(crate) const NO_DRIVER: &str = "there is no Vulkan driver; install one (Debian: mesa-vulkan-drivers)";

const VALIDATION: &CStr = c"VK_LAYER_KHRONOS_validation";

/// What is in a message that is not about us, and is left out: while a device is made, layers of the driver or of other
/// programs look this function up as if it were the device's. We load no functions of video, and `ash` asks the
/// instance for this one.
const OF_OTHERS: &str = "vkGetPhysicalDeviceVideoEncodeQualityLevelPropertiesKHR";

/// What the validation layer said.
pub(crate) type Messages = Arc<Mutex<Vec<String>>>;

/// An instance of our own. Destroyed when dropped.
pub(crate) struct OwnedInstance {
    // Keeps the loader's library open for as long as the instance lives.
    pub entry: ash::Entry,
    pub raw: ash::Instance,
    /// Whether `VK_EXT_debug_utils` is enabled.
    pub debug_utils: bool,
    messenger: Option<(ext::debug_utils::Instance, vk::DebugUtilsMessengerEXT)>,
    /// Boxed so that the messenger's user pointer stays valid wherever the struct moves.
    messages: Box<Messages>,
}

impl OwnedInstance {
    /// Opens the loader (the system's, or the library at `loader`) and makes a Vulkan 1.2 instance, with the validation
    /// layer (and its synchronisation validation) when asked for.
    pub fn new(loader: Option<&Path>, validation: bool) -> Result<Self> {
        // SAFETY: loading a Vulkan loader; it runs no code of ours.
        let entry = unsafe { loader.map_or_else(|| ash::Entry::load(), |path| ash::Entry::load_from(path)) }
            .map_err(|e| Error::NoLoader(e.to_string()))?;
        let app = vk::ApplicationInfo::default()
            .application_name(c"vkdenoise")
            .engine_name(c"vkdenoise")
            .api_version(vk::API_VERSION_1_2);
        let mut layers = Vec::new();
        let mut extensions = Vec::new();
        if validation {
            // SAFETY: plain query of the loader.
            let present = unsafe { entry.enumerate_instance_layer_properties() }
                .called("vkEnumerateInstanceLayerProperties")?
                .iter()
                .any(|layer| layer.layer_name_as_c_str() == Ok(VALIDATION));
            if !present {
                return Err(Error::InvalidOption {
                    option: "validation",
                    reason: "VK_LAYER_KHRONOS_validation is not installed (Debian: vulkan-validationlayers)".into(),
                });
            }
            layers.push(VALIDATION.as_ptr());
            extensions.push(ext::validation_features::NAME.as_ptr());
        }
        // SAFETY: plain query of the loader.
        let known = unsafe { entry.enumerate_instance_extension_properties(None) }.unwrap_or_default();
        let debug_utils = validation
            || known.iter().any(|extension| extension.extension_name_as_c_str() == Ok(ext::debug_utils::NAME));
        if debug_utils {
            extensions.push(ext::debug_utils::NAME.as_ptr());
        }
        let enabled = [vk::ValidationFeatureEnableEXT::SYNCHRONIZATION_VALIDATION];
        let mut features = vk::ValidationFeaturesEXT::default().enabled_validation_features(&enabled);
        let mut info = vk::InstanceCreateInfo::default()
            .application_info(&app)
            .enabled_layer_names(&layers)
            .enabled_extension_names(&extensions);
        if validation {
            info = info.push_next(&mut features);
        }
        // SAFETY: every pointer in `info` outlives the call.
        let created = unsafe { entry.create_instance(&info, None) };
        if matches!(created, Err(vk::Result::ERROR_INCOMPATIBLE_DRIVER)) {
            return Err(Error::NoDevice(NO_DRIVER.into()));
        }
        let raw = created.called("vkCreateInstance")?;
        let mut instance = Self { debug_utils, messenger: None, messages: Box::default(), raw, entry };
        if validation {
            let loader = ext::debug_utils::Instance::new(&instance.entry, &instance.raw);
            let info = vk::DebugUtilsMessengerCreateInfoEXT::default()
                .message_severity(
                    vk::DebugUtilsMessageSeverityFlagsEXT::WARNING | vk::DebugUtilsMessageSeverityFlagsEXT::ERROR,
                )
                .message_type(
                    vk::DebugUtilsMessageTypeFlagsEXT::VALIDATION | vk::DebugUtilsMessageTypeFlagsEXT::PERFORMANCE,
                )
                .pfn_user_callback(Some(on_message))
                .user_data((&raw mut *instance.messages).cast());
            // SAFETY: the user data is boxed in `instance`, which destroys the messenger before it is freed.
            let messenger =
                unsafe { loader.create_debug_utils_messenger(&info, None) }.called("vkCreateDebugUtilsMessengerEXT")?;
            instance.messenger = Some((loader, messenger));
        }
        Ok(instance)
    }

    /// A handle to the validation messages.
    pub fn messages(&self) -> Messages {
        Messages::clone(&self.messages)
    }
}

impl Drop for OwnedInstance {
    fn drop(&mut self) {
        // SAFETY: everything made from the instance holds it alive, so nothing uses it any more.
        unsafe {
            if let Some((loader, messenger)) = &self.messenger {
                loader.destroy_debug_utils_messenger(*messenger, None);
            }
            self.raw.destroy_instance(None);
        }
    }
}

unsafe extern "system" fn on_message(
    _severity: vk::DebugUtilsMessageSeverityFlagsEXT,
    _types: vk::DebugUtilsMessageTypeFlagsEXT,
    data: *const vk::DebugUtilsMessengerCallbackDataEXT<'_>,
    user: *mut c_void,
) -> vk::Bool32 {
    // SAFETY: the layer passes valid callback data, and `user` is the boxed Messages of a live instance.
    unsafe {
        let text = (*data).message_as_c_str().map(|m| m.to_string_lossy().into_owned()).unwrap_or_default();
        if text.contains(OF_OTHERS) {
            return vk::FALSE;
        }
        let messages = &*user.cast::<Messages>();
        messages.lock().unwrap_or_else(PoisonError::into_inner).push(text);
    }
    vk::FALSE
}

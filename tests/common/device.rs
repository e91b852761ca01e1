//! One device per test binary, under the validation layer.

use std::sync::OnceLock;
use vkdenoise::vk::device::DeviceOptions;
use vkdenoise::{Cache, Device, DeviceSelector};

/// The device that `VKDENOISE_DEVICE` names, or the best. Without the layer where `VKDENOISE_VALIDATION` is `off`: a
/// machine that is there to be measured need not have it.
pub fn device() -> &'static Device {
    static DEVICE: OnceLock<Device> = OnceLock::new();
    DEVICE.get_or_init(|| {
        let selector = DeviceSelector::from_env().unwrap_or_default();
        let device = Device::open_with(&DeviceOptions {
            selector,
            validation: std::env::var("VKDENOISE_VALIDATION").as_deref() != Ok("off"),
            cache: Cache::Off,
            ..DeviceOptions::default()
        });
        device.unwrap_or_else(|error| panic!("no device to test on: {error}"))
    })
}

/// Fails with the first messages of the validation layer, if there are any.
pub fn assert_no_validation_messages() {
    let messages = device().validation_messages();
    let first = messages.iter().take(3).map(String::as_str).collect::<Vec<_>>().join("\n");
    assert!(messages.is_empty(), "{} validation messages:\n{first}", messages.len());
}

//! The Vulkan devices there are.

use crate::error::raised;
use pyo3::prelude::*;

/// A Vulkan device as the denoiser sees it.
#[pyclass(frozen, get_all, module = "vkdenoise")]
#[derive(Clone)]
pub struct DeviceInfo {
    /// Position in `devices()`, for `device=`.
    index: usize,
    /// The driver's name for it.
    name: String,
    /// The driver's name and version.
    driver: String,
    /// "discrete GPU", "integrated GPU", "virtual GPU", "CPU" or "other".
    kind: String,
    /// Vulkan version, such as "1.3.230".
    api_version: String,
    /// Size of its largest heap of its own memory, in bytes.
    memory_bytes: u64,
    /// What the denoiser needs and the device lacks, named as in the Vulkan specification.
    missing: Vec<String>,
}

#[pymethods]
impl DeviceInfo {
    /// Whether the denoiser runs on it: nothing is missing.
    #[getter]
    fn usable(&self) -> bool {
        self.missing.is_empty()
    }

    fn __repr__(&self) -> String {
        let Self { index, name, kind, driver, .. } = self;
        format!("DeviceInfo(index={index}, name={name:?}, kind={kind:?}, driver={driver:?}, usable={})", {
            if self.usable() { "True" } else { "False" }
        })
    }
}

impl From<&vkdenoise::DeviceInfo> for DeviceInfo {
    fn from(info: &vkdenoise::DeviceInfo) -> Self {
        Self {
            index: info.index,
            name: info.name.clone(),
            driver: info.driver.clone(),
            kind: info.kind.to_string(),
            api_version: info.api_version.clone(),
            memory_bytes: info.memory_bytes,
            missing: info.missing.clone(),
        }
    }
}

impl DeviceInfo {
    /// Its name.
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// Every Vulkan device there is, usable or not.
#[pyfunction]
pub fn devices(py: Python<'_>) -> PyResult<Vec<DeviceInfo>> {
    let found = py.detach(vkdenoise::Device::list).map_err(raised)?;
    Ok(found.iter().map(DeviceInfo::from).collect())
}

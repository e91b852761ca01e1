//! The driver's cache of compiled kernels, kept in a file between processes.

use super::caps::Identity;
use crate::vk::cache::{Cache, CacheFile, hash};
use ash::vk;
use std::sync::{Mutex, PoisonError};

/// A device's pipeline cache; a null handle where the driver would not make one. Its owner destroys it.
pub(crate) struct PipelineCache {
    pub raw: vk::PipelineCache,
    file: Option<CacheFile>,
    /// Hash of what the file holds.
    kept: Mutex<Option<u64>>,
}

/// Bytes of the header that Vulkan prescribes: its size, its version, vendor, device, UUID.
const HEADER: usize = 32;

impl PipelineCache {
    /// With what the file of this device, driver and set of kernels holds. What is damaged or another driver's is left
    /// alone.
    pub fn new(device: &ash::Device, identity: &Identity, cache: &Cache) -> Self {
        let file = CacheFile::of_device(cache, "pipelines", identity);
        let kept = file.as_ref().and_then(CacheFile::read).filter(|data| is_of(data, identity));
        let info = vk::PipelineCacheCreateInfo::default().initial_data(kept.as_deref().unwrap_or_default());
        // SAFETY: the device is alive, and the data were written by a driver of the same identity.
        let made = unsafe { device.create_pipeline_cache(&info, None) };
        tracing::debug!(bytes = kept.as_ref().map_or(0, Vec::len), made = made.is_ok(), "pipeline cache");
        Self { raw: made.unwrap_or_default(), file, kept: Mutex::new(kept.as_deref().map(hash)) }
    }

    /// Writes the file anew, if the driver has something new to keep.
    pub fn store(&self, device: &ash::Device) {
        let Some(file) = self.file.as_ref().filter(|_| self.raw != vk::PipelineCache::null()) else { return };
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        // SAFETY: the cache is alive and of this device.
        let Ok(data) = (unsafe { device.get_pipeline_cache_data(self.raw) }) else { return };
        let found = Some(hash(&data));
        // A driver may keep nothing here and everything in a cache of its own.
        if data.len() <= HEADER || *kept == found {
            return;
        }
        match file.write(&data) {
            Ok(()) => *kept = found,
            Err(error) => tracing::debug!(%error, "the pipeline cache cannot be written"),
        }
    }
}

/// Whether data begin with the header of a device and driver. Drivers check this too; not all of them with care.
fn is_of(data: &[u8], identity: &Identity) -> bool {
    let fields = [HEADER as u32, vk::PipelineCacheHeaderVersion::ONE.as_raw() as u32, identity.vendor, identity.device];
    let header = fields.iter().flat_map(|field| field.to_ne_bytes()).chain(identity.uuid);
    data.len() > HEADER && data[..HEADER].iter().copied().eq(header)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_of_another_device_or_driver_are_not_given_to_this_one() {
        let identity = Identity { vendor: 5, device: 6, driver: 7, uuid: [9; 16], subgroup: 8 };
        let mut data: Vec<u8> = [32u32, 1, 5, 6].iter().flat_map(|field| field.to_ne_bytes()).collect();
        data.extend([9; 16]);
        assert!(!is_of(&data, &identity), "nothing but a header");
        data.push(0);
        assert!(is_of(&data, &identity));
        for at in 0..HEADER {
            let mut other = data.clone();
            other[at] ^= 1;
            assert!(!is_of(&other, &identity), "byte {at}");
        }
    }
}

//! Which of the physical devices is meant.

use super::Checked;
use super::caps::{self, Caps, DeviceInfo};
use super::instance::{NO_DRIVER, OwnedInstance};
use crate::error::{Error, Result};
use ash::vk;
use std::convert::Infallible;
use std::str::FromStr;

/// Which device to open.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum DeviceSelector {
    /// The best one: a discrete GPU before an integrated one before a CPU driver; the larger memory on a tie.
    #[default]
    Best,
    /// By position in [`crate::Device::list`].
    Index(usize),
    /// By a part of its name or of its driver's, in any case.
    Name(String),
}

impl FromStr for DeviceSelector {
    type Err = Infallible;

    /// `best`, an index, or part of a name.
    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match (text, text.parse()) {
            ("best" | "", _) => Self::Best,
            (_, Ok(index)) => Self::Index(index),
            (name, Err(_)) => Self::Name(name.to_owned()),
        })
    }
}

impl DeviceSelector {
    /// The selector in the environment variable `VKDENOISE_DEVICE`, where that is set.
    pub fn from_env() -> Option<Self> {
        let Ok(selector) = std::env::var("VKDENOISE_DEVICE").ok()?.parse();
        Some(selector)
    }
}

/// A physical device, and what it can do.
type Found = (vk::PhysicalDevice, DeviceInfo, Caps);

/// Every physical device, in the loader's order.
pub(super) fn enumerate(instance: &OwnedInstance) -> Result<Vec<Found>> {
    // SAFETY: the instance is alive.
    let physicals = unsafe { instance.raw.enumerate_physical_devices() }.called("vkEnumeratePhysicalDevices")?;
    let inspect = |(index, physical)| {
        let (info, caps) = caps::inspect(&instance.raw, physical, index);
        (physical, info, caps)
    };
    Ok(physicals.into_iter().enumerate().map(inspect).collect())
}

/// Position of the wanted device.
pub(super) fn select(found: &[Found], selector: &DeviceSelector) -> Result<usize> {
    let unknown = |wanted: String| {
        let names: Vec<_> = found.iter().map(|(_, info, _)| format!("{}: {}", info.index, info.name)).collect();
        let available = if names.is_empty() { "none".into() } else { names.join(", ") };
        Error::UnknownDevice { wanted, available }
    };
    match selector {
        DeviceSelector::Index(index) if *index < found.len() => Ok(*index),
        DeviceSelector::Index(index) => Err(unknown(index.to_string())),
        DeviceSelector::Name(name) => {
            let wanted = name.to_lowercase();
            let matches =
                |(_, info, _): &Found| format!("{} {}", info.name, info.driver).to_lowercase().contains(&wanted);
            found.iter().position(matches).ok_or_else(|| unknown(name.clone()))
        }
        DeviceSelector::Best => found
            .iter()
            .enumerate()
            .filter(|(_, (_, info, _))| info.missing.is_empty())
            .min_by_key(|(_, (_, info, _))| (info.kind, std::cmp::Reverse(info.memory_bytes)))
            .map(|(at, _)| at)
            .ok_or_else(|| {
                let lacks: Vec<_> = found
                    .iter()
                    .map(|(_, info, _)| format!("{} lacks {}", info.name, info.missing.join(", ")))
                    .collect();
                Error::NoDevice(if lacks.is_empty() { NO_DRIVER.into() } else { lacks.join("; ") })
            }),
    }
}

//! Which devices there are, and which to use.

use crate::Failure;
use crate::args::Args;
use crate::reporter::print_line;
use serde::Serialize;
use vkdenoise::{Device, DeviceInfo, DeviceKind, DeviceSelector};

/// The devices to share the images out among: one, or with "all" every GPU that can be used, and where there is none
/// the CPU drivers.
pub fn wanted(args: &Args) -> Result<Vec<DeviceSelector>, Failure> {
    let selector = args.device.clone().or_else(DeviceSelector::from_env).unwrap_or_default();
    if !matches!(&selector, DeviceSelector::Name(name) if name.eq_ignore_ascii_case("all")) {
        return Ok(vec![selector]);
    }
    let mut usable: Vec<DeviceInfo> = Device::list().map_err(Failure::failed)?;
    usable.retain(|device| device.missing.is_empty());
    if usable.iter().any(|device| device.kind != DeviceKind::Cpu) {
        usable.retain(|device| device.kind != DeviceKind::Cpu);
    }
    // Without any, opening the best says what each lacks.
    match usable.is_empty() {
        true => Ok(vec![DeviceSelector::Best]),
        false => Ok(usable.into_iter().map(|device| DeviceSelector::Index(device.index)).collect()),
    }
}

#[derive(Serialize)]
struct Row {
    index: usize,
    name: String,
    kind: String,
    driver: String,
    api_version: String,
    memory_bytes: u64,
    usable: bool,
    missing: Vec<String>,
}

/// Prints every device, one a line, and what it lacks.
pub fn list(json: bool) -> Result<(), Failure> {
    let devices = Device::list().map_err(Failure::failed)?;
    if devices.is_empty() {
        return Err(Failure::Failed(
            "there is no Vulkan device: install a driver (Debian: mesa-vulkan-drivers)".into(),
        ));
    }
    for device in devices {
        let row = Row {
            index: device.index,
            name: device.name,
            kind: device.kind.to_string(),
            driver: device.driver,
            api_version: device.api_version,
            memory_bytes: device.memory_bytes,
            usable: device.missing.is_empty(),
            missing: device.missing,
        };
        print_line(&if json { json_line(&row)? } else { text_line(&row) })?;
    }
    Ok(())
}

fn json_line(row: &Row) -> Result<String, Failure> {
    serde_json::to_string(row).map_err(Failure::failed)
}

fn text_line(row: &Row) -> String {
    let verdict = if row.usable { "usable".into() } else { format!("lacks {}", row.missing.join(", ")) };
    let gib = row.memory_bytes as f64 / f64::from(1 << 30);
    let Row { index, name, kind, driver, api_version, .. } = row;
    format!("{index}: {name} ({kind}), {driver}, Vulkan {api_version}, {gib:.1} GiB: {verdict}")
}

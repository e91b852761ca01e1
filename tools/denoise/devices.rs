//! `--list-devices`.

use crate::Failure;
use serde::Serialize;
use vkdenoise::Device;

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
        crate::report::print_line(&if json { json_line(&row)? } else { text_line(&row) })?;
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

//! The device under measurement and what is said of it.

use crate::args::Common;
use cpu_time::ProcessTime;
use serde::Serialize;
use std::time::SystemTime;
use vkdenoise::profile::Roof;
use vkdenoise::{Device, DeviceKind, DeviceOptions, Error};

/// An open device with its roofs.
pub struct Session {
    pub device: Device,
    pub roof: Roof,
    pub repeat: u32,
    pub warm_up: u32,
}

/// What a report begins with.
#[derive(Serialize)]
pub struct Header {
    device: String,
    driver: String,
    vulkan: String,
    date: String,
    repeat: u32,
    timestamps: bool,
    roof_gflop_per_second_f32: f64,
    roof_gb_per_second_f32: f64,
    roof_gflop_per_second_f16: Option<f64>,
    roof_gb_per_second_f16: Option<f64>,
    roof_gflop_per_second_matrix: Option<f64>,
}

impl Session {
    /// Opens the device and measures its roofs.
    pub fn open(common: &Common) -> Result<Self, Error> {
        let options = DeviceOptions {
            selector: common.device.clone(),
            pipeline_statistics: true,
            host_clock: common.host_clock,
            matrix_halves: common.matrix_halves,
            ..DeviceOptions::default()
        };
        let device = Device::open_with(&options)?;
        let roof = Roof::measure(&device)?;
        Ok(Self { device, roof, repeat: common.repeat, warm_up: common.warm_up })
    }

    /// What a piece of work costs beside its time: milliseconds of this process's CPU time on CPU drivers, where other
    /// work on the machine stretches the time but hardly this; `None` elsewhere.
    pub fn cpu_ms<T>(&self, work: impl FnOnce() -> Result<T, Error>) -> Result<(T, Option<f64>), Error> {
        let clock = ProcessTime::now();
        let done = work()?;
        let ms = clock.elapsed().as_secs_f64() * 1e3;
        Ok((done, (self.device.info().kind == DeviceKind::Cpu).then_some(ms)))
    }

    pub fn header(&self) -> Header {
        let info = self.device.info();
        let date = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
        Header {
            device: info.name.clone(),
            driver: info.driver.clone(),
            vulkan: info.api_version.clone(),
            date: date.split('T').next().unwrap_or_default().into(),
            repeat: self.repeat,
            timestamps: self.device.has_timestamps(),
            roof_gflop_per_second_f32: self.roof.flops_f32 * 1e-9,
            roof_gb_per_second_f32: self.roof.bytes_f32 * 1e-9,
            roof_gflop_per_second_f16: self.roof.flops_f16.map(|rate| rate * 1e-9),
            roof_gb_per_second_f16: self.roof.bytes_f16.map(|rate| rate * 1e-9),
            roof_gflop_per_second_matrix: self.roof.flops_matrix.map(|rate| rate * 1e-9),
        }
    }
}

impl Header {
    /// A few lines.
    pub fn text(&self) -> String {
        let Self { device, driver, vulkan, date, repeat, .. } = self;
        let (flops, bytes) = (self.roof_gflop_per_second_f32, self.roof_gb_per_second_f32);
        let mut text = format!("{device}; {driver}; Vulkan {vulkan}; {date}; medians of {repeat} runs\n");
        text += &format!("roof: fp32 {flops:.1} GFLOP/s of multiply-adds, {bytes:.1} GB/s of copies");
        if let (Some(flops), Some(bytes)) = (self.roof_gflop_per_second_f16, self.roof_gb_per_second_f16) {
            text += &format!("; fp16 {flops:.1} GFLOP/s, {bytes:.1} GB/s");
        }
        text += &match self.roof_gflop_per_second_matrix {
            Some(flops) => format!("; matrices {flops:.1} GFLOP/s\n"),
            None => "; no cooperative matrices\n".into(),
        };
        if !self.timestamps {
            text += "No timestamps: whole passes are timed, on the host, and no kernels.\n";
        }
        text
    }
}

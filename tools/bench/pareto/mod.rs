//! Run time against error: what every setting of the engine costs and how far off it is, frame by frame.

pub mod frames;
pub mod front;
pub mod measure;
pub mod plot;
pub mod store;
pub mod table;

use serde::{Deserialize, Serialize};

/// What goes wrong beside the figures.
pub type Result<T, E = Box<dyn std::error::Error + Send + Sync>> = std::result::Result<T, E>;

/// What a time was taken with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Clock {
    /// CPU seconds of the whole process, for devices that are CPUs.
    Cpu,
    /// The device's timestamps around the pass.
    Device,
}

/// One setting on one frame: a line of the results file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// The network, or a peer's name.
    pub network: String,
    /// The tier of the engine, or a peer's mode.
    pub tier: String,
    /// Folder of the frame's scene.
    pub scene: String,
    /// Folder of the frame's view.
    pub view: String,
    /// Samples per pixel.
    pub spp: u32,
    /// Pixels of the frame.
    pub pixels: u64,
    /// What the seconds were taken with.
    pub clock: Clock,
    /// Median seconds of a warm run.
    pub seconds: f64,
    /// Least seconds.
    pub seconds_min: f64,
    /// Runs that were timed.
    pub runs: u32,
    /// PSNR in dB to the rendered reference.
    pub psnr: f64,
    /// SSIM to it; `None` for frames of less than 11 pixels.
    pub ssim: Option<f64>,
    /// relMSE to it.
    pub relmse: f64,
    /// Mean FLIP to it, 0 (alike) to 1, of the 8-bit images at 67 pixels a degree (Andersson et al. 2020).
    pub flip: f64,
    /// NMSE of `log1p(exposure * colour)` to the same network in f64, on the frame's upper left part; a peer has none.
    pub nmse: Option<f64>,
    /// Largest difference of a sample in that measure.
    pub worst: Option<f64>,
}

impl Record {
    /// Network and tier.
    pub fn setting(&self) -> String {
        if self.tier.is_empty() { self.network.clone() } else { format!("{}, {}", self.network, self.tier) }
    }

    /// Seconds a million pixels.
    pub fn seconds_per_megapixel(&self) -> f64 {
        self.seconds / self.pixels as f64 * 1e6
    }
}

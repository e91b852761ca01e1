//! The command line tool from outside: what it writes, what it says, how it fails.
//!
//! Runs that need a device are few, as each opens one; the failures are made to happen without any driver.

/// One argument list from literals and paths.
macro_rules! arguments {
    ($($argument:expr),* $(,)?) => { [$(std::ffi::OsStr::new(&$argument).to_os_string()),*] };
}

#[path = "cli/failures.rs"]
mod failures;
#[path = "cli/farm.rs"]
mod farm;
#[path = "cli/files.rs"]
mod files;
#[path = "cli/images.rs"]
mod images;
#[path = "cli/light.rs"]
mod light;
#[path = "cli/signals.rs"]
mod signals;

use exr::prelude::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, LayerAttributes, WritableImage};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use vkdenoise::exr_io::{ExrFrame, LayerOptions};
use vkdenoise::testing::Bench;
use vkdenoise::{Device, DeviceKind, DeviceOptions, DeviceSelector};

const SIZE: (usize, usize) = (32, 24);
const FEATURES: &str = "A albedo.B albedo.G albedo.R B G N.X N.Y N.Z R Z";

struct Directory(tempfile::TempDir);

impl Directory {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// An image of these channels: a smooth scene, noisy where the name is a colour's and `noise` says so.
    fn exr(&self, name: &str, channels: &str, noise: f32) -> PathBuf {
        let mut seed = 7u32;
        let mut channel = |(index, channel): (usize, &str)| {
            let mut random = || {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (seed >> 8) as f32 / (1 << 24) as f32 - 0.5
            };
            let color = matches!(channel.rsplit('.').next(), Some("R" | "G" | "B"));
            let amount = if color && !channel.starts_with("albedo") { noise } else { 0.0 };
            let sample = |i: usize| {
                let (x, y) = ((i % SIZE.0) as f32 / 31.0, (i / SIZE.0) as f32 / 23.0);
                (0.2 + 0.3 * x + 0.2 * y + 0.05 * index as f32) * (1.0 + amount * random())
            };
            AnyChannel::new(channel, FlatSamples::F32((0..SIZE.0 * SIZE.1).map(sample).collect()))
        };
        let channels: Vec<AnyChannel<FlatSamples>> =
            channels.split_whitespace().enumerate().map(&mut channel).collect();
        let channels = AnyChannels::sort(channels.into());
        let mut image = Image::from_encoded_channels(SIZE, Encoding::SMALL_LOSSLESS, channels);
        image.layer_data.attributes =
            LayerAttributes { software_name: Some("a renderer".into()), ..Default::default() };
        let path = self.path(name);
        image.write().non_parallel().to_file(&path).unwrap();
        path
    }

    fn names(&self, folder: &str) -> Vec<String> {
        let entries = std::fs::read_dir(self.path(folder)).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

fn tool() -> Command {
    Command::new(env!("CARGO_BIN_EXE_vkdenoise"))
}

struct Ran {
    code: Option<i32>,
    out: String,
    err: String,
}

fn ran(output: Output) -> Ran {
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    Ran { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
}

fn run<A: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = A>) -> Ran {
    ran(tool().args(arguments).output().unwrap())
}

/// Runs where there is no driver, so that opening a device would be the failure.
fn run_without_device<A: AsRef<std::ffi::OsStr>>(arguments: impl IntoIterator<Item = A>) -> Ran {
    let mut tool = tool();
    for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        tool.env(variable, "no-driver.json");
    }
    let ran = ran(tool.args(arguments).output().unwrap());
    assert!(!ran.err.contains("Vulkan device"), "the device was opened before: {}", ran.err);
    ran
}

fn succeeded(ran: &Ran) {
    assert_eq!(ran.code, Some(0), "{}{}", ran.out, ran.err);
}

fn color(path: &Path) -> Vec<f32> {
    ExrFrame::read(path, &LayerOptions::color_only(None)).unwrap().color().to_vec()
}

//! The command line tool from outside: what it writes, what it says, how it fails.
//!
//! Runs that need a device are few, as each opens one; the failures are made to happen without any driver.
#![cfg(feature = "cli")]

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

/// One argument list from literals and paths.
macro_rules! arguments {
    ($($argument:expr),* $(,)?) => { [$(std::ffi::OsStr::new(&$argument).to_os_string()),*] };
}

#[test]
fn denoises_with_features_reference_json_and_preview() {
    let d = Directory::new();
    let (noisy, reference) = (d.exr("noisy.exr", FEATURES, 1.5), d.exr("reference.exr", FEATURES, 0.0));
    let (out, png) = (d.path("out.exr"), d.path("out.png"));
    let ran = run(arguments![noisy, "-o", out, "--reference", reference, "--png", png, "--json"]);
    succeeded(&ran);
    assert!(ran.err.contains("colour R/G/B, albedo albedo.R/G/B, normal N.X/Y/Z, depth Z"), "{}", ran.err);

    assert_eq!(ran.out.lines().count(), 1, "{}", ran.out);
    let json: Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(json["input"], noisy.to_str().unwrap());
    assert_eq!(json["output"], out.to_str().unwrap());
    assert_eq!((&json["width"], &json["height"]), (&32.into(), &24.into()));
    assert_eq!(json["layers"]["normal"], "N.X/Y/Z");
    for text in ["device", "driver", "precision"] {
        assert!(json[text].as_str().is_some_and(|s| !s.is_empty()), "{text}: {json}");
    }
    for number in ["exposure", "total_ms", "psnr_noisy", "psnr", "ssim_noisy", "ssim", "relmse_noisy", "relmse"] {
        assert!(json[number].as_f64().is_some_and(f64::is_finite), "{number}: {json}");
    }
    assert!(json["gpu_ms"].is_null() || json["gpu_ms"].as_f64().is_some_and(|ms| ms > 0.0), "{json}");
    let figure = |name: &str| json[name].as_f64().unwrap();
    assert!(figure("psnr") > figure("psnr_noisy") && figure("relmse") < figure("relmse_noisy"), "{json}");

    let preview = image::open(&png).unwrap();
    assert_eq!((preview.width(), preview.height()), (3 * 32, 24));
    let everything = |path: &Path| exr::prelude::read_all_flat_layers_from_file(path).unwrap();
    let (before, after) = (everything(&noisy), everything(&out));
    assert_eq!(before.layer_data[0].attributes, after.layer_data[0].attributes);
    let channels = |image: &exr::prelude::FlatImage| image.layer_data[0].channel_data.list.clone();
    for (before, after) in channels(&before).iter().zip(&channels(&after)) {
        let is_color = ["R", "G", "B"].contains(&before.name.to_string().as_str());
        assert_eq!(before == after, !is_color, "{}", before.name);
    }
}

#[test]
fn a_region_is_the_whole_cropped() {
    let d = Directory::new();
    let (noisy, reference) = (d.exr("noisy.exr", FEATURES, 1.5), d.exr("reference.exr", FEATURES, 0.0));
    let (whole, part, png) = (d.path("whole.exr"), d.path("part.exr"), d.path("part.png"));
    succeeded(&run(arguments![noisy, "-o", whole]));
    let region = arguments!["--region", "5,2,20,12", "--reference", reference, "--png", png, "--json"];
    let ran = run(arguments![noisy, "-o", part].into_iter().chain(region));
    succeeded(&ran);
    assert!(ran.err.contains("20 x 12 from (5, 2), ") && ran.err.contains(" of 32 x 24"), "{}", ran.err);
    let json: Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(json["region"], serde_json::json!([5, 2, 20, 12]));
    let work = json["work"].as_f64().unwrap();
    assert!(work > 0.1 && work < 1.0, "{json}");

    let frame = ExrFrame::read(&part, &LayerOptions::color_only(None)).unwrap();
    assert_eq!((frame.extent().width, frame.extent().height), (20, 12));
    let crop =
        |image: Vec<f32>| -> Vec<f32> { (2..14).flat_map(|y| image[3 * (y * 32 + 5)..][..3 * 20].to_vec()).collect() };
    let wanted = crop(color(&whole));
    assert!(frame.color().iter().zip(&wanted).all(|(a, b)| a.to_bits() == b.to_bits()));
    let everything = exr::prelude::read_all_flat_layers_from_file(&part).unwrap();
    assert_eq!(everything.layer_data[0].attributes.layer_position, exr::math::Vec2(5, 2));
    assert_eq!(everything.attributes.display_window.size, exr::math::Vec2(32, 24));
    let preview = image::open(&png).unwrap();
    assert_eq!((preview.width(), preview.height()), (3 * 20, 12));
    // The figures are those of the region.
    let of_crop = |image: &[f32]| {
        let reference = crop(color(&reference));
        vkdenoise::metrics::Comparison::new(frame.extent(), image, &reference).unwrap().psnr()
    };
    let figure = |name: &str| json[name].as_f64().unwrap();
    assert_eq!([figure("psnr_noisy"), figure("psnr")], [of_crop(&crop(color(&noisy))), of_crop(&wanted)]);
}

/// Whatever has less noise than the threshold stays as it is, by the layers that say so or by the image.
#[test]
fn what_is_quiet_keeps_its_pixels() {
    let d = Directory::new();
    let noisy = d.exr("noisy.exr", &format!("{FEATURES} variance.Y"), 1.5);
    let counts = d.exr("counts.exr", "samples", 0.0);
    let (whole, out, png) = (d.path("whole.exr"), d.path("out.exr"), d.path("out.png"));
    succeeded(&run(arguments![noisy, "-o", whole]));
    let skipping = |more: &[&std::ffi::OsStr]| -> (Value, Vec<f32>) {
        let ran = run(arguments![noisy, "-o", out, "--png", png, "--json"]
            .iter()
            .map(|a| a.as_os_str())
            .chain(more.iter().copied()));
        succeeded(&ran);
        (serde_json::from_str(&ran.out).unwrap(), color(&out))
    };
    let os = std::ffi::OsStr::new;
    let (json, kept) = skipping(&[os("--skip-below"), os("1000")]);
    assert_eq!((&json["denoised"], &json["layers"]["variance"]), (&0.0.into(), &"variance.Y".into()), "{json}");
    assert!(json["work"].as_f64().is_some_and(|work| work < 0.4) && !json["active"].as_array().unwrap().is_empty());
    assert!(kept.iter().zip(color(&noisy)).all(|(a, b)| a.to_bits() == b.to_bits()));
    let preview = image::open(&png).unwrap();
    assert_eq!((preview.width(), preview.height()), (3 * 32, 24));

    let from_file = [os("--variance"), os("none"), os("--samples"), counts.as_os_str(), os("--skip-mode"), os("exact")];
    let (json, denoised) = skipping(&[&[os("--skip-below"), os("0.5")][..], &from_file].concat());
    assert_eq!((&json["denoised"], &json["layers"]["variance"]), (&1.0.into(), &Value::Null), "{json}");
    assert!(denoised.iter().zip(color(&whole)).all(|(a, b)| a.to_bits() == b.to_bits()));
    let (json, _) = skipping(&[]);
    assert_eq!((&json["denoised"], &json["layers"]["variance"]), (&Value::Null, &Value::Null), "{json}");
}

#[test]
fn several_inputs_go_on_after_one_that_fails() {
    let d = Directory::new();
    for frame in 8..11 {
        d.exr(&format!("shot.{frame:04}.exr"), "R G B", 1.0);
        d.exr(&format!("albedo.{frame:04}.exr"), "R G B", 0.0);
    }
    let cut = std::fs::read(d.path("shot.0009.exr")).unwrap();
    std::fs::write(d.path("shot.0009.exr"), &cut[..cut.len() / 2]).unwrap();
    std::fs::create_dir(d.path("out")).unwrap();
    let (inputs, albedo) = (d.path("shot.####.exr"), d.path("albedo.%04d.exr"));
    let ran =
        run(arguments![inputs, "-o", d.path("out"), "--albedo", albedo, "--reference", d.path("albedo.####.exr")]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    assert!(ran.err.contains("shot.0009.exr is incomplete") && ran.err.contains("1 of 3 images failed"), "{}", ran.err);
    assert!(
        ran.err.contains("albedo R/G/B in") && ran.err.contains("albedo.0010.exr, no normal, no depth"),
        "{}",
        ran.err
    );
    assert_eq!(d.names("out"), ["shot.0008.exr", "shot.0010.exr"]);
    let figures: Vec<&str> = ran.out.lines().collect();
    assert_eq!(figures.len(), 2, "{}", ran.out);
    for words in ["shot.0008.exr: PSNR ", " dB, SSIM ", ", relMSE "] {
        assert!(figures[0].contains(words), "{}", ran.out);
    }
}

#[test]
fn in_place_by_layer_name_and_quiet() {
    let d = Directory::new();
    let layers = "A.Combined.R A.Combined.G A.Combined.B B.Combined.R B.Combined.G B.Combined.B";
    let (file, copy) = (d.exr("views.exr", layers, 1.0), d.exr("copy.exr", layers, 1.0));
    let none_chosen = run_without_device(arguments![file, "-o", file]);
    assert_eq!(none_chosen.code, Some(1));
    assert!(
        none_chosen.err.contains("A.Combined, B.Combined") && none_chosen.err.contains("--layer"),
        "{}",
        none_chosen.err
    );

    let blend = ["--blend", "1", "--exposure", "0.5", "--quiet", "--layer", "B", "--precision", "fp32"];
    let ran = run(arguments![file, "-o", file].into_iter().chain(blend.map(Into::into)));
    succeeded(&ran);
    assert_eq!((ran.out.as_str(), ran.err.as_str()), ("", ""));
    let read = |path: &Path, layer: &str| {
        let frame = ExrFrame::read(path, &LayerOptions::color_only(Some(layer.into()))).unwrap();
        frame.color().to_vec()
    };
    // All of the noisy input is blended in, so nothing changes but by rounding; the other layer not even so.
    let pairs = read(&file, "B").into_iter().zip(read(&copy, "B"));
    pairs.for_each(|(a, b)| assert!((a - b).abs() < 1e-3 * b.abs().max(1.0), "{a} {b}"));
    assert_eq!(read(&file, "A"), read(&copy, "A"));
    assert_eq!(d.names(""), ["copy.exr", "views.exr"]);
}

/// Each quality is another network, stores less or leaves something out, and so another picture; the default is the balanced one.
#[test]
fn a_quality_chooses_network_and_what_is_left_out() {
    let d = Directory::new();
    let input = d.exr("in.exr", FEATURES, 0.0);
    let denoise = |options: &[&str]| {
        let out = d.path("out.exr");
        let ran = run(arguments![input, "-o", out, "--json"].into_iter().chain(options.iter().map(Into::into)));
        succeeded(&ran);
        let said: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
        let word = |key: &str| said[key].as_str().unwrap().to_owned();
        (word("network"), said["denoised"].clone(), color(&out), word("precision"))
    };
    let [fast, balanced, high] = ["fast", "balanced", "high"].map(|quality| denoise(&["--quality", quality]));
    assert_eq!([&fast.0, &balanced.0, &high.0], ["hybrid", "hybrid", "expanded_patch"]);
    assert_eq!(
        [&fast.1, &balanced.1, &high.1],
        [&0.0.into(), &Value::Null, &Value::Null],
        "no noise, nothing to denoise"
    );
    assert_ne!(fast.2, balanced.2);
    assert_ne!(balanced.2, high.2);
    assert_eq!(denoise(&[]), balanced);
    let plain = ["--quality", "fast", "--skip-below", "0", "--precision", &balanced.3];
    assert_eq!(denoise(&plain), balanced, "what is asked for counts more");
    let selector = DeviceSelector::from_env().unwrap_or_default();
    let device = Device::open_with(&DeviceOptions { selector, ..DeviceOptions::default() }).unwrap();
    if device.info().kind == DeviceKind::Cpu && Bench::can_store_halves(&device) {
        assert_eq!(fast.3, "fp16", "halves are faster");
        assert_eq!(denoise(&plain[..4]), denoise(&["--precision", "fp16"]));
    }
}

#[cfg(unix)]
#[test]
fn an_interrupt_leaves_whole_files_only() {
    use std::os::unix::process::ExitStatusExt;
    let d = Directory::new();
    std::fs::create_dir(d.path("out")).unwrap();
    let first = d.exr("shot.000.exr", "R G B", 1.0);
    for frame in 1..400 {
        std::fs::copy(&first, d.path(&format!("shot.{frame:03}.exr"))).unwrap();
    }
    let mut child = tool().args(arguments![d.path("shot.*.exr"), "-o", d.path("out"), "-q"]).spawn().unwrap();
    while !d.path("out/shot.000.exr").exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before its first output");
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let status = child.wait().unwrap();
    assert!(status.code() == Some(130), "{status}, signal {:?}", status.signal());
    let written = d.names("out");
    assert!(!written.is_empty() && written.len() < 400, "{} written", written.len());
    for name in written {
        assert!(name.ends_with(".exr") && !name.starts_with('.'), "{name} was left behind");
        color(&d.path("out").join(name));
    }
}

#[test]
fn devices_are_listed_and_an_unknown_one_is_refused() {
    let listed = run(["--list-devices", "--json"]);
    succeeded(&listed);
    let first: Value = serde_json::from_str(listed.out.lines().next().unwrap()).unwrap();
    assert!(first["index"] == 0 && first["name"].is_string() && first["missing"].is_array(), "{first}");
    let text = run(["--list-devices"]);
    assert!(text.out.starts_with(&format!("0: {}", first["name"].as_str().unwrap())), "{}", text.out);

    let d = Directory::new();
    let input = d.exr("in.exr", "R G B", 1.0);
    let with_variable = |value: &str, option: &[&str]| {
        let mut tool = tool();
        tool.env("VKDENOISE_DEVICE", value).args(arguments![input, "-o", d.path("out.exr")]).args(option);
        ran(tool.output().unwrap())
    };
    // The option wins over the variable.
    let refused = with_variable("0", &["--device", "no such device"]);
    assert_eq!(refused.code, Some(1));
    assert!(
        refused.err.contains("no such device") && refused.err.contains(first["name"].as_str().unwrap()),
        "{}",
        refused.err
    );
    let refused = with_variable("the variable's device", &[]);
    assert!(refused.code == Some(1) && refused.err.contains("the variable's device"), "{}", refused.err);
    assert_eq!(d.names(""), ["in.exr"]);
}

#[test]
fn failures_name_what_is_wrong_before_a_device_is_opened() {
    let d = Directory::new();
    let (good, other) = (d.exr("good.exr", "R G B", 1.0), d.exr("other.exr", "R G B", 1.0));
    let cut = d.path("cut.exr");
    let bytes = std::fs::read(&good).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() - 7]).unwrap();
    let garbage = d.path("garbage.safetensors");
    std::fs::write(&garbage, b"\xff\xff\xff\xff not weights").unwrap();
    let small = d.path("small.exr");
    exr::prelude::write_rgb_file(&small, 4, 4, |_, _| (0.5f32, 0.5f32, 0.5f32)).unwrap();
    let (out, missing) = (d.path("out.exr"), d.path("missing.exr"));

    let cases = [
        (1, "missing.exr", arguments![missing, "-o", out].to_vec()),
        (1, "cut.exr is incomplete", arguments![cut, "-o", out].to_vec()),
        (1, "not an OpenEXR file", arguments![garbage, "-o", out].to_vec()),
        (1, "garbage.safetensors", arguments![good, "-o", out, "--weights", garbage].to_vec()),
        (1, "missing.exr", arguments![good, "-o", out, "--weights", missing].to_vec()),
        (1, "there is no directory", arguments![good, "-o", d.path("nowhere/out.exr")].to_vec()),
        (1, "there is no such directory", arguments![good, "-o", d.path("nowhere/")].to_vec()),
        (1, "no file matches", arguments![d.path("shot.####.exr"), "-o", out].to_vec()),
        (1, "no colour 'diffuse' layer", arguments![good, "-o", out, "--layer", "diffuse"].to_vec()),
        (1, "small.exr covers 4 x 4", arguments![good, "-o", out, "--albedo", small].to_vec()),
        (1, "small.exr has 4 x 4", arguments![good, "-o", out, "--reference", small].to_vec()),
        (1, "has no frame number", arguments![good, "-o", out, "--depth", d.path("z.##.exr")].to_vec()),
        (2, "for several inputs", arguments![good, other, "-o", out].to_vec()),
        (2, "would overwrite", arguments![good, "-o", d.0.path()].to_vec()),
        (2, "would overwrite", arguments![good, "-o", other, "--reference", other].to_vec()),
        (2, "would overwrite", arguments![good, "-o", out, "--png", good].to_vec()),
        (2, "--output", arguments![good].to_vec()),
        (2, "Usage", arguments!["-o", out].to_vec()),
        (2, "number above 0", arguments![good, "-o", out, "--exposure", "0"].to_vec()),
        (2, "from 0 to 1", arguments![good, "-o", out, "--blend", "1.5"].to_vec()),
        (2, "auto, keep or mend", arguments![good, "-o", out, "--fireflies", "all"].to_vec()),
        (2, "0 or above", arguments![good, "-o", out, "--skip-below", "-1"].to_vec()),
        (2, "exact or approximate", arguments![good, "-o", out, "--skip-mode", "some"].to_vec()),
        (1, "region", arguments![good, "-o", out, "--region", "0,0,33,1"].to_vec()),
        (2, "X,Y,W,H", arguments![good, "-o", out, "--region", "0,0,8"].to_vec()),
        (2, "X,Y,W,H", arguments![good, "-o", out, "--region", "0,0,8,0"].to_vec()),
        (2, "X,Y,W,H", arguments![good, "-o", out, "--region", "0,0,8,8,8"].to_vec()),
        (2, "X,Y,W,H", arguments![good, "-o", out, "--region", "-1,0,8,8"].to_vec()),
        (2, "precision", arguments![good, "-o", out, "--precision", "fp12"].to_vec()),
        (2, "fast, balanced or high", arguments![good, "-o", out, "--quality", "best"].to_vec()),
        (2, "cannot be used with", arguments![good, "-o", out, "--quality", "high", "--weights", other].to_vec()),
    ];
    let before = d.names("");
    for (code, words, arguments) in cases {
        let ran = run_without_device(&arguments);
        assert!(ran.code == Some(code) && ran.err.contains(words), "{arguments:?}: {:?} {}", ran.code, ran.err);
        assert_eq!(ran.out, "", "{arguments:?}");
    }
    assert_eq!(d.names(""), before, "nothing was written");
    assert_eq!(std::fs::read(&good).unwrap(), bytes);
}

#[test]
fn no_driver_is_said_with_what_to_do() {
    let directory = Directory::new();
    let input = directory.exr("in.exr", FEATURES, 0.0);
    let output = directory.path("out.exr");
    let mut tool = tool();
    for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
        tool.env(variable, "no-driver.json");
    }
    let ran = ran(tool.arg(&input).arg("-o").arg(&output).output().unwrap());
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    assert!(ran.err.contains("no usable Vulkan device") && ran.err.contains("install"), "{}", ran.err);
    assert!(!output.exists());
}

//! Images: features, regions, references, qualities.

use super::*;

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
    assert!(work > 0.1 && work <= 1.0, "{json}");

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
fn what_is_converged_keeps_its_pixels() {
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

/// The fastest quality stores less or leaves something out, the highest averages two pictures, and so they give others;
/// the default is the balanced one.
#[test]
fn a_quality_chooses_what_is_left_out() {
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
    assert_eq!([&fast.0, &balanced.0, &high.0], ["hybrid"; 3]);
    assert_eq!(
        [&fast.1, &balanced.1, &high.1],
        [&0.0.into(), &Value::Null, &Value::Null],
        "no noise, nothing to denoise"
    );
    assert_ne!(fast.2, balanced.2);
    assert_ne!(high.2, balanced.2);
    let apart = high.2.iter().zip(&balanced.2).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(apart < 0.05 && high.3 == balanced.3, "{apart}, {}", high.3);
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

/// An image that does not fit the budget is cut into tiles, and that is said.
#[test]
fn an_image_beyond_the_budget_is_cut_into_tiles() {
    let d = Directory::new();
    let (input, whole, tiles) = (d.path("wide.exr"), d.path("whole.exr"), d.path("tiles.exr"));
    exr::prelude::write_rgb_file(&input, 640, 50, |x, y| {
        let noise = (x * 7919 + y * 104_729) % 97;
        (0.1 + noise as f32 / 97.0, 0.2, 0.3)
    })
    .unwrap();
    succeeded(&run(arguments![input, "-o", whole]));
    let averaged = run(arguments![input, "-o", tiles, "--quality", "high", "--json"]);
    succeeded(&averaged);
    assert!(averaged.out.contains("\"averaged\":true") && color(&whole) != color(&tiles), "{}", averaged.out);
    // In tiles it is not, and that is said.
    let once = run(arguments![input, "-o", tiles, "--memory-budget", "50", "--quality", "high", "--json"]);
    succeeded(&once);
    assert!(once.out.contains("\"averaged\":false") && once.err.contains("not averaged"), "{}{}", once.out, once.err);
    let of_high = color(&tiles);
    let ran = run(arguments![input, "-o", tiles, "--memory-budget", "50", "--json"]);
    succeeded(&ran);
    let json: Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!((&json["tiles"]["margin"], &json["tiles"]["exact"]), (&128.into(), &false.into()), "{}", ran.out);
    assert!(json["device_bytes"].as_u64().unwrap() <= 50 << 20, "{}", ran.out);
    let count = json["tiles"]["count"].as_u64().unwrap();
    assert!(count > 1 && ran.err.contains(&format!("640 x 50 in {count} tiles with margins of 128")), "{}", ran.err);
    assert_eq!(of_high, color(&tiles));
    let apart = color(&whole).iter().zip(color(&tiles)).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(apart < 0.01, "{apart}");
    let refused = run(arguments![input, "-o", d.path("none.exr"), "--memory-budget", "20"]);
    assert!(refused.code == Some(1) && refused.err.contains("the budget is 20971520"), "{}", refused.err);
    assert_eq!(d.names(""), ["tiles.exr", "whole.exr", "wide.exr"]);
}

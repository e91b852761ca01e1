//! Light groups, other layers and alpha, denoised with the colour's kernels.

use super::*;
use std::collections::HashMap;

fn case(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases").join(name).with_extension("exr")
}

/// All channels of a file of one part by their names.
fn channels(path: &Path) -> HashMap<String, Vec<f32>> {
    let image = exr::prelude::read_all_flat_layers_from_file(path).unwrap();
    let list = image.layer_data[0].channel_data.list.iter();
    list.map(|channel| (channel.name.to_string(), channel.sample_data.values_as_f32().collect())).collect()
}

/// The most that a sum of layers is off another, of it.
fn off(channels: &HashMap<String, Vec<f32>>, parts: &[&str], whole: &str) -> f32 {
    let mut worst = 0.0f32;
    for channel in ["R", "G", "B"] {
        let of = |layer: &str| &channels[&format!("{layer}.{channel}")];
        for (i, whole) in of(whole).iter().enumerate() {
            let sum: f64 = parts.iter().map(|part| f64::from(of(part)[i])).sum();
            worst = worst.max(((sum - f64::from(*whole)) / f64::from(whole.abs().max(1e-6))).abs() as f32);
        }
    }
    worst
}

/// How much neighbours of a column differ, root mean square.
fn rough(plane: &[f32]) -> f64 {
    let differences = (64..plane.len()).map(|i| f64::from(plane[i] - plane[i - 64]).powi(2));
    (differences.sum::<f64>() / (plane.len() - 64) as f64).sqrt()
}

#[test]
fn light_groups_add_up_to_the_colour() {
    let d = Directory::new();
    let (input, out, part) = (case("21_light_groups"), d.path("out.exr"), d.path("part.exr"));
    let groups = ["Combined_Key", "Combined_Fill"];
    let before = channels(&input);
    let noisy = off(&before, &groups, "Combined");
    assert!(noisy < 1e-5, "the file's own are off by {noisy:.1e}");
    let ran = run(arguments![input, "-o", out, "--light-groups", "auto", "--json"]);
    succeeded(&ran);
    assert!(ran.err.contains("; with it Combined_Fill.R/G/B, Combined_Key.R/G/B"), "{}", ran.err);
    let json: Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(json["layers"]["signals"], serde_json::json!(["Combined_Fill.R/G/B", "Combined_Key.R/G/B"]));
    let after = channels(&out);
    let sum = off(&after, &groups, "Combined");
    println!("light groups: off by {sum:.1e}, before {noisy:.1e}");
    assert!(sum <= 1e-5, "the sum is off by {sum:.1e}");
    for group in ["Combined", "Combined_Key", "Combined_Fill"] {
        let [before, after] = [&before, &after].map(|channels| rough(&channels[&format!("{group}.G")]));
        println!("{group}: rough {before:.3}, then {after:.3}");
        assert!(after < 0.7 * before, "{group} is as rough as before: {before} {after}");
    }
    // By name, and in a region, with the same bits.
    let region = ["--region", "8,8,40,24"];
    let names = ["--aov", "Combined_Key", "Combined_Fill"];
    let ran = run(arguments![input, "-o", part]
        .into_iter()
        .chain(arguments![region[0], region[1], names[0], names[1], names[2]]));
    succeeded(&ran);
    let cropped = channels(&part);
    for (name, whole) in &after {
        let crop: Vec<f32> = (8..32).flat_map(|y| whole[y * 64 + 8..][..40].to_vec()).collect();
        assert_eq!(cropped[name], crop, "{name}");
    }
}

/// Over grey and over white, the edge of what was denoised with its alpha is smoother than with the noisy one.
#[test]
fn alpha_is_kept_or_denoised() {
    let d = Directory::new();
    let (input, kept, denoised) = (case("20_noisy_alpha"), d.path("kept.exr"), d.path("denoised.exr"));
    let before = channels(&input);
    succeeded(&run(arguments![input, "-o", kept]));
    succeeded(&run(arguments![input, "-o", denoised, "--alpha", "denoise"]));
    let (kept, denoised) = (channels(&kept), channels(&denoised));
    assert_eq!(kept["A"], before["A"]);
    let over = |channels: &HashMap<String, Vec<f32>>, grey: f32| -> Vec<f32> {
        channels["G"].iter().zip(&channels["A"]).map(|(color, alpha)| color + (1.0 - alpha) * grey).collect()
    };
    for grey in [0.18, 1.0] {
        let [noisy, of_kept, of_denoised] = [&before, &kept, &denoised].map(|channels| rough(&over(channels, grey)));
        println!("over {grey}: rough {noisy:.4}, alpha kept {of_kept:.4}, denoised {of_denoised:.4}");
        assert!(of_denoised < 0.5 * of_kept, "over {grey}: {of_kept:.4} {of_denoised:.4}");
    }
    assert!(denoised["A"].iter().all(|alpha| (0.0..=1.0).contains(alpha)));
    let mean = |plane: &[f32]| plane.iter().sum::<f32>() / plane.len() as f32;
    assert!((mean(&denoised["A"]) - mean(&before["A"])).abs() < 0.01);
    let columns = |plane: &[f32]| -> Vec<f32> {
        (0..64).map(|x| plane.iter().skip(x).step_by(64).sum::<f32>() / (plane.len() / 64) as f32).collect()
    };
    for (x, (after, before)) in columns(&denoised["A"]).iter().zip(columns(&before["A"])).enumerate() {
        assert!((after - before).abs() < 0.06, "column {x}: coverage {after} for {before}");
    }
}

#[test]
fn other_layers_are_what_their_channels_say() {
    let d = Directory::new();
    let names = "B G R direct.B direct.G direct.R P.X P.Y P.Z ao.V albedo.R albedo.G albedo.B A Z";
    let (input, out) = (d.exr("in.exr", names, 1.5), d.path("out.exr"));
    let ran = run(arguments![input, "-o", out, "--aov", "direct", "P", "ao", "albedo", "Z", "--alpha", "denoise"]);
    succeeded(&ran);
    let (before, after) = (channels(&input), channels(&out));
    assert_eq!(before.len(), after.len());
    for (name, values) in &after {
        assert!(values != &before[name], "{name} was not denoised");
        // A smooth ramp without noise stays near, on any scale.
        if !["R", "G", "B", "direct.R", "direct.G", "direct.B"].contains(&name.as_str()) && name != "A" {
            let worst = values.iter().zip(&before[name]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(worst < 0.15, "{name} is off by {worst}");
        }
    }
    let ran = run(arguments![input, "-o", out, "--aov", "direct:value"]);
    succeeded(&ran);
    assert!(channels(&out)["direct.R"] != after["direct.R"], "light and value are the same");
    assert_eq!(channels(&out)["P.X"], before["P.X"]);
}

/// Other prefixes than Blender's; what is in no group is said, and what is denoised or a feature by its name is no
/// group.
#[test]
fn light_groups_that_are_not_all_are_noted() {
    let d = Directory::new();
    let groups = "RGBA_key.B RGBA_key.G RGBA_key.R RGBA_denoised.B RGBA_denoised.G RGBA_denoised.R";
    let names = format!("B G R {groups} rgba_albedo.B rgba_albedo.G rgba_albedo.R");
    let (input, out) = (d.exr("in.exr", &names, 1.0), d.path("out.exr"));
    let ran = run(arguments![input, "-o", out, "--light-groups", "auto"]);
    succeeded(&ran);
    assert!(ran.err.contains("; with it RGBA_key.R/G/B\n"), "{}", ran.err);
    assert!(ran.err.contains("% off the colour"), "{}", ran.err);
}

#[test]
fn signals_that_cannot_be_are_refused() {
    let d = Directory::new();
    let input = d.exr("in.exr", "B G R direct.B direct.G direct.R u.V", 1.0);
    let out = d.path("out.exr");
    let refused = |arguments: &[&str], words: &[&str]| {
        let ran = run_without_device(
            arguments![input, "-o", out]
                .into_iter()
                .chain(arguments.iter().map(|argument| std::ffi::OsStr::new(argument).to_os_string())),
        );
        assert!(ran.code == Some(1) && words.iter().all(|word| ran.err.contains(word)), "{arguments:?}: {}", ran.err);
        assert_eq!(d.names(""), ["in.exr"]);
    };
    refused(&["--aov", "diffuse"], &["no 'diffuse' layer", "direct.B/G/R"]);
    refused(&["--aov", "u:light"], &["'u' has no red, green and blue"]);
    refused(&["--light-groups", "auto"], &["no light group", "Combined_NAME"]);
    refused(&["--alpha", "denoise"], &["no alpha"]);
    refused(&["--into", "direct", "--aov", "direct"], &["written twice"]);
    let unknown = run_without_device(arguments![input, "-o", out, "--light-groups", "all"]);
    assert!(unknown.code == Some(2) && unknown.err.contains("auto"), "{}", unknown.err);

    // A network without kernels: the message says which one has some.
    let residual = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/hybrid.safetensors");
    let ran = run(arguments![input, "-o", out, "--aov", "direct", "--weights", residual]);
    assert!(ran.code == Some(1) && ran.err.contains("take the network that ships"), "{}", ran.err);
    assert_eq!(d.names(""), ["in.exr"]);
}

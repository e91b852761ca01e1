//! What is wrong is said, with what to do, and before a device is opened where that can be.

use super::*;

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
        (2, "number above 0", arguments![good, "-o", out, "--exposure", "-1"].to_vec()),
        (2, "from 0 to 1", arguments![good, "-o", out, "--blend", "1.5"].to_vec()),
        (2, "from 0 to 1", arguments![good, "-o", out, "--blend", "-0.5"].to_vec()),
        (2, "what is written is OpenEXR", arguments![good, "-o", d.path("out.png")].to_vec()),
        (2, "what is written is OpenEXR", arguments![good, "-o", d.path("out.####.TIF")].to_vec()),
        (2, "standard output takes one image", arguments![good, other, "-o", "-"].to_vec()),
        (2, "leave out --json", arguments![good, "-o", "-", "--reference", other].to_vec()),
        (2, "1-100x2", arguments![good, "-o", out, "--frames", "9-1"].to_vec()),
        (1, "good.exr has no frame number", arguments![good, "-o", out, "--frames", "1-9"].to_vec()),
        (1, "no frame number to put into", arguments![good, "-o", d.path("out.####.exr")].to_vec()),
        (2, "is its own output", arguments![good, "-o", good, "--skip-existing"].to_vec()),
        (1, "no view 'left'; it has: main", arguments![good, "-o", out, "--view", "left"].to_vec()),
        (1, "no colour 'beauty'", arguments![good, "-o", out, "--into", "beauty"].to_vec()),
        (2, "0 or above", arguments![good, "-o", out, "--skip-below", "-1"].to_vec()),
        (2, "exact or approximate", arguments![good, "-o", out, "--skip-mode", "some"].to_vec()),
        (2, "lie within the frame of 32 x 24", arguments![good, "-o", out, "--region", "0,0,33,1"].to_vec()),
        (2, "X,Y,W,H", arguments![good, "-o", out, "--region", "0,0,8"].to_vec()),
        (2, "X,Y,W,H", arguments![good, "-o", out, "--region", "0,0,8,0"].to_vec()),
        (2, "X,Y,W,H", arguments![good, "-o", out, "--region", "0,0,8,8,8"].to_vec()),
        (2, "X,Y,W,H", arguments![good, "-o", out, "--region", "-1,0,8,8"].to_vec()),
        (2, "precision", arguments![good, "-o", out, "--precision", "fp12"].to_vec()),
        (2, "fast, balanced or high", arguments![good, "-o", out, "--quality", "best"].to_vec()),
        (2, "auto, keep or mend", arguments![good, "-o", out, "--fireflies", "all"].to_vec()),
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

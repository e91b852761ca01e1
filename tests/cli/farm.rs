//! Many images: sequences, what fails, what is there already, where it goes.

use super::*;

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
    assert_eq!(ran.code, Some(3), "{}{}", ran.out, ran.err);
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

/// An interrupt stops an image in its middle.
#[cfg(unix)]
#[test]
fn an_interrupt_stops_an_image_in_its_middle() {
    use std::io::{BufRead, BufReader};
    use std::process::Stdio;
    let d = Directory::new();
    let (input, out) = (d.path("large.exr"), d.path("out.exr"));
    // Many times as long on a CPU as anything that this test waits for.
    exr::prelude::write_rgb_file(&input, 1024, 1024, |x, y| {
        let noise = (x * 7919 + y * 104_729) % 97;
        (0.1 + noise as f32 / 97.0, 0.2, 0.3)
    })
    .unwrap();
    let arguments = arguments![input, "-o", out, "--cache", "off"];
    let mut child = tool().args(arguments).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines().map(Result::unwrap);
    assert!(said.next().unwrap().contains("colour R/G/B"));
    std::thread::sleep(std::time::Duration::from_millis(700));
    assert!(child.try_wait().unwrap().is_none(), "it ended before it was interrupted");
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let rest: Vec<String> = said.collect();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{rest:?}");
    assert_eq!(rest, ["vkdenoise: interrupted: 0 of 1 images are written"]);
    assert_eq!(d.names(""), ["large.exr"]);
}

/// Frames by a range, into names with their numbers; one that is missing has its record.
#[test]
fn frames_go_into_a_pattern_and_each_has_its_record() {
    let d = Directory::new();
    for frame in [1, 2, 3, 5, 7] {
        d.exr(&format!("shot.{frame:04}.exr"), "R G B", 1.0);
    }
    std::fs::create_dir(d.path("out")).unwrap();
    let (inputs, outputs) = (d.path("shot.####.exr"), d.path("out/den.%03d.exr"));
    let ran = run(arguments![inputs, "-o", outputs, "--frames", "1-7x2,9", "--json"]);
    assert_eq!(ran.code, Some(3), "{}{}", ran.out, ran.err);
    assert_eq!(d.names("out"), ["den.001.exr", "den.003.exr", "den.005.exr", "den.007.exr"]);
    let records: Vec<Value> = ran.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let of = |number: &str| records.iter().find(|r| r["input"].as_str().unwrap().contains(number)).unwrap();
    assert_eq!(records.len(), 5);
    assert!(of("0007")["error"].is_null() && of("0007")["exposure"].is_number());
    let missing = of("0009");
    assert!(missing["error"].as_str().unwrap().contains("shot.0009.exr"), "{missing}");
    assert_eq!(missing["output"], d.path("out/den.009.exr").to_str().unwrap());

    // What is there is left as it is, and what was missing is done.
    d.exr("shot.0009.exr", "R G B", 1.0);
    let first = std::fs::metadata(d.path("out/den.001.exr")).unwrap().modified().unwrap();
    let again = run(arguments![inputs, "-o", outputs, "--frames", "1-9x2", "--json", "--skip-existing"]);
    succeeded(&again);
    let skipped = again.out.lines().filter(|line| line.contains("\"skipped\":true")).count();
    assert_eq!((skipped, again.out.lines().count()), (4, 5), "{}", again.out);
    assert_eq!(std::fs::metadata(d.path("out/den.001.exr")).unwrap().modified().unwrap(), first);
    assert!(d.path("out/den.009.exr").exists());
    // A whole sequence says what it leaves out. All outputs are there, so that no device is needed.
    std::fs::copy(d.path("out/den.001.exr"), d.path("out/den.002.exr")).unwrap();
    let gaps = run_without_device(arguments![inputs, "-o", outputs, "--skip-existing"]);
    succeeded(&gaps);
    assert!(gaps.err.contains("of 1-9, frames 4, 6, 8 are missing"), "{}", gaps.err);
}

/// All that fail are another exit code than some; the records say why.
#[test]
fn all_that_fail_are_told_from_some() {
    let d = Directory::new();
    std::fs::create_dir(d.path("out")).unwrap();
    let ran = run_without_device(arguments![d.path("a.1.exr"), d.path("a.2.exr"), "-o", d.path("out"), "--json"]);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    assert!(ran.err.contains("2 of 2 images failed"), "{}", ran.err);
    assert_eq!(ran.out.lines().filter(|line| line.contains("\"error\":\"cannot read ")).count(), 2, "{}", ran.out);
    let one = run_without_device(arguments![d.path("a.1.exr"), "-o", d.path("out"), "--json"]);
    assert_eq!((one.code, one.out.lines().count()), (Some(1), 1), "{}{}", one.out, one.err);
}

/// Outputs are tried before anything is denoised; what may only be read is not replaced.
#[cfg(target_os = "linux")]
#[test]
fn outputs_are_tried_before_the_first_image() {
    use std::os::unix::fs::PermissionsExt;
    let d = Directory::new();
    let (good, old) = (d.exr("good.1.exr", "R G B", 1.0), d.exr("old.exr", "R G B", 1.0));
    let kept = std::fs::read(&old).unwrap();
    std::fs::set_permissions(&old, std::fs::Permissions::from_mode(0o444)).unwrap();
    let ran = run_without_device(arguments![good, "-o", old]);
    assert_eq!(ran.code, Some(1), "{}", ran.err);
    assert!(ran.err.contains("old.exr: it is there and may only be read"), "{}", ran.err);
    assert_eq!(std::fs::read(&old).unwrap(), kept);
    // Nobody may make files there, not even root.
    let ran = run_without_device(arguments![good, "-o", "/proc/out.exr"]);
    assert!(ran.code == Some(1) && ran.err.contains("cannot write /proc/out.exr"), "{}", ran.err);
    let ran = run_without_device(arguments![good, "-o", d.path("out.exr"), "--png", "/proc/preview.png"]);
    assert!(ran.code == Some(1) && ran.err.contains("cannot write /proc/preview.png"), "{}", ran.err);
    assert_eq!(d.names(""), ["good.1.exr", "old.exr"]);
}

/// A disk that is full: the error says so, nothing is left behind, and the next image is tried.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_leaves_nothing_behind() {
    let d = Directory::new();
    let big = d.exr("shot.1.exr", FEATURES, 1.0);
    std::fs::copy(&big, d.path("shot.2.exr")).unwrap();
    std::fs::create_dir(d.path("out")).unwrap();
    // Files may not grow beyond 8 KiB at the most; without the signal, writing fails.
    let limited = Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 8; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_vkdenoise")])
        .args(arguments![d.path("shot.#.exr"), "-o", d.path("out"), "--cache", "off", "--json"])
        // It would write files too.
        .env("MESA_SHADER_CACHE_DISABLE", "true")
        .output()
        .unwrap();
    let ran = ran(limited);
    assert_eq!(ran.code, Some(1), "{}{}", ran.out, ran.err);
    assert_eq!(ran.err.matches("vkdenoise: cannot write ").count(), 2, "{}", ran.err);
    assert!(d.names("out").is_empty(), "{:?}", d.names("out"));
}

/// The image on standard output is the one that a file would have.
#[test]
fn standard_output_takes_the_file() {
    let d = Directory::new();
    let (input, file) = (d.exr("in.exr", "R G B A", 1.0), d.path("file.exr"));
    succeeded(&run(arguments![input, "-o", file]));
    let piped = tool().arg(&input).args(["-o", "-"]).output().unwrap();
    assert!(piped.status.success());
    assert_eq!(piped.stdout, std::fs::read(&file).unwrap());
    assert_eq!(d.names(""), ["file.exr", "in.exr"]);
}

/// Images are shared out among all devices, with the same bits.
#[test]
fn all_devices_share_the_images() {
    let d = Directory::new();
    for frame in 1..5 {
        d.exr(&format!("shot.{frame}.exr"), "R G B", 1.0);
    }
    for folder in ["one", "all"] {
        std::fs::create_dir(d.path(folder)).unwrap();
    }
    succeeded(&run(arguments![d.path("shot.#.exr"), "-o", d.path("one"), "--frames", "1-4"]));
    let shared = run(arguments![d.path("shot.#.exr"), "-o", d.path("all"), "--device", "all", "--json"]);
    succeeded(&shared);
    assert_eq!(shared.out.lines().count(), 4);
    for frame in 1..5 {
        let name = format!("shot.{frame}.exr");
        assert_eq!(
            std::fs::read(d.path("one").join(&name)).unwrap(),
            std::fs::read(d.path("all").join(&name)).unwrap()
        );
    }
}

//! `vkdenoise-profile` as a program: what it prints and writes.

use serde_json::Value;
use std::path::Path;
use std::process::Command;

fn run(arguments: &[&str]) -> Vec<u8> {
    let output = Command::new(env!("CARGO_BIN_EXE_vkdenoise-profile")).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    output.stdout
}

fn json(bytes: &[u8]) -> Value {
    serde_json::from_slice(bytes).unwrap()
}

fn number(value: &Value, path: &str) -> f64 {
    value.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("no number {path}"))
}

#[test]
fn a_network_in_every_form() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| dir.path().join(name).display().to_string();
    let (csv, trace, plot) = (file("k.csv"), file("k.json"), file("k.svg"));
    let size = ["--size", "64x40", "--repeat", "3"];
    let files = ["--csv", &csv, "--trace", &trace, "--plot", &plot];
    let report = json(&run(&[&["network", "--json"][..], &size, &files].concat()));

    let kernels = report["kernels"].as_array().unwrap();
    assert!(kernels.len() > 90, "{} kernels", kernels.len());
    for kernel in kernels {
        let time = |what: &str| number(kernel, &format!("/microseconds/{what}"));
        assert!(0.0 < time("min") && time("min") <= time("median") && time("spread") >= 0.0, "{kernel}");
    }
    // The padded frame is 128x128, whose FLOPs are known, folded.
    let sum = |rows: &str, key: &str| report[rows].as_array().unwrap().iter().map(|row| number(row, key)).sum::<f64>();
    for rows in ["kernels", "by_stage", "by_kernel"] {
        assert!((sum(rows, "/gflop") - 2.5682).abs() < 1e-4, "{rows}");
        assert!((sum(rows, "/share") - 1.0).abs() < 1e-9, "{rows}");
    }
    let kernels_ms = number(&report, "/kernels_ms");
    assert!((sum("by_stage", "/microseconds/median") * 1e-3 - kernels_ms).abs() < 1e-6 * kernels_ms);
    for roof in ["roof_gflop_per_second_f32", "roof_gb_per_second_f32"] {
        assert!(number(&report, &format!("/session/{roof}")) > 0.0);
    }

    let text = std::fs::read_to_string(Path::new(&csv)).unwrap();
    let widths: Vec<_> = text.lines().map(|line| line.split(',').count()).collect();
    assert_eq!(widths, vec![widths[0]; kernels.len() + 1]);

    let trace = json(&std::fs::read(Path::new(&trace)).unwrap());
    let events = trace["traceEvents"].as_array().unwrap();
    let spans: Vec<_> = events.iter().filter(|e| e["ph"] == "X" && e["tid"] == 2).collect();
    assert_eq!(spans.len(), kernels.len());
    let ends = |span: &Value| number(span, "/ts") + number(span, "/dur");
    assert!(spans.windows(2).all(|pair| ends(pair[0]) <= number(pair[1], "/ts")), "kernels overlap");

    let picture = std::fs::read_to_string(Path::new(&plot)).unwrap();
    for word in ["<svg", "roof:", "conv3x3", "FLOP per byte"] {
        assert!(picture.contains(word), "{word} is not in the picture");
    }

    let table = String::from_utf8(run(&[&["network"][..], &size].concat())).unwrap();
    for word in ["enc.0.0.conv", "bottleneck", "of roof", "whole pass", "GB/s"] {
        assert!(table.contains(word), "{word} is not in the table");
    }
}

#[test]
fn what_is_left_out_shows() {
    let base = ["network", "--json", "--repeat", "1", "--warm-up", "0", "--size", "1000x40"];
    let report = |more: &[&str]| json(&run(&[&base[..], more].concat()));
    let stage = |report: &Value, name: &str| {
        let rows = report["by_stage"].as_array().unwrap();
        let row = rows.iter().find(|row| row["layer"] == name).unwrap_or_else(|| panic!("no stage {name}"));
        number(row, "/tiles/0") / number(row, "/tiles/1")
    };
    let converged = report(&["--converged", "1", "--converged-mode", "exact"]);
    assert_eq!((number(&converged, "/converged/denoised"), stage(&converged, "dec1")), (0.0, 0.0));
    assert!(number(&converged, "/work") < 0.3 && number(&converged, "/converged/whole_pass_ms/median") > 0.0);
    let region = report(&["--region", "0,0,16,16"]);
    assert_eq!(region["region"], serde_json::json!([0, 0, 16, 16]));
    // What counts is in the left half of the coarse maps; little of it at the end.
    assert!((0.2..0.95).contains(&number(&region, "/work")), "{}", region["work"]);
    assert!(stage(&region, "output") < 0.1 && (0.1..1.0).contains(&stage(&region, "bottleneck")));
    let gflop = |report: &Value| number(report, "/work") * 2.5682 * 8.0;
    let sum =
        |report: &Value| report["kernels"].as_array().unwrap().iter().map(|row| number(row, "/gflop")).sum::<f64>();
    assert!((sum(&region) / gflop(&region) - 1.0).abs() < 1e-3, "{} GFLOP", sum(&region));

    let unchanged = report(&["--features", "unchanged"]);
    assert!((number(&unchanged, "/work") - 0.8555).abs() < 1e-3, "{}", unchanged["work"]);
    assert_eq!(stage(&unchanged, "bottleneck"), 0.875, "two of its sixteen kernels are of features");
    let text = String::from_utf8(run(&[&["network"][..], &base[2..], &["--features", "none"]].concat())).unwrap();
    assert!(text.contains(" % of the work of a whole frame with all features") && text.contains("active"), "{text}");
}

#[test]
fn convolutions_and_blocks_of_every_form() {
    let common = ["--repeat", "2", "--json"];
    let dir = tempfile::tempdir().unwrap();
    let plot = dir.path().join("conv.svg").display().to_string();
    let report = json(&run(&[&["conv", "--size", "64", "--channels", "16", "--plot", &plot][..], &common].concat()));
    let kernels = report["kernels"].as_array().unwrap();
    let named = |row: &Value, key: &str| row[key].as_str().unwrap().to_owned();
    // CPU drivers have kernels of their own, one more for so few inputs; GPUs those that stage what invocations share.
    let forms = ["_stationary", "_cpu", "_staged"];
    let kernel = |row: &Value| {
        let name = named(row, "kernel");
        forms.iter().fold(name.as_str(), |name, form| name.trim_end_matches(form)).to_owned()
    };
    let found: Vec<_> = kernels.iter().map(|row| (named(row, "stage"), kernel(row))).collect();
    let expected = [
        ("direct", "conv3x3"),
        ("F(2x2,3x3)", "winograd3x3"),
        ("F(4x4,3x3)", "winograd3x3"),
        ("two kernels", "depthwise3x3"),
        ("two kernels", "linear"),
        ("fused", "separable3x3"),
    ];
    assert_eq!(found, expected.map(|(form, kernel)| (form.to_owned(), kernel.to_owned())));
    // 64x64 tokens of 16 channels: 9 and 1 products for each pair of channels, 9 for each channel.
    let tokens = 64.0 * 64.0;
    let (standard, depthwise, pointwise) =
        (2.0 * 9.0 * 256.0 * tokens, 2.0 * 9.0 * 16.0 * tokens, 2.0 * 256.0 * tokens);
    let flops = [standard, standard, standard, depthwise, pointwise, depthwise + pointwise];
    for (row, flops) in kernels.iter().zip(flops) {
        assert!((number(row, "/gflop") * 1e9 - flops).abs() < 0.5, "{row}");
        // No kernel can do with fewer loads than inputs, in vectors of four, and each stores its outputs once.
        assert!(number(row, "/global_accesses") * 1e6 >= 2.0 * tokens * 4.0, "{row}");
        assert_eq!(number(row, "/shared_accesses"), 0.0);
    }
    // What the fused kernel saves: the map between, written and read.
    let moved = |form: &str| -> f64 {
        let rows = kernels.iter().filter(|row| row["stage"] == form);
        rows.map(|row| number(row, "/mb_read") + number(row, "/mb_written")).sum()
    };
    assert!((moved("two kernels") - moved("fused") - 2.0 * tokens * 64e-6).abs() < 1e-6);
    assert!(std::fs::read_to_string(&plot).unwrap().contains("F(4x4,3x3)"));

    let report = json(&run(&[&["blocks", "--sizes", "32,48", "--channels", "32"][..], &common].concat()));
    let blocks = report["blocks"].as_array().unwrap();
    assert_eq!(blocks.len(), 2);
    for block in blocks {
        let measured = block["measured"].as_array().unwrap();
        assert!(measured.len() == 3 && measured.iter().all(|m| number(m, "/ms/min") > 0.0), "{block}");
    }
}

#[test]
fn without_timestamps_it_says_so_and_times_whole_passes() {
    let small = ["--repeat", "2", "--host-clock"];
    let table = |arguments: &[&str]| String::from_utf8(run(&[arguments, &small].concat())).unwrap();
    for arguments in [&["network", "--size", "16"][..], &["conv", "--size", "16", "--channels", "8"]] {
        let text = table(arguments);
        assert!(text.contains("No timestamps: whole passes are timed"), "{text}");
        assert!(!text.contains("NaN") && !text.contains("conv3x3"), "{text}");
    }
    let report = json(&run(&[&["network", "--size", "16", "--json"][..], &small].concat()));
    assert_eq!(report["session"]["timestamps"], false);
    assert!(number(&report, "/pass_ms/min") > 0.0 && report["kernels"].as_array().unwrap().is_empty());
}

#[test]
fn nonsense_is_refused() {
    for arguments in [&["network", "--arch", "unet"][..], &["network", "--size", "0x5"], &["roof", "--repeat", "0"]] {
        let output = Command::new(env!("CARGO_BIN_EXE_vkdenoise-profile")).args(arguments).output().unwrap();
        assert!(!output.status.success() && !output.stderr.is_empty(), "{arguments:?}");
    }
}

//! `vkdenoise-bench pareto` from outside: a sweep over one pair, stopped and continued.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

/// A folder of pairs with the test render in it.
fn pairs() -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    let view = root.path().join("teapot/v0");
    std::fs::create_dir_all(&view).unwrap();
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    std::fs::copy(data.join("teapot_spp0004.exr"), view.join("spp0004.exr")).unwrap();
    std::fs::copy(data.join("teapot_ref.exr"), view.join("ref.exr")).unwrap();
    root
}

fn pareto(root: &Path, options: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vkdenoise-bench"));
    command.arg("pareto").arg(root.join(".")).arg("--results").arg(root.join("results.jsonl"));
    command
        .args(["--network", "hybrid_kernels", "--tier", "fp32", "--repeat", "1", "--exact-side", "24", "--json"])
        .args(options)
        .output()
        .unwrap()
}

fn points(output: &Output) -> Vec<Value> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice::<Value>(&output.stdout).unwrap()["points"].as_array().unwrap().clone()
}

#[test]
fn a_sweep_is_measured_once_and_reported_again() {
    let root = pairs();
    let svg = root.path().join("plot.svg");
    let first = points(&pareto(root.path(), &["--plot", svg.to_str().unwrap()]));
    let number = |point: &Value, key: &str| point[key].as_f64().unwrap();
    assert_eq!(first.len(), 1);
    let point = &first[0];
    assert_eq!((point["setting"].as_str(), point["spp"].as_u64()), (Some("hybrid_kernels, fp32"), Some(4)));
    assert_eq!(point["front"], true);
    assert!(number(point, "seconds_per_megapixel") > 0.0);
    // The input has 20.4 dB.
    assert!(number(point, "psnr") > 30.0 && number(point, "ssim") > 0.8, "{point}");
    assert!(number(point, "flip") < 0.2 && number(point, "nmse") < 1e-9 && number(point, "worst") < 1e-4, "{point}");
    assert!(std::fs::read_to_string(&svg).unwrap().contains("hybrid_kernels, fp32"));

    // All is known: nothing is measured, so the times are the same to the last digit.
    assert_eq!(points(&pareto(root.path(), &[])), first);
}

#[test]
fn what_cannot_be_swept_is_said() {
    let root = pairs();
    for (options, expected) in [
        (&["--scenes", "kitchen"][..], "no <scene>/<view>/spp####.exr"),
        (&["--network", "hybrid_kernels=weights/hybrid.safetensors"], "two networks of the name 'hybrid_kernels'"),
        (&["--network", "kitchen"], "no network 'kitchen' is known"),
        (&["--tier", "fp1"], "no tier 'fp1'"),
    ] {
        let output = pareto(root.path(), options);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains(expected), "{options:?}: {said}");
    }
    assert!(!root.path().join("results.jsonl").exists(), "nothing was measured");
}

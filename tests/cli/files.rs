//! Files of several views, cut-outs, raw pictures beside denoised ones.

use super::*;

fn case(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases").join(name).with_extension("exr")
}

/// Every view is denoised, each as it would be alone, and one file is written.
#[test]
fn every_view_is_denoised() {
    let d = Directory::new();
    let (input, png) = (case("04_blender_stereo"), d.path("preview.png"));
    let (both, right) = (d.path("both.exr"), d.path("right.exr"));
    let ran = run(arguments![input, "-o", both, "--json", "--png", png]);
    succeeded(&ran);
    let records: Vec<Value> = ran.out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!([&records[0]["view"], &records[1]["view"]], ["left", "right"], "{}", ran.out);
    assert_eq!(records[1]["layers"]["albedo"], "ViewLayer.Denoising Albedo.right.R/G/B");
    assert!(
        ran.err.contains("04_blender_stereo.exr, view right: colour ViewLayer.Combined.right.R/G/B"),
        "{}",
        ran.err
    );
    let preview = image::open(&png).unwrap();
    assert_eq!((preview.width(), preview.height()), (4 * 64, 48));

    let one = run(arguments![input, "-o", right, "--view", "right", "--json"]);
    succeeded(&one);
    assert_eq!(one.out.lines().count(), 1);
    let view = |path: &Path, view: &str| {
        let options = LayerOptions { view: Some(view.into()), ..LayerOptions::color_only(None) };
        ExrFrame::read(path, &options).unwrap().color().to_vec()
    };
    assert_eq!(view(&both, "right"), view(&right, "right"));
    assert_eq!(view(&right, "left"), view(&input, "left"));
    // Each view keeps its brightness (the right eye's is three times the left's), what is between its pixels goes.
    let mean = |image: &[f32]| image.iter().map(|v| f64::from(*v)).sum::<f64>() / image.len() as f64;
    let rough =
        |image: &[f32]| image.windows(4).map(|w| f64::from(w[0] - w[3]).abs()).sum::<f64>() / image.len() as f64;
    for eye in ["left", "right"] {
        let (noisy, denoised) = (view(&input, eye), view(&both, eye));
        assert!((mean(&denoised) / mean(&noisy) - 1.0).abs() < 0.2, "{eye}: {} {}", mean(&denoised), mean(&noisy));
        assert!(rough(&denoised) < 0.5 * rough(&noisy), "{eye}: {} {}", rough(&denoised), rough(&noisy));
    }
}

/// Pixels whose colour and alpha are exactly 0 stay so.
#[test]
fn what_is_cut_out_stays_empty() {
    let d = Directory::new();
    let (input, out) = (case("blender45_transparent"), d.path("out.exr"));
    succeeded(&run(arguments![input, "-o", out]));
    let alpha = |path: &Path| -> Vec<f32> {
        let image = exr::prelude::read_all_flat_layers_from_file(path).unwrap();
        let mut list = image.layer_data[0].channel_data.list.iter();
        let found = list.find(|channel| channel.name.to_string() == "ViewLayer.Combined.A").unwrap();
        found.sample_data.values_as_f32().collect()
    };
    let (coverage, before, after) = (alpha(&input), color(&input), color(&out));
    let empty: Vec<usize> =
        (0..coverage.len()).filter(|&i| coverage[i] == 0.0 && before[3 * i..][..3] == [0.0; 3]).collect();
    assert_eq!(empty.len(), 2481);
    empty.into_iter().for_each(|i| assert_eq!(after[3 * i..][..3], [0.0; 3], "pixel {i}"));
    assert_ne!(before, after);
    assert_eq!(alpha(&out), coverage);
}

/// The counts of Cycles decide what is left out.
#[test]
fn sample_counts_of_cycles_are_used() {
    let d = Directory::new();
    let (input, out) = (case("blender45_adaptive_samplecount"), d.path("out.exr"));
    // Every square has a pixel of 16 samples, whose noise is taken to be one over the root of 16. As shares (0.33) they
    // would be far above both thresholds.
    for (threshold, share) in [("0.26", 0.0), ("0.24", 1.0)] {
        let ran = run(arguments![input, "-o", out, "--skip-below", threshold, "--json"]);
        succeeded(&ran);
        let json: Value = serde_json::from_str(&ran.out).unwrap();
        assert_eq!(
            (&json["layers"]["samples"], &json["denoised"]),
            (&"ViewLayer.Debug Sample Count.X".into(), &share.into())
        );
        assert!(ran.err.contains("shares of 48 samples"), "{}", ran.err);
    }
}

/// The result goes where it is wanted.
#[test]
fn the_result_goes_into_another_layer() {
    let d = Directory::new();
    let names = "L.Combined.R L.Combined.G L.Combined.B L.raw.R L.raw.G L.raw.B";
    let (input, out) = (d.exr("in.exr", names, 1.0), d.path("out.exr"));
    let ran = run(arguments![input, "-o", out, "--into", "L.Combined", "--layer", "L.raw", "--json"]);
    succeeded(&ran);
    let json: Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(json["layers"]["into"], "L.Combined.R/G/B");
    let read = |path: &Path, layer: &str| {
        ExrFrame::read(path, &LayerOptions::color_only(Some(layer.into()))).unwrap().color().to_vec()
    };
    assert_eq!(read(&out, "L.raw"), read(&input, "L.raw"));
    assert_ne!(read(&out, "L.Combined"), read(&input, "L.Combined"));
}

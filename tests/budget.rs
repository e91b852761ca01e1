//! The error budget on a real frame with the network that ships: bounds on its result, and on every dispatch before it.

#[path = "../tools/bench/budget/mod.rs"]
mod budget;
mod common;

use budget::{measure, result, table};
use common::case::{MATRIX_LIMIT, targets};
use common::device::{assert_no_validation_messages, device};
use vkdenoise::exr_io::{ExrFrame, LayerOptions};
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::kernels::{Arithmetic, Storage};
use vkdenoise::net::Graph;
use vkdenoise::options::ConvAlgorithm;
use vkdenoise::plan::plan;
use vkdenoise::reference::Reference;
use vkdenoise::target::Target;
use vkdenoise::testing::Bench;
use vkdenoise::{Denoiser, Extent, Frame, Layout, Options, PlaneMut, Precision, Weights};

/// What the network's result may be wrong by: NMSE.
const RESULT_LIMIT: f64 = 1e-9;
/// The same of maps of halves on matrices: what a kernel may be wrong by, for each of the seventy that follow one
/// another in the Hybrid.
const MATRIX_RESULT_LIMIT: f64 = 70.0 * MATRIX_LIMIT;

#[test]
fn every_algorithm_keeps_its_budget_on_a_real_frame() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/teapot_spp0004.exr");
    let file = ExrFrame::read(path, &LayerOptions::default()).unwrap();
    let frame = Frame { extent: Extent::new(128, 120), ..file.frame() };
    let features = frame.features;
    assert!(features.albedo.is_some() && features.normal.is_some() && features.depth.is_some());
    let weights = Weights::hybrid_kernels().unwrap();
    let direct = Target::default();
    let winograd = |tile| Target { conv: ConvAlgorithm::Winograd(tile), ..direct };
    let preferred = Bench::default_target(device());
    let forms =
        [winograd(WinogradTile::F2), winograd(WinogradTile::F4)].map(|form| Target { kernels: preferred, ..form });
    let on_matrices = Target::for_gpu(Storage::F16, Arithmetic::Matrices);
    let on_matrices = device().has_matrices().then_some(on_matrices);
    let in_floats = targets().into_iter().map(|kernels| Target { kernels, ..direct });
    for forms in in_floats.chain(forms).chain(on_matrices) {
        let lines = measure(device(), &weights, &frame, &forms).unwrap();
        let last = result(&lines).unwrap();
        let limit = if forms.arithmetic == Arithmetic::Matrices { MATRIX_RESULT_LIMIT } else { RESULT_LIMIT };
        let Target { kernels, conv, arithmetic, .. } = forms;
        println!("{kernels:?}, {conv:?}, {arithmetic:?}: {:.1e} in {}", last.nmse, last.name);
        assert!(last.name == "head.mix" && last.nmse <= limit, "{last:?}");
        for line in &lines {
            // An error may be larger on its way than at the end, where it meets the whole result; not by much.
            assert!(line.nmse <= 10.0 * limit, "{line:?}");
            assert!(line.largest > 0.0 && line.half_range < 1.0, "{line:?}");
        }
        assert_eq!(table::markdown(&lines).lines().count(), lines.len() + 2);
    }
    assert_no_validation_messages();
}

/// Feature maps of halves, with the shipped weights on a real frame, against f64: what the eye sees of it, in decibels.
#[test]
fn halves_are_exact_to_the_eye() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/teapot_spp0004.exr");
    let file = ExrFrame::read(path, &LayerOptions::default()).unwrap();
    let (frame, extent) = (file.frame(), file.frame().extent);
    let weights = Weights::hybrid_kernels().unwrap();
    let options = Options { precision: Precision::F16, ..Options::default() };
    let Ok(mut denoiser) = Denoiser::new(device(), &weights, &options) else {
        return println!("the device cannot store halves");
    };
    assert_eq!(denoiser.precision(), Precision::F16);
    let mut found = vec![0.0; 3 * extent.pixels() as usize];
    let report = denoiser.denoise(&frame, PlaneMut::f32(&mut found, Layout::interleaved(extent, 3))).unwrap();
    let graph = Graph::new(weights.arch()).unwrap();
    let plan = plan(&graph, extent, &Target::default()).unwrap();
    let mut reference = Reference::new(&plan, &weights).unwrap();
    reference.set_frame(&frame, None, 0.0).unwrap();
    reference.run();
    let tone = |value: f64| (value * f64::from(report.exposure)).clamp(0.0, 1.0).powf(1.0 / 2.2);
    let differences = found.iter().zip(reference.output()).map(|(f, r)| tone(f64::from(*f)) - tone(*r));
    let squares = differences.map(|d| d * d).sum::<f64>() / found.len() as f64;
    let decibels = -10.0 * squares.log10();
    println!("{decibels:.1} dB");
    assert!(decibels >= 90.0, "{decibels:.1} dB");
    assert_no_validation_messages();
}

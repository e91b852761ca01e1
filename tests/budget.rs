//! The error budget on a real frame with the shipped weights: bounds on the residual, and on every dispatch before it.

#[path = "../tools/bench/budget/mod.rs"]
mod budget;
mod common;

use budget::{measure, residual, table};
use common::case::{MATRIX_LIMIT, variants};
use common::device::{assert_no_validation_messages, device};
use vkdenoise::exr_io::{ExrFrame, LayerOptions};
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::plan::{ConvAlgorithm, PlanOptions};
use vkdenoise::testing::Bench;
use vkdenoise::{Extent, Frame, Weights};

/// What the network's residual may be wrong by: NMSE.
const RESIDUAL_LIMIT: f64 = 1e-9;
/// The same on matrices: what one kernel may be wrong by, for each of the seventy that follow one another in the Hybrid.
const MATRIX_RESIDUAL_LIMIT: f64 = 70.0 * MATRIX_LIMIT;

#[test]
fn every_algorithm_keeps_its_budget_on_a_real_frame() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/teapot_spp0004.exr");
    let file = ExrFrame::read(path, &LayerOptions::default()).unwrap();
    let frame = Frame { extent: Extent::new(128, 120), ..file.frame() };
    let features = frame.features;
    assert!(features.albedo.is_some() && features.normal.is_some() && features.depth.is_some());
    let weights = Weights::hybrid().unwrap();
    let direct = PlanOptions::default();
    let winograd = |tile| PlanOptions { conv: ConvAlgorithm::Winograd(tile), ..direct };
    let preferred = Bench::default_variants(device());
    let forms = [(preferred, winograd(WinogradTile::F2)), (preferred, winograd(WinogradTile::F4))];
    for (variants, forms) in variants().into_iter().map(|variants| (variants, direct)).chain(forms) {
        let lines = measure(device(), &weights, &frame, variants, &forms).unwrap();
        let last = residual(&lines).unwrap();
        let limit = if variants.matrix { MATRIX_RESIDUAL_LIMIT } else { RESIDUAL_LIMIT };
        println!("{variants:?}, {:?}: {:.1e} in {}", forms.conv, last.nmse, last.name);
        assert!(last.name.starts_with("output") && last.nmse <= limit, "{last:?}");
        for line in &lines {
            // An error may be larger on its way than at the end, where it meets the whole residual; not by much.
            assert!(line.nmse <= 10.0 * limit, "{line:?}");
            assert!(line.largest > 0.0 && line.half_range < 1.0, "{line:?}");
        }
        assert_eq!(table::markdown(&lines).lines().count(), lines.len() + 2);
    }
    assert_no_validation_messages();
}

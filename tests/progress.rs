//! Progress of the host path: told between submissions, and where the answer is to stop, nothing is half done.

mod common;

use common::compare::assert_same_bits;
use common::device::{assert_no_validation_messages, device};
use common::planes::TestFrame;
use std::ops::ControlFlow;
use vkdenoise::{
    Converged, ConvergedMode, Denoiser, DeviceKind, Error, Extent, Layout, Options, PlaneMut, Region, Weights,
};

const EXTENT: Extent = Extent::new(67, 45);
const UNTOUCHED: f32 = -7.0;

fn denoiser(options: &Options) -> Denoiser {
    Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), options).unwrap()
}

fn rgb() -> Layout {
    Layout::interleaved(EXTENT, 3)
}

fn denoise(denoiser: &mut Denoiser, frame: &TestFrame) -> Vec<f32> {
    let mut output = vec![UNTOUCHED; 3 * EXTENT.pixels() as usize];
    denoiser.denoise(&frame.frame(), PlaneMut::f32(&mut output, rgb())).unwrap();
    output
}

/// Denoises, stopping at the call `stop` if there is one; what was told is added to `told`.
fn watched(
    denoiser: &mut Denoiser,
    frame: &TestFrame,
    stop: Option<usize>,
    told: &mut Vec<f32>,
) -> (Result<(), Error>, Vec<f32>) {
    let mut output = vec![UNTOUCHED; 3 * EXTENT.pixels() as usize];
    let mut progress = |done: f32| {
        told.push(done);
        if Some(told.len() - 1) == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    };
    let plane = PlaneMut::f32(&mut output, rgb());
    let result = denoiser.denoise_with(&frame.frame(), plane, &mut [], Some(&mut progress));
    (result.map(|_| ()), output)
}

#[test]
fn a_watched_frame_has_the_same_bits_and_grows_from_nothing_to_all() {
    let converged = Converged { threshold: 0.05, mode: ConvergedMode::Exact };
    for options in [Options::default(), Options { converged: Some(converged), ..Options::default() }] {
        let mut denoiser = denoiser(&options);
        for (region, seed) in [(None, 1), (Some(Region { x: 5, y: 9, width: 30, height: 20 }), 2), (None, 3)] {
            denoiser.set_region(region);
            let frame = TestFrame::random(EXTENT, seed);
            let expected = denoise(&mut denoiser, &frame);
            let mut told = Vec::new();
            let (result, output) = watched(&mut denoiser, &frame, None, &mut told);
            result.unwrap();
            assert_same_bits(&output, &expected, "watched");
            assert_same_bits(&denoise(&mut denoiser, &frame), &expected, "unwatched after it");
            assert!(told.len() > 2 && told[0] == 0.0 && told[told.len() - 1] == 1.0, "{told:?}");
            assert!(told.windows(2).all(|pair| pair[0] < pair[1]), "{told:?}");
            if device().info().kind == DeviceKind::Cpu {
                assert!(told.len() > 40, "{} submissions", told.len() - 1);
            }
        }
    }
    assert_no_validation_messages();
}

#[test]
fn stopped_anywhere_it_leaves_the_output_and_the_next_frame_is_right() {
    let mut denoiser = denoiser(&Options::default());
    let [first, second] = [4, 5].map(|seed| TestFrame::random(EXTENT, seed));
    let expected = denoise(&mut denoiser, &second);
    let mut told = Vec::new();
    watched(&mut denoiser, &first, None, &mut told).0.unwrap();
    // Every seventh call, the second and the last: an odd step, so that what comes next takes turns.
    for stop in (0..told.len()).step_by(7).chain([1, told.len() - 1]) {
        let mut until = Vec::new();
        let (result, output) = watched(&mut denoiser, &first, Some(stop), &mut until);
        assert!(matches!(result, Err(Error::Cancelled)), "call {stop}: {result:?}");
        assert!(output.iter().all(|&value| value == UNTOUCHED), "call {stop}: the output was touched");
        if device().info().kind == DeviceKind::Cpu {
            // There every kernel is a submission by itself, whatever it took the last time.
            assert_eq!(until, told[..=stop]);
        }
        if stop % 2 == 0 {
            assert_same_bits(&denoise(&mut denoiser, &second), &expected, "the next frame");
        } else {
            assert_same_bits(&watched(&mut denoiser, &second, None, &mut Vec::new()).1, &expected, "watched next");
        }
    }
    assert_no_validation_messages();
}

#[test]
fn in_place_the_colour_stays_as_it_was() {
    let mut denoiser = denoiser(&Options::default());
    let frame = TestFrame::random(EXTENT, 6);
    let expected = denoise(&mut denoiser, &frame);
    let common::planes::Samples::F32(noisy) = &frame.color.samples else { unreachable!() };
    let mut color = noisy.clone();
    let features = frame.frame().features;
    let mut calls = 0;
    let stopped =
        denoiser.denoise_in_place_with(EXTENT, PlaneMut::f32(&mut color, rgb()), &features, &mut |done: f32| {
            calls += 1;
            if done > 0.5 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        });
    assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
    assert!(calls > 2);
    assert_same_bits(&color, noisy, "the colour of a cancelled call");
    let mut go_on = |_: f32| ControlFlow::Continue(());
    denoiser.denoise_in_place_with(EXTENT, PlaneMut::f32(&mut color, rgb()), &features, &mut go_on).unwrap();
    assert_same_bits(&color, &expected, "in place");
    assert_no_validation_messages();
}

/// What was kept of the features is gone with a cancelled frame, and asking for it is refused.
#[test]
fn kept_features_do_not_outlive_a_cancelled_frame() {
    let mut denoiser = denoiser(&Options { keep_features: true, ..Options::default() });
    let frame = TestFrame::random(EXTENT, 8);
    let expected = denoise(&mut denoiser, &frame);
    denoiser.set_features_unchanged(true);
    let (result, output) = watched(&mut denoiser, &frame, None, &mut Vec::new());
    result.unwrap();
    assert_same_bits(&output, &expected, "features kept, watched");
    assert!(matches!(watched(&mut denoiser, &frame, Some(1), &mut Vec::new()).0, Err(Error::Cancelled)));
    let refused = watched(&mut denoiser, &frame, None, &mut Vec::new()).0;
    assert!(matches!(refused, Err(Error::InvalidOption { option: "features_unchanged", .. })), "{refused:?}");
    denoiser.set_features_unchanged(false);
    assert_same_bits(&denoise(&mut denoiser, &frame), &expected, "features given again");
}

/// The kernels' times are those of all submissions.
#[test]
fn a_watched_frame_is_profiled_whole() {
    let mut denoiser = denoiser(&Options::default());
    if denoiser.set_profiling(true).is_err() {
        return;
    }
    let frame = TestFrame::random(EXTENT, 9);
    denoise(&mut denoiser, &frame);
    let names = |denoiser: &Denoiser| denoiser.records().iter().map(|record| record.name.clone()).collect::<Vec<_>>();
    let expected = names(&denoiser);
    watched(&mut denoiser, &frame, None, &mut Vec::new()).0.unwrap();
    assert!(expected.len() > 40);
    assert_eq!(names(&denoiser), expected);
    assert!(denoiser.records().iter().map(|record| record.microseconds).sum::<f64>() > 0.0);
    assert_no_validation_messages();
}

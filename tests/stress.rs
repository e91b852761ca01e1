//! A sample of the stress cases that `vkdenoise-bench stress` runs in full, and frames of arbitrary bits.

mod common;
#[path = "../tools/bench/stress/mod.rs"]
mod stress;

use common::device::{assert_no_validation_messages, device};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngSeed};
use std::sync::Mutex;
use std::time::Instant;
use stress::light::is_of_training;
use stress::scene::Scene;
use stress::subject::{Exactness, Subject, Tier, in_and_out_alone};
use stress::{Depends, Effort, bad_samples, cases};
use vkdenoise::options::ConvAlgorithm;
use vkdenoise::{Denoiser, Extent, Layout, Options, PlaneMut, Weights};

/// 32-bit floats and direct convolutions; the kernels' own tests hold the tiers to each other.
fn tier() -> Tier {
    Tier::preferred(device())
}

/// Runs the cases that `wanted` picks. All figures must be inside their bounds but those that training answers for.
fn check(weights: &Weights, tier: Tier, wanted: impl Fn(&str) -> bool) {
    let mut subject = Subject::engine(device(), weights, tier).unwrap();
    let (mut broken, mut run) = (Vec::new(), 0);
    for case in cases().into_iter().filter(|case| wanted(case.name)) {
        let started = Instant::now();
        for measured in case.measure(&mut subject, Effort::Sample).unwrap() {
            let shown = measured.shown();
            let line = format!("{}, {}: {} {shown}, bound {}", tier.name, case.name, measured.what, measured.bound);
            println!("{line}");
            if !measured.is_within() && measured.depends == Depends::Engine {
                broken.push(line);
            }
        }
        println!("{}: {:.1} s", case.name, started.elapsed().as_secs_f64());
        run += 1;
    }
    assert!(run > 0 && broken.is_empty(), "of {run} cases, outside their bounds: {broken:#?}");
    assert_no_validation_messages();
}

#[test]
fn bad_pixels_stay_local() {
    let weights = Weights::hybrid_kernels().unwrap();
    check(&weights, tier(), |name| name.contains("bad pixel"));
}

#[test]
fn content_shapes_and_sequences() {
    let weights = Weights::hybrid_kernels().unwrap();
    check(&weights, tier(), |name| !name.contains("bad pixel"));
}

/// What a network may spoil, the way in and out must keep by itself.
#[test]
fn the_way_in_and_out_alone_keeps_light() {
    let weights = in_and_out_alone(&Weights::hybrid_kernels().unwrap()).unwrap();
    check(&weights, tier(), is_of_training);
}

/// Maps of halves, and matrices where the device has them.
#[test]
fn tiers_with_halves_keep_bounds_of_their_own() {
    check_tiers(|tier| tier.exactness == Exactness::Half && tier.conv == ConvAlgorithm::Direct);
}

/// Sample counts call half of every frame converged.
#[test]
fn tiers_that_leave_converged_squares_out_keep_the_bounds() {
    check_tiers(|tier| tier.converged.is_some());
}

/// The cases that say most, on tiers with the kernels that the device prefers.
fn check_tiers(wanted: impl Fn(&Tier) -> bool) {
    let weights = Weights::hybrid_kernels().unwrap();
    let tiers =
        Tier::all(device()).into_iter().filter(|tier| wanted(tier) && tier.cpu_kernels == self::tier().cpu_kernels);
    let tiers: Vec<Tier> = tiers.collect();
    if tiers.is_empty() {
        return println!("not tested: the device has no such tier");
    }
    let names = [
        "one bad pixel in colour",
        "one bad pixel in all planes",
        "neutral",
        "firefly",
        "radiance",
        "nothing unusual",
        "kilometres",
        "sequence",
    ];
    for tier in tiers {
        check(&weights, tier, |name| names.iter().any(|n| name.contains(n)));
    }
}

/// Any 32 bits as a float, the odd kinds often.
fn sample() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => any::<u32>().prop_map(f32::from_bits),
        4 => 0.0f32..2.0,
        1 => prop::sample::select(vec![f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -0.0, 1e-40]),
    ]
}

/// A small frame of arbitrary bits in every plane, with any of the features missing.
fn frame() -> impl Strategy<Value = Scene> {
    let planes = |(width, height)| {
        let pixels = width as usize * height as usize;
        let plane = move |channels| prop::collection::vec(sample(), channels * pixels);
        let features = (prop::option::of(plane(3)), prop::option::of(plane(3)), prop::option::of(plane(1)));
        (plane(3), features).prop_map(move |(color, (albedo, normal, depth))| Scene {
            extent: Extent::new(width, height),
            clean: Vec::new(),
            color,
            albedo,
            normal,
            depth,
            samples: None,
        })
    };
    (1..=24u32, 1..=16u32).prop_flat_map(planes)
}

proptest! {
    #![proptest_config(Config {
        cases: 8, max_shrink_iters: 40, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..Config::default()
    })]

    #[test]
    fn frames_of_arbitrary_bits_give_sound_pictures_twice(scene in frame()) {
        static DENOISER: Mutex<Option<Denoiser>> = Mutex::new(None);
        let mut denoiser = DENOISER.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let denoiser = denoiser.get_or_insert_with(|| {
            tier().denoiser(device(), &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap()
        });
        let rgb = Layout::interleaved(scene.extent, 3);
        let mut outputs = [(); 2].map(|()| vec![f32::NAN; scene.color.len()]);
        for output in &mut outputs {
            denoiser.denoise(&scene.frame(), PlaneMut::f32(output, rgb)).unwrap();
        }
        prop_assert_eq!(bad_samples(&outputs[0]), 0.0);
        prop_assert!(outputs[0] == outputs[1], "another run, other bits");
    }
}

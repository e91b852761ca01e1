//! Whole networks: the engine against the f64 reference and against PyTorch. What frames the network that ships is
//! given is here; whether heads of kernels are PyTorch's, in `tests/head.rs`.

mod common;

use common::case::{KERNEL_LIMIT, PREPROCESSING};
use common::compare::{max_error, nmse, rms};
use common::device::{assert_no_validation_messages, device};
use common::golden::Golden;
use common::network::{bench_of, crop, download, mirrored, network_range, plan_of, run_and_assert_shares, wide};
use common::planes::{TestFrame, TestPlane};
use common::trained::{expanded_patch, residual_hybrid};
use std::collections::{BTreeMap, HashSet};
use std::sync::Mutex;
use vkdenoise::frame::{Extent, Frame, Layout, PlaneMut};
use vkdenoise::kernels::Call;
use vkdenoise::net::{Arch, Weights};
use vkdenoise::plan::{Place, Plan};
use vkdenoise::reference::Reference;
use vkdenoise::testing::denoise_and_read;
use vkdenoise::{Denoiser, Exposure, Options};

/// What a network's residual may be wrong by: NMSE.
const NETWORK_LIMIT: f64 = 1e-9;
/// What the logarithm of the picture that kernels make may be wrong by, NMSE: as strict, as a residual is 0.26 to 0.29
/// of it (golden_trained).
const PICTURE_LIMIT: f64 = 1e-10;
/// What it may be from PyTorch's, in the log domain.
const GOLDEN_LIMIT: f64 = 1e-4;

fn hashed(name: &str, seed: u64) -> Weights {
    Weights::hashed(&Arch::named(name).unwrap(), PREPROCESSING, seed).unwrap()
}

/// The engine's residual for a golden file's own network inputs, cropped.
fn residual_of_golden_inputs(golden: &Golden, prefix: &str, weights: &Weights) -> Vec<f32> {
    let (color, aux) = (format!("{prefix}log_color"), format!("{prefix}aux"));
    let extent = golden.extent(&color);
    let plan = plan_of(weights, extent);
    let mut bench = bench_of(&plan, weights);
    bench.upload(plan.log_color.buffer, &mirrored(golden.tensor(&color), extent, &plan.log_color));
    bench.upload(plan.aux.buffer, &mirrored(golden.tensor(&aux), extent, &plan.aux));
    let calls: Vec<Call> = plan.dispatches[network_range(&plan)].iter().map(|d| d.call.clone()).collect();
    bench.run(&calls).unwrap();
    let used: Vec<u64> = plan.buffers.iter().map(|buffer| buffer.bytes).collect();
    bench.check_guards(&used).unwrap();
    crop(&download(&bench, &plan, plan.residual.buffer), plan.padded, extent)
}

#[test]
fn pytorch_agrees_on_trained_weights() {
    let golden = Golden::read("golden_trained.safetensors");
    for weights in [residual_hybrid(), expanded_patch()] {
        let name = &weights.arch().name;
        for prefix in ["square.", "odd."] {
            let found = residual_of_golden_inputs(&golden, prefix, &weights);
            let error = max_error(&found, &wide(golden.tensor(&format!("{prefix}residual.{name}"))));
            println!("{name}, {prefix} largest error {error:.1e}");
            assert!(error <= GOLDEN_LIMIT, "{name}, {prefix} largest error {error:.1e}");
        }
    }
    assert_no_validation_messages();
}

/// What the engine's host path makes in the network, and its plan.
fn engine_result(denoiser: &mut Denoiser, frame: &Frame) -> (Vec<f32>, Plan) {
    denoise_and_read(denoiser, frame, |plan| plan.residual.buffer).unwrap()
}

/// The ten networks with random weights, on a real frame: PyTorch's residual for its own inputs, and the reference's
/// residual for the frame's planes, through the host path. Two at a time: one alone leaves a core idle by turns.
#[test]
fn every_network_is_pytorch_and_the_reference() {
    let golden = Golden::read("golden_random.safetensors");
    let (names, seen) = (Mutex::new(Arch::NAMES.into_iter()), Mutex::new(HashSet::new()));
    let next = || names.lock().unwrap().next();
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some(name) = next() {
                    assert_pytorch_and_the_reference(name, &golden, &seen);
                }
            });
        }
    });
    assert_no_validation_messages();
}

/// `seen`: the blocks of which it was shown that every branch matters, once for each kind.
fn assert_pytorch_and_the_reference(name: &str, golden: &Golden, seen: &Mutex<HashSet<String>>) {
    let (frame, weights) = (golden.frame(""), hashed(name, golden.number("seed") as u64));
    let found = residual_of_golden_inputs(golden, "", &weights);
    let theirs = wide(golden.tensor(&format!("residual.{name}")));
    let (pytorch, far_from_pytorch) = (nmse(&found, &theirs), max_error(&found, &theirs));
    assert!(pytorch <= NETWORK_LIMIT, "{name}: NMSE {pytorch:.1e} to PyTorch");

    let mut denoiser = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    let (found, plan) = engine_result(&mut denoiser, &frame.frame());
    let mut reference = Reference::new(&plan, &weights).unwrap();
    reference.set_frame(&frame.frame(), None, 0.0).unwrap();
    (0..network_range(&plan).start).for_each(|i| reference.run_dispatch(i));
    let arch = weights.arch();
    let blocks = arch.stages.iter().map(|stage| stage.block).chain([arch.bottleneck.block]);
    let new = blocks.filter(|block| seen.lock().unwrap().insert(format!("{block:?}"))).count() > 0;
    if new {
        run_and_assert_shares(&mut reference, &plan, &weights);
    } else {
        network_range(&plan).for_each(|i| reference.run_dispatch(i));
    }
    let nmse = padded_nmse(&found, &reference, &plan);
    let expected = crop(&reference.view(&plan.residual), plan.padded, plan.padded);
    let far = max_error(&crop(&found, plan.padded, plan.padded), &expected);
    println!(
        "{name}: NMSE {nmse:.1e}, largest error {far:.1e} of {:.1}; PyTorch {pytorch:.1e}, {far_from_pytorch:.1e}",
        rms(&expected)
    );
    assert!(nmse <= NETWORK_LIMIT, "{name}: NMSE {nmse:.1e}");
}

/// NMSE of a residual to the reference's, padding included.
fn padded_nmse(found: &[f32], reference: &Reference, plan: &Plan) -> f64 {
    let expected = reference.view(&plan.residual);
    nmse(&crop(found, plan.padded, plan.padded), &crop(&expected, plan.padded, plan.padded))
}

/// NMSE of the logarithm of the picture that kernels make, padding included.
fn picture_nmse(found: &[f32], reference: &Reference, plan: &Plan) -> f64 {
    let found = crop(found, plan.padded, plan.padded);
    let log: Vec<f32> = found.iter().map(|&radiance| f64::from(radiance).ln_1p() as f32).collect();
    let expected = crop(&reference.view(&plan.residual), plan.padded, plan.padded);
    nmse(&log, &expected.iter().map(|radiance| radiance.ln_1p()).collect::<Vec<_>>())
}

/// Every kernel on what the device itself gave it: an error shows where it is made.
fn assert_every_dispatch(name: &str, frame: &TestFrame, weights: &Weights) {
    let plan = plan_of(weights, frame.extent);
    let mut bench = bench_of(&plan, weights);
    let mut used: Vec<u64> = plan.buffers.iter().map(|buffer| buffer.bytes).collect();
    frame.upload(&mut bench, &mut used);
    let network = network_range(&plan);
    let calls: Vec<Call> = plan.dispatches[..network.end].iter().map(|d| d.call.clone()).collect();
    bench.run(&calls).unwrap();
    bench.check_guards(&used).unwrap();

    let mut reference = Reference::new(&plan, weights).unwrap();
    let mut worst = BTreeMap::<&str, f64>::new();
    for dispatch in &plan.dispatches[network] {
        let traffic = dispatch.traffic();
        for &(id, _) in &traffic.reads {
            if !matches!(plan.buffer(id).place, Place::Weights { .. }) {
                reference.set_buffer(id, &wide(&download(&bench, &plan, id)));
            }
        }
        let [(result, _)] = traffic.writes[..] else { panic!("{} writes several buffers", dispatch.name) };
        // The size to compare with is that of the branch, without the residual that it is added to.
        let mut branch = dispatch.call.clone();
        let kind = match &mut branch {
            Call::Conv3x3(k) => (k.residual.take(), "conv3x3").1,
            Call::Linear(k) => (k.residual.take(), "linear").1,
            Call::Unembed(_) => "unembed",
            Call::Depthwise3x3(_) => "depthwise3x3",
            Call::LayerNorm(_) => "layer_norm",
            Call::WindowAttention(_) => "window_attention",
            Call::TokenSum(_) | Call::FilmVector(_) => "film",
            other => panic!("{other:?} is no part of the network"),
        };
        let squares = |values: &[f64]| values.iter().filter(|v| !v.is_nan()).map(|v| v * v).sum::<f64>();
        reference.run_call(&branch);
        let size = squares(reference.buffer(result));
        reference.run_call(&dispatch.call);
        let found = download(&bench, &plan, result);
        let differences: Vec<f64> =
            reference.buffer(result).iter().zip(found).map(|(expected, found)| f64::from(found) - expected).collect();
        let nmse = squares(&differences) / size;
        assert!(nmse <= KERNEL_LIMIT, "{name}: NMSE {nmse:.1e} in {}", dispatch.name);
        let worst = worst.entry(kind).or_default();
        *worst = worst.max(nmse);
    }
    let worst: Vec<String> = worst.iter().map(|(kind, nmse)| format!("{kind} {nmse:.1e}")).collect();
    println!("{name}: {}", worst.join(", "));
    assert_no_validation_messages();
}

#[test]
fn every_kernel_on_real_input() {
    let golden = Golden::read("golden_trained.safetensors");
    for prefix in ["square.", "odd."] {
        assert_every_dispatch(&format!("hybrid, {prefix}"), &golden.frame(prefix), &residual_hybrid());
    }
}

#[test]
fn every_kernel_on_random_input() {
    let frame = TestFrame::random(Extent::new(45, 70), 1);
    for name in ["hybrid", "jsa_baseline"] {
        assert_every_dispatch(name, &frame, &hashed(name, 2));
    }
}

/// From planes to the network's picture and the output, at sizes that are padded a lot, a little and not at all; and
/// again in the other order: what a run leaves behind does not reach the next.
#[test]
fn every_size_is_the_reference() {
    let weights = Weights::hybrid_kernels().unwrap();
    let mut denoiser = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    let sizes = [(1, 1), (1, 7), (127, 65), (128, 128), (129, 70)].map(|(w, h)| Extent::new(w, h));
    let mut first = Vec::new();
    for extent in sizes {
        let frame = TestFrame::random(extent, 9);
        let (found, plan) = engine_result(&mut denoiser, &frame.frame());
        let mut reference = Reference::new(&plan, &weights).unwrap();
        reference.set_frame(&frame.frame(), None, 0.0).unwrap();
        reference.run();
        let error = picture_nmse(&found, &reference, &plan);
        println!("{extent:?}: NMSE {error:.1e}");
        assert!(error <= PICTURE_LIMIT, "{extent:?}: NMSE {error:.1e}");
        let output = denoised(&mut denoiser, &frame.frame());
        let scale = reference.output().iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        let error = max_error(&output, reference.output()) / scale;
        assert!(error <= 1e-5, "{extent:?}: the output is off by {error:.1e} of its largest value");
        first.push(output);
    }
    for (extent, output) in sizes.into_iter().zip(first).rev() {
        let frame = TestFrame::random(extent, 9);
        assert!(denoised(&mut denoiser, &frame.frame()) == output, "{extent:?}: another run, other bits");
    }
    assert_no_validation_messages();
}

fn denoised(denoiser: &mut Denoiser, frame: &Frame) -> Vec<f32> {
    let mut output = vec![0.0; 3 * frame.extent.pixels() as usize];
    denoiser.denoise(frame, PlaneMut::f32(&mut output, Layout::interleaved(frame.extent, 3))).unwrap();
    output
}

/// Half-float planes with gaps, a fixed exposure, a blend, missing features.
#[test]
fn every_kind_of_frame_is_the_reference() {
    let weights = Weights::hybrid_kernels().unwrap();
    let extent = Extent::new(45, 70);
    let full = TestFrame::random(extent, 4);
    let mut far = full.clone();
    // 65504 is what a half makes of every larger depth: background.
    far.depth = Some(TestPlane::packed(extent, 1, (0..45 * 70).map(|i| [3.0, 9.0, 65504.0][i % 3]).collect()));
    let plain = Options::default();
    let fixed = Options { exposure: Exposure::Fixed(0.7), blend: 0.25, ..plain };
    let noisy = Options { blend: 1.0, ..plain };
    let cases = [
        ("spread", full.spread(false), plain),
        ("halves", full.spread(true), plain),
        ("halves, far background", far.spread(true), plain),
        ("no albedo", TestFrame { albedo: None, ..full.clone() }, plain),
        ("no normal", TestFrame { normal: None, ..full.clone() }, plain),
        ("no depth", TestFrame { depth: None, ..full.clone() }, plain),
        ("fixed exposure, blend", full.clone(), fixed),
        ("colour alone, all of it noisy", TestFrame { albedo: None, normal: None, depth: None, ..full }, noisy),
    ];
    let mut denoiser = Denoiser::new(device(), &weights, &plain).unwrap();
    for (name, frame, options) in cases {
        if options != plain {
            denoiser = Denoiser::new(device(), &weights, &options).unwrap();
        }
        let (found, plan) = engine_result(&mut denoiser, &frame.frame());
        let mut reference = Reference::new(&plan, &weights).unwrap();
        let factor = if let Exposure::Fixed(factor) = options.exposure { Some(factor.into()) } else { None };
        reference.set_frame(&frame.frame(), factor, options.blend.into()).unwrap();
        reference.run();
        let picture = picture_nmse(&found, &reference, &plan);
        let output = nmse(&denoised(&mut denoiser, &frame.frame()), reference.output());
        println!("{name}: NMSE {picture:.1e}, of the output {output:.1e}");
        assert!(picture <= PICTURE_LIMIT && output <= NETWORK_LIMIT, "{name}: {picture:.1e}, {output:.1e}");
    }
    assert_no_validation_messages();
}

/// All radiance times 1e-4 or 1e4 gives the same picture.
#[test]
fn brightness_does_not_matter() {
    let (golden, weights) = (Golden::read("golden_trained.safetensors"), Weights::hybrid_kernels().unwrap());
    let mut denoiser = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    let frame = golden.frame("square.");
    let key = golden.number("square.key");
    let plain = denoised(&mut denoiser, &frame.frame());
    for factor in [1e-4, 1e4] {
        let radiance = golden.tensor("square.color").iter().map(|sample| sample * factor).collect();
        let scaled = TestFrame { color: TestPlane::packed(frame.extent, 3, radiance), ..frame.clone() };
        for (a, b) in denoised(&mut denoiser, &scaled.frame()).iter().zip(&plain) {
            let (a, b) = (f64::from(a / factor), f64::from(*b));
            assert!((a - b).abs() <= 1e-3 * (b + 1e-3 * key), "times {factor}: {a} instead of {b}");
        }
    }
    assert_no_validation_messages();
}

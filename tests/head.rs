//! Whole networks with a head of predicted kernels.

mod common;

use common::case::{PREPROCESSING, small_hybrid};
use common::compare::{assert_same_bits, nmse};
use common::device::{assert_no_validation_messages, device};
use common::golden::Golden;
use common::network::{bench_of, crop, download, mirrored, network_range, plan_of, wide};
use common::planes::{TestFrame, TestPlane};
use common::random::Random;
use vkdenoise::kernels::Call;
use vkdenoise::net::{Arch, Head, Weights};
use vkdenoise::reference::Reference;
use vkdenoise::testing::{Bench, denoise_and_read, overwrite_memory};
use vkdenoise::{
    Converged, ConvergedMode, Denoiser, Extent, Features, Frame, Layout, Noise, NoiseKind, Options, Plane, PlaneMut,
    Precision, Region,
};

/// What the exposed radiance may be wrong by, in 32-bit floats and with maps of halves: NMSE.
const LIMIT: f64 = 1e-9;
const HALF_LIMIT: f64 = 1e-5;

fn heads() -> [(&'static str, Head); 3] {
    [("pure", Head::pure()), ("gloss", Head::gloss()), ("gated", Head::gated())]
}

/// High enough for bands of the whole head.
const BANDED: Extent = Extent::new(120, 517);

fn in_bands_of(max_chain_bytes: u64) -> Options {
    Options { max_chain_bytes: Some(max_chain_bytes), ..Options::default() }
}

/// How many bands the picture is put out in.
fn bands_of(denoiser: &Denoiser, extent: Extent) -> usize {
    let pass = denoiser.pass(extent).unwrap();
    pass.plan().dispatches.iter().filter(|dispatch| matches!(dispatch.call, Call::Output(_))).count()
}

fn denoise(denoiser: &mut Denoiser, frame: &Frame) -> Vec<f32> {
    let mut output = vec![-1.0; 3 * frame.extent.pixels() as usize];
    denoiser.denoise(frame, PlaneMut::f32(&mut output, Layout::interleaved(frame.extent, 3))).unwrap();
    output
}

fn denoised(weights: &Weights, options: &Options, frame: &Frame) -> Vec<f32> {
    denoise(&mut Denoiser::new(device(), weights, options).unwrap(), frame)
}

/// PyTorch's exposed radiance for its own network inputs.
#[test]
fn pytorch_agrees() {
    let golden = Golden::read("golden_kernels.safetensors");
    let extent = golden.extent("log_color");
    for (name, head) in heads() {
        let weights =
            Weights::hashed(&Arch { head, ..Arch::hybrid() }, PREPROCESSING, golden.number("seed") as u64).unwrap();
        let log_color = wide(golden.tensor("log_color"));
        let theirs = log_color.iter().zip(golden.tensor(&format!("residual.hybrid.{name}")));
        let theirs: Vec<f64> = theirs.map(|(c, r)| (c + f64::from(*r)).exp_m1()).collect();

        let plan = plan_of(&weights, extent);
        let mut bench = bench_of(&plan, &weights);
        let color = mirrored(golden.tensor("log_color"), extent, &plan.log_color);
        let aux = mirrored(golden.tensor("aux"), extent, &plan.aux);
        bench.upload(plan.log_color.buffer, &color);
        bench.upload(plan.aux.buffer, &aux);
        let network = network_range(&plan);
        let calls: Vec<Call> = plan.dispatches[network.clone()].iter().map(|d| d.call.clone()).collect();
        bench.run(&calls).unwrap();
        let used: Vec<u64> = plan.buffers.iter().map(|buffer| buffer.bytes).collect();
        bench.check_guards(&used).unwrap();
        let found = crop(&download(&bench, &plan, plan.residual.buffer), plan.padded, extent);

        let mut reference = Reference::new(&plan, &weights).unwrap();
        reference.set_buffer(plan.log_color.buffer, &wide(&color));
        reference.set_buffer(plan.aux.buffer, &wide(&aux));
        network.for_each(|i| reference.run_dispatch(i));
        let twin: Vec<f64> = crop(reference.buffer(plan.residual.buffer), plan.padded, extent);
        let single: Vec<f32> = twin.iter().map(|&value| value as f32).collect();
        let (engine, twin) = (nmse(&found, &theirs), nmse(&single, &theirs));
        println!("{name}: NMSE of the engine {engine:.1e}, of the f64 twin {twin:.1e}");
        // The file holds PyTorch's f64 result in 32-bit floats of the logarithm.
        assert!(engine <= LIMIT && twin <= 1e-12, "{name}: {engine:.1e}, {twin:.1e}");
    }
    assert_no_validation_messages();
}

/// From planes to the result and the output, at sizes that are padded a lot, a little and not at all.
#[test]
fn every_size_is_the_reference() {
    for (name, head) in heads() {
        let weights = small_hybrid(head.clone());
        for precision in [Precision::F32, Precision::F16] {
            if precision == Precision::F16 && !Bench::can_store_halves(device()) {
                println!("not tested: the device cannot store halves");
                continue;
            }
            let mut denoiser = Denoiser::new(device(), &weights, &Options { precision, ..Options::default() }).unwrap();
            for extent in [(1, 1), (70, 45), (128, 128)].map(|(w, h)| Extent::new(w, h)) {
                let frame = TestFrame::random(extent, 9);
                let (found, plan) =
                    denoise_and_read(&mut denoiser, &frame.frame(), |plan| plan.residual.buffer).unwrap();
                let mut reference = Reference::new(&plan, &weights).unwrap();
                reference.set_frame(&frame.frame(), None, 0.0).unwrap();
                reference.run();
                let expected = crop(&reference.view(&plan.residual), plan.padded, plan.padded);
                let radiance = nmse(&crop(&found, plan.padded, plan.padded), &expected);
                let output = nmse(&denoise(&mut denoiser, &frame.frame()), reference.output());
                println!("{name}, {precision}, {extent:?}: NMSE {radiance:.1e}, of the output {output:.1e}");
                let limit = if precision == Precision::F32 { LIMIT } else { HALF_LIMIT };
                assert!(radiance <= limit && output <= limit, "{name}, {extent:?}: {radiance:.1e}, {output:.1e}");
            }
        }
    }
    assert_no_validation_messages();
}

/// Kernels alone average: a constant stays what it is, and black is black, whatever the features say.
#[test]
fn kernels_alone_keep_a_constant_and_black() {
    let extent = Extent::new(120, 90);
    let precisions = [Precision::F32, Precision::F16];
    let all = [small_hybrid(Head::pure()), small_hybrid(Head::gloss()), Weights::hybrid_kernels().unwrap()];
    for (weights, precision) in all.iter().flat_map(|weights| precisions.map(|precision| (weights, precision))) {
        if precision == Precision::F16 && !Bench::can_store_halves(device()) {
            continue;
        }
        let mut denoiser = Denoiser::new(device(), weights, &Options { precision, ..Options::default() }).unwrap();
        let noisy = TestFrame::random(extent, 3);
        let grey = TestPlane::packed(extent, 3, [0.31, 0.02, 0.9].repeat(extent.pixels() as usize));
        for albedo in [None, Some(grey)] {
            let constant = TestPlane::packed(extent, 3, [0.7, 2.0, 0.01].repeat(extent.pixels() as usize));
            let flat = TestFrame { color: constant, albedo: albedo.clone(), ..noisy.clone() };
            for (i, value) in denoise(&mut denoiser, &flat.frame()).iter().enumerate() {
                let own = [0.7, 2.0, 0.01][i % 3];
                assert!((value / own - 1.0).abs() <= 1e-5, "{value} for {own}");
            }
            let black = TestPlane::packed(extent, 3, vec![0.0; 3 * extent.pixels() as usize]);
            let black = TestFrame { color: black, albedo, ..noisy.clone() };
            assert!(denoise(&mut denoiser, &black.frame()).iter().all(|value| *value == 0.0));
        }
        let dark = TestPlane::packed(extent, 3, vec![0.0; 3 * extent.pixels() as usize]);
        let output = denoise(&mut denoiser, &TestFrame { color: dark, ..noisy }.frame());
        assert!(output.iter().all(|value| *value == 0.0), "black with an albedo that varies");
    }
    assert_no_validation_messages();
}

#[test]
fn regions_have_the_bits_of_the_whole() {
    // In bands, what a region needs of the kernels' inputs is made again in each of them.
    let (extent, banded) = (BANDED, in_bands_of(1 << 19));
    // Kernels alone are a part of those with gloss.
    let heads = heads().into_iter().filter(|(name, _)| *name != "pure");
    let cases = heads.flat_map(|(name, head)| [(name, head.clone(), Options::default()), (name, head, banded)]);
    for (name, head, options) in cases {
        let weights = small_hybrid(head.clone());
        let mut denoiser = Denoiser::new(device(), &weights, &options).unwrap();
        assert_eq!(bands_of(&denoiser, extent) > 1, options.max_chain_bytes.is_some(), "{name}");
        let frame = TestFrame::random(extent, 1);
        let whole = denoise(&mut denoiser, &frame.frame());
        let mut random = Random::new(5);
        for _ in 0..6 {
            let (width, height) = (random.integer(1, 90), random.integer(1, 90));
            let (x, y) = (random.integer(0, extent.width - width), random.integer(0, extent.height - height));
            let region = Region { x, y, width, height };
            // What the arena still holds of the whole must not stand in for what the region fails to compute.
            overwrite_memory(&mut denoiser, extent).unwrap();
            denoiser.set_region(Some(region));
            for (i, (part, whole)) in denoise(&mut denoiser, &frame.frame()).iter().zip(&whole).enumerate() {
                let (x, y) = (i as u32 / 3 % extent.width, i as u32 / 3 / extent.width);
                let expected = if region.contains(x, y) { *whole } else { -1.0 };
                assert_eq!(part.to_bits(), expected.to_bits(), "{name}, {region:?}: pixel ({x}, {y})");
            }
        }
    }
    assert_no_validation_messages();
}

/// In bands, with and without features, and with features kept from the frame before.
#[test]
fn bands_and_features_make_no_difference() {
    let extent = BANDED;
    let frame = TestFrame::random(extent, 7);
    let bare = TestFrame { albedo: None, normal: None, depth: None, ..frame.clone() };
    for (name, head) in heads() {
        let weights = small_hybrid(head.clone());
        let whole = in_bands_of(u64::MAX);
        for frame in [&frame, &bare] {
            let expected = denoised(&weights, &whole, &frame.frame());
            let sizes: &[u64] = if head == Head::pure() { &[1 << 19, 1 << 21] } else { &[1 << 19] };
            for &bytes in sizes {
                let mut in_bands = Denoiser::new(device(), &weights, &in_bands_of(bytes)).unwrap();
                assert!(bands_of(&in_bands, extent) > 1, "{name} in bands of {bytes}");
                let found = denoise(&mut in_bands, &frame.frame());
                assert_same_bits(&found, &expected, &format!("{name} in bands of {bytes}"));
            }
        }
        // Without features they are constant ones.
        let pixels = extent.pixels() as usize;
        let constant = TestFrame {
            albedo: Some(TestPlane::packed(extent, 3, vec![0.0; 3 * pixels])),
            normal: Some(TestPlane::packed(extent, 3, vec![0.0; 3 * pixels])),
            depth: Some(TestPlane::packed(extent, 1, vec![0.0; pixels])),
            ..frame.clone()
        };
        let expected = denoised(&weights, &whole, &constant.frame());
        assert_same_bits(&denoised(&weights, &whole, &bare.frame()), &expected, name);
    }
    assert_no_validation_messages();
}

/// Squares of 16 pixels that are to be denoised.
fn active(x: u32, y: u32) -> bool {
    (x * 7 + y * 5).is_multiple_of(23)
}

#[test]
fn converged_tiles_are_left_out() {
    let extent = Extent::new(250, 211);
    let (rgb, one) = (Layout::interleaved(extent, 3), Layout::interleaved(extent, 1));
    let pixels = extent.pixels() as usize;
    let mut random = Random::new(8);
    let (color, albedo) = (random.values(3 * pixels, 0.0, 2.0), random.values(3 * pixels, 0.0, 1.0));
    let square = |i: usize| (i as u32 % extent.width / 16, i as u32 / extent.width / 16);
    let is_active = |i: usize| active(square(i).0, square(i).1);
    let samples: Vec<f32> = (0..pixels).map(|i| if is_active(i) { 4.0 } else { 4096.0 }).collect();
    let noise = Noise { plane: Plane::f32(&samples, one), kind: NoiseKind::Samples };
    let features = Features { albedo: Some(Plane::f32(&albedo, rgb)), noise: Some(noise), ..Features::default() };
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features };
    for (name, head) in heads() {
        let weights = small_hybrid(head.clone());
        let whole = denoised(&weights, &Options::default(), &frame);
        // Kernels alone are a part of those with gloss.
        let modes = [ConvergedMode::Exact, ConvergedMode::default()];
        for mode in modes.into_iter().take(if name == "pure" { 1 } else { 2 }) {
            let converged = Some(Converged { threshold: 0.02, mode });
            let mut denoiser = Denoiser::new(device(), &weights, &Options { converged, ..Options::default() }).unwrap();
            overwrite_memory(&mut denoiser, extent).unwrap();
            let found = denoise(&mut denoiser, &frame);
            for (i, found) in found.iter().enumerate() {
                assert!(found.is_finite() && *found >= 0.0, "{name}, {mode:?}: {found}");
                if mode == ConvergedMode::Exact && is_active(i / 3) {
                    assert_eq!(found.to_bits(), whole[i].to_bits(), "{name}: sample {i}");
                }
            }
            denoise(&mut denoiser, &TestFrame::random(extent, 2).frame());
            assert_same_bits(&denoise(&mut denoiser, &frame), &found, "after another frame");
        }
    }
    assert_no_validation_messages();
}

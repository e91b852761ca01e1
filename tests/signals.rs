//! Signals that go through the kernels of a frame's colour: against the f64 twins, sums of parts, bits, refusals.

mod common;

use common::case::small_hybrid;
use common::compare::{assert_same_bits, nmse};
use common::device::{assert_no_validation_messages, device};
use common::planes::{TestFrame, TestPlane};
use common::random::Random;
use vkdenoise::kernels::{Arithmetic, Storage};
use vkdenoise::net::{Graph, Head, Weights};
use vkdenoise::plan::{Plan, plan};
use vkdenoise::reference::Reference;
use vkdenoise::target::Target;
use vkdenoise::testing::{Bench, denoiser_with_kernels};
use vkdenoise::{
    Converged, ConvergedMode, Denoiser, Error, Extent, Fireflies, Frame, Layout, Options, Plane, PlaneMut, Precision,
    Region, Signal, SignalKind,
};

/// NMSE of a result against f64, in 32-bit floats and with maps of halves.
const LIMIT: f64 = 1e-9;
const HALF_LIMIT: f64 = 1e-5;
/// How far a sum of denoised parts may be from the denoised colour, of it.
const SUM_LIMIT: f32 = 1e-5;

fn options() -> Options {
    Options { signals: true, ..Options::default() }
}

/// Samples of a signal.
#[derive(Clone)]
struct Given {
    kind: SignalKind,
    channels: usize,
    samples: Vec<f32>,
}

/// The denoised colour and signals.
fn denoise(denoiser: &mut Denoiser, frame: &Frame, signals: &[Given]) -> (Vec<f32>, Vec<Vec<f32>>) {
    let extent = frame.extent;
    let pixels = extent.pixels() as usize;
    let mut color = vec![-1.0; 3 * pixels];
    let mut outputs: Vec<Vec<f32>> = signals.iter().map(|signal| vec![-1.0; signal.channels * pixels]).collect();
    let mut given: Vec<Signal> = signals
        .iter()
        .zip(&mut outputs)
        .map(|(signal, output)| {
            let layout = Layout::interleaved(extent, signal.channels);
            Signal {
                kind: signal.kind,
                channels: signal.channels as u32,
                plane: Plane::f32(&signal.samples, layout),
                output: PlaneMut::f32(output, layout),
            }
        })
        .collect();
    let target = PlaneMut::f32(&mut color, Layout::interleaved(extent, 3));
    denoiser.denoise_with(frame, target, &mut given, None).unwrap();
    (color, outputs)
}

/// Parts of a colour, three of them, whose sum is the colour but for rounding; some have negative samples.
fn parts(color: &[f32], seed: u64) -> Vec<Given> {
    let mut random = Random::new(seed);
    let shares: Vec<[f32; 3]> = color
        .iter()
        .map(|_| {
            let (a, b) = (random.uniform(-0.1, 1.0), random.uniform(0.0, 1.0));
            let a = if random.integer(0, 3) == 0 { 0.0 } else { a };
            [a, (1.0 - a) * b, 1.0 - a - (1.0 - a) * b]
        })
        .collect();
    let part = |which: usize| color.iter().zip(&shares).map(|(color, shares)| color * shares[which]).collect();
    (0..3).map(|which| Given { kind: SignalKind::Light, channels: 3, samples: part(which) }).collect()
}

/// What the sum of parts is off by at most, of the colour, where the caller's own parts add up to its colour.
fn worst_sum(color: &[f32], outputs: &[Vec<f32>]) -> f32 {
    let off = |i: usize| {
        let parts: Vec<f64> = outputs.iter().map(|part| f64::from(part[i])).collect();
        // Of parts that cancel out, the rounding is that of the largest.
        let size = parts.iter().map(|part| part.abs()).fold(f64::from(color[i].abs()), f64::max);
        if size == 0.0 { 0.0 } else { ((parts.iter().sum::<f64>() - f64::from(color[i])).abs() / size) as f32 }
    };
    (0..color.len()).map(off).fold(0.0, |worst, off| if off > worst || off.is_nan() { off } else { worst })
}

/// A clean frame and a noisy one, with what is bright, lone, negative or beyond the network's range among it.
fn difficult(extent: Extent, noise: f32, seed: u64) -> TestFrame {
    let mut random = Random::new(seed);
    let mut frame = TestFrame::random(extent, seed);
    let width = extent.width as usize;
    let pixels = extent.pixels() as usize;
    let mut color: Vec<f32> = (0..3 * pixels)
        .map(|i| 0.4 + 0.2 * ((i / 3 % width) as f32 * 0.1).sin() + noise * random.uniform(-0.3, 0.3))
        .collect();
    let mut set = |x: usize, y: usize, rgb: [f32; 3]| {
        if x < width && y * width + x < pixels {
            color[3 * (y * width + x)..][..3].copy_from_slice(&rgb);
        }
    };
    // Fireflies, one beside a sun; a sun beyond the range; a broken number; negative channels; black.
    for (x, y) in [(5, 5), (20, 9), (40, 30), (41, 13)] {
        set(x, y, [3000.0, 20.0, 0.0]);
    }
    (0..25).for_each(|i| set(44 + i % 5, 10 + i / 5, [9000.0, 12000.0, 7e6]));
    set(30, 20, [1e14, 1e14, 0.0]);
    (0..30).for_each(|i| set(10 + i % 6, 20 + i / 6, [-0.05, 0.1, 0.9]));
    (0..64).for_each(|i| set(i % 8, 32 + i / 8, [0.0; 3]));
    frame.color = TestPlane::packed(extent, 3, color);
    frame
}

fn samples(plane: &TestPlane) -> Vec<f32> {
    let common::planes::Samples::F32(samples) = &plane.samples else { panic!("halves") };
    samples.clone()
}

fn plan_of(weights: &Weights, extent: Extent, target: &Target) -> Plan {
    plan(&Graph::new(weights.arch()).unwrap(), extent, target).unwrap()
}

/// Every kind of signal, from planes to planes, with samples that are not finite.
#[test]
fn signals_are_the_reference() {
    let weights = small_hybrid(Head::gloss());
    for (precision, cpu) in [(Precision::F32, true), (Precision::F16, true), (Precision::F16, false)] {
        if precision == Precision::F16 && !Bench::can_store_halves(device())
            || cpu && !Bench::can_run_cpu_kernels(device())
        {
            println!("not tested: {precision}, kernels for CPU drivers: {cpu}");
            continue;
        }
        for (extent, blend) in [((1, 1), 0.0), ((70, 45), 0.25)] {
            let extent = Extent::new(extent.0, extent.1);
            let options = Options { precision, blend, ..options() };
            let mut denoiser = denoiser_with_kernels(device(), &weights, &options, cpu).unwrap();
            let frame = difficult(extent, 0.1, 9);
            let mut given = parts(&samples(&frame.color), 3);
            let mut random = Random::new(8);
            let pixels = extent.pixels() as usize;
            given.push(Given { kind: SignalKind::Value, channels: 3, samples: random.values(3 * pixels, -5.0, 5.0) });
            given.push(Given { kind: SignalKind::Value, channels: 1, samples: random.values(pixels, -5.0, 5.0) });
            given.push(Given { kind: SignalKind::Alpha, channels: 1, samples: random.values(pixels, -0.2, 1.2) });
            let mut color = samples(&frame.color);
            if pixels > 1 {
                for signal in &mut given {
                    let len = signal.samples.len();
                    for at in [7, 100, 101, 102] {
                        signal.samples[at % len] = f32::NAN;
                    }
                    signal.samples[900] = f32::INFINITY;
                }
                // A lamp of +Inf of which one part is, one pixel of +Inf, and one of NaN.
                for at in (600..609).chain(810..819) {
                    (color[at], given[0].samples[at]) = (f32::INFINITY, f32::INFINITY);
                }
                (color[300], given[1].samples[300]) = (f32::INFINITY, f32::INFINITY);
                color[450] = f32::NAN;
            }
            let frame = TestFrame { color: TestPlane::packed(extent, 3, color), ..frame };
            let (_, found) = denoise(&mut denoiser, &frame.frame(), &given);
            let pass = denoiser.pass(extent).unwrap();
            let mut reference = Reference::new(pass.plan(), &weights).unwrap();
            for (i, (signal, found)) in given.iter().zip(&found).enumerate() {
                let plane = Plane::f32(&signal.samples, Layout::interleaved(extent, signal.channels));
                reference.set_signal(signal.kind, signal.channels as u32, &plane).unwrap();
                reference.set_frame(&frame.frame(), None, f64::from(blend)).unwrap();
                reference.run();
                // By the logarithm: a sun must not hide the rest.
                let log = |value: f64| value.signum() * value.abs().ln_1p();
                let expected: Vec<f64> = reference.signal().iter().map(|&value| log(value)).collect();
                let found: Vec<f32> = found.iter().map(|&value| log(f64::from(value)) as f32).collect();
                let error = nmse(&found, &expected);
                println!("{precision}, {extent:?}, signal {i} ({:?}): NMSE {error:.1e}", signal.kind);
                let limit = if precision == Precision::F32 { LIMIT } else { HALF_LIMIT };
                assert!(error <= limit, "{precision}, {extent:?}, signal {i} ({:?}): NMSE {error:.1e}", signal.kind);
            }
        }
    }
    assert_no_validation_messages();
}

/// The parts of a colour still add up to it: mended, kept, beyond the range, negative, blended, in every tier and
/// where what has converged is left out.
#[test]
fn sums_of_parts_hold() {
    let extent = Extent::new(70, 45);
    let shipped = Weights::hybrid_kernels().unwrap();
    let every = [Fireflies::Auto, Fireflies::Keep, Fireflies::Mend];
    let cases = [
        ("32-bit floats", &every[..], options()),
        ("blended", &every[..1], Options { blend: 0.4, ..options() }),
        ("maps of halves", &every[..1], Options { precision: Precision::F16, ..options() }),
        (
            "converged",
            &every[..1],
            Options { converged: Some(Converged { threshold: 0.02, mode: ConvergedMode::default() }), ..options() },
        ),
    ];
    for (name, fireflies, options) in cases {
        if options.precision == Precision::F16 && !Bench::can_store_halves(device()) {
            continue;
        }
        let mut denoiser = Denoiser::new(device(), &shipped, &options).unwrap();
        for (fireflies, noise) in fireflies.iter().flat_map(|fireflies| [0.02, 1.0].map(|noise| (*fireflies, noise))) {
            denoiser.set_fireflies(fireflies);
            let name = format!("{name}, {fireflies:?}");
            let frame = difficult(extent, noise, 21);
            let mut color = samples(&frame.color);
            if options.converged.is_some() {
                // A pixel that is left alone is what it was in every part; a negative one is 0 in the colour alone.
                color.iter_mut().for_each(|sample| *sample = sample.max(0.0));
            }
            let given = parts(&color, 5);
            let frame = TestFrame { color: TestPlane::packed(extent, 3, color.clone()), ..frame };
            let before: Vec<Vec<f32>> = given.iter().map(|part| part.samples.clone()).collect();
            let (denoised, outputs) = denoise(&mut denoiser, &frame.frame(), &given);
            let (worst, own) = (worst_sum(&denoised, &outputs), worst_sum(&color, &before));
            println!("{name}, noise {noise}: the sum is off by {worst:.1e} (the noisy one by {own:.1e})");
            assert!(worst <= SUM_LIMIT, "{name}, noise {noise}: {worst:.1e}");
            let changed = outputs.iter().zip(&before).any(|(after, before)| after != before);
            assert!(changed, "{name}: nothing was denoised");
            // A part that is the colour is the colour.
            let whole = [Given { kind: SignalKind::Light, channels: 3, samples: color }];
            let (denoised, same) = denoise(&mut denoiser, &frame.frame(), &whole);
            let worst = worst_sum(&denoised, &same);
            assert!(worst <= SUM_LIMIT, "{name}, noise {noise}: all of it is off by {worst:.1e}");
        }
    }
    assert_no_validation_messages();
}

/// Where the albedo would make more of a constant than it is, its result is cut, and so are its parts.
#[test]
fn what_is_cut_of_the_colour_is_cut_of_its_parts() {
    let extent = Extent::new(70, 45);
    let color = vec![0.8; 3 * extent.pixels() as usize];
    let given = parts(&color, 12);
    let frame = TestFrame { color: TestPlane::packed(extent, 3, color.clone()), ..TestFrame::random(extent, 5) };
    let mut denoiser = Denoiser::new(device(), &small_hybrid(Head::pure()), &options()).unwrap();
    let (denoised, outputs) = denoise(&mut denoiser, &frame.frame(), &given);
    let cut = denoised.iter().filter(|value| **value == 0.8).count();
    let worst = worst_sum(&denoised, &outputs);
    println!("{cut} of {} samples are cut; the sum is off by {worst:.1e}", color.len());
    assert!(cut > color.len() / 20 && cut < color.len() && worst <= SUM_LIMIT, "{cut}, {worst:.1e}");
    assert_no_validation_messages();
}

/// The colour is the same with signals as without, and a signal whatever comes with it, and in a region.
#[test]
fn bits_depend_on_nothing_else() {
    let extent = Extent::new(150, 90);
    let weights = small_hybrid(Head::gloss());
    let frame = difficult(extent, 0.5, 2);
    let mut given = parts(&samples(&frame.color), 7);
    let pixels = extent.pixels() as usize;
    let alpha = Random::new(4).values(pixels, 0.0, 1.0);
    given.push(Given { kind: SignalKind::Alpha, channels: 1, samples: alpha });
    let mut plain = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    let (alone, _) = denoise(&mut plain, &frame.frame(), &[]);
    let mut signals: Vec<Vec<Vec<f32>>> = Vec::new();
    for options in [options(), Options { max_chain_bytes: Some(1 << 18), ..options() }] {
        let mut denoiser = Denoiser::new(device(), &weights, &options).unwrap();
        let (color, outputs) = denoise(&mut denoiser, &frame.frame(), &given);
        for (one, other) in signals.iter().flatten().zip(&outputs) {
            assert_same_bits(other, one, "a signal in bands");
        }
        signals.push(outputs.clone());
        assert_same_bits(&color, &alone, "the colour beside signals");
        assert_same_bits(&denoise(&mut denoiser, &frame.frame(), &[]).0, &alone, "the colour without signals");
        let reversed: Vec<Given> = given.iter().rev().cloned().collect();
        let (_, again) = denoise(&mut denoiser, &frame.frame(), &reversed);
        for (one, other) in outputs.iter().zip(again.iter().rev()) {
            assert_same_bits(other, one, "in another order");
        }
        assert_same_bits(&denoise(&mut denoiser, &frame.frame(), &given[1..2]).1[0], &outputs[1], "alone");

        let other = difficult(extent, 1.0, 77);
        for region in [Region { x: 40, y: 8, width: 30, height: 17 }, Region { x: 149, y: 0, width: 1, height: 90 }] {
            denoiser.set_region(None);
            denoise(&mut denoiser, &other.frame(), &parts(&samples(&other.color), 9));
            denoiser.set_region(Some(region));
            let (_, parts) = denoise(&mut denoiser, &frame.frame(), &given);
            for (signal, (part, whole)) in given.iter().zip(parts.iter().zip(&outputs)) {
                for (i, (part, whole)) in part.iter().zip(whole).enumerate() {
                    let pixel = (i / signal.channels) as u32;
                    let inside = region.contains(pixel % extent.width, pixel / extent.width);
                    let expected = if inside { *whole } else { -1.0 };
                    assert_eq!(part.to_bits(), expected.to_bits(), "{region:?}: sample {i} of {:?}", signal.kind);
                }
            }
        }
    }
    assert_no_validation_messages();
}

/// Averages: a constant stays, what is in a range stays in it, zero is zero.
#[test]
fn signals_are_averaged() {
    let extent = Extent::new(100, 60);
    let pixels = extent.pixels() as usize;
    let frame = difficult(extent, 1.0, 6);
    let mut random = Random::new(2);
    let cover: Vec<f32> = (0..pixels).map(|_| f32::from(u8::from(random.coin()))).collect();
    let given = [
        Given { kind: SignalKind::Value, channels: 3, samples: vec![-2.5; 3 * pixels] },
        Given { kind: SignalKind::Alpha, channels: 1, samples: vec![1.0; pixels] },
        Given { kind: SignalKind::Alpha, channels: 1, samples: cover },
        Given { kind: SignalKind::Light, channels: 3, samples: vec![0.0; 3 * pixels] },
    ];
    let mut denoiser = Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), &options()).unwrap();
    let (_, outputs) = denoise(&mut denoiser, &frame.frame(), &given);
    assert!(outputs[0].iter().all(|value| (value / -2.5 - 1.0).abs() <= 1e-5));
    assert!(outputs[1].iter().all(|value| (value - 1.0).abs() <= 1e-5 && *value <= 1.0));
    assert!(outputs[2].iter().all(|value| (0.0..=1.0).contains(value)));
    let spread = |values: &[f32]| values.iter().map(|value| (value - 0.5).powi(2)).sum::<f32>() / pixels as f32;
    assert!(spread(&outputs[2]) < 0.1, "coverage of one sample is as noisy as before: {}", spread(&outputs[2]));
    assert!(outputs[3].iter().all(|value| *value == 0.0));
    assert_no_validation_messages();
}

/// All signals share the pass's memory: so much of a pixel, however many they are. Beside them a large frame's head
/// does not run in bands to the picture, as it does in halves without them.
#[test]
fn memory_is_that_of_one_signal() {
    let weights = Weights::hybrid_kernels().unwrap();
    // Bytes of a pixel with signals: in 32-bit floats no more than without, as their maps lie where the network's did.
    let kinds = [
        (Extent::new(1024, 1024), Target::default(), 615.0),
        (Extent::new(3840, 2160), Target::default(), 420.0),
        (Extent::new(3840, 2160), Target::for_gpu(Storage::F16, Arithmetic::Floats), 262.0),
        (Extent::new(3840, 2160), Target::for_gpu(Storage::F16, Arithmetic::Matrices), 262.0),
    ];
    for (extent, target, most) in kinds {
        let of = |signals| plan_of(&weights, extent, &Target { signals, ..target });
        let (with, without) = (of(true), of(false));
        let per_pixel = |bytes: u64| bytes as f64 / extent.pixels() as f64;
        let (all, more) = (per_pixel(with.bytes()), per_pixel(with.bytes() - without.bytes()));
        let own: u64 = with.buffers.iter().filter(|buffer| buffer.name.starts_with("signal.")).map(|b| b.bytes).sum();
        println!(
            "{extent:?}, {:?}, {:?}: {more:.0} bytes a pixel more in all, of {:.0}; maps of a signal: {:.0}",
            target.storage,
            target.arithmetic,
            per_pixel(without.bytes()),
            per_pixel(own)
        );
        assert!(all <= most, "{all:.0} bytes a pixel");
        assert!(without.dispatches.iter().all(|dispatch| !dispatch.of_signals));
        assert!(with.dispatches.iter().any(|dispatch| dispatch.of_signals));
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let extent = Extent::new(20, 10);
    let pixels = extent.pixels() as usize;
    let refused = |weights: &Weights| match Denoiser::new(device(), weights, &options()) {
        Err(Error::InvalidOption { option: "signals", reason }) => reason,
        other => panic!("{other:?}"),
    };
    let residual = refused(&common::trained::residual_hybrid());
    assert!(residual.contains("predicts no kernels") && residual.contains("the network that ships"), "{residual}");
    assert!(refused(&small_hybrid(Head::gated())).contains("residual"));

    let frame = TestFrame::random(extent, 1);
    let try_with = |denoiser: &mut Denoiser, kind, channels: usize, len: usize| {
        let mut color = vec![-1.0f32; 3 * pixels];
        let (samples, mut output) = (vec![0.5f32; len], vec![-1.0f32; len]);
        let layout = Layout::interleaved(extent, channels);
        let signal = Signal {
            kind,
            channels: channels as u32,
            plane: Plane::f32(&samples, layout),
            output: PlaneMut::f32(&mut output, layout),
        };
        let target = PlaneMut::f32(&mut color, Layout::interleaved(extent, 3));
        let result = denoiser.denoise_with(&frame.frame(), target, &mut [signal], None);
        let untouched = color.iter().chain(&output).all(|value| *value == -1.0);
        assert_eq!(result.is_err(), untouched);
        result.map(|_| ())
    };
    let weights = small_hybrid(Head::pure());
    let mut denoiser = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    let result = try_with(&mut denoiser, SignalKind::Light, 3, 3 * pixels);
    assert!(matches!(result, Err(Error::InvalidOption { option: "signals", .. })), "{result:?}");
    let mut denoiser = Denoiser::new(device(), &weights, &options()).unwrap();
    for (kind, channels) in
        [(SignalKind::Light, 1), (SignalKind::Value, 2), (SignalKind::Value, 4), (SignalKind::Alpha, 3)]
    {
        let result = try_with(&mut denoiser, kind, channels, channels * pixels);
        assert!(
            matches!(result, Err(Error::InvalidOption { option: "signal", .. })),
            "{kind:?}, {channels}: {result:?}"
        );
    }
    let result = try_with(&mut denoiser, SignalKind::Light, 3, 3 * pixels - 1);
    assert!(matches!(result, Err(Error::PlaneMismatch { plane: "signal", .. })), "{result:?}");
    try_with(&mut denoiser, SignalKind::Light, 3, 3 * pixels).unwrap();
}

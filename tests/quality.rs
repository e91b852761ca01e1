//! Qualities: what each takes, and the fastest, in halves and with converged squares left out, in every way that a
//! frame can be asked for.

mod common;

use common::compare::assert_same_bits;
use common::device::{assert_no_validation_messages, device};
use common::random::Random;
use std::ops::ControlFlow;
use std::sync::{LazyLock, Mutex, MutexGuard, PoisonError};
use vkdenoise::testing::{Bench, cut_into_tiles};
use vkdenoise::{
    Denoiser, DeviceKind, Error, Extent, Features, Frame, Layout, Noise, NoiseKind, Options, Plane, PlaneMut,
    Precision, Progress, Quality, Region, Signal, SignalKind, Weights,
};

const EXTENT: Extent = Extent::new(640, 100);
const PIXELS: usize = EXTENT.pixels() as usize;
const UNTOUCHED: f32 = -7.0;
/// Columns that are to be denoised: squares of 16 pixels.
const NOISY: usize = 320;
/// Beside them pixels of both are blended.
const BLEND: usize = 8;

/// What the fastest quality is on the device, with all else that a denoiser can be made for.
fn fast(keep_features: bool) -> Options {
    let (precision, converged) = (Quality::Fast.precision(device()), Quality::Fast.converged());
    Options { precision, converged, keep_features, signals: true, ..Options::default() }
}

fn denoiser(options: &Options) -> Denoiser {
    Denoiser::new(device(), &Quality::Fast.weights().unwrap(), options).unwrap()
}

/// The one that most tests share, as a CPU driver compiles for each.
fn shared() -> MutexGuard<'static, Denoiser> {
    static SHARED: LazyLock<Mutex<Denoiser>> = LazyLock::new(|| Mutex::new(denoiser(&fast(false))));
    SHARED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A frame of noise, two parts of its light and sample counts that call its right half converged.
struct Scene {
    color: Vec<f32>,
    parts: [Vec<f32>; 2],
    albedo: Vec<f32>,
    depth: Vec<f32>,
    samples: Vec<f32>,
}

impl Scene {
    fn new(seed: u64, noisy: usize) -> Self {
        let mut random = Random::new(seed);
        let color = random.values(3 * PIXELS, 0.0, 2.0);
        let first: Vec<f32> = color.iter().map(|value| value * random.uniform(0.0, 1.0)).collect();
        let second = color.iter().zip(&first).map(|(all, first)| all - first).collect();
        let count = |i: usize| if i % (EXTENT.width as usize) < noisy { 4.0 } else { 4096.0 };
        Self {
            parts: [first, second],
            albedo: random.values(3 * PIXELS, 0.1, 1.0),
            depth: random.values(PIXELS, 1.0, 9.0),
            samples: (0..PIXELS).map(count).collect(),
            color,
        }
    }

    fn frame(&self, with_features: bool) -> Frame<'_> {
        let (rgb, one) = (Layout::interleaved(EXTENT, 3), Layout::interleaved(EXTENT, 1));
        let noise = Some(Noise { plane: Plane::f32(&self.samples, one), kind: NoiseKind::Samples });
        let (albedo, depth) = (Some(Plane::f32(&self.albedo, rgb)), Some(Plane::f32(&self.depth, one)));
        let bare = Features { noise, ..Features::default() };
        let features = if with_features { Features { albedo, depth, ..bare } } else { bare };
        Frame { extent: EXTENT, color: Plane::f32(&self.color, rgb), features }
    }

    /// The colour and its parts, denoised; the call's end.
    fn denoise_with(
        &self,
        denoiser: &mut Denoiser,
        with_features: bool,
        progress: Option<&mut Progress>,
    ) -> ([Vec<f32>; 3], Result<(), Error>) {
        let rgb = Layout::interleaved(EXTENT, 3);
        let mut outputs = [0; 3].map(|_| vec![UNTOUCHED; 3 * PIXELS]);
        let [color, first, second] = &mut outputs;
        let mut signals = [(&self.parts[0], first), (&self.parts[1], second)].map(|(samples, output)| Signal {
            kind: SignalKind::Light,
            channels: 3,
            plane: Plane::f32(samples, rgb),
            output: PlaneMut::f32(output, rgb),
        });
        let frame = self.frame(with_features);
        let result = denoiser.denoise_with(&frame, PlaneMut::f32(color, rgb), &mut signals, progress);
        (outputs, result.map(|_| ()))
    }

    fn denoise(&self, denoiser: &mut Denoiser, with_features: bool) -> [Vec<f32>; 3] {
        let (outputs, result) = self.denoise_with(denoiser, with_features, None);
        result.unwrap();
        outputs
    }

    /// What is converged keeps its bits, the rest is denoised, and so are the parts, which add up; nothing outside of
    /// the region is written.
    fn check(&self, [color, first, second]: &[Vec<f32>; 3], region: Region, what: &str) {
        let (mut before, mut after) = (0.0, 0.0);
        for i in 0..3 * PIXELS {
            let (x, y) = (i / 3 % EXTENT.width as usize, i / 3 / EXTENT.width as usize);
            let values = [color[i], first[i], second[i]];
            let at = format!("{what}: ({x}, {y}) is {values:?}");
            if !region.contains(x as u32, y as u32) {
                assert_eq!(values, [UNTOUCHED; 3], "{at}");
                continue;
            }
            assert!(values.iter().all(|value| value.is_finite() && *value >= 0.0), "{at}");
            let most = values.into_iter().fold(0.0, f32::max);
            assert!((first[i] + second[i] - color[i]).abs() <= 1e-5 * most + f32::MIN_POSITIVE, "{at}");
            if x >= NOISY + BLEND {
                assert_eq!(values, [self.color[i], self.parts[0][i], self.parts[1][i]], "{at}");
            } else if x < NOISY {
                before += (self.color[i] - 1.0).powi(2);
                after += (color[i] - 1.0).powi(2);
            }
        }
        assert!(after < 0.5 * before, "{what}: the noise was {before}, and is {after}");
    }
}

const ALL: Region = Region { x: 0, y: 0, width: EXTENT.width, height: EXTENT.height };

#[test]
fn what_each_quality_is() {
    for quality in Quality::ALL {
        assert_eq!(quality.weights().unwrap(), Weights::hybrid_kernels().unwrap(), "{quality}");
        let is_fast = quality == Quality::Fast;
        assert_eq!(quality.converged().map(|converged| converged.threshold), is_fast.then_some(0.02), "{quality}");
        let halves = is_fast && device().info().kind == DeviceKind::Cpu && Bench::can_store_halves(device());
        assert_eq!(quality.precision(device()), if halves { Precision::F16 } else { Precision::Auto }, "{quality}");
        assert_eq!(quality.self_ensemble(), quality == Quality::High);
        assert_eq!(quality.to_string().parse::<Quality>().unwrap(), quality);
    }
    assert_eq!(Quality::default(), Quality::Balanced);
}

/// With nothing converged it has the bits of the same halves without the choice.
#[test]
fn nothing_converged_changes_nothing() {
    let scene = Scene::new(1, EXTENT.width as usize);
    let found = scene.denoise(&mut shared(), true);
    let whole = scene.denoise(&mut denoiser(&Options { converged: None, ..fast(false) }), true);
    for (found, whole) in found.iter().zip(&whole) {
        assert_same_bits(found, whole, "nothing converged");
    }
    assert_no_validation_messages();
}

#[test]
fn halves_of_frames_with_all_that_goes_with_them() {
    let mut fast = shared();
    let (scene, other) = (Scene::new(2, NOISY), Scene::new(3, EXTENT.width as usize));
    for with_features in [true, false] {
        let what = if with_features { "with features" } else { "without" };
        let found = scene.denoise(&mut fast, with_features);
        scene.check(&found, ALL, what);
        let active = fast.active_tiles().unwrap();
        assert!((active.denoised(EXTENT) - 0.5).abs() < 1e-9, "{what}: {}", active.denoised(EXTENT));
        // Another frame, all of it noisy, leaves other things in the arena.
        other.denoise(&mut fast, true);
        for (again, found) in scene.denoise(&mut fast, with_features).iter().zip(&found) {
            assert_same_bits(again, found, what);
        }
    }
    let region = Region { x: 200, y: 30, width: 280, height: 50 };
    fast.set_region(Some(region));
    scene.check(&scene.denoise(&mut fast, true), region, "a region");
    fast.set_region(None);
    assert_no_validation_messages();
}

#[test]
fn watched_and_cancelled() {
    let mut fast = shared();
    let scene = Scene::new(4, NOISY);
    let expected = scene.denoise(&mut fast, true);
    let mut told = Vec::new();
    let mut watch = |done: f32| {
        told.push(done);
        ControlFlow::Continue(())
    };
    let (watched, result) = scene.denoise_with(&mut fast, true, Some(&mut watch));
    result.unwrap();
    assert!(told.len() > 2 && told[0] == 0.0 && told[told.len() - 1] == 1.0, "{told:?}");
    for (watched, expected) in watched.iter().zip(&expected) {
        assert_same_bits(watched, expected, "watched");
    }
    let mut stop = |done: f32| if done > 0.5 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) };
    let (outputs, result) = scene.denoise_with(&mut fast, true, Some(&mut stop));
    assert!(matches!(result, Err(Error::Cancelled)), "{result:?}");
    assert!(outputs.iter().flatten().all(|&value| value == UNTOUCHED));
    for (after, expected) in scene.denoise(&mut fast, true).iter().zip(&expected) {
        assert_same_bits(after, expected, "after a cancelled one");
    }
    assert_no_validation_messages();
}

#[test]
fn features_that_are_kept() {
    let mut keeping = denoiser(&fast(true));
    let (scene, other) = (Scene::new(5, NOISY), Scene::new(6, EXTENT.width as usize));
    let first = scene.denoise(&mut keeping, true);
    scene.check(&first, ALL, "features given");
    keeping.set_features_unchanged(true);
    // Of another frame nothing but the features of the first is kept.
    other.denoise(&mut keeping, true);
    for (kept, first) in scene.denoise(&mut keeping, true).iter().zip(&first) {
        assert_same_bits(kept, first, "features kept");
    }
    assert_no_validation_messages();
}

/// A frame in tiles is denoised everywhere, and takes no signals.
#[test]
fn frames_in_tiles() {
    let mut tiled = denoiser(&fast(false));
    cut_into_tiles(&mut tiled, EXTENT, [384, 128], 128).unwrap();
    let scene = Scene::new(7, NOISY);
    let (outputs, refused) = scene.denoise_with(&mut tiled, true, None);
    assert!(matches!(refused, Err(Error::InvalidOption { option: "signals", .. })), "{refused:?}");
    assert!(outputs.iter().flatten().all(|&value| value == UNTOUCHED));
    let rgb = Layout::interleaved(EXTENT, 3);
    let run = |denoiser: &mut Denoiser, samples: &Scene| {
        let mut output = vec![UNTOUCHED; 3 * PIXELS];
        let report = denoiser.denoise(&samples.frame(true), PlaneMut::f32(&mut output, rgb)).unwrap();
        (report, output)
    };
    let (report, found) = run(&mut tiled, &scene);
    assert_eq!(report.tiles.map(|tiles| tiles.count), Some(3));
    let everywhere = Scene { samples: vec![4.0; PIXELS], ..scene };
    let (whole, expected) = run(&mut shared(), &everywhere);
    let log = |value: f32| (value * whole.exposure).ln_1p();
    let apart = found.iter().zip(&expected).map(|(a, b)| (log(*a) - log(*b)).abs()).fold(0.0, f32::max);
    println!("at most {apart:e} apart");
    assert!(apart < 0.1, "{apart}");
    assert_no_validation_messages();
}

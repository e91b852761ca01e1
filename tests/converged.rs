//! Converged tiles: the caller's pixels where nothing needs denoising, the whole frame's pass elsewhere.

mod common;

use common::case::small_net;
use common::compare::assert_same_bits;
use common::device::{assert_no_validation_messages, device};
use common::random::Random;
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::metrics::Comparison;
use vkdenoise::net::Block;
use vkdenoise::options::{ConvAlgorithm, SeparableForm};
use vkdenoise::testing::{Bench, overwrite_memory};
use vkdenoise::{
    Converged, ConvergedMode, Denoiser, Error, Extent, Features, Frame, Layout, Noise, NoiseKind, Options, Plane,
    PlaneMut, Precision, Region, Weights,
};

/// Of 16x14 squares, the last ones cut.
const EXTENT: Extent = Extent::new(250, 211);
const SQUARE: u32 = 16;
const BLEND: f32 = 8.0;

/// A frame of noise with sample counts that say where it is converged.
struct Scene {
    extent: Extent,
    color: Vec<f32>,
    albedo: Vec<f32>,
    depth: Vec<f32>,
    samples: Vec<f32>,
    /// The squares that are to be denoised.
    active: Vec<bool>,
}

impl Scene {
    /// The pixels are those of the seed, whatever is converged of them.
    fn new(extent: Extent, seed: u64, active: impl Fn(u32, u32) -> bool) -> Self {
        let mut random = Random::new(seed);
        let pixels = extent.pixels() as usize;
        let at = |i: usize| (i as u32 % extent.width / SQUARE, i as u32 / extent.width / SQUARE);
        let is_active = |(x, y): (u32, u32)| active(x, y);
        let columns = extent.width.div_ceil(SQUARE);
        Self {
            extent,
            color: random.values(3 * pixels, 0.0, 2.0),
            albedo: random.values(3 * pixels, 0.0, 1.0),
            depth: random.values(pixels, 1.0, 9.0),
            samples: (0..pixels).map(|i| if is_active(at(i)) { 4.0 } else { 4096.0 }).collect(),
            active: (0..columns * extent.height.div_ceil(SQUARE))
                .map(|i| is_active((i % columns, i / columns)))
                .collect(),
        }
    }

    fn frame(&self) -> Frame<'_> {
        let (rgb, one) = (Layout::interleaved(self.extent, 3), Layout::interleaved(self.extent, 1));
        let features = Features {
            albedo: Some(Plane::f32(&self.albedo, rgb)),
            depth: Some(Plane::f32(&self.depth, one)),
            noise: Some(Noise { plane: Plane::f32(&self.samples, one), kind: NoiseKind::Samples }),
            ..Features::default()
        };
        Frame { extent: self.extent, color: Plane::f32(&self.color, rgb), features }
    }

    fn is_active(&self, x: i64, y: i64) -> bool {
        let (columns, rows) = (self.extent.width.div_ceil(SQUARE), self.extent.height.div_ceil(SQUARE));
        let inside = x >= 0 && y >= 0 && x < i64::from(columns) && y < i64::from(rows);
        inside && self.active[y as usize * columns as usize + x as usize]
    }

    /// Pixels from one's middle to the nearest square that is denoised, if there is one within the blend.
    fn distance(&self, x: u32, y: u32) -> f32 {
        let (column, row) = (i64::from(x / SQUARE), i64::from(y / SQUARE));
        let beyond = |at: u32, square: i64| {
            let (at, low) = (at as f32 + 0.5, (square * i64::from(SQUARE)) as f32);
            (low - at).max(at - low - SQUARE as f32).max(0.0)
        };
        let near = (row - 1..row + 2).flat_map(|r| (column - 1..column + 2).map(move |c| (c, r)));
        let active = near.filter(|(c, r)| self.is_active(*c, *r));
        active.map(|(c, r)| beyond(x, c).hypot(beyond(y, r))).fold(BLEND, f32::min)
    }
}

fn denoise(denoiser: &mut Denoiser, frame: &Frame) -> Vec<f32> {
    let mut output = vec![f32::NAN; 3 * frame.extent.pixels() as usize];
    denoiser.denoise(frame, PlaneMut::f32(&mut output, Layout::interleaved(frame.extent, 3))).unwrap();
    output
}

fn converged(mode: ConvergedMode) -> Option<Converged> {
    Some(Converged { threshold: 0.02, mode })
}

/// A denoiser whose arena holds what must not be read.
fn soiled(weights: &Weights, options: &Options, extent: Extent) -> Denoiser {
    let mut denoiser = Denoiser::new(device(), weights, options).unwrap();
    overwrite_memory(&mut denoiser, extent).unwrap();
    denoiser
}

/// Compares a result with the whole frame's pass: equal bits where denoised, the input's far from that, a mixture
/// between.
fn assert_exact(scene: &Scene, found: &[f32], whole: &[f32]) {
    let mut counts = [0usize; 3];
    for (i, found) in found.iter().enumerate() {
        let (x, y) = (i as u32 / 3 % scene.extent.width, i as u32 / 3 / scene.extent.width);
        let distance = scene.distance(x, y);
        let share = distance / BLEND;
        let share = share * share * (3.0 - 2.0 * share);
        let own = scene.color[i];
        let (kind, expected, step) = match distance {
            0.0 => (0, whole[i], 0.0),
            BLEND => (2, own, 0.0),
            _ => (1, whole[i] * (1.0 - share) + own * share, 1e-5 * (whole[i] + own)),
        };
        counts[kind] += 1;
        assert!(
            found.to_bits() == expected.to_bits() || (found - expected).abs() <= step,
            "({x}, {y}): {found}, not {expected}; {distance} from what is denoised"
        );
    }
    println!("{counts:?} samples denoised, blended, kept");
}

/// Whether a square is to be denoised.
type Pattern = fn(u32, u32) -> bool;

/// Patterns of squares to denoise: one, a diagonal, everything but one, none, all.
fn patterns() -> Vec<(&'static str, Pattern)> {
    vec![
        ("one", |x, y| (x, y) == (7, 5)),
        ("corners", |x, y| (x, y) == (0, 0) || (x, y) == (15, 13)),
        ("some", |x, y| x * 7 % 13 == y * 5 % 11),
        ("all but one", |x, y| (x, y) != (4, 9)),
        ("half", |_, y| y < 7),
        ("none", |_, _| false),
        ("all", |_, _| true),
    ]
}

fn check_exact(weights: &Weights, options: Options, extent: Extent) {
    let mut whole = Denoiser::new(device(), weights, &options).unwrap();
    let mut denoiser = soiled(weights, &Options { converged: converged(ConvergedMode::Exact), ..options }, extent);
    let expected = denoise(&mut whole, &Scene::new(extent, 1, |_, _| true).frame());
    for (name, pattern) in patterns() {
        println!("{name}");
        let scene = Scene::new(extent, 1, pattern);
        // The pattern before left what is right in this one too.
        overwrite_memory(&mut denoiser, extent).unwrap();
        let found = denoise(&mut denoiser, &scene.frame());
        assert_exact(&scene, &found, &expected);
    }
    assert_no_validation_messages();
}

#[test]
fn exact_tiles_have_the_bits_of_the_whole() {
    check_exact(&Weights::hybrid_kernels().unwrap(), Options::default(), EXTENT);
}

/// Winograd's results depend on where its tiles begin; fused kernels read around.
#[test]
fn exact_tiles_by_winograd_have_the_bits_of_the_whole() {
    for tile in [WinogradTile::F2, WinogradTile::F4] {
        let conv = Some(ConvAlgorithm::Winograd(tile));
        let options = Options { conv, separable: Some(SeparableForm::Fused), ..Options::default() };
        check_exact(&small_net(16, Block::ShJsa { ratio: 0.5 }), options, Extent::new(256, 224));
    }
}

/// Halves, and kernels on matrices: other numbers of tiles in a workgroup.
#[test]
fn exact_tiles_of_other_forms_have_the_bits_of_the_whole() {
    let weights = small_net(32, Block::ShJsa { ratio: 0.5 });
    for precision in [Precision::F16, Precision::Matrix] {
        let can = match precision {
            Precision::Matrix => device().has_matrices(),
            _ => Bench::can_store_halves(device()),
        };
        if can {
            check_exact(&weights, Options { precision, ..Options::default() }, EXTENT);
        } else {
            println!("not tested: the device cannot do {precision}");
        }
    }
}

/// On a long frame every part of the network leaves tiles out, with the bits of the whole where it does not.
#[test]
fn exact_tiles_of_a_long_frame_leave_out_of_every_part() {
    let weights = Weights::hybrid_kernels().unwrap();
    for extent in [Extent::new(2560, 128), Extent::new(128, 2560)] {
        let mut whole = Denoiser::new(device(), &weights, &Options::default()).unwrap();
        let options = Options { converged: converged(ConvergedMode::Exact), ..Options::default() };
        let mut denoiser = soiled(&weights, &options, extent);
        let scene = Scene::new(extent, 5, |x, y| x.max(y) == 70 || x.max(y) == 74);
        let expected = denoise(&mut whole, &scene.frame());
        let found = denoise(&mut denoiser, &scene.frame());
        assert_exact(&scene, &found, &expected);
        let active = denoiser.active_tiles().unwrap();
        for (part, count) in &active.parts {
            assert!(*count > 0 && *count < part.tiles, "{part:?}: {count}");
        }
    }
    assert_no_validation_messages();
}

/// What a mode promises whatever is converged: the caller's bits far from what is denoised, and the same bits whatever
/// ran before.
fn check_promises(denoiser: &mut Denoiser, scene: &Scene) -> Vec<f32> {
    let found = denoise(denoiser, &scene.frame());
    for (i, found) in found.iter().enumerate() {
        let (x, y) = (i as u32 / 3 % scene.extent.width, i as u32 / 3 / scene.extent.width);
        assert!(found.is_finite() && *found >= 0.0, "({x}, {y}) is {found}");
        if scene.distance(x, y) == BLEND {
            assert_eq!(found.to_bits(), scene.color[i].to_bits(), "({x}, {y})");
        }
    }
    overwrite_memory(denoiser, scene.extent).unwrap();
    let again = denoise(denoiser, &scene.frame());
    assert_same_bits(&again, &found, "with other things in the arena");
    found
}

#[test]
fn approximate_tiles_are_close_to_the_whole() {
    let (weights, extent) = (Weights::hybrid_kernels().unwrap(), EXTENT);
    let mut whole = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    let options = Options { converged: converged(ConvergedMode::default()), ..Options::default() };
    let mut denoiser = soiled(&weights, &options, extent);
    let expected = denoise(&mut whole, &Scene::new(extent, 1, |_, _| true).frame());
    for (name, pattern) in patterns() {
        let scene = Scene::new(extent, 1, pattern);
        let found = check_promises(&mut denoiser, &scene);
        let is_denoised = |i: &usize| {
            let pixel = *i as u32 / 3;
            scene.distance(pixel % extent.width, pixel / extent.width) == 0.0
        };
        let (own, full): (Vec<f32>, Vec<f32>) =
            (0..found.len()).filter(is_denoised).map(|i| (found[i], expected[i])).unzip();
        if name == "all" {
            assert_same_bits(&found, &expected, "nothing to leave out");
        } else if !own.is_empty() {
            let line = Extent::new(own.len() as u32 / 3, 1);
            let close = Comparison::new(line, &own, &full).unwrap().tone_mapped_db(0.18);
            println!("{name}: {close:.1} dB");
            // Squares that stand alone in noise called converged lack all that the whole pass sees around them, and
            // the light that is given back there (26.0 dB; 27.8 without). How much is a matter of the weights too: over
            // 30 with those that look less far around.
            let least = if ["half", "all but one"].contains(&name) { 50.0 } else { 25.5 };
            assert!(close > least, "{name}: {close} dB");
        }
    }
    assert_no_validation_messages();
}

/// FiLM at two resolutions, one of tiles larger than the map's squares.
#[test]
fn approximate_tiles_of_several_films_keep_their_promises() {
    let (weights, extent) = (small_net(16, Block::ShJsa { ratio: 0.5 }), EXTENT);
    let mut whole = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    let options = Options { converged: converged(ConvergedMode::default()), ..Options::default() };
    let mut denoiser = soiled(&weights, &options, extent);
    for (i, (name, pattern)) in patterns().into_iter().enumerate() {
        let scene = Scene::new(extent, i as u64, pattern);
        let found = check_promises(&mut denoiser, &scene);
        let active = denoiser.active_tiles().unwrap();
        let sampled = active.parts.iter().filter(|(part, _)| part.sampled).map(|(part, _)| part.tile_pixels);
        assert_eq!(sampled.fold(0, u32::max), 32);
        if name == "all" {
            assert_same_bits(&found, &denoise(&mut whole, &scene.frame()), "nothing to leave out");
        }
    }
    assert_no_validation_messages();
}

/// Frames of noise of which all but one square is wrongly called converged.
#[test]
fn wrong_maps_do_no_more_harm_than_they_must() {
    let (weights, extent) = (Weights::hybrid_kernels().unwrap(), EXTENT);
    let options = |mode| Options { converged: converged(mode), ..Options::default() };
    let mut approximate = soiled(&weights, &options(ConvergedMode::default()), extent);
    let mut random = Random::new(8);
    for seed in 0..5 {
        let (column, row) = (random.integer(0, 15), random.integer(0, 13));
        let scene = Scene::new(extent, seed, |x, y| (x, y) == (column, row));
        check_promises(&mut approximate, &scene);
    }
    assert_no_validation_messages();
}

/// Frames without features repeat a small map; with features kept, theirs are the whole frame's.
#[test]
fn features_that_are_missing_or_kept_make_no_difference() {
    let (weights, extent) = (Weights::hybrid_kernels().unwrap(), Extent::new(300, 211));
    let pattern = |x: u32, y: u32| (x / 6 + y / 5).is_multiple_of(2);
    let scene = Scene::new(extent, 4, pattern);
    let mut plain = Denoiser::new(device(), &weights, &Options::default()).unwrap();
    for mode in [ConvergedMode::Exact, ConvergedMode::default()] {
        let mut denoiser = soiled(&weights, &Options { converged: converged(mode), ..Options::default() }, extent);
        let mut frame = scene.frame();
        let with = denoise(&mut denoiser, &frame);
        (frame.features.albedo, frame.features.depth) = (None, None);
        let without = denoise(&mut denoiser, &frame);
        if mode == ConvergedMode::Exact {
            assert_exact(&scene, &without, &denoise(&mut plain, &frame));
        }
        let options = Options { converged: converged(mode), keep_features: true, ..Options::default() };
        let mut keeping = soiled(&weights, &options, extent);
        // Another part is converged at first.
        denoise(&mut keeping, &Scene { color: scene.color.clone(), ..Scene::new(extent, 4, |x, _| x < 3) }.frame());
        keeping.set_features_unchanged(true);
        let kept = denoise(&mut keeping, &scene.frame());
        match mode {
            ConvergedMode::Exact => assert_same_bits(&kept, &with, "features kept"),
            // Features are the whole frame's then, not read as zero beyond margins.
            ConvergedMode::Approximate(_) => assert!(kept.iter().all(|value| value.is_finite())),
        }
    }
    assert_no_validation_messages();
}

#[test]
fn a_region_of_converged_tiles_has_the_bits_of_the_whole() {
    let (weights, extent) = (Weights::hybrid_kernels().unwrap(), EXTENT);
    let scene = Scene::new(extent, 4, |x, y| (x / 2 + y / 2).is_multiple_of(3));
    let options = Options { converged: converged(ConvergedMode::Exact), ..Options::default() };
    let whole = denoise(&mut soiled(&weights, &options, extent), &scene.frame());
    let mut denoiser = soiled(&weights, &options, extent);
    // Squares outside of a region are converged: the blend beside them may lie within it, so it begins and ends with
    // squares that are.
    let region = Region { x: 0, y: 32, width: 112, height: 100 };
    denoiser.set_region(Some(region));
    let mut part = vec![-1.0; whole.len()];
    denoiser.denoise(&scene.frame(), PlaneMut::f32(&mut part, Layout::interleaved(extent, 3))).unwrap();
    let mut differing = 0;
    for (i, (part, whole)) in part.iter().zip(&whole).enumerate() {
        let (x, y) = (i as u32 / 3 % extent.width, i as u32 / 3 / extent.width);
        if !region.contains(x, y) {
            assert_eq!(*part, -1.0, "({x}, {y}) lies outside");
        } else if scene.distance(x, y) == 0.0 {
            assert_eq!(part.to_bits(), whole.to_bits(), "({x}, {y})");
        } else {
            differing += usize::from(part != whole);
        }
    }
    println!("{differing} samples of converged squares blend with what lies outside, or do not");
    assert_no_validation_messages();
}

#[test]
fn the_report_tells_what_was_active() {
    let (weights, extent) = (Weights::hybrid_kernels().unwrap(), Extent::new(300, 211));
    let options = Options { converged: converged(ConvergedMode::default()), ..Options::default() };
    let mut denoiser = Denoiser::new(device(), &weights, &options).unwrap();
    assert!(denoiser.active_tiles().is_none());
    let rgb = Layout::interleaved(extent, 3);
    let mut work = |pattern: Pattern| {
        let scene = Scene::new(extent, 1, pattern);
        let mut output = vec![0.0; 3 * extent.pixels() as usize];
        let report = denoiser.denoise(&scene.frame(), PlaneMut::f32(&mut output, rgb)).unwrap();
        let active = denoiser.active_tiles().unwrap().clone();
        let columns = active.size.columns as usize;
        for (i, wanted) in scene.active.iter().enumerate() {
            let (x, y) = (i % extent.width.div_ceil(SQUARE) as usize, i / extent.width.div_ceil(SQUARE) as usize);
            assert_eq!(active.map[y * columns + x], *wanted, "square ({x}, {y})");
        }
        (report.work, active)
    };
    let (all, _) = work(|_, _| true);
    let (some, active) = work(|x, _| x < 9);
    let (none, idle) = work(|_, _| false);
    assert!(all == 1.0 && some < 0.9 && some > 0.3 && none < 0.3, "{all} {some} {none}");
    assert!((active.denoised(extent) - 9.0 / 19.0).abs() < 1e-9 && idle.denoised(extent) == 0.0);
    // What FiLM takes the mean of has a sample.
    assert!(idle.parts.iter().all(|(part, count)| (*count > 0) == part.sampled && *count < part.tiles));
}

#[test]
fn thresholds_that_mean_nothing_are_refused() {
    for threshold in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let options =
            Options { converged: Some(Converged { threshold, mode: ConvergedMode::Exact }), ..Options::default() };
        let refused = Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), &options);
        assert!(matches!(refused, Err(Error::InvalidOption { option: "converged threshold", .. })));
    }
    assert_eq!("exact".parse::<ConvergedMode>().unwrap(), ConvergedMode::Exact);
    assert!(matches!("some".parse::<ConvergedMode>(), Err(Error::InvalidOption { option: "converged mode", .. })));
}

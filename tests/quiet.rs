//! Quiet tiles: the caller's pixels where nothing needs denoising, the whole frame's pass elsewhere.

mod common;

use common::device::{assert_no_validation_messages, device};
use common::random::Random;
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::plan::{ConvAlgorithm, SeparableForm};
use vkdenoise::{
    ActiveTiles, Denoiser, Extent, Features, Frame, Layout, Noise, NoiseKind, Options, Plane, PlaneMut, Quiet,
    QuietMargins, QuietMode, Region, Weights,
};

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

fn quiet(mode: QuietMode) -> Option<Quiet> {
    Some(Quiet { threshold: 0.02, mode })
}

/// A denoiser with something else's pass behind it in its arena.
fn soiled(weights: &Weights, options: &Options, extent: Extent) -> Denoiser {
    let mut denoiser = Denoiser::new(device(), weights, options).unwrap();
    let mut noise = Random::new(99).values(3 * extent.pixels() as usize, 0.0, 900.0);
    noise[7] = f32::NAN;
    let rgb = Layout::interleaved(extent, 3);
    denoise(&mut denoiser, &Frame { extent, color: Plane::f32(&noise, rgb), features: Features::default() });
    denoiser
}

/// Compares a result with the whole frame's pass: equal bits where denoised, the input's far from that, a mixture between.
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

/// Patterns of squares to denoise: one, a diagonal, everything but one, none, all.
fn patterns() -> Vec<(&'static str, fn(u32, u32) -> bool)> {
    vec![
        ("one", |x, y| (x, y) == (7, 5)),
        ("corners", |x, y| (x, y) == (0, 0) || (x, y) == (18, 13)),
        ("some", |x, y| x * 7 % 13 == y * 5 % 11),
        ("all but one", |x, y| (x, y) != (4, 9)),
        ("none", |_, _| false),
        ("all", |_, _| true),
    ]
}

fn check_exact(weights: &Weights, options: Options, extent: Extent) {
    let mut whole = Denoiser::new(device(), weights, &options).unwrap();
    let mut denoiser = soiled(weights, &Options { quiet: quiet(QuietMode::Exact), ..options }, extent);
    for (i, (name, pattern)) in patterns().into_iter().enumerate() {
        println!("{name}");
        let scene = Scene::new(extent, i as u64, pattern);
        let expected = denoise(&mut whole, &scene.frame());
        let found = denoise(&mut denoiser, &scene.frame());
        assert_exact(&scene, &found, &expected);
    }
    assert_no_validation_messages();
}

#[test]
fn exact_tiles_have_the_bits_of_the_whole() {
    check_exact(&Weights::hybrid().unwrap(), Options::default(), Extent::new(300, 211));
}

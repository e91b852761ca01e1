//! Noisy features: the albedo is filtered where they are noisy and keeps its bits elsewhere, in every way a frame goes.

mod common;

use common::case::PREPROCESSING;
use common::compare::assert_same_bits;
use common::device::{assert_no_validation_messages, device};
use common::random::Random;
use vkdenoise::net::{Arch, Weights};
use vkdenoise::{Denoiser, Extent, Features, Frame, Layout, Options, Plane, PlaneMut, Precision, Region, TileReport};

const EXTENT: Extent = Extent::new(150, 100);
/// What is noisy in [`Picture::noisy`].
const NOISY: Region = Region { x: 60, y: 40, width: 30, height: 30 };

struct Picture {
    extent: Extent,
    color: Vec<f32>,
    albedo: Vec<f32>,
    normal: Vec<f32>,
}

impl Picture {
    /// Flat and curved surfaces with edges, bars and grain; colour with noise.
    fn clean(extent: Extent) -> Self {
        let (mut random, pixels) = (Random::new(3), extent.pixels() as usize);
        let at = |i: usize| (i % extent.width as usize, i / extent.width as usize);
        let normal = |i| match at(i) {
            (x, y) if x % 50 < 20 => [0.01 * (x % 50) as f32, 0.02 * (y % 40) as f32, 0.5],
            (x, _) if x % 31 < 3 => [0.0, 1.0, 0.0],
            _ => [0.0, 0.0, 1.0],
        };
        Self {
            extent,
            color: random.values(3 * pixels, 0.0, 2.0),
            albedo: random.values(3 * pixels, 0.2, 0.8),
            normal: (0..pixels).flat_map(normal).collect(),
        }
    }

    /// The same with noise in a part of the normals.
    fn noisy(extent: Extent) -> Self {
        let (mut random, mut picture) = (Random::new(4), Self::clean(extent));
        for (i, normal) in picture.normal.chunks_exact_mut(3).enumerate() {
            let (x, y) = (i as u32 % extent.width, i as u32 / extent.width);
            if NOISY.contains(x, y) {
                normal.copy_from_slice(&random.values(3, -1.0, 1.0));
            }
        }
        picture
    }

    fn frame(&self) -> Frame<'_> {
        let rgb = Layout::interleaved(self.extent, 3);
        let features = Features {
            albedo: Some(Plane::f32(&self.albedo, rgb)),
            normal: Some(Plane::f32(&self.normal, rgb)),
            ..Features::default()
        };
        Frame { extent: self.extent, color: Plane::f32(&self.color, rgb), features }
    }
}

fn denoised(denoiser: &mut Denoiser, frame: &Frame) -> (Vec<f32>, Option<TileReport>) {
    let mut output = vec![-1.0; 3 * frame.extent.pixels() as usize];
    let report = denoiser.denoise(frame, PlaneMut::f32(&mut output, Layout::interleaved(frame.extent, 3))).unwrap();
    (output, report.tiles)
}

fn denoise(weights: &Weights, options: &Options, frame: &Frame) -> Vec<f32> {
    denoised(&mut Denoiser::new(device(), weights, options).unwrap(), frame).0
}

/// A residual of random weights, and the head that divides by the albedo.
fn networks() -> [Weights; 2] {
    [Weights::hashed(&Arch::hybrid(), PREPROCESSING, 9).unwrap(), Weights::hybrid_kernels().unwrap()]
}

#[test]
fn clean_features_keep_their_bits_and_noisy_ones_do_not() {
    let (clean, noisy) = (Picture::clean(EXTENT), Picture::noisy(EXTENT));
    for weights in networks() {
        for precision in [Precision::F32, Precision::F16] {
            let options = Options { precision, ..Options::default() };
            let taken = Options { clean_aux: true, ..options };
            let both = |picture: &Picture| [&options, &taken].map(|o| denoise(&weights, o, &picture.frame()));
            let [filtered, as_it_is] = both(&clean);
            assert_same_bits(&filtered, &as_it_is, "clean features");
            let [filtered, as_it_is] = both(&noisy);
            assert_ne!(filtered, as_it_is, "noisy features");
        }
    }
    assert_no_validation_messages();
}

/// Without normals nothing tells noise from texture, without albedo there is nothing to filter.
#[test]
fn one_feature_alone_is_taken_as_it_is() {
    let noisy = Picture::noisy(EXTENT);
    let weights = &networks()[1];
    for with_albedo in [true, false] {
        let mut frame = noisy.frame();
        let features = frame.features;
        frame.features = match with_albedo {
            true => Features { normal: None, ..features },
            false => Features { albedo: None, ..features },
        };
        let [filtered, as_it_is] =
            [false, true].map(|clean_aux| denoise(weights, &Options { clean_aux, ..Options::default() }, &frame));
        assert_same_bits(&filtered, &as_it_is, "one feature");
    }
}

/// Regions end within what is noisy, at no multiple of a tile.
#[test]
fn regions_have_the_bits_of_the_whole() {
    let noisy = Picture::noisy(EXTENT);
    for weights in networks() {
        let mut denoiser = Denoiser::new(device(), &weights, &Options::default()).unwrap();
        let whole = denoised(&mut denoiser, &noisy.frame()).0;
        for region in
            [NOISY, Region { x: 0, y: 0, width: 77, height: 53 }, Region { x: 85, y: 44, width: 3, height: 1 }]
        {
            denoiser.set_region(Some(region));
            let part = denoised(&mut denoiser, &noisy.frame()).0;
            let expected: Vec<f32> = (0..EXTENT.pixels() as u32)
                .flat_map(|i| {
                    let inside = region.contains(i % EXTENT.width, i / EXTENT.width);
                    (0..3).map(move |channel| (inside, 3 * i as usize + channel))
                })
                .map(|(inside, at)| if inside { whole[at] } else { -1.0 })
                .collect();
            assert_same_bits(&part, &expected, &format!("{region:?}"));
        }
    }
}

//! Pixels of NaN, Inf, absurd and negative values, in every plane.

use super::moves::{FarMoves, Unit};
use super::random::Random;
use super::scene::Scene;
use super::subject::Subject;
use super::{Bound, Cases, Effort, Measured, Result, bad_samples, sound};
use std::fmt;
use vkdenoise::Extent;

/// What this module measures.
pub const CASES: Cases = &[
    ("one bad pixel in colour", |s, e| one(s, e, &[Target::Color])),
    ("one bad pixel in albedo", |s, e| one(s, e, &[Target::Albedo])),
    ("one bad pixel in normal", |s, e| one(s, e, &[Target::Normal])),
    ("one bad pixel in depth", |s, e| one(s, e, &[Target::Depth])),
    ("one bad pixel in all planes", |s, e| one(s, e, &Target::ALL)),
    ("1 % bad pixels in colour", |s, e| many(s, e, &[Target::Color], 0.01)),
    ("1 % bad pixels in albedo", |s, e| many(s, e, &[Target::Albedo], 0.01)),
    ("1 % bad pixels in normal", |s, e| many(s, e, &[Target::Normal], 0.01)),
    ("1 % bad pixels in depth", |s, e| many(s, e, &[Target::Depth], 0.01)),
    ("1 % bad pixels in all planes", |s, e| many(s, e, &Target::ALL, 0.01)),
    ("all pixels bad in colour", |s, e| many(s, e, &[Target::Color], 1.0)),
    ("all pixels bad in albedo", |s, e| many(s, e, &[Target::Albedo], 1.0)),
    ("all pixels bad in normal", |s, e| many(s, e, &[Target::Normal], 1.0)),
    ("all pixels bad in depth", |s, e| many(s, e, &[Target::Depth], 1.0)),
    ("all pixels bad in all planes", |s, e| many(s, e, &Target::ALL, 1.0)),
];

/// Whether a case leaves no square without a bad pixel.
pub fn spoils_every_square(case: &str) -> bool {
    ["all pixels bad in colour", "all pixels bad in all planes"].contains(&case)
}

/// Values that a broken renderer writes. The largest denormal and the smallest; 1e4 is odd for a feature only.
const VALUES: [f32; 11] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    1e4,
    1e10,
    1e30,
    f32::MAX,
    -1.0,
    -1e30,
    1.1754942e-38,
    f32::from_bits(1),
];

/// A plane of the frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Target {
    Color,
    Albedo,
    Normal,
    Depth,
}

impl Target {
    const ALL: [Self; 4] = [Self::Color, Self::Albedo, Self::Normal, Self::Depth];

    /// Writes a value to every channel of a pixel.
    fn spoil(self, scene: &mut Scene, pixel: usize, value: f32) {
        let plane = match self {
            Self::Color => Some(&mut scene.color),
            Self::Albedo => scene.albedo.as_mut(),
            Self::Normal => scene.normal.as_mut(),
            Self::Depth => scene.depth.as_mut(),
        };
        let channels = if self == Self::Depth { 1 } else { 3 };
        if let Some(plane) = plane {
            plane[channels * pixel..][..channels].fill(value);
        }
    }
}

/// The side of the frame in which a bad pixel must stay local, and how far that is, in pixels.
pub const SIDE: u32 = 256;
const NEAR: u32 = 64;

/// Samples farther from a pixel than it may reach.
pub fn far((x, y): (u32, u32)) -> impl Fn(usize) -> bool {
    move |sample| {
        let pixel = sample as u32 / 3;
        (pixel % SIDE).abs_diff(x).max((pixel / SIDE).abs_diff(y)) > NEAR
    }
}

/// Where bad pixels are put: near a corner, so that the far end of the coarsest attention window is as far as can be,
/// and in the middle.
pub fn places(effort: Effort) -> &'static [(u32, u32)] {
    match effort {
        Effort::Sample => &[(37, 41)],
        Effort::Everything => &[(37, 41), (120, 131)],
    }
}

fn one(subject: &mut Subject, effort: Effort, targets: &[Target]) -> Result<Vec<Measured>> {
    let scene = Scene::new(Extent::new(SIDE, SIDE), 1);
    let mut sound = sound();
    let mut moves = FarMoves::new(subject, &scene, Unit::Value)?;
    let mut mean = Measured::new("the mean moves, of itself", Bound::AtMost(0.01));
    let values: &[f32] = match effort {
        Effort::Sample => &[f32::INFINITY],
        Effort::Everything => &VALUES,
    };
    for &(x, y) in places(effort) {
        for &value in values {
            // A firefly that is no bad pixel by the rule may be true light: it has a bound of its own.
            if targets.contains(&Target::Color) && value == 1e4 {
                continue;
            }
            let mut scene = scene.clone();
            targets.iter().for_each(|target| target.spoil(&mut scene, scene_pixel(x, y), value));
            let output = subject.denoise(&scene)?;
            let input = Input { value, place: Some((x, y)) };
            sound.take(bad_samples(&output), input);
            moves.take(&output, far((x, y)), input)?;
            mean.take(mean_move(&output, moves.clean()), input);
        }
    }
    Ok(std::iter::once(sound).chain(moves.figures()).chain([mean]).collect())
}

fn scene_pixel(x: u32, y: u32) -> usize {
    (y * SIDE + x) as usize
}

fn mean_move(output: &[f32], clean: &[f32]) -> f64 {
    let mean = |values: &[f32]| values.iter().map(|&v| f64::from(v)).sum::<f64>() / values.len() as f64;
    (mean(output) - mean(clean)).abs() / mean(clean)
}

fn many(subject: &mut Subject, effort: Effort, targets: &[Target], share: f32) -> Result<Vec<Measured>> {
    let scene = Scene::new(Extent::new(61, 47), 2);
    let mut sound = sound();
    let values: &[f32] = match effort {
        Effort::Sample => &[f32::NAN],
        Effort::Everything => &VALUES,
    };
    for &value in values {
        let (mut scene, mut random) = (scene.clone(), Random::new(3));
        for pixel in 0..scene.pixels() {
            // Each plane by itself: a pixel may be bad in one and good in another.
            for target in targets {
                if random.uniform(0.0, 1.0) < share {
                    target.spoil(&mut scene, pixel, value);
                }
            }
        }
        sound.take(bad_samples(&subject.denoise(&scene)?), Input { value, place: None });
    }
    Ok(vec![sound])
}

/// The value that was written, and where, for the matrix.
#[derive(Clone, Copy)]
struct Input {
    value: f32,
    place: Option<(u32, u32)>,
}

impl fmt::Display for Input {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.value {
            f32::MAX => write!(f, "FLT_MAX")?,
            value if value.abs() < 1e4 && value.fract() == 0.0 => write!(f, "{value}")?,
            value => write!(f, "{value:e}")?,
        }
        self.place.map_or(Ok(()), |(x, y)| write!(f, " at {x},{y}"))
    }
}

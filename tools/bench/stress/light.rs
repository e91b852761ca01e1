//! Very bright light that may be true, and light of any scale.

use super::bad_pixels::{SIDE, far, places};
use super::moves::{FarMoves, Unit, tone_mapped_db};
use super::random::Random;
use super::scene::Scene;
use super::subject::{Exactness, Subject};
use super::{Bound, Cases, Effort, Measured, Result, bad_samples, sound};
use vkdenoise::Extent;
use vkdenoise::metrics::Comparison;

/// What this module measures.
pub const CASES: Cases = &[
    ("one firefly that is no bad pixel", firefly),
    ("fireflies of 1e6 in 1 % of the pixels", fireflies),
    ("an emitter of 5x5 pixels and 1000 keys", emitter),
    ("radiance times 1e-6 to 1e6", scaled),
];

/// Whether a case has figures that a network may spoil, so that the way in and out should be seen alone.
pub fn is_of_training(case: &str) -> bool {
    ["firefl", "emitter", "neutral: a constant", "neutral: a ramp"].iter().any(|part| case.contains(part))
}

fn firefly(subject: &mut Subject, effort: Effort) -> Result<Vec<Measured>> {
    let scene = Scene::new(Extent::new(SIDE, SIDE), 1);
    let key = scene.key()?;
    let mut sound = sound();
    let mut moves = FarMoves::new(subject, &scene, Unit::Key)?;
    let keys: &[f64] = match effort {
        Effort::Sample => &[0.99e8],
        Effort::Everything => &[1e2, 1e3, 1e4, 1e6, 0.99e8],
    };
    for &(x, y) in places(effort) {
        for &keys in keys {
            let mut color = scene.color.clone();
            let at = scene.at(x, y);
            color[at..at + 3].fill((keys * key) as f32);
            let output = subject.denoise(&scene.with_color(color))?;
            let input = format!("{keys:.0e} keys at {x},{y}");
            sound.take(bad_samples(&output), &input);
            moves.take(&output, far((x, y)), &input)?;
        }
    }
    Ok(std::iter::once(sound).chain(moves.figures()).collect())
}

/// The scene that fireflies fall on.
fn canvas(effort: Effort) -> Scene {
    match effort {
        Effort::Sample => Scene::new(Extent::new(128, 96), 4),
        Effort::Everything => Scene::new(Extent::new(SIDE, SIDE), 4),
    }
}

fn fireflies(subject: &mut Subject, effort: Effort) -> Result<Vec<Measured>> {
    let scene = canvas(effort);
    let psnr = |output: &[f32]| Ok::<_, vkdenoise::Error>(Comparison::new(scene.extent, output, &scene.clean)?.psnr());
    let plain = psnr(&subject.denoise(&scene)?)?;
    let mut lost = Measured::new("PSNR falls, dB", Bound::AtMost(6.0));
    let mut color = scene.color.clone();
    let mut random = Random::new(5);
    for pixel in color.chunks_exact_mut(3) {
        if random.uniform(0.0, 1.0) < 0.01 {
            pixel.fill(1e6);
        }
    }
    let output = subject.denoise(&scene.with_color(color))?;
    lost.take(plain - psnr(&output)?, format!("from {plain:.1}"));
    let mut sound = sound();
    sound.take(bad_samples(&output), "");
    Ok(vec![sound, lost])
}

/// No cheat by a low clamp: what an emitter and its surroundings hold, of what they held.
fn emitter(subject: &mut Subject, effort: Effort) -> Result<Vec<Measured>> {
    let scene = canvas(effort);
    let (key, mut color) = (scene.key()?, scene.color.clone());
    let (x, y) = (scene.extent.width / 2, scene.extent.height / 2);
    for row in y - 2..=y + 2 {
        let at = scene.at(x - 2, row);
        color[at..at + 15].fill((1000.0 * key) as f32);
    }
    let scene = scene.with_color(color);
    let output = subject.denoise(&scene)?;
    let energy = |values: &[f32]| -> f64 {
        let rows = y - 16..=y + 16;
        rows.flat_map(|row| &values[scene.at(x - 16, row)..scene.at(x + 17, row)]).map(|&v| f64::from(v)).sum()
    };
    let mut kept = Measured::new("energy within 16 pixels, of the input's", Bound::AtLeast(0.95));
    kept.take(energy(&output) / energy(&scene.color), "");
    Ok(vec![kept])
}

fn scaled(subject: &mut Subject, effort: Effort) -> Result<Vec<Measured>> {
    let scene = Scene::new(Extent::new(96, 80), 6);
    let key = scene.key()?;
    let plain = subject.denoise(&scene)?;
    let mut figure = match subject.exactness() {
        Exactness::Single => Measured::new("pixels move, of value + 1e-3 key", Bound::AtMost(1e-3)),
        Exactness::Half => Measured::new("tone-mapped dB to the unscaled", Bound::AtLeast(50.0)),
    };
    let powers: &[i32] = match effort {
        Effort::Sample => &[-6, 6],
        Effort::Everything => &[-6, -5, -4, -3, -2, -1, 1, 2, 3, 4, 5, 6],
    };
    for &power in powers {
        // In f64: the powers of ten are no floats.
        let factor = 10f64.powi(power);
        let times = |values: &[f32], by: f64| values.iter().map(|&v| (f64::from(v) * by) as f32).collect::<Vec<_>>();
        let output = subject.denoise(&scene.with_color(times(&scene.color, factor)))?;
        let output = times(&output, factor.recip());
        let value = match subject.exactness() {
            Exactness::Single => Unit::Value.largest(&output, &plain, key, |_| true),
            Exactness::Half => tone_mapped_db(&output, &plain, key)?,
        };
        figure.take(value, format!("1e{power}"));
    }
    Ok(vec![figure])
}

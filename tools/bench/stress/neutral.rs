//! What goes in comes out: samples that are no light, lamps and suns, stars, frames without noise (`docs/neutral.md`).

use super::random::Random;
use super::scene::Scene;
use super::subject::Subject;
use super::{Bound, Cases, Effort, Measured, Result, sound};
use vkdenoise::{Exposure, Extent, Fireflies};

/// What this module measures.
pub const CASES: Cases = &[
    ("neutral: a channel of -1e-7", |s, _| negative(s, [-1e-7, 0.3, 0.2])),
    ("neutral: wide-gamut colours", |s, _| negative(s, [-0.02, 0.05, 0.9])),
    ("neutral: a hole of NaN", hole),
    ("neutral: a disc of +Inf", infinite),
    ("neutral: a sun of 1e6", |s, _| sun(s, 1e6, false)),
    ("neutral: a sun of 1.6e9", |s, _| sun(s, 1.6e9, false)),
    ("neutral: a sun of 1.6e9 in noise", |s, _| sun(s, 1.6e9, true)),
    ("neutral: 60 stars, kept", |s, _| stars(s, Some(Fireflies::Keep), false)),
    ("neutral: 60 stars, auto", |s, _| stars(s, None, false)),
    ("neutral: 60 fireflies in noise, auto", |s, _| stars(s, None, true)),
    ("neutral: all black", black),
    ("neutral: a constant", constant),
    ("neutral: a ramp", ramp),
    ("neutral: energy at 4 samples", energy),
];

/// As the files of the kind have it.
const EXTENT: Extent = Extent::new(64, 48);

/// A frame of colour alone.
fn scene(color: impl Fn(u32, u32) -> [f32; 3]) -> Scene {
    let pixels = (0..EXTENT.height).flat_map(|y| (0..EXTENT.width).map(move |x| (x, y)));
    let color: Vec<f32> = pixels.flat_map(|(x, y)| color(x, y)).collect();
    Scene { extent: EXTENT, clean: color.clone(), color, albedo: None, normal: None, depth: None, samples: None }
}

/// Gives every pixel the noise of some samples.
fn noisy(mut scene: Scene, samples: u32, lit: impl Fn(f32) -> bool) -> Scene {
    let mut random = Random::new(12);
    for pixel in scene.color.chunks_exact_mut(3).filter(|pixel| lit(pixel[0])) {
        let noise = (0..samples).map(|_| -random.uniform(1e-6, 1.0).ln()).sum::<f32>() / samples as f32;
        pixel.iter_mut().for_each(|sample| *sample *= noise);
    }
    scene
}

fn inside((x, y): (u32, u32), left: u32, top: u32, side: u32) -> bool {
    (left..left + side).contains(&x) && (top..top + side).contains(&y)
}

fn in_disc((x, y): (u32, u32), radius: f32) -> bool {
    (x as f32 - 31.5).hypot(y as f32 - 23.5) < radius
}

/// The mean of one channel or all over the pixels that count.
fn mean(values: &[f32], channel: Option<usize>, counts: impl Fn((u32, u32)) -> bool) -> f64 {
    let at = |i: usize| ((i / 3) as u32 % EXTENT.width, (i / 3) as u32 / EXTENT.width);
    let of = |i: &usize| channel.is_none_or(|channel| i % 3 == channel) && counts(at(*i));
    let chosen: Vec<f64> = (0..values.len()).filter(of).map(|i| values[i].into()).collect();
    chosen.iter().sum::<f64>() / chosen.len() as f64
}

/// A block with a channel below 0 keeps the others.
fn negative(subject: &mut Subject, block: [f32; 3]) -> Result<Vec<Measured>> {
    let is_block = |at| inside(at, 20, 10, 20);
    let scene = scene(|x, y| if is_block((x, y)) { block } else { [0.3; 3] });
    let output = subject.denoise(&scene)?;
    let mut kept = Measured::new("the block's blue, of the input's", Bound::AtLeast(0.93));
    kept.take(mean(&output, Some(2), is_block) / f64::from(block[2]), "");
    let mut fringe = Measured::new("red of the block, of what is around", Bound::AtMost(0.1));
    fringe.take(mean(&output, Some(0), |at| inside(at, 24, 14, 12)) / 0.3, "");
    Ok(vec![kept, fringe])
}

/// A lost bucket looks like what is around it.
fn hole(subject: &mut Subject, _: Effort) -> Result<Vec<Measured>> {
    let is_hole = |at| inside(at, 12, 6, 34);
    let scene = scene(|x, y| if is_hole((x, y)) { [f32::NAN; 3] } else { [0.5, 0.4, 0.3] });
    let output = subject.denoise(&scene)?;
    let of = |figure: fn(f64, f64) -> f64, start| {
        let pixels = (0..output.len()).filter(|i| is_hole(((i / 3) as u32 % 64, (i / 3) as u32 / 64)));
        pixels.map(|i| f64::from(output[i]) / [0.5, 0.4, 0.3][i % 3]).fold(start, figure)
    };
    let mut least = Measured::new("the darkest of the hole, of what is around", Bound::AtLeast(0.9));
    least.take(of(f64::min, f64::MAX), "");
    let mut most = Measured::new("the brightest of the hole, of what is around", Bound::AtMost(1.0001));
    most.take(of(f64::max, 0.0), "");
    Ok(vec![least, most])
}

/// As bright as the brightest finite light.
fn infinite(subject: &mut Subject, _: Effort) -> Result<Vec<Measured>> {
    let plain = noisy(scene(|x, _| [0.2 + 0.01 * x as f32; 3]), 4, |_| true);
    let largest = plain.color.iter().copied().fold(0.0, f32::max);
    let is_disc = |at| in_disc(at, 5.0);
    let mut color = plain.color.clone();
    for (i, sample) in color.iter_mut().enumerate() {
        if is_disc(((i / 3) as u32 % 64, (i / 3) as u32 / 64)) {
            *sample = f32::INFINITY;
        }
    }
    let output = subject.denoise(&plain.with_color(color))?;
    let mut sound = sound();
    sound.take(super::bad_samples(&output), "");
    let mut bright = Measured::new("the disc, of the frame's largest sample", Bound::AtLeast(0.999));
    bright.take(mean(&output, None, is_disc) / f64::from(largest), "");
    Ok(vec![sound, bright])
}

/// A sun keeps its energy, and does not shine on the rest.
fn sun(subject: &mut Subject, radiance: f32, in_noise: bool) -> Result<Vec<Measured>> {
    let is_sun = |at| in_disc(at, 4.0);
    let ground = scene(|_, _| [0.2; 3]);
    let ground = if in_noise { noisy(ground, 4, |_| true) } else { ground };
    let mut color = ground.color.clone();
    for (i, sample) in color.iter_mut().enumerate() {
        if is_sun(((i / 3) as u32 % 64, (i / 3) as u32 / 64)) {
            *sample = radiance;
        }
    }
    let output = subject.denoise(&ground.with_color(color))?;
    let sum = mean(&output, None, is_sun) / f64::from(radiance);
    let mut least = Measured::new("the sun, of the input's", Bound::AtLeast(0.95));
    let mut most = Measured::new("the sun, of the input's, at most", Bound::AtMost(1.05));
    least.take(sum, "");
    most.take(sum, "");
    let mut far = Measured::new("the ground 16 pixels away, of the input's", Bound::AtMost(1.5));
    far.take(mean(&output, None, |at| !in_disc(at, 20.0)) / 0.2, "");
    Ok(vec![least, most, far])
}

/// Lone pixels of 500 on 0.2.
fn stars(subject: &mut Subject, fireflies: Option<Fireflies>, in_noise: bool) -> Result<Vec<Measured>> {
    let ground = scene(|_, _| [0.2; 3]);
    let ground = if in_noise { noisy(ground, 4, |_| true) } else { ground };
    let (mut random, mut color, mut found) = (Random::new(21), ground.color.clone(), Vec::new());
    while found.len() < 60 {
        let at = (random.integer(0, EXTENT.width - 1), random.integer(0, EXTENT.height - 1));
        let near = |(x, y): &(u32, u32)| x.abs_diff(at.0).max(y.abs_diff(at.1)) < 3;
        if !found.iter().any(near) {
            found.push(at);
            let first = ground.at(at.0, at.1);
            color[first..first + 3].fill(500.0);
        }
    }
    let scene = ground.with_color(color);
    // A peer has no such choice.
    if let (Some(engine), Some(fireflies)) = (subject.as_engine(), fireflies) {
        engine.denoiser.set_fireflies(fireflies);
    }
    let output = subject.denoise(&scene);
    if let Some(engine) = subject.as_engine() {
        engine.denoiser.set_fireflies(Fireflies::Auto);
    }
    let output = output?;
    let light = |values: &[f32]| mean(values, None, |_| true) - mean(&ground.color, None, |_| true);
    let share = light(&output) / light(&scene.color);
    let mut kept = match in_noise {
        false => Measured::new("the stars' energy, of the input's", Bound::AtLeast(0.95)),
        true => Measured::new("the fireflies' energy, of the input's", Bound::AtMost(0.05)),
    };
    kept.take(share, "");
    Ok(vec![kept])
}

/// Black at any exposure.
fn black(subject: &mut Subject, _: Effort) -> Result<Vec<Measured>> {
    let scene = scene(|_, _| [0.0; 3]);
    let mut most = Measured::new("the largest sample", Bound::AtMost(0.0));
    let mut take = |subject: &mut Subject, exposure: &str| -> Result<()> {
        let output = subject.denoise(&scene)?;
        most.take(output.into_iter().fold(0.0, f32::max).into(), exposure);
        Ok(())
    };
    take(subject, "")?;
    for exposure in [0.01, 1.0, 100.0] {
        let Some(engine) = subject.as_engine() else { break };
        engine.denoiser.set_exposure(Exposure::Fixed(exposure))?;
        take(subject, &format!("exposure {exposure}"))?;
    }
    if let Some(engine) = subject.as_engine() {
        engine.denoiser.set_exposure(Exposure::Auto)?;
    }
    Ok(vec![most])
}

/// Nothing is brighter than what came in, and hardly anything darker.
fn constant(subject: &mut Subject, _: Effort) -> Result<Vec<Measured>> {
    let output = subject.denoise(&scene(|_, _| [1.0; 3]))?;
    let mut most = Measured::new("the largest sample, of the input's", Bound::AtMost(1.0));
    most.take(output.iter().copied().fold(0.0, f32::max).into(), "");
    let mut least = Measured::new("the least sample, of the input's", Bound::AtLeast(0.998));
    least.take(output.iter().copied().fold(f32::MAX, f32::min).into(), "");
    Ok(vec![most, least])
}

/// From black to 4 without noise.
fn ramp(subject: &mut Subject, _: Effort) -> Result<Vec<Measured>> {
    let scene = scene(|x, _| [4.0 * x as f32 / 63.0; 3]);
    let output = subject.denoise(&scene)?;
    let mut end = Measured::new("its brightest column, of the input's", Bound::AtMost(1.0));
    end.take(mean(&output, None, |(x, _)| x == 63) / 4.0, "");
    let mut moved = Measured::new("root mean square of the change, of the mean", Bound::AtMost(0.005));
    let squares = output.iter().zip(&scene.color).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
    moved.take((squares / output.len() as f64).sqrt() / mean(&scene.color, None, |_| true), "");
    Ok(vec![end, moved])
}

/// Light is neither lost nor made: of some frames of other noise together, as chance moves the mean of what came in,
/// and with it the result's, by half a percent in each.
fn energy(subject: &mut Subject, effort: Effort) -> Result<Vec<Measured>> {
    let sum = |values: &[f32]| values.iter().map(|&v| f64::from(v)).sum::<f64>();
    let (mut found, mut right) = (0.0, 0.0);
    let seeds = match effort {
        Effort::Sample => 14..16,
        Effort::Everything => 14..26,
    };
    for seed in seeds {
        let scene = Scene { samples: None, ..Scene::new(Extent::new(128, 96), seed) };
        found += sum(&subject.denoise(&scene)?);
        right += sum(&scene.clean);
    }
    let what = "energy, of the picture's without noise, is off by";
    let mut bias = Measured::new(what, Bound::AtMost(0.005)).by_weights();
    bias.take((found / right - 1.0).abs(), "");
    Ok(vec![bias])
}

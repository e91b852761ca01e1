//! Pictures and features at the ends of what renderers write. Beside the plain rule that an output is finite and at
//! least 0, the engine is held to the f64 reference: what the network makes in 32-bit floats, what a screen shows where
//! there are halves.

use super::moves::{Unit, tone_mapped_db};
use super::scene::Scene;
use super::subject::{Engine, Exactness, Subject};
use super::{Bound, Cases, Effort, Measured, Result, bad_samples, sound};
use vkdenoise::kernels::stats::EXPOSURE;
use vkdenoise::metrics::nmse;
use vkdenoise::net::Graph;
use vkdenoise::plan::plan;
use vkdenoise::reference::Reference;
use vkdenoise::target::Target;
use vkdenoise::testing::denoise_and_read;
use vkdenoise::{Extent, Layout, PlaneMut};

/// What this module measures.
pub const CASES: Cases = &[
    ("nothing unusual", |s, e| content(s, e, |_| ())),
    ("all black", |s, e| content(s, e, |scene| scene.color.fill(0.0))),
    ("all equal", |s, e| content(s, e, |scene| scene.color.fill(0.5))),
    ("a step of 1e6 contrast", |s, e| content(s, e, |scene| by_pixel(scene, |x, _| if x < 29 { 1e-3 } else { 1e3 }))),
    ("checkerboard", |s, e| content(s, e, |scene| by_pixel(scene, |x, y| ((x + y) % 2) as f32))),
    ("lines of one pixel", |s, e| content(s, e, |scene| by_pixel(scene, line))),
    ("normals of length 1000", |s, e| content(s, e, |scene| normals(scene, 1000.0))),
    ("normals of length 0", |s, e| content(s, e, |scene| normals(scene, 0.0))),
    ("albedo of 10", |s, e| content(s, e, |scene| scene.albedo.iter_mut().flatten().for_each(|v| *v *= 10.0))),
    ("sky depths of 1e10", |s, e| content(s, e, sky)),
    ("depth in kilometres", depth_unit),
];

fn by_pixel(scene: &mut Scene, value: impl Fn(usize, usize) -> f32) {
    let width = scene.extent.width as usize;
    for (i, pixel) in scene.color.chunks_exact_mut(3).enumerate() {
        pixel.fill(value(i % width, i / width));
    }
}

/// Bright rows and columns on a dark ground.
fn line(x: usize, y: usize) -> f32 {
    if x % 17 == 5 || y % 13 == 7 { 8.0 } else { 0.02 }
}

fn normals(scene: &mut Scene, length: f32) {
    scene.normal.iter_mut().flatten().for_each(|v| *v *= length);
}

/// The upper half of the frame is sky.
fn sky(scene: &mut Scene) {
    let half = scene.pixels() / 2;
    if let Some(depth) = &mut scene.depth {
        depth[..half].fill(1e10);
    }
}

/// A frame that is padded to one step of the network's grid.
const EXTENT: Extent = Extent::new(61, 47);

/// The frame of tiers that leave converged squares out: of tiles of every part of the network some are left out.
const LARGE: Extent = Extent::new(256, 256);

fn content(subject: &mut Subject, effort: Effort, change: fn(&mut Scene)) -> Result<Vec<Measured>> {
    let leaves_out = subject.as_engine().is_some_and(|engine| engine.tier.converged.is_some());
    let mut scene = Scene::new(if leaves_out { LARGE } else { EXTENT }, 7);
    change(&mut scene);
    let mut sound = sound();
    sound.take(bad_samples(&subject.denoise(&scene)?), "");
    let mut figures = vec![sound];
    if let Some(engine) = subject.as_engine()
        && let Some(mut figure) = engine.against_whole(&scene)?
    {
        // What lies on the one side reaches as far as what lies on the other.
        let other = scene.with_the_other_half_converged();
        engine.against_whole(&other)?.iter().for_each(|other| figure.take(other.value, "the other half"));
        figures.push(figure);
    }
    // The reference takes its time; colour at its ends is where it can differ most.
    let wanted = effort == Effort::Everything || scene.color != Scene::new(EXTENT, 7).color;
    // Converged squares keep their input, which is not what the network makes of them.
    if let Some(engine) = subject.as_engine().filter(|_| wanted && !leaves_out) {
        figures.push(to_reference(engine, &scene)?);
    }
    Ok(figures)
}

/// How far the engine is from the f64 reference.
fn to_reference(engine: &mut Engine, scene: &Scene) -> Result<Measured> {
    let (residual, _) = denoise_and_read(&mut engine.denoiser, &scene.frame(), |plan| plan.residual.buffer)?;
    let plan = plan(&Graph::new(engine.weights.arch())?, scene.extent, &Target::default())?;
    let mut reference = Reference::new(&plan, &engine.weights)?;
    reference.set_frame(&scene.frame(), None, 0.0)?;
    reference.run();
    let single = |values: &[f64]| values.iter().map(|&v| v as f32).collect::<Vec<_>>();
    let mut figure;
    match engine.tier.exactness {
        Exactness::Single => {
            figure = Measured::new("the network's result, NMSE to f64", Bound::AtMost(1e-9));
            figure.take(nmse(&residual, &single(reference.buffer(plan.residual.buffer)))?, "");
        }
        Exactness::Half => {
            figure = Measured::new("tone-mapped dB to f64", Bound::AtLeast(60.0));
            let mut output = vec![f32::NAN; scene.color.len()];
            let rgb = Layout::interleaved(scene.extent, 3);
            engine.denoiser.denoise(&scene.frame(), PlaneMut::f32(&mut output, rgb))?;
            let exposure = reference.buffer(plan.stats)[EXPOSURE];
            figure.take(tone_mapped_db(&output, &single(reference.output()), 0.18 / exposure)?, "");
        }
    }
    Ok(figure)
}

/// The unit of depth makes no difference.
fn depth_unit(subject: &mut Subject, _: Effort) -> Result<Vec<Measured>> {
    let mut scene = Scene::new(EXTENT, 7);
    let key = scene.key()?;
    let metres = subject.denoise(&scene)?;
    scene.depth.iter_mut().flatten().for_each(|v| *v *= 1e-3);
    let kilometres = subject.denoise(&scene)?;
    let mut moved;
    match subject.exactness() {
        Exactness::Single => {
            moved = Measured::new("pixels move, of value + 1e-3 key", Bound::AtMost(1e-3));
            moved.take(Unit::Value.largest(&kilometres, &metres, key, |_| true), "");
        }
        Exactness::Half => {
            moved = Measured::new("tone-mapped dB to metres", Bound::AtLeast(50.0));
            moved.take(tone_mapped_db(&kilometres, &metres, key)?, "");
        }
    }
    Ok(vec![moved])
}

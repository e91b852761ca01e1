//! How far a result lies from the undisturbed one, and how far it may.
//!
//! In 32-bit floats a move is what the disturbance did. Where maps or factors are rounded to halves, a change of 1e-7
//! anywhere rounds some of them the other way, and the result moves by about as much as the tier is off without any
//! disturbance. The network computes in the log domain, where that error is of one size; of a pixel next to black it is
//! more than 1 %. Both results are off, so beside 1 % such a tier may move by twice its own largest error in the log
//! domain, and what a screen shows is held to a bound of its own.

use super::scene::Scene;
use super::subject::{Exactness, Subject};
use super::{Bound, Measured, Result};
use std::fmt;
use vkdenoise::Extent;
use vkdenoise::metrics::Comparison;

/// What pixels far from a disturbance may move by.
const FAR: f64 = 0.01;
/// What a far pixel may move by as shown, in tiers with halves: dB over all far pixels.
const FAR_DB: f64 = 60.0;

/// What a move is measured in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unit {
    /// The value itself and a thousandth of the key.
    Value,
    /// The key.
    Key,
}

impl Unit {
    fn at(self, value: f64, key: f64) -> f64 {
        if self == Self::Value { value + 1e-3 * key } else { key }
    }

    /// The largest `|a - b|` in this unit of the samples that `counts` picks.
    pub fn largest(self, output: &[f32], clean: &[f32], key: f64, counts: impl Fn(usize) -> bool) -> f64 {
        largest(output, clean, counts, |a, b| (a - b).abs() / self.at(b, key))
    }
}

/// The largest of what `figure` makes of the samples that `counts` picks.
fn largest(output: &[f32], clean: &[f32], counts: impl Fn(usize) -> bool, figure: impl Fn(f64, f64) -> f64) -> f64 {
    let figures = output.iter().zip(clean).enumerate().filter(|(i, _)| counts(*i));
    let figures = figures.map(|(_, (&a, &b))| figure(f64::from(a), f64::from(b)));
    // Not `f64::max`: that would forgive a NaN.
    figures.fold(0.0, |worst, m| if m > worst || m.is_nan() { m } else { worst })
}

/// How the pixels far from disturbances move.
pub struct FarMoves {
    unit: Unit,
    key: f64,
    clean: Vec<f32>,
    /// Tiers with halves: the same of 32-bit floats, and what is shown of a move.
    halves: Option<(Vec<f32>, Measured)>,
    moved: Measured,
    /// Tiers that leave converged squares out: how the undisturbed frame's others differ from the whole frame's pass.
    whole: Option<Measured>,
}

impl FarMoves {
    /// Of a subject from what it makes of the undisturbed scene.
    ///
    /// # Errors
    /// As [`Subject::denoise`].
    pub fn new(subject: &mut Subject, scene: &Scene, unit: Unit) -> Result<Self> {
        let (what, bound) = match (subject.exactness(), unit) {
            (Exactness::Single, Unit::Value) => ("far pixels move, of value + 1e-3 key", FAR),
            (Exactness::Single, Unit::Key) => ("far pixels move, of the key", FAR),
            (Exactness::Half, Unit::Value) => {
                ("far pixels move, of 1 % of value + 1e-3 key and twice the tier's own error", 1.0)
            }
            (Exactness::Half, Unit::Key) => ("far pixels move, of 1 % of the key and twice the tier's own error", 1.0),
        };
        let shown = Measured::new("far pixels, tone-mapped dB to the undisturbed", Bound::AtLeast(FAR_DB));
        let clean = subject.denoise_undisturbed(scene)?;
        let whole = match subject.as_engine() {
            Some(engine) => engine.against_whole(scene)?,
            None => None,
        };
        Ok(Self {
            unit,
            key: scene.key()?,
            clean,
            whole,
            halves: subject.in_single(scene)?.map(|single| (single, shown)),
            moved: Measured::new(what, Bound::AtMost(bound)),
        })
    }

    /// What the subject makes of the undisturbed scene.
    pub fn clean(&self) -> &[f32] {
        &self.clean
    }

    /// Takes in what it makes of the disturbed one; `is_far` tells the samples that count.
    ///
    /// # Errors
    /// None for outputs of the scene's size.
    pub fn take(&mut self, output: &[f32], is_far: impl Fn(usize) -> bool, input: impl fmt::Display) -> Result<()> {
        let (unit, key) = (self.unit, self.key);
        let moved = unit.largest(output, &self.clean, key, &is_far);
        let Some((single, shown)) = &mut self.halves else {
            self.moved.take(moved, input);
            return Ok(());
        };
        let exposure = 0.18 / key;
        let apart = |a: f64, b: f64| ((exposure * a).ln_1p() - (exposure * b).ln_1p()).abs();
        let own = largest(&self.clean, single, &is_far, apart);
        let share = |a: f64, b: f64| {
            // A small move in the log domain.
            let allowed = FAR * unit.at(b, key) * exposure / (1.0 + exposure * b);
            apart(a, b) / (allowed + 2.0 * own)
        };
        let share = largest(output, &self.clean, &is_far, share);
        self.moved.take(share, format!("{moved:.1e} of the unit, own {own:.1e} in the log domain, {input}"));
        let far = |values: &[f32]| (0..values.len()).filter(|i| is_far(*i)).map(|i| values[i]).collect::<Vec<_>>();
        shown.take(tone_mapped_db(&far(output), &far(&self.clean), self.key)?, input);
        Ok(())
    }

    /// What was found.
    pub fn figures(self) -> impl Iterator<Item = Measured> {
        std::iter::once(self.moved).chain(self.halves.map(|(_, shown)| shown)).chain(self.whole)
    }
}

/// Tone-mapped dB between two lists of pixels of a frame.
///
/// # Errors
/// Where their lengths differ.
pub fn tone_mapped_db(a: &[f32], b: &[f32], key: f64) -> Result<f64> {
    let line = Extent::new((a.len() / 3) as u32, 1);
    Ok(Comparison::new(line, a, b)?.tone_mapped_db((0.18 / key) as f32))
}

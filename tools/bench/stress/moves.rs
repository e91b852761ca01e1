//! How far a result lies from the undisturbed one, and how far it may.
//!
//! In 32-bit floats a move is what the disturbance did. Where maps or factors are rounded to halves, a change of 1e-7 anywhere
//! rounds some of them the other way, and the result moves by about as much as the tier is off without any disturbance: of a
//! pixel next to black more than 1 %. Both results are off by that much, so such a tier may move by twice its own largest
//! error beside, and what a screen shows is held to a bound of its own.

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
    /// The largest `|a - b|` in this unit of the samples that `counts` picks.
    pub fn largest(self, output: &[f32], clean: &[f32], key: f64, counts: impl Fn(usize) -> bool) -> f64 {
        let moves = output.iter().zip(clean).enumerate().filter(|(i, _)| counts(*i)).map(|(_, (&a, &b))| {
            let (a, b) = (f64::from(a), f64::from(b));
            let unit = if self == Self::Value { b + 1e-3 * key } else { key };
            (a - b).abs() / unit
        });
        // Not `f64::max`: that would forgive a NaN.
        moves.fold(0.0, |worst, m| if m > worst || m.is_nan() { m } else { worst })
    }
}

/// How the pixels far from disturbances move.
pub struct FarMoves {
    unit: Unit,
    key: f64,
    clean: Vec<f32>,
    /// Tiers with halves: the same of 32-bit floats, and what is shown of a move.
    halves: Option<(Vec<f32>, Measured)>,
    moved: Measured,
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
                ("far pixels move, of (1 % + twice the tier's own error) of value + 1e-3 key", 1.0)
            }
            (Exactness::Half, Unit::Key) => ("far pixels move, of (1 % + twice the tier's own error) of the key", 1.0),
        };
        let shown = Measured::new("far pixels, tone-mapped dB to the undisturbed", Bound::AtLeast(FAR_DB));
        Ok(Self {
            unit,
            key: scene.key()?,
            clean: subject.denoise_undisturbed(scene)?,
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
        let moved = self.unit.largest(output, &self.clean, self.key, &is_far);
        let Some((single, shown)) = &mut self.halves else {
            self.moved.take(moved, input);
            return Ok(());
        };
        let own = self.unit.largest(&self.clean, single, self.key, &is_far);
        self.moved.take(moved / (FAR + 2.0 * own), format!("{moved:.1e}, own {own:.1e}, {input}"));
        let far = |values: &[f32]| (0..values.len()).filter(|i| is_far(*i)).map(|i| values[i]).collect::<Vec<_>>();
        shown.take(tone_mapped_db(&far(output), &far(&self.clean), self.key)?, input);
        Ok(())
    }

    /// What was found.
    pub fn figures(self) -> impl Iterator<Item = Measured> {
        std::iter::once(self.moved).chain(self.halves.map(|(_, shown)| shown))
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

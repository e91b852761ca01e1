//! Inputs that try to break a denoiser, and what each may do to its result.
//!
//! `vkdenoise-bench stress` runs everything and prints a matrix; the tests run a sample of the same cases. A case is a
//! function from a subject (a tier of the engine, or a peer behind a pipe) to figures, each with its bound.

#![allow(dead_code, reason = "the tests and the benchmark each use a part")]
#![allow(clippy::duplicate_mod, reason = "the tests have the random numbers twice")]

pub mod bad_pixels;
pub mod content;
pub mod left_out;
pub mod light;
pub mod moves;
pub mod neutral;
#[path = "../../../tests/common/random.rs"]
pub mod random;
pub mod scene;
pub mod sequences;
pub mod shapes;
pub mod subject;
pub mod table;

use std::fmt;
use subject::Subject;

/// What goes wrong beside the figures: the library's errors and a peer's pipe.
pub type Result<T, E = Box<dyn std::error::Error + Send + Sync>> = std::result::Result<T, E>;

/// How much to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// What the test suite has time for.
    Sample,
    /// Every value, place and size.
    Everything,
}

/// Where a figure must lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// At most this.
    AtMost(f64),
    /// At least this.
    AtLeast(f64),
}

impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AtMost(end) => write!(f, "≤ {}", number(*end)),
            Self::AtLeast(end) => write!(f, "≥ {}", number(*end)),
        }
    }
}

/// What answers for a figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Depends {
    /// The engine with the network that ships, or with any other: the tests hold it to the bound.
    Engine,
    /// How well the network was trained: the tests do not.
    Weights,
}

/// The worst figure of a case.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// What the figure is.
    pub what: &'static str,
    /// What answers for it.
    pub depends: Depends,
    /// Where it must lie.
    pub bound: Bound,
    /// The figure.
    pub value: f64,
    /// The input that caused it.
    pub worst: String,
}

impl Measured {
    /// No figure yet.
    pub fn new(what: &'static str, bound: Bound) -> Self {
        let value = match bound {
            Bound::AtMost(_) => f64::NEG_INFINITY,
            Bound::AtLeast(_) => f64::INFINITY,
        };
        Self { what, depends: Depends::Engine, bound, value, worst: String::new() }
    }

    /// The same, where the network's training answers for it.
    pub fn by_weights(self) -> Self {
        Self { depends: Depends::Weights, ..self }
    }

    /// Takes a figure in; the worst one stays, a NaN above all.
    pub fn take(&mut self, value: f64, input: impl fmt::Display) {
        let worse = match self.bound {
            Bound::AtMost(_) => value > self.value,
            Bound::AtLeast(_) => value < self.value,
        };
        if worse || (value.is_nan() && !self.value.is_nan()) {
            self.value = value;
            self.worst = input.to_string();
        }
    }

    /// Whether the figure is inside its bound; a NaN is not.
    pub fn is_within(&self) -> bool {
        match self.bound {
            Bound::AtMost(end) => self.value <= end,
            Bound::AtLeast(end) => self.value >= end,
        }
    }

    /// The figure, the input that caused it, and a word where it is outside its bound.
    pub fn shown(&self) -> String {
        let word = if self.is_within() { "" } else { "BROKEN " };
        let cause = if self.worst.is_empty() { String::new() } else { format!(" ({})", self.worst) };
        format!("{word}{}{cause}", number(self.value))
    }
}

fn number(value: f64) -> String {
    if value == 0.0 || (1e-2..1e4).contains(&value.abs()) {
        let text = format!("{value:.3}");
        let text = text.trim_end_matches('0').trim_end_matches('.');
        return text.into();
    }
    format!("{value:.1e}")
}

/// A case by name, and how it is run.
#[derive(Clone, Copy)]
pub struct Case {
    /// What is done to the input.
    pub name: &'static str,
    /// Measures a subject. Empty where the case does not concern it.
    pub run: fn(&mut Subject, Effort) -> Result<Vec<Measured>>,
}

/// All cases, in the matrix's order.
pub fn cases() -> Vec<Case> {
    [bad_pixels::CASES, neutral::CASES, light::CASES, content::CASES, shapes::CASES, sequences::CASES]
        .into_iter()
        .flatten()
        .map(|&(name, run)| Case { name, run })
        .collect()
}

impl Case {
    /// Measures a subject; of a tier that leaves converged squares out, also what it left out.
    ///
    /// # Errors
    /// As [`Subject::denoise`].
    pub fn measure(&self, subject: &mut Subject, effort: Effort) -> Result<Vec<Measured>> {
        let mut figures = (self.run)(subject, effort)?;
        figures.extend(subject.take_left_out().figures(!bad_pixels::spoils_every_square(self.name)));
        Ok(figures)
    }
}

/// A list of named cases.
pub type Cases = &'static [(&'static str, fn(&mut Subject, Effort) -> Result<Vec<Measured>>)];

/// How many samples are NaN, infinite or negative.
pub fn bad_samples(output: &[f32]) -> f64 {
    output.iter().filter(|v| !(v.is_finite() && **v >= 0.0)).count() as f64
}

/// A figure that counts the samples that are not finite and at least 0.
pub fn sound() -> Measured {
    Measured::new("samples that are not finite and ≥ 0", Bound::AtMost(0.0))
}

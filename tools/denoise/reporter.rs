//! Where what is said goes: results to standard output, everything else to standard error, both beside a progress bar.

use crate::Failure;
use crate::args::Args;
use crate::jobs::Job;
use crate::report::{Outcome, left_json, selection_text};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use vkdenoise::exr_io::Selection;

/// What an image counts for on the bar.
const OF_AN_IMAGE: u64 = 1000;

/// Says what happens to each image; shared by the devices.
pub struct Reporter {
    /// In thousandths of an image.
    bar: ProgressBar,
    images: usize,
    begun: AtomicUsize,
    quiet: bool,
    json: bool,
}

impl Reporter {
    /// For so many images. The bar is shown on a terminal only.
    pub fn new(args: &Args, images: usize) -> Self {
        let bar = if args.quiet { ProgressBar::hidden() } else { ProgressBar::new(images as u64 * OF_AN_IMAGE) };
        if !args.quiet {
            if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed_precise} {wide_bar} {percent} % {msg}")
            {
                bar.set_style(style);
            }
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Self { bar, images, begun: AtomicUsize::new(0), quiet: args.quiet, json: args.json }
    }

    /// An image is begun; it ends with what is returned, well or not.
    pub fn begin(&self, job: &Job) -> Share<'_> {
        let number = 1 + self.begun.fetch_add(1, Ordering::Relaxed);
        self.bar.set_message(format!("{number} of {}: {}", self.images, job.input.display()));
        Share { bar: &self.bar, told: 0 }
    }

    /// An image is left out or failed before it was begun.
    pub fn pass_over(&self) {
        self.begun.fetch_add(1, Ordering::Relaxed);
        self.bar.inc(OF_AN_IMAGE);
    }

    /// All images are done with.
    pub fn finish(&self) {
        self.bar.finish_and_clear();
    }

    /// What an image was read from.
    pub fn selection(&self, job: &Job, selection: &Selection) {
        self.say(|| selection_text(job, selection));
    }

    /// What was done with an image.
    pub fn done(&self, outcome: &Outcome) -> Result<(), Failure> {
        self.say(|| outcome.summary());
        let line = if self.json { Some(outcome.json().map_err(Failure::failed)?) } else { outcome.figures_text() };
        line.map_or(Ok(()), |line| self.print(&line))
    }

    /// An image failed; with `aloud` that is said on standard error too.
    pub fn failed(&self, job: &Job, message: &str, aloud: bool) -> Result<(), Failure> {
        if aloud {
            self.bar.suspend(|| eprintln!("vkdenoise: {message}"));
        }
        self.left(job, Some(message))
    }

    /// An image is left out, as its output is there.
    pub fn skipped(&self, job: &Job) -> Result<(), Failure> {
        self.say(|| format!("{}: there already", job.output));
        self.left(job, None)
    }

    fn left(&self, job: &Job, error: Option<&str>) -> Result<(), Failure> {
        match self.json {
            true => self.print(&left_json(job, error).map_err(Failure::failed)?),
            false => Ok(()),
        }
    }

    /// Something that a person may want to know.
    pub fn say(&self, text: impl FnOnce() -> String) {
        if !self.quiet {
            self.bar.suspend(|| eprintln!("{}", text()));
        }
    }

    fn print(&self, line: &str) -> Result<(), Failure> {
        self.bar.suspend(|| print_line(line))
    }
}

/// An image's share of the bar.
pub struct Share<'a> {
    bar: &'a ProgressBar,
    told: u64,
}

impl Share<'_> {
    /// So much of the image is done, from 0 to 1.
    pub fn tell(&mut self, done: f64) {
        let done = ((done * OF_AN_IMAGE as f64) as u64).clamp(self.told, OF_AN_IMAGE);
        self.bar.inc(done - std::mem::replace(&mut self.told, done));
    }
}

impl Drop for Share<'_> {
    fn drop(&mut self) {
        self.bar.inc(OF_AN_IMAGE - self.told);
    }
}

/// Prints a line on standard output, which may have been closed.
pub fn print_line(line: &str) -> Result<(), Failure> {
    let mut out = std::io::stdout().lock();
    let written = writeln!(out, "{line}").and_then(|()| out.flush());
    written.map_err(|error| Failure::Failed(format!("cannot write to standard output: {error}")))
}

//! All images, shared out among the devices.

use crate::args::Args;
use crate::jobs::{Job, Plan};
use crate::reporter::Reporter;
use crate::session::{Session, Trouble};
use crate::{Failure, devices, interrupt};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use vkdenoise::Weights;
use vkdenoise::exr_io::WriteCheck;

/// Does all jobs. One that fails does not keep the others from being done.
pub fn run(args: &Args, plan: &Plan) -> Result<(), Failure> {
    let weights = match &args.weights {
        Some(file) => {
            Weights::from_file(file).map_err(|error| Failure::Failed(format!("{}: {error}", file.display())))?
        }
        None => args.quality.weights().map_err(Failure::failed)?,
    };
    let reporter = Reporter::new(args, plan.jobs.len());
    plan.notes.iter().for_each(|note| reporter.say(|| note.clone()));
    let result = Run { args, weights: &weights, reporter: &reporter, jobs: &plan.jobs, failed: Mutex::default() }.all();
    reporter.finish();
    result
}

struct Run<'a> {
    args: &'a Args,
    weights: &'a Weights,
    reporter: &'a Reporter,
    jobs: &'a [Job],
    failed: Mutex<Failed>,
}

/// What came of the images so far.
#[derive(Default)]
struct Failed {
    /// Images that were written.
    written: usize,
    /// Images that could not be done.
    images: usize,
    /// Of these, those that do not have what the command line asks for.
    usage: usize,
    /// The message of an only image.
    message: String,
    /// Why no image can be done.
    everything: Option<Failure>,
    /// Whether images were left out as it was told to stop.
    interrupted: bool,
}

impl Run<'_> {
    fn all(&self) -> Result<(), Failure> {
        let ready = self.ready()?;
        // The first image is begun on the first device, so that a fault in the command line opens no other.
        let selectors =
            if ready.len() > 1 { devices::wanted(self.args)? } else { devices::wanted(self.args)?[..1].to_vec() };
        let next = AtomicUsize::new(0);
        let take = || {
            let job = ready.get(next.fetch_add(1, Ordering::Relaxed)).copied()?;
            if interrupt::stopped() {
                self.note(job, Err(Trouble::Interrupted));
            }
            self.goes_on().then_some(job)
        };
        std::thread::scope(|scope| {
            for selector in selectors {
                let mut session = Session::new(self.args, self.weights, selector, self.reporter);
                scope.spawn(move || {
                    while let Some(job) = take() {
                        let mut share = self.reporter.begin(job);
                        self.note(job, session.denoise(job, &mut share));
                    }
                });
            }
        });
        self.sum_up()
    }

    /// The images that are to be denoised: their output is not there yet, or need not be, and can be written.
    fn ready(&self) -> Result<Vec<&Job>, Failure> {
        let mut ready = Vec::with_capacity(self.jobs.len());
        let mut check = WriteCheck::default();
        for job in self.jobs {
            let there =
                |path: &std::path::Path| std::fs::metadata(path).is_ok_and(|file| file.is_file() && file.len() > 0);
            if self.args.skip_existing && job.output.file().is_some_and(there) {
                self.reporter.skipped(job)?;
                self.reporter.pass_over();
                continue;
            }
            let mut files = job.output.file().into_iter().chain(job.png.as_deref());
            match files.try_for_each(|file| check.check(file)) {
                Ok(()) => ready.push(job),
                Err(error) => {
                    self.note(job, Err(error.into()));
                    self.reporter.pass_over();
                }
            }
        }
        Ok(ready)
    }

    fn goes_on(&self) -> bool {
        let failed = self.failed.lock().unwrap_or_else(PoisonError::into_inner);
        failed.everything.is_none() && !failed.interrupted
    }

    fn note(&self, job: &Job, result: Result<(), Trouble>) {
        let all = self.jobs.len();
        let mut failed = self.failed.lock().unwrap_or_else(PoisonError::into_inner);
        let (message, usage) = match result {
            Ok(()) => {
                failed.written += 1;
                return;
            }
            Err(Trouble::Image(message)) => (message, false),
            Err(Trouble::Usage(message)) => (message, true),
            Err(Trouble::Everything(failure)) => {
                failed.everything.get_or_insert(failure);
                return;
            }
            Err(Trouble::Interrupted) => {
                failed.interrupted = true;
                return;
            }
        };
        // What is to be said of an only image is said at the end.
        let told = self.reporter.failed(job, &message, all > 1);
        failed.images += 1;
        failed.usage += usize::from(usage);
        failed.message = message;
        if let Err(failure) = told {
            failed.everything.get_or_insert(failure);
        }
    }

    fn sum_up(&self) -> Result<(), Failure> {
        let mut failed = self.failed.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(failure) = failed.everything.take() {
            return Err(failure);
        }
        let Failed { images, usage, written, interrupted, .. } = *failed;
        if interrupted {
            let all = self.jobs.len();
            return Err(Failure::Interrupted(format!("interrupted: {written} of {all} images are written")));
        }
        let message = match self.jobs.len() {
            1 => std::mem::take(&mut failed.message),
            all => format!("{images} of {all} images failed"),
        };
        match images {
            0 => Ok(()),
            _ if usage == self.jobs.len() => Err(Failure::Usage(message)),
            _ if images == self.jobs.len() => Err(Failure::Failed(message)),
            _ => Err(Failure::Some(message)),
        }
    }
}

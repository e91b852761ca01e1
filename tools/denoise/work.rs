//! Denoises the images one after another, all with one denoiser.

use crate::args::Args;
use crate::jobs::Job;
use crate::report::{Figures, Outcome, print_line, selection_text};
use crate::{Failure, interrupt, preview};
use indicatif::{ProgressBar, ProgressStyle};
use std::time::Duration;
use vkdenoise::exr_io::{ExrError, ExrFrame, LayerOptions};
use vkdenoise::{
    Denoiser, Device, DeviceOptions, DeviceSelector, Error, Extent, Layout, Options, PlaneMut, Precision, Weights,
};

/// Does all jobs. One that fails does not keep the others from being done.
pub fn run(args: &Args, jobs: &[Job]) -> Result<(), Failure> {
    let weights = match &args.weights {
        Some(file) => {
            Weights::from_file(file).map_err(|error| Failure::Failed(format!("{}: {error}", file.display())))?
        }
        None => args.quality.weights().map_err(Failure::failed)?,
    };
    let mut session = Session { args, weights, engine: None, bar: bar(args, jobs.len()) };
    let mut failed = 0;
    for job in jobs {
        match session.denoise(job) {
            Ok(()) => {}
            Err(Trouble::Image(message)) if jobs.len() == 1 => return Err(Failure::Failed(message)),
            Err(Trouble::Image(message)) => {
                failed += 1;
                session.bar.suspend(|| eprintln!("vkdenoise: {message}"));
            }
            Err(Trouble::Everything(failure)) => return Err(failure),
        }
        session.bar.inc(1);
    }
    session.bar.finish_and_clear();
    if failed == 0 {
        return Ok(());
    }
    Err(Failure::Failed(format!("{failed} of {} images failed", jobs.len())))
}

/// Shown on a terminal only.
fn bar(args: &Args, jobs: usize) -> ProgressBar {
    if args.quiet {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(jobs as u64);
    if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed_precise} {wide_bar} {pos}/{len} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(Duration::from_millis(200));
    bar
}

enum Trouble {
    /// This image cannot be done.
    Image(String),
    /// No image can be done.
    Everything(Failure),
}

impl From<ExrError> for Trouble {
    /// These errors name their file.
    fn from(error: ExrError) -> Self {
        Self::Image(error.to_string())
    }
}

struct Session<'a> {
    args: &'a Args,
    weights: Weights,
    engine: Option<Engine>,
    bar: ProgressBar,
}

struct Engine {
    device: Device,
    denoiser: Denoiser,
}

impl Engine {
    /// For images of about `extent`.
    fn open(args: &Args, weights: &Weights, extent: Extent) -> Result<Self, Error> {
        let selector = args.device.clone().or_else(DeviceSelector::from_env).unwrap_or_default();
        let cache = args.cache.clone();
        let device = Device::open_with(&DeviceOptions { selector, cache, ..DeviceOptions::default() })?;
        let Args { precision, exposure, blend, fireflies, memory_budget, .. } = args;
        let options = Options {
            precision: if *precision == Precision::Auto { args.quality.precision(&device) } else { *precision },
            exposure: *exposure,
            blend: *blend,
            fireflies: *fireflies,
            memory_budget: memory_budget.map(|mib| mib << 20),
            quiet: args.quiet(),
            ..Options::default()
        };
        let mut denoiser = match args.tune {
            true => Denoiser::tuned(&device, weights, &options, extent)?,
            false => Denoiser::new(&device, weights, &options)?,
        };
        denoiser.set_region(args.region);
        Ok(Self { device, denoiser })
    }
}

impl Session<'_> {
    fn denoise(&mut self, job: &Job) -> Result<(), Trouble> {
        self.bar.set_message(job.input.display().to_string());
        let image = ExrFrame::read(&job.input, &job.layers)?;
        let region = self.args.region;
        region.map_or(Ok(()), |region| image.check_region(region))?;
        let reference = job.reference.as_ref().map(|_| read_reference(job, &image)).transpose()?;
        self.say(|| selection_text(job, image.selection()));

        let extent = image.extent();
        // Opened for the first image: by now the arguments and that image have proved good.
        let engine = match &mut self.engine {
            Some(engine) => engine,
            none => none.insert(
                Engine::open(self.args, &self.weights, extent).map_err(|e| Trouble::Everything(Failure::failed(e)))?,
            ),
        };
        let mut color = vec![0.0; image.color().len()];
        let target = PlaneMut::f32(&mut color, Layout::interleaved(extent, 3));
        let of_image = |error: Error| Trouble::Image(format!("{}: {error}", job.input.display()));
        let report = engine.denoiser.denoise(&image.frame(), target).map_err(|error| match error {
            Error::DeviceLost => Trouble::Everything(Failure::Failed(format!("{}: {error}", job.input.display()))),
            error => of_image(error),
        })?;

        {
            let _whole = interrupt::hold_off();
            match region {
                Some(region) => image.write_region(&job.output, &color, region)?,
                None => image.write_with_color(&job.output, &color)?,
            }
        }
        let active = engine.denoiser.active_tiles().cloned();
        let size = region.map_or(extent, |region| Extent::new(region.width, region.height));
        let cut = |image| preview::cut(extent, region, image);
        let (noisy, denoised) = (cut(image.color()), cut(&color));
        let reference = reference.as_ref().map(|reference| cut(reference.color()));
        if let Some(png) = &job.png {
            let dimmed = active.as_ref().map(|active| preview::dim(extent, active, &color));
            let dimmed = dimmed.as_deref().map(|dimmed| preview::cut(extent, region, dimmed));
            let mut images = vec![&*noisy, &*denoised];
            images.extend(reference.as_deref());
            images.extend(dimmed.as_deref());
            let _whole = interrupt::hold_off();
            preview::write(png, size, report.exposure, &images)?;
        }
        let figures = match &reference {
            Some(reference) => {
                let figures = |image| Figures::new(size, image, reference).map_err(of_image);
                Some([figures(&noisy)?, figures(&denoised)?])
            }
            None => None,
        };
        let (info, precision) = (engine.device.info().clone(), engine.denoiser.precision().to_string());
        self.tell(&Outcome {
            job,
            extent,
            region,
            device: &info.name,
            driver: &info.driver,
            network: self.weights.arch().name.clone(),
            precision,
            report: &report,
            active: active.as_ref(),
            selection: image.selection(),
            figures,
        })
        .map_err(Trouble::Everything)
    }

    fn say(&self, text: impl FnOnce() -> String) {
        if !self.args.quiet {
            self.bar.suspend(|| eprintln!("{}", text()));
        }
    }

    fn tell(&self, outcome: &Outcome) -> Result<(), Failure> {
        self.say(|| outcome.summary());
        let line = if self.args.json { Some(outcome.json().map_err(Failure::failed)?) } else { outcome.figures_text() };
        line.map_or(Ok(()), |line| self.bar.suspend(|| print_line(&line)))
    }
}

/// Reads the reference's colour: the layer of the same name if it has one, else by the usual names.
fn read_reference(job: &Job, image: &ExrFrame) -> Result<ExrFrame, Trouble> {
    let path = job.reference.as_deref().unwrap_or(&job.input);
    let named = ExrFrame::read(path, &LayerOptions::color_only(job.layers.layer.clone()));
    let reference = match named {
        Err(ExrError::NoLayer { .. }) if job.layers.layer.is_some() => {
            ExrFrame::read(path, &LayerOptions::color_only(None))
        }
        other => other,
    }?;
    let (wanted, found) = (image.extent(), reference.extent());
    if found != wanted {
        let sizes =
            format!("{} x {} pixels, the image {} x {}", found.width, found.height, wanted.width, wanted.height);
        return Err(Trouble::Image(format!("reference {} has {sizes}", path.display())));
    }
    Ok(reference)
}

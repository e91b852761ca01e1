//! One image after another, all with one denoiser on one device.

use crate::args::Args;
use crate::jobs::{Job, Output};
use crate::report::{Figures, Outcome};
use crate::reporter::{Reporter, Share};
use crate::{Failure, interrupt, preview};
use std::borrow::Cow;
use std::io::{Cursor, Write};
use std::ops::ControlFlow;
use vkdenoise::exr_io::{ExrError, ExrFrame, ExrOutput, ExrSignal, LayerOptions};
use vkdenoise::{
    ActiveTiles, Denoiser, Device, DeviceOptions, DeviceSelector, Error, Extent, Layout, Options, Plane, PlaneMut,
    Precision, Progress, Report, Signal, Weights,
};

/// Why an image is not done.
pub enum Trouble {
    /// This image cannot be done.
    Image(String),
    /// The command line asks for something that this image does not have.
    Usage(String),
    /// No image can be done.
    Everything(Failure),
    /// It was told to stop.
    Interrupted,
}

impl From<ExrError> for Trouble {
    /// These errors name their file.
    fn from(error: ExrError) -> Self {
        match error {
            ExrError::Region { .. } => Self::Usage(error.to_string()),
            error => Self::Image(error.to_string()),
        }
    }
}

/// Denoises on one device, which is opened for the first image.
pub struct Session<'a> {
    args: &'a Args,
    weights: &'a Weights,
    selector: DeviceSelector,
    engine: Option<Engine>,
    reporter: &'a Reporter,
}

struct Engine {
    device: Device,
    denoiser: Denoiser,
}

impl Engine {
    /// Opens the device.
    fn open(args: &Args, weights: &Weights, selector: &DeviceSelector) -> Result<Self, Error> {
        let (selector, cache) = (selector.clone(), args.cache.clone());
        let device = Device::open_with(&DeviceOptions { selector, cache, ..DeviceOptions::default() })?;
        let Args { precision, exposure, blend, fireflies, clean_aux, memory_budget, .. } = args;
        let options = Options {
            precision: if *precision == Precision::Auto { args.quality.precision(&device) } else { *precision },
            exposure: *exposure,
            blend: *blend,
            fireflies: *fireflies,
            clean_aux: *clean_aux,
            memory_budget: memory_budget.map(|mib| mib << 20),
            converged: args.converged(),
            self_ensemble: args.quality.self_ensemble(),
            signals: !args.signals().is_empty(),
            ..Options::default()
        };
        let mut denoiser = Denoiser::new(&device, weights, &options)?;
        denoiser.set_region(args.region);
        Ok(Self { device, denoiser })
    }
}

/// One view of an image, denoised.
struct Done<'a> {
    frame: &'a ExrFrame,
    color: Vec<f32>,
    /// Of each of the frame's signals.
    signals: Vec<Vec<f32>>,
    reference: Option<ExrFrame>,
    report: Report,
    active: Option<ActiveTiles>,
}

impl<'a> Session<'a> {
    pub fn new(args: &'a Args, weights: &'a Weights, selector: DeviceSelector, reporter: &'a Reporter) -> Self {
        Self { args, weights, selector, engine: None, reporter }
    }

    /// Denoises all views of an image, writes them, and says so.
    pub fn denoise(&mut self, job: &Job, share: &mut Share) -> Result<(), Trouble> {
        let views = ExrFrame::read_views(&job.input, &job.layers)?;
        let region = self.args.region;
        let mut references = Vec::new();
        for view in &views {
            region.map_or(Ok(()), |region| view.check_region(region))?;
            references.push(job.reference.as_ref().map(|_| read_reference(job, view)).transpose()?);
            self.reporter.selection(job, view.selection());
        }
        if job.png.is_some() && views.iter().any(|view| view.extent() != views[0].extent()) {
            let input = job.input.display();
            return Err(Trouble::Usage(format!("--png: the views of {input} differ in size; choose one with --view")));
        }
        let mut done = Vec::with_capacity(views.len());
        for (at, (frame, reference)) in views.iter().zip(references).enumerate() {
            let mut progress = |done: f32| {
                share.tell((at as f64 + f64::from(done)) / views.len() as f64);
                if interrupt::stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            };
            done.push(self.denoise_view(job, frame, reference, &mut progress)?);
        }
        self.write(job, &done)?;
        for view in &done {
            self.report(job, view)?;
        }
        Ok(())
    }

    fn denoise_view<'v>(
        &mut self,
        job: &Job,
        frame: &'v ExrFrame,
        reference: Option<ExrFrame>,
        progress: &mut Progress,
    ) -> Result<Done<'v>, Trouble> {
        let extent = frame.extent();
        // Opened for the first image: by now the arguments and that image have proved good.
        let engine = match &mut self.engine {
            Some(engine) => engine,
            none => {
                let opened = Engine::open(self.args, self.weights, &self.selector);
                none.insert(opened.map_err(|e| Trouble::Everything(Failure::failed(e)))?)
            }
        };
        let mut color = vec![0.0; frame.color().len()];
        let target = PlaneMut::f32(&mut color, Layout::interleaved(extent, 3));
        let mut signals: Vec<Vec<f32>> = frame.signals().iter().map(|s| vec![0.0; s.samples().len()]).collect();
        let mut planes: Vec<Signal> =
            frame.signals().iter().zip(&mut signals).map(|(signal, out)| planes(extent, signal, out)).collect();
        let report =
            engine.denoiser.denoise_with(&frame.frame(), target, &mut planes, Some(progress)).map_err(|error| {
                let message = format!("{}: {error}", job.input.display());
                match error {
                    Error::Cancelled => Trouble::Interrupted,
                    Error::DeviceLost => Trouble::Everything(Failure::Failed(message)),
                    _ => Trouble::Image(message),
                }
            })?;
        frame.keep_empty(&mut color);
        for (signal, values) in frame.signals().iter().zip(&mut signals) {
            frame.keep_empty_signal(signal, values);
        }
        Ok(Done { frame, color, signals, reference, report, active: engine.denoiser.active_tiles().cloned() })
    }

    fn write(&self, job: &Job, done: &[Done]) -> Result<(), Trouble> {
        let pictures: Vec<(&ExrFrame, &[f32])> = done.iter().map(|done| (done.frame, done.color.as_slice())).collect();
        let mut output = ExrOutput::new(&pictures, self.args.region)?;
        for view in done {
            output = output.with_signals(view.frame, &view.signals)?;
        }
        match &job.output {
            Output::File(path) => {
                let _whole = interrupt::hold_off();
                output.write(path)?;
            }
            Output::Standard => {
                let mut bytes = Cursor::new(Vec::new());
                let told = |error| Trouble::Image(format!("cannot write to standard output: {error}"));
                output.write_to(&mut bytes).map_err(told)?;
                let mut out = std::io::stdout().lock();
                out.write_all(bytes.get_ref()).and_then(|()| out.flush()).map_err(told)?;
            }
        }
        let (Some(png), Some(first)) = (&job.png, done.first()) else { return Ok(()) };
        let images: Vec<Cow<[f32]>> = done.iter().flat_map(|view| self.shown(view)).collect();
        let images: Vec<&[f32]> = images.iter().map(AsRef::as_ref).collect();
        let _whole = interrupt::hold_off();
        preview::write(png, self.size(first), first.report.exposure, &images)?;
        Ok(())
    }

    /// The images of a view that `--png` has side by side.
    fn shown<'v>(&self, view: &'v Done) -> Vec<Cow<'v, [f32]>> {
        let (extent, region) = (view.frame.extent(), self.args.region);
        let cut = |image| preview::cut(extent, region, image);
        let mut images = vec![cut(view.frame.color()), cut(&view.color)];
        images.extend(view.reference.as_ref().map(|reference| cut(reference.color())));
        if let Some(active) = &view.active {
            let dimmed = preview::dim(extent, active, &view.color);
            images.push(Cow::Owned(preview::cut(extent, region, &dimmed).into_owned()));
        }
        images
    }

    /// The size of what is written of a view.
    fn size(&self, view: &Done) -> Extent {
        self.args.region.map_or(view.frame.extent(), |region| Extent::new(region.width, region.height))
    }

    fn report(&self, job: &Job, view: &Done) -> Result<(), Trouble> {
        let Some(Engine { device, denoiser }) = &self.engine else { return Ok(()) };
        let (extent, region) = (view.frame.extent(), self.args.region);
        let cut = |image| preview::cut(extent, region, image);
        let figures = view.reference.as_ref().map(|reference| {
            let reference = cut(reference.color());
            let figures = |image| Figures::new(self.size(view), &cut(image), &reference);
            Ok([figures(view.frame.color())?, figures(&view.color)?])
        });
        let figures = figures.transpose();
        let figures = figures.map_err(|error: Error| Trouble::Image(format!("{}: {error}", job.input.display())))?;
        let outcome = Outcome {
            job,
            extent,
            region,
            device: &device.info().name,
            driver: &device.info().driver,
            network: &self.weights.arch().name,
            precision: denoiser.precision().to_string(),
            self_ensemble: self.args.quality.self_ensemble(),
            report: &view.report,
            active: view.active.as_ref(),
            selection: view.frame.selection(),
            figures,
        };
        self.reporter.done(&outcome).map_err(Trouble::Everything)
    }
}

/// A signal of a file, and where its result goes.
fn planes<'v>(extent: Extent, signal: &'v ExrSignal, out: &'v mut [f32]) -> Signal<'v> {
    let layout = Layout::interleaved(extent, signal.channels());
    Signal {
        kind: signal.kind(),
        channels: signal.channels() as u32,
        plane: Plane::f32(signal.samples(), layout),
        output: PlaneMut::f32(out, layout),
    }
}

/// Reads the reference's colour: the layer of the same name and view if it has one, else by the usual names.
fn read_reference(job: &Job, image: &ExrFrame) -> Result<ExrFrame, Trouble> {
    let path = job.reference.as_deref().unwrap_or(&job.input);
    let read = |layer: Option<String>, view: Option<String>| {
        ExrFrame::read(path, &LayerOptions { view, ..LayerOptions::color_only(layer) })
    };
    let (layer, view) = (job.layers.layer.clone(), image.selection().view.clone());
    let mut reference = read(layer.clone(), view.clone());
    for (layer, view) in [(None, view), (layer, None), (None, None)] {
        if matches!(reference, Err(ExrError::NoLayer { .. } | ExrError::NoView { .. })) {
            reference = read(layer, view);
        }
    }
    let reference = reference?;
    let (wanted, found) = (image.extent(), reference.extent());
    if found != wanted {
        let sizes =
            format!("{} x {} pixels, the image {} x {}", found.width, found.height, wanted.width, wanted.height);
        return Err(Trouble::Image(format!("reference {} has {sizes}", path.display())));
    }
    Ok(reference)
}

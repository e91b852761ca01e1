//! The class that holds a network on a device.

use crate::alpha::{self, AlphaMode};
use crate::arrays::Input;
use crate::devices::DeviceInfo;
use crate::error::raised;
use crate::layers::Layers;
use crate::output::{Output, as_read, reborrow};
use crate::progress::{Turns, Watcher, ended};
use crate::settings::{self, DeviceChoice, FrameSettings, Settings};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use std::mem::ManuallyDrop;
use std::path::PathBuf;
use std::process;
use std::sync::{Mutex, PoisonError};
use vkdenoise::{Extent, Features, Frame, Noise, NoiseKind, Progress, Region};

/// What one call did.
#[pyclass(frozen, get_all, module = "vkdenoise")]
#[derive(Clone)]
pub struct Report {
    /// The factor on the colour that was used: exposure= of a sequence's other frames keeps it from flickering.
    exposure: f32,
    /// Milliseconds on the device; None where it has no timestamps.
    gpu_ms: Option<f64>,
    /// Milliseconds of the library's whole call: copies, device, wait. The first call of a size also plans, allocates
    /// and compiles.
    total_ms: f64,
    /// Share of the whole frame's work that was done: less than 1 for a region and where something was skipped.
    work: f64,
    /// Memory that the denoiser has on the device, in bytes.
    device_bytes: u64,
    /// Tiles that the frame was cut into to fit the device or the budget; 1: none.
    tiles: usize,
}

impl From<vkdenoise::Report> for Report {
    fn from(report: vkdenoise::Report) -> Self {
        let vkdenoise::Report { exposure, gpu_ms, total_ms, work, device_bytes, tiles, .. } = report;
        Self { exposure, gpu_ms, total_ms, work, device_bytes, tiles: tiles.map_or(1, |tiles| tiles.count) }
    }
}

#[pymethods]
impl Report {
    fn __repr__(&self) -> String {
        let Self { exposure, gpu_ms, total_ms, work, device_bytes, tiles } = self;
        let gpu_ms = gpu_ms.map_or("None".into(), |ms| format!("{ms:.3}"));
        format!(
            "Report(exposure={exposure}, gpu_ms={gpu_ms}, total_ms={total_ms:.3}, work={work:.3}, \
             device_bytes={device_bytes}, tiles={tiles})"
        )
    }
}

/// A network on a device, kept between frames. Threads may share it: their calls take turns.
///
/// Its options are those of `vkdenoise.denoise` that are not a frame's own, with the same errors, and:
///     keep_features  keeps what depends on albedo, normal and depth alone, for `features_unchanged`; more memory.
///     signals        whether frames may come with `light_groups`, `aovs` and `alpha="denoise"`; not with every `weights`.
///     cache          where compiled kernels are kept for the next process: a folder, "user" (vkdenoise in the user's
///                    folder for such files) or "off".
#[pyclass(frozen, module = "vkdenoise")]
pub struct Denoiser {
    inner: ManuallyDrop<Turns>,
    /// Apart from `inner`, which is held for the time of a whole frame.
    report: Mutex<Option<Report>>,
    /// A Vulkan device does not outlive a fork.
    process: u32,
    signals: bool,
    device: DeviceInfo,
    quality: String,
    precision: String,
}

#[pymethods]
impl Denoiser {
    #[new]
    #[pyo3(signature = (*, quality="balanced", weights=None, precision="auto", blend=0.0, clean_aux=false,
        skip_below=None, skip_mode="approximate", memory_budget=None, keep_features=false, signals=false,
        device=None, cache=PathBuf::from("user")))]
    #[allow(clippy::too_many_arguments, reason = "keywords")]
    fn new(
        py: Python<'_>,
        quality: &str,
        weights: Option<PathBuf>,
        precision: &str,
        blend: f32,
        clean_aux: bool,
        skip_below: Option<f32>,
        skip_mode: &str,
        memory_budget: Option<u64>,
        keep_features: bool,
        signals: bool,
        device: Option<DeviceChoice>,
        cache: PathBuf,
    ) -> PyResult<Self> {
        let quality: vkdenoise::Quality = quality.parse().map_err(raised)?;
        let settings = Settings {
            quality,
            weights,
            precision: precision.parse().map_err(raised)?,
            blend,
            clean_aux,
            converged: settings::converged(quality, skip_below, skip_mode.parse().map_err(raised)?),
            memory_budget,
            keep_features,
            signals,
            selector: settings::selector(device)?,
            cache: settings::cache(cache),
        };
        let denoiser = py.detach(|| settings.denoiser()).map_err(raised)?;
        Ok(Self {
            device: DeviceInfo::from(denoiser.device().info()),
            quality: quality.to_string(),
            precision: denoiser.precision().to_string(),
            inner: ManuallyDrop::new(Turns::new(denoiser)),
            report: Mutex::default(),
            process: process::id(),
            signals,
        })
    }

    /// Denoises a frame.
    ///
    /// Its planes and options, what it returns and its errors are those of `vkdenoise.denoise`, and:
    ///     features_unchanged  albedo, normal and depth are those of the last call without this, and not looked at, for
    ///                         less work and the same bits; for denoisers made with `keep_features`. After a call that
    ///                         was cancelled they have to be given once more.
    /// `light_groups`, `aovs` and `alpha="denoise"` are for denoisers made with `signals`.
    #[pyo3(signature = (color, albedo=None, normal=None, depth=None, *, out=None, exposure=None, fireflies="auto",
        region=None, variance=None, samples=None, features_unchanged=false, light_groups=None, aovs=None, alpha="keep",
        progress=None))]
    #[allow(clippy::too_many_arguments, reason = "keywords")]
    fn denoise<'py>(
        &self,
        py: Python<'py>,
        color: &Bound<'py, PyAny>,
        albedo: Option<&Bound<'py, PyAny>>,
        normal: Option<&Bound<'py, PyAny>>,
        depth: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
        exposure: Option<f32>,
        fireflies: &str,
        region: Option<[i64; 4]>,
        variance: Option<&Bound<'py, PyAny>>,
        samples: Option<&Bound<'py, PyAny>>,
        features_unchanged: bool,
        light_groups: Option<&Bound<'py, PyAny>>,
        aovs: Option<&Bound<'py, PyAny>>,
        alpha: &str,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.check_process()?;
        let settings = FrameSettings::new(exposure, fireflies, region, features_unchanged)?;
        let color = Input::color(color)?;
        let vectors = |name, plane: Option<_>| plane.map(|plane| Input::vectors(name, plane, &color)).transpose();
        let scalars = |name, plane: Option<_>| plane.map(|plane| Input::scalars(name, plane, &color)).transpose();
        let (albedo, normal) = (vectors("albedo", albedo)?, vectors("normal", normal)?);
        let depth = scalars("depth", depth)?;
        let (noise, kind) = match (scalars("variance", variance)?, scalars("samples", samples)?) {
            (Some(_), Some(_)) => {
                return Err(PyValueError::new_err("both variance and samples are given; one of them tells the noise"));
            }
            (None, samples) => (samples, NoiseKind::Samples),
            (variance, None) => (variance, NoiseKind::Variance),
        };
        let extent = color.extent()?;
        let mut layers = Layers::new(light_groups, aovs, &color, settings.region)?;
        let alpha = AlphaMode::new(alpha, color.has_alpha())?;
        self.check_signals(!layers.is_empty() || alpha == AlphaMode::Denoise)?;
        let mut watcher = progress.map(Watcher::new).transpose()?;
        let inputs = [Some(&color), albedo.as_ref(), normal.as_ref(), depth.as_ref(), noise.as_ref()];
        let inputs: Vec<_> = inputs.into_iter().flatten().chain(layers.inputs()).collect();
        let mut output = match out {
            Some(out) => Output::given(out, &inputs)?,
            None => Output::new(&color, settings.region)?,
        };
        let part = settings.region.unwrap_or(Region::all(extent));
        let features = Features {
            albedo: albedo.as_ref().map(Input::plane),
            normal: normal.as_ref().map(Input::plane),
            depth: depth.as_ref().map(Input::plane),
            noise: noise.as_ref().map(|noise| Noise { plane: noise.plane(), kind }),
        };
        let frame = Frame { extent, color: color.plane(), features };
        let mut denoised_alpha = match alpha {
            AlphaMode::Denoise => Some(alpha::zeros(extent)?),
            AlphaMode::Keep => None,
        };
        let (has_alpha, mut target, mut signals) = (color.has_alpha(), output.plane(), layers.signals());
        signals.extend(denoised_alpha.as_mut().map(|denoised| alpha::signal(&frame.color, extent, denoised)));
        let report = py.detach(|| -> PyResult<_> {
            let mut denoiser = self.inner.take()?;
            settings.apply(&mut denoiser).map_err(raised)?;
            let mut tell = watcher.as_mut().map(|watcher| |share: f32| watcher.tell(&self.inner, share));
            let progress = tell.as_mut().map(|tell| tell as &mut Progress);
            let done = denoiser.denoise_with(&frame, reborrow(&mut target), &mut signals, progress);
            let report = done.map_err(|error| ended(watcher, error))?;
            drop(denoiser);
            if has_alpha {
                let own = if alpha == AlphaMode::Denoise { signals.pop() } else { None };
                let denoised = own.as_ref().map(|signal| as_read(&signal.output));
                alpha::finish(&frame.color, denoised.as_ref(), extent, part, &mut target, &mut signals);
            }
            Ok(report)
        })?;
        drop(signals);
        *self.report.lock().unwrap_or_else(PoisonError::into_inner) = Some(Report::from(report));
        layers.finish(output.finish(part)?, part)
    }

    /// The device memory that a frame of this size takes, in bytes: nothing is allocated.
    fn memory_required(&self, py: Python<'_>, height: u32, width: u32) -> PyResult<u64> {
        self.check_process()?;
        let required = py.detach(|| self.inner.take()?.memory_required(Extent::new(width, height)).map_err(raised))?;
        Ok(required.host())
    }

    /// What the last call that ended did; None before the first.
    #[getter]
    fn report(&self) -> Option<Report> {
        self.report.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The device that it runs on.
    #[getter]
    fn device(&self) -> DeviceInfo {
        self.device.clone()
    }

    /// "fast", "balanced" or "high".
    #[getter]
    fn quality(&self) -> &str {
        &self.quality
    }

    /// The precision in use: "fp32", "fp16" or "matrix".
    #[getter]
    fn precision(&self) -> &str {
        &self.precision
    }

    fn __repr__(&self) -> String {
        let Self { quality, precision, device, .. } = self;
        format!("Denoiser(quality={quality:?}, precision={precision:?}, device={:?})", device.name())
    }
}

impl Denoiser {
    fn check_process(&self) -> PyResult<()> {
        if self.process == process::id() {
            return Ok(());
        }
        Err(PyRuntimeError::new_err(
            "this Denoiser was made before a fork, and its device stayed with the parent: make a new one here",
        ))
    }

    fn check_signals(&self, wanted: bool) -> PyResult<()> {
        if self.signals || !wanted {
            return Ok(());
        }
        Err(PyValueError::new_err(
            "light_groups, aovs and alpha='denoise' are for denoisers made for them: \
             Denoiser(signals=True)",
        ))
    }
}

impl Drop for Denoiser {
    fn drop(&mut self) {
        if self.process == process::id() {
            // SAFETY: once, here, and nothing reads it afterwards.
            unsafe { ManuallyDrop::drop(&mut self.inner) };
        }
    }
}

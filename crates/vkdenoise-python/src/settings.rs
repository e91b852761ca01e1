//! Keywords as the library's options.

use crate::error::raised;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;
use vkdenoise::{
    Cache, Converged, ConvergedMode, Device, DeviceOptions, DeviceSelector, Exposure, Fireflies, Options, Precision,
    Quality, Region, Weights,
};

/// A device by its index or by part of its name.
#[derive(FromPyObject)]
pub enum DeviceChoice {
    #[pyo3(transparent)]
    Index(i64),
    #[pyo3(transparent)]
    Name(String),
}

impl DeviceChoice {
    fn selector(self) -> PyResult<DeviceSelector> {
        match self {
            Self::Index(index) => usize::try_from(index)
                .map(DeviceSelector::Index)
                .map_err(|_| PyValueError::new_err(format!("device is {index}; an index of devices() is 0 or above"))),
            Self::Name(name) => {
                let Ok(selector) = name.parse();
                Ok(selector)
            }
        }
    }
}

/// What a denoiser is made of, still as it was given.
pub struct Settings {
    pub quality: Quality,
    pub weights: Option<PathBuf>,
    pub precision: Precision,
    pub blend: f32,
    pub clean_aux: bool,
    pub converged: Option<Converged>,
    pub memory_budget: Option<u64>,
    pub keep_features: bool,
    pub signals: bool,
    pub selector: DeviceSelector,
    pub cache: Cache,
}

/// The device of a choice; without one, that of `VKDENOISE_DEVICE`, else the best.
pub fn selector(choice: Option<DeviceChoice>) -> PyResult<DeviceSelector> {
    match choice {
        Some(choice) => choice.selector(),
        None => Ok(DeviceSelector::from_env().unwrap_or_default()),
    }
}

/// What is left out: what `skip_below` says, else what the quality does; 0 is nothing.
pub fn converged(quality: Quality, skip_below: Option<f32>, mode: ConvergedMode) -> Option<Converged> {
    let threshold = skip_below.or_else(|| quality.converged().map(|converged| converged.threshold));
    threshold.filter(|&threshold| threshold != 0.0).map(|threshold| Converged { threshold, mode })
}

/// A folder, or `"user"` or `"off"`.
pub fn cache(folder: PathBuf) -> Cache {
    match folder.to_str() {
        Some(text) => {
            let Ok(cache) = text.parse();
            cache
        }
        None => Cache::Folder(folder),
    }
}

impl Settings {
    /// Opens the device and puts the network on it.
    pub fn denoiser(&self) -> vkdenoise::Result<vkdenoise::Denoiser> {
        let weights = match &self.weights {
            Some(file) => Weights::from_file(file)?,
            None => self.quality.weights()?,
        };
        let device = Device::open_with(&DeviceOptions {
            selector: self.selector.clone(),
            cache: self.cache.clone(),
            ..DeviceOptions::default()
        })?;
        let precision = match self.precision {
            Precision::Auto => self.quality.precision(&device),
            given => given,
        };
        let options = Options {
            precision,
            blend: self.blend,
            clean_aux: self.clean_aux,
            converged: self.converged,
            self_ensemble: self.quality.self_ensemble(),
            memory_budget: self.memory_budget,
            keep_features: self.keep_features,
            signals: self.signals,
            ..Options::default()
        };
        vkdenoise::Denoiser::new(&device, &weights, &options)
    }
}

/// What may differ from frame to frame.
#[derive(Clone, Copy)]
pub struct FrameSettings {
    pub exposure: Exposure,
    pub fireflies: Fireflies,
    pub region: Option<Region>,
    pub features_unchanged: bool,
}

impl FrameSettings {
    /// Of the keywords of a call.
    pub fn new(
        exposure: Option<f32>,
        fireflies: &str,
        region: Option<[i64; 4]>,
        features_unchanged: bool,
    ) -> PyResult<Self> {
        Ok(Self {
            exposure: exposure.map_or(Exposure::Auto, Exposure::Fixed),
            fireflies: fireflies.parse().map_err(raised)?,
            region: region.map(rectangle).transpose()?,
            features_unchanged,
        })
    }

    /// Sets them on a denoiser.
    pub fn apply(&self, denoiser: &mut vkdenoise::Denoiser) -> vkdenoise::Result<()> {
        denoiser.set_exposure(self.exposure)?;
        denoiser.set_fireflies(self.fireflies);
        denoiser.set_region(self.region);
        denoiser.set_features_unchanged(self.features_unchanged);
        Ok(())
    }
}

fn rectangle(region: [i64; 4]) -> PyResult<Region> {
    let [x, y, width, height] = region.map(u32::try_from);
    match (x, y, width, height) {
        (Ok(x), Ok(y), Ok(width), Ok(height)) => Ok(Region { x, y, width, height }),
        _ => Err(PyValueError::new_err(format!(
            "region is {region:?}; give (x, y, width, height) in pixels, none below 0"
        ))),
    }
}

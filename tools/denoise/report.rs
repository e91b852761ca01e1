//! What is said about each image, in words and in JSON.

use crate::jobs::Job;
use serde::Serialize;
use vkdenoise::exr_io::{Selection, UsedLayer};
use vkdenoise::metrics::Comparison;
use vkdenoise::{ActiveTiles, Error, Extent, Part, Region, Report, TileReport};

/// The figures of one image against a reference.
pub struct Figures {
    psnr: f64,
    ssim: Option<f64>,
    rel_mse: f64,
}

impl Figures {
    /// Computes them; all slices interleaved RGB of `extent`.
    pub fn new(extent: Extent, image: &[f32], reference: &[f32]) -> Result<Self, Error> {
        let comparison = Comparison::new(extent, image, reference)?;
        Ok(Self { psnr: comparison.psnr(), ssim: comparison.ssim(), rel_mse: comparison.rel_mse() })
    }
}

/// Everything there is to say about one denoised image.
pub struct Outcome<'a> {
    pub job: &'a Job,
    pub extent: Extent,
    /// What was denoised of it, if not all.
    pub region: Option<Region>,
    pub device: &'a str,
    pub driver: &'a str,
    /// The network's name.
    pub network: &'a str,
    pub precision: String,
    /// Whether two results were to be averaged: those of images in tiles are not.
    pub self_ensemble: bool,
    pub report: &'a Report,
    /// What was denoised, where converged squares are left out.
    pub active: Option<&'a ActiveTiles>,
    pub selection: &'a Selection,
    /// Before and after, if there is a reference.
    pub figures: Option<[Figures; 2]>,
}

#[derive(Serialize)]
struct Layers {
    color: String,
    /// Where the result went, if not into the colour.
    #[serde(skip_serializing_if = "Option::is_none")]
    into: Option<String>,
    albedo: Option<String>,
    normal: Option<String>,
    depth: Option<String>,
    variance: Option<String>,
    samples: Option<String>,
    /// What was denoised beside the colour.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    signals: Vec<String>,
}

/// How much of a part of the network ran.
#[derive(Serialize)]
struct PartRecord {
    stage: String,
    tile_pixels: u32,
    sampled: bool,
    share: f64,
}

/// The fields of `--json`. Figures that are infinite (equal images) or not numbers are null.
#[derive(Serialize)]
struct Record<'a> {
    input: String,
    output: String,
    /// The view, in files that have views.
    #[serde(skip_serializing_if = "Option::is_none")]
    view: Option<&'a str>,
    width: u32,
    height: u32,
    /// Left column, top row, width, height; null without `--region`.
    region: Option<[u32; 4]>,
    /// Share of the whole image's work that was done.
    work: f64,
    /// Share of the squares that were denoised; null without `--skip-below`.
    denoised: Option<f64>,
    /// The parts of the network, each with the share of its tiles that were active.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    active: Vec<PartRecord>,
    device: &'a str,
    driver: &'a str,
    network: &'a str,
    precision: &'a str,
    /// Whether it is the average of two results.
    averaged: bool,
    exposure: f32,
    gpu_ms: Option<f64>,
    total_ms: f64,
    device_bytes: u64,
    /// How it was cut, where it does not fit the device or the budget in whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    tiles: Option<TileRecord>,
    layers: Layers,
    #[serde(flatten)]
    figures: Option<FigureRecord>,
}

/// How an image was cut.
#[derive(Serialize)]
struct TileRecord {
    count: usize,
    /// Pixels that a tile looks at beyond its own.
    margin: u32,
    /// Whether that leaves no seam.
    exact: bool,
}

#[derive(Serialize)]
struct FigureRecord {
    psnr_noisy: f64,
    psnr: f64,
    ssim_noisy: Option<f64>,
    ssim: Option<f64>,
    relmse_noisy: f64,
    relmse: f64,
}

/// What `--json` has of an image that was not denoised.
#[derive(Serialize)]
struct LeftRecord<'a> {
    input: String,
    output: String,
    /// Why it failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<&'a str>,
    /// Whether it was there already.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    skipped: bool,
}

/// One JSON object in one line for an image that was not denoised: as it failed, or as its output was there.
pub fn left_json(job: &Job, error: Option<&str>) -> Result<String, serde_json::Error> {
    let (input, output) = (job.input.display().to_string(), job.output.to_string());
    serde_json::to_string(&LeftRecord { input, output, error, skipped: error.is_none() })
}

impl Outcome<'_> {
    /// One JSON object in one line.
    pub fn json(&self) -> Result<String, serde_json::Error> {
        let name = |layer: &Option<UsedLayer>| layer.as_ref().map(UsedLayer::to_string);
        serde_json::to_string(&Record {
            input: self.job.input.display().to_string(),
            output: self.job.output.to_string(),
            view: self.selection.view.as_deref(),
            width: self.extent.width,
            height: self.extent.height,
            region: self.region.map(|Region { x, y, width, height }| [x, y, width, height]),
            work: self.report.work,
            denoised: self.active.map(|active| active.denoised(self.extent)),
            active: self.active.map_or(Vec::new(), |active| {
                let record = |(at, (part, _)): (usize, &(Part, u32))| PartRecord {
                    stage: part.stage.to_string(),
                    tile_pixels: part.tile_pixels,
                    sampled: part.sampled,
                    share: active.share(at),
                };
                active.parts.iter().enumerate().map(record).collect()
            }),
            device: self.device,
            driver: self.driver,
            network: self.network,
            precision: &self.precision,
            averaged: self.self_ensemble && self.report.tiles.is_none(),
            exposure: self.report.exposure,
            gpu_ms: self.report.gpu_ms,
            total_ms: self.report.total_ms,
            device_bytes: self.report.device_bytes,
            tiles: self.report.tiles.map(|TileReport { count, margin, exact, .. }| TileRecord { count, margin, exact }),
            layers: Layers {
                color: self.selection.color.to_string(),
                into: name(&self.selection.into),
                albedo: name(&self.selection.albedo),
                normal: name(&self.selection.normal),
                depth: name(&self.selection.depth),
                variance: name(&self.selection.variance),
                samples: name(&self.selection.samples),
                signals: self.selection.signals.iter().map(UsedLayer::to_string).collect(),
            },
            figures: self.figures.as_ref().map(|[noisy, denoised]| FigureRecord {
                psnr_noisy: noisy.psnr,
                psnr: denoised.psnr,
                ssim_noisy: noisy.ssim,
                ssim: denoised.ssim,
                relmse_noisy: noisy.rel_mse,
                relmse: denoised.rel_mse,
            }),
        })
    }

    /// The figures before and after, if there is a reference.
    pub fn figures_text(&self) -> Option<String> {
        let [noisy, denoised] = self.figures.as_ref()?;
        let ssim = |figures: &Figures| figures.ssim.map_or("-".into(), |ssim| format!("{ssim:.4}"));
        Some(format!(
            "{}{}: PSNR {:.2} -> {:.2} dB, SSIM {} -> {}, relMSE {:.5} -> {:.5}",
            self.job.input.display(),
            view_text(self.selection),
            noisy.psnr,
            denoised.psnr,
            ssim(noisy),
            ssim(denoised),
            noisy.rel_mse,
            denoised.rel_mse,
        ))
    }

    /// What was written and how long it took.
    pub fn summary(&self) -> String {
        let Outcome { extent: Extent { width, height }, report, .. } = self;
        let gpu = report.gpu_ms.map_or(String::new(), |ms| format!(", {ms:.1} on the device"));
        let part = self.region.map_or(String::new(), |Region { x, y, width, height }| {
            format!("{width} x {height} from ({x}, {y}), {:.1} % of the work, of ", 100.0 * report.work)
        });
        let converged = self.active.map_or(String::new(), |active| {
            let denoised = 100.0 * active.denoised(self.extent);
            format!(", {denoised:.1} % of it denoised for {:.1} % of the work", 100.0 * report.work)
        });
        let tiles = report.tiles.map_or(String::new(), |TileReport { count, margin, .. }| {
            let once = if self.self_ensemble { ", not averaged as --quality high would" } else { "" };
            format!(" in {count} tiles with margins of {margin}{once}")
        });
        format!(
            "{}{}: {part}{width} x {height}{tiles}{converged}, exposure {:.4}, {} {} in {:.1} ms{gpu} ({})",
            self.job.output,
            view_text(self.selection),
            report.exposure,
            self.network,
            self.precision,
            report.total_ms,
            self.device,
        )
    }
}

/// Which view of an image is spoken of.
fn view_text(selection: &Selection) -> String {
    selection.view.as_ref().map_or(String::new(), |view| format!(", view {view}"))
}

/// Which layers an image was read from, one line, and a line for each note.
pub fn selection_text(job: &Job, selection: &Selection) -> String {
    let input = job.input.display();
    let mut text = format!("{input}{}: colour {}", view_text(selection), selection.color);
    for (role, layer) in [("albedo", &selection.albedo), ("normal", &selection.normal), ("depth", &selection.depth)] {
        match layer {
            Some(layer) => text.push_str(&format!(", {role} {layer}")),
            None => text.push_str(&format!(", no {role}")),
        }
    }
    for (role, layer) in [("variance", &selection.variance), ("samples", &selection.samples)] {
        layer.iter().for_each(|layer| text.push_str(&format!(", {role} {layer}")));
    }
    if !selection.signals.is_empty() {
        let names: Vec<String> = selection.signals.iter().map(UsedLayer::to_string).collect();
        text.push_str(&format!("; with it {}", names.join(", ")));
    }
    selection.notes.iter().for_each(|note| text.push_str(&format!("\n{input}: {note}")));
    text
}

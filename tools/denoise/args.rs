//! The command line.

use crate::ranges::Frames;
use clap::{Parser, ValueEnum};
use std::path::PathBuf;
use vkdenoise::exr_io::{AovLayer, FeatureSource, SignalLayers};
use vkdenoise::{Cache, Converged, ConvergedMode, DeviceSelector, Exposure, Fireflies, Precision, Quality, Region};

/// Denoises OpenEXR renders with Vulkan.
///
/// Finds colour, albedo, normal and depth by the names that renderers write and says which it used. The output is the
/// input file with its colour replaced: alpha, other layers, windows and metadata stay; pixels whose colour and alpha
/// are 0 stay 0. Every view of a stereo file is denoised. The output is written beside and renamed, so -o may name the
/// input itself.
///
/// Exit code: 0: all was written; 3: some images failed, the others are written; 1: all failed; 2: the command line is
/// wrong; 130: interrupted.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100)]
pub struct Args {
    /// OpenEXR files, frame patterns (shot.####.exr, shot.%04d.exr) or quoted globs ('shot.*.exr')
    #[arg(value_name = "IN.exr", required_unless_present = "list_devices")]
    pub inputs: Vec<PathBuf>,

    /// File to write, or one with a place for the frame number (den.####.exr), or a directory that exists, where each
    /// output takes its input's name; "-": standard output
    #[arg(short, long, value_name = "OUT", required_unless_present = "list_devices")]
    pub output: Option<PathBuf>,

    /// Which frames of a sequence: 7, 1-100, 1-100x2 (every second), 1-10,20-30. One that is missing counts as failed
    #[arg(long, value_name = "RANGE", value_parser = parsed::<Frames>)]
    pub frames: Option<Frames>,

    /// Leave out images whose output is there already
    #[arg(long)]
    pub skip_existing: bool,

    /// Separate albedo file (or frame pattern); "none": use no albedo
    #[arg(long, value_name = "F", value_parser = feature)]
    pub albedo: Option<FeatureSource>,

    /// Separate normal file (or frame pattern); "none": use no normal
    #[arg(long, value_name = "F", value_parser = feature)]
    pub normal: Option<FeatureSource>,

    /// Separate depth file (or frame pattern); "none": use no depth
    #[arg(long, value_name = "F", value_parser = feature)]
    pub depth: Option<FeatureSource>,

    /// Colour layer by name: a layer (ViewLayer.Combined), a part, a view layer (ViewLayer) or a view
    #[arg(long, value_name = "NAME")]
    pub layer: Option<String>,

    /// Layer to write the result into, by the same names, in place of the one that it is made from
    #[arg(long, value_name = "NAME")]
    pub into: Option<String>,

    /// Layers to denoise beside the colour with its kernels, so that sums hold, each into its own place: red, green and
    /// blue are a part of the light, anything else is averaged as it is. NAME:value or NAME:light says otherwise
    #[arg(long, value_name = "NAME", num_args = 1.., value_parser = parsed::<AovLayer>)]
    pub aov: Vec<AovLayer>,

    /// The same for light groups, found by the names that renderers write (Combined_NAME, RGBA_NAME, Beauty_NAME,
    /// C_NAME, ...): auto or none
    #[arg(long, value_name = "G", default_value = "none")]
    pub light_groups: LightGroups,

    /// What becomes of the colour's alpha: keep it, or denoise it with the colour's kernels
    #[arg(long, value_name = "A", default_value = "keep")]
    pub alpha: Alpha,

    /// View to denoise (left, right, a camera). Without it: all views of the file
    #[arg(long, value_name = "NAME")]
    pub view: Option<String>,

    /// Run time against error: fast, balanced or high. fast is --skip-below 0.02, and on a CPU --precision fp16; high
    /// averages the results of the image and of the image turned by half a circle, in twice the time
    #[arg(long, value_name = "Q", default_value = "balanced", value_parser = parsed::<Quality>)]
    pub quality: Quality,

    /// Weights file (safetensors) in place of the built-in network
    #[arg(long, value_name = "F", conflicts_with = "quality")]
    pub weights: Option<PathBuf>,

    /// Vulkan device: "best", an index of --list-devices, part of a name, or "all": every GPU takes the next image
    /// [env: VKDENOISE_DEVICE]
    #[arg(long, value_name = "D", value_parser = parsed::<DeviceSelector>)]
    pub device: Option<DeviceSelector>,

    /// Arithmetic and storage: auto, fp32, fp16 (feature maps stored as halves, for half of the memory) or matrix
    /// (halves in cooperative matrices, where the device has them)
    #[arg(long, value_name = "P", env = "VKDENOISE_PRECISION", default_value = "auto", value_parser = parsed::<Precision>)]
    pub precision: Precision,

    /// Factor that brings the image to normal brightness, or "auto". Give one for a sequence, lest it flicker, and for
    /// both eyes of a stereo pair
    #[arg(long, value_name = "F", default_value = "auto", allow_hyphen_values = true, value_parser = exposure)]
    pub exposure: Exposure,

    /// Share of the noisy input in the output, from 0 (all denoised) to 1
    #[arg(long, value_name = "A", default_value_t = 0.0, allow_hyphen_values = true, value_parser = share)]
    pub blend: f32,

    /// Lone pixels much brighter than those around: "keep" their light, "mend" them (a path that found a lamp by
    /// chance), or "auto": mend where the image is noisy, keep where it is clean, as stars are
    #[arg(long, value_name = "F", default_value = "auto", value_parser = parsed::<Fireflies>)]
    pub fireflies: Fireflies,

    /// Albedo and normals are free of noise, or were denoised before: take them as they are. Else albedo is filtered
    /// where it is noisy, as in glass and depth of field
    #[arg(long)]
    pub clean_aux: bool,

    /// Most device memory to use, in MiB: an image that needs more is denoised in tiles that overlap
    #[arg(long, value_name = "MIB")]
    pub memory_budget: Option<u64>,

    /// Where to keep compiled kernels for the next run: a folder, "user" (vkdenoise in the user's cache folder) or
    /// "off"
    #[arg(long, value_name = "DIR", env = "VKDENOISE_CACHE", default_value = "user", value_parser = parsed::<Cache>)]
    pub cache: Cache,

    /// Denoise these pixels alone, for part of the work and with the same result: X,Y,W,H, counted from the upper left
    /// corner of the image. The output is the input cropped to them
    #[arg(long, value_name = "X,Y,W,H", allow_hyphen_values = true, value_parser = parsed::<Region>)]
    pub region: Option<Region>,

    /// Leave out what has less relative noise than this: squares of 16x16 pixels that keep their colour, for part of
    /// the work. 0.02 is hardly visible. The noise is estimated, or known from a layer of variance or sample counts. 0,
    /// the default but with --quality fast: denoise all
    #[arg(long, value_name = "NOISE", allow_hyphen_values = true, value_parser = noise)]
    pub skip_below: Option<f32>,

    /// What is left out with them: "approximate" (as much as is hardly visible) or "exact" (what the rest does not
    /// depend on)
    #[arg(long, value_name = "M", default_value = "approximate", value_parser = parsed::<ConvergedMode>)]
    pub skip_mode: ConvergedMode,

    /// Separate file (or frame pattern) of the luminance's variance, for --skip-below; "none": use none
    #[arg(long, value_name = "F", value_parser = feature)]
    pub variance: Option<FeatureSource>,

    /// Separate file (or frame pattern) of sample counts, for --skip-below; "none": use none
    #[arg(long, value_name = "F", value_parser = feature)]
    pub samples: Option<FeatureSource>,

    /// Reference file (or frame pattern): prints PSNR, SSIM and relMSE before and after
    #[arg(long, value_name = "REF.exr")]
    pub reference: Option<PathBuf>,

    /// PNG with the noisy, the denoised and the reference image side by side, and with --skip-below what was left out,
    /// darkened; a directory for several inputs
    #[arg(long, value_name = "PREVIEW.png")]
    pub png: Option<PathBuf>,

    /// Print one JSON object for each view of an image (or each device) on standard output; one that failed has "error"
    #[arg(long)]
    pub json: bool,

    /// Print only errors and what was asked for (JSON, figures)
    #[arg(short, long)]
    pub quiet: bool,

    /// List the Vulkan devices and what each lacks
    #[arg(long, conflicts_with_all = ["inputs", "output"])]
    pub list_devices: bool,
}

/// Which light groups are denoised.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LightGroups {
    /// Those that are by their names
    Auto,
    /// None
    None,
}

/// What becomes of alpha.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Alpha {
    /// It is denoised with the colour's kernels
    Denoise,
    /// It stays as it is
    Keep,
}

/// Parses by the type's own rule and hands on its words.
fn parsed<T: std::str::FromStr<Err: std::fmt::Display>>(text: &str) -> Result<T, String> {
    text.parse().map_err(|error: T::Err| error.to_string())
}

fn feature(text: &str) -> Result<FeatureSource, String> {
    Ok(if text == "none" { FeatureSource::Unused } else { FeatureSource::File(text.into()) })
}

fn exposure(text: &str) -> Result<Exposure, String> {
    if text == "auto" {
        return Ok(Exposure::Auto);
    }
    match text.parse::<f32>() {
        Ok(factor) if factor.is_finite() && factor > 0.0 => Ok(Exposure::Fixed(factor)),
        _ => Err("give \"auto\" or a number above 0".into()),
    }
}

impl Args {
    /// What is denoised beside the colour.
    pub fn signals(&self) -> SignalLayers {
        let (light_groups, alpha) = (self.light_groups == LightGroups::Auto, self.alpha == Alpha::Denoise);
        SignalLayers { aovs: self.aov.clone(), light_groups, alpha }
    }

    /// What is left out as it needs no denoising.
    pub fn converged(&self) -> Option<Converged> {
        let threshold = self.skip_below.or_else(|| self.quality.converged().map(|converged| converged.threshold));
        threshold.filter(|&noise| noise > 0.0).map(|threshold| Converged { threshold, mode: self.skip_mode })
    }
}

fn noise(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(noise) if noise.is_finite() && noise >= 0.0 => Ok(noise),
        _ => Err("give a number, 0 or above".into()),
    }
}

fn share(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        Ok(share) if (0.0..=1.0).contains(&share) => Ok(share),
        _ => Err("give a number from 0 to 1".into()),
    }
}

//! `converged`: what is saved where a part of a frame needs no denoising, and what becomes of the picture.

use crate::stress;
use clap::Args;
use cpu_time::ProcessTime;
use std::path::PathBuf;
use vkdenoise::exr_io::{ExrFrame, LayerOptions};
use vkdenoise::kernels::converged::MAP_TILE;
use vkdenoise::metrics::Comparison;
use vkdenoise::{
    ActiveTiles, Converged, ConvergedMargins, ConvergedMode, Denoiser, Device, DeviceSelector, Error, Extent, Frame,
    Layout, Options, PlaneMut, Weights,
};

/// Arguments of `converged`.
#[derive(Args)]
pub struct ConvergedArgs {
    /// The frame; a layer of variance or sample counts says what is converged, else it is estimated.
    frame: PathBuf,
    /// What it should become.
    #[arg(long)]
    reference: Option<PathBuf>,
    /// Relative noise below which nothing is denoised.
    #[arg(long, default_value_t = 0.025)]
    threshold: f32,
    /// Rules to try: exact, approximate, or margins in pixels of output, decoder 0, 1, 2, bottleneck, encoder 2, 1, 0
    /// and input, as in 0,8,32,64,0,64,32,8,0.
    #[arg(long = "mode", default_values = ["approximate", "exact"], value_parser = mode)]
    modes: Vec<(String, ConvergedMode)>,
    /// Timed rounds; each runs every rule once, in turn.
    #[arg(long, default_value_t = 5)]
    repeat: u32,
    /// Device: an index or part of a name.
    #[arg(long, env = "VKDENOISE_DEVICE", default_value = "best")]
    device: DeviceSelector,
}

fn mode(text: &str) -> Result<(String, ConvergedMode), String> {
    let numbers: Vec<u32> = text.split(',').map_while(|number| number.parse().ok()).collect();
    let mode = match numbers[..] {
        [output, d0, d1, d2, bottleneck, e2, e1, e0, input] => {
            let (decoder, encoder) = ([d0, d1, d2], [e0, e1, e2]);
            ConvergedMode::Approximate(ConvergedMargins { output, decoder, bottleneck, encoder, input })
        }
        _ => text.parse().map_err(|error: Error| error.to_string())?,
    };
    Ok((text.to_owned(), mode))
}

/// One rule, and what came of it.
struct Case {
    name: String,
    denoiser: Denoiser,
    seconds: Vec<f64>,
    work: f64,
    exposure: f32,
    output: Vec<f32>,
}

/// CPU seconds of a whole call, rule by rule in turn; medians, and ratios to the whole frame's. One JSON object a rule.
pub fn run(args: &ConvergedArgs) -> stress::Result<()> {
    let image = ExrFrame::read(&args.frame, &LayerOptions::default())?;
    let reference = args.reference.as_ref().map(|path| ExrFrame::read(path, &LayerOptions::color_only(None)));
    let reference = reference.transpose()?;
    let (device, weights) = (Device::open(&args.device)?, Weights::hybrid_kernels()?);
    let case = |name: &str, mode: Option<ConvergedMode>| -> Result<Case, Error> {
        let converged = mode.map(|mode| Converged { threshold: args.threshold, mode });
        let denoiser = Denoiser::new(&device, &weights, &Options { converged, ..Options::default() })?;
        Ok(Case { name: name.into(), denoiser, seconds: vec![], work: 1.0, exposure: 1.0, output: vec![] })
    };
    let mut cases = vec![case("whole", None)?];
    for (name, mode) in &args.modes {
        cases.push(case(name, Some(*mode))?);
    }
    // The first round compiles.
    for round in 0..=args.repeat {
        for case in &mut cases {
            case.run(&image.frame(), round > 0)?;
        }
    }
    let (whole, rest) = cases.split_at(1);
    for case in &cases {
        let seconds = median(&case.seconds);
        let mut line = serde_json::json!({
            "device": device.info().name, "driver": device.info().driver, "frame": args.frame, "mode": case.name,
            "work": case.work, "cpu_s": seconds, "ratio": seconds / median(&whole[0].seconds),
        });
        let same = case.denoiser.active_tiles().or(rest.first().and_then(|case| case.denoiser.active_tiles()));
        if let Some(active) = same {
            let shares: Vec<_> = case.denoiser.active_tiles().map_or(vec![], shares);
            line["active"] = shares.into();
            line["picture"] = picture(image.extent(), active, case, &whole[0], reference.as_ref())?;
        }
        println!("{line}");
    }
    Ok(())
}

impl Case {
    fn run(&mut self, frame: &Frame, timed: bool) -> Result<(), Error> {
        self.output.resize(3 * frame.extent.pixels() as usize, 0.0);
        let target = PlaneMut::f32(&mut self.output, Layout::interleaved(frame.extent, 3));
        let clock = ProcessTime::now();
        let report = self.denoiser.denoise(frame, target)?;
        if timed {
            self.seconds.push(clock.elapsed().as_secs_f64());
        }
        (self.work, self.exposure) = (report.work, report.exposure);
        Ok(())
    }
}

fn shares(active: &ActiveTiles) -> Vec<serde_json::Value> {
    let share = |(at, (part, _)): (usize, &(vkdenoise::Part, u32))| serde_json::json!({ "stage": part.stage.to_string(), "tile_pixels": part.tile_pixels, "sampled": part.sampled, "share": active.share(at) });
    active.parts.iter().enumerate().map(share).collect()
}

/// Denoised squares and the others apart: decibels to the whole pass, PSNR to the reference, whether the bits are the
/// whole pass's.
fn picture(
    extent: Extent,
    active: &ActiveTiles,
    case: &Case,
    whole: &Case,
    reference: Option<&ExrFrame>,
) -> stress::Result<serde_json::Value> {
    let columns = active.size.columns as usize;
    let is_active = |pixel: usize| {
        let (x, y) = (pixel % extent.width as usize, pixel / extent.width as usize);
        active.map[y / MAP_TILE as usize * columns + x / MAP_TILE as usize]
    };
    let mut found = serde_json::json!({ "denoised": active.denoised(extent) });
    for (name, wanted) in [("denoised_squares", true), ("converged_squares", false)] {
        let pick = |samples: &[f32]| -> Vec<f32> {
            let pixels = samples.chunks_exact(3).enumerate().filter(|(pixel, _)| is_active(*pixel) == wanted);
            pixels.flat_map(|(_, color)| color).copied().collect()
        };
        let (own, full) = (pick(&case.output), pick(&whole.output));
        if own.is_empty() {
            continue;
        }
        let line = Extent::new(own.len() as u32 / 3, 1);
        let mut figures = serde_json::json!({
            "db_to_whole": Comparison::new(line, &own, &full)?.tone_mapped_db(case.exposure),
            "same_bits": own.iter().zip(&full).all(|(a, b)| a.to_bits() == b.to_bits()),
        });
        if let Some(reference) = reference {
            figures["psnr"] = Comparison::new(line, &own, &pick(reference.color()))?.psnr().into();
        }
        found[name] = figures;
    }
    Ok(found)
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

//! `network`: every kernel of a forward pass.

use crate::args::{Given, Output};
use crate::plot::{self, Point};
use crate::rows::{self, Row};
use crate::session::Session;
use crate::summary::Summary;
use crate::{Failure, export, table};
use serde_json::json;
use vkdenoise::net::{Arch, DepthRule, ExposureRule, Head, Preprocessing};
use vkdenoise::vk::statistics::PipelineStatistic;
use vkdenoise::{
    ActiveTiles, Converged, ConvergedMode, Denoiser, Error, Extent, Features, Frame, KernelRecord, Layout, Noise,
    NoiseKind, Options, Part, Plane, PlaneMut, Region, Report, Weights,
};

/// What the passes measured.
pub struct Measured {
    /// Milliseconds of the pass as it is.
    pub plain: Summary,
    /// Milliseconds of CPU time of it, on CPU drivers.
    pub cpu: Option<Summary>,
    /// Milliseconds with a timestamp around every kernel.
    pub profiled: Summary,
    /// Milliseconds of CPU time of that.
    pub profiled_cpu: Option<Summary>,
    /// Share of the FLOPs of a whole frame with all features.
    pub work: f64,
    /// Milliseconds of the pass, and of its CPU time, with nothing left out that is converged; where something is.
    pub all: Option<(Summary, Option<Summary>)>,
    /// What was denoised then.
    pub active: Option<ActiveTiles>,
    /// Share of a profiled pass that its kernels take.
    pub kernels_share: Summary,
    /// The kernels of every profiled run.
    pub runs: Vec<Vec<KernelRecord>>,
    /// What the compiler says of them, where the device tells.
    pub statistics: Vec<PipelineStatistic>,
}

/// What is run.
pub struct Subject {
    pub extent: Extent,
    pub options: Options,
    pub region: Option<Region>,
    /// The share of the rows that need no denoising, and how they are left out.
    pub converged: Option<(f64, ConvergedMode)>,
    pub features: Given,
}

impl Subject {
    /// A whole frame with everything.
    pub fn whole(extent: Extent) -> Self {
        Self { extent, options: Options::default(), region: None, converged: None, features: Given::All }
    }
}

/// Random weights: the work does not depend on them.
pub fn weights(arch: &Arch) -> Result<Weights, Error> {
    let preprocessing =
        Preprocessing { exposure: ExposureRule::Auto, depth: DepthRule::Percentile, version: Preprocessing::VERSION };
    Ok(Weights::hashed(arch, preprocessing, 1)?)
}

/// Runs a network on a frame; plain and profiled passes in turn, where `profile` and the device allow.
pub fn measure(session: &Session, arch: &Arch, subject: &Subject, profile: bool) -> Result<Measured, Error> {
    let Subject { extent, region, features: given, converged: left_out, .. } = *subject;
    let options = Options { keep_features: given == Given::Unchanged, ..subject.options };
    let converged = left_out.map(|(_, mode)| Converged { threshold: 0.1, mode });
    let weights = weights(arch)?;
    let mut denoiser = Denoiser::new(&session.device, &weights, &Options { converged, ..options })?;
    let mut whole = converged.map(|_| Denoiser::new(&session.device, &weights, &options)).transpose()?;
    let pixels = extent.pixels() as usize;
    // Any picture does as well.
    let noise = |i: usize| (i.wrapping_mul(2_654_435_761) >> 16 & 0xffff) as f32 / 65536.0;
    let color: Vec<f32> = (0..3 * pixels).map(|i| noise(i) * noise(i / 3) * 4.0).collect();
    let depth: Vec<f32> = (0..pixels).map(|i| 1.0 + noise(i / 500) * 10.0).collect();
    let mut output = vec![0.0; 3 * pixels];
    let rgb = Layout::interleaved(extent, 3);
    let all = Features {
        albedo: Some(Plane::f32(&color, rgb)),
        normal: Some(Plane::f32(&color, rgb)),
        depth: Some(Plane::f32(&depth, Layout::interleaved(extent, 1))),
        noise: None,
    };
    // The upper rows have one sample a pixel.
    let noisy = left_out.map_or(0, |(share, _)| ((1.0 - share) * f64::from(extent.height)).round() as usize);
    let counts: Vec<f32> = (0..pixels).map(|i| if i / (extent.width as usize) < noisy { 1.0 } else { 1e6 }).collect();
    let noise = Noise { plane: Plane::f32(&counts, Layout::interleaved(extent, 1)), kind: NoiseKind::Samples };
    let features = if given == Given::None { Features::default() } else { all };
    let features = Features { noise: Some(noise), ..features };
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features };
    if given == Given::Unchanged {
        denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb))?;
        denoiser.set_features_unchanged(true);
    }
    denoiser.set_region(region);
    if let Some(whole) = &mut whole {
        whole.set_region(region);
    }
    let mut second = vec![0.0; if whole.is_some() { 3 * pixels } else { 0 }];
    let (mut all_ms, mut all_cpu) = (Vec::new(), Vec::new());
    let mut work = 1.0;
    let profile = profile && session.device.has_timestamps();
    let mut run = |profile: bool| -> Result<(f64, Vec<KernelRecord>), Error> {
        denoiser.set_profiling(profile)?;
        let report: Report = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb))?;
        work = report.work;
        Ok((report.gpu_ms.unwrap_or(report.total_ms), denoiser.records().to_vec()))
    };
    let (mut plain, mut profiled, mut runs) = (Vec::new(), Vec::new(), Vec::new());
    let (mut cpu, mut profiled_cpu) = (Vec::new(), Vec::new());
    for turn in 0..session.warm_up + session.repeat {
        let ((ms, _), plain_cpu) = session.cpu_ms(|| run(false))?;
        let all = match &mut whole {
            Some(whole) => Some(session.cpu_ms(|| whole.denoise(&frame, PlaneMut::f32(&mut second, rgb)))?),
            None => None,
        };
        let with = if profile { Some(session.cpu_ms(|| run(true))?) } else { None };
        if turn >= session.warm_up {
            plain.push(ms);
            cpu.extend(plain_cpu);
            if let Some((report, whole_cpu)) = all {
                all_ms.push(report.gpu_ms.unwrap_or(report.total_ms));
                all_cpu.extend(whole_cpu);
            }
            if let Some(((ms, records), with_cpu)) = with {
                profiled.push(ms);
                profiled_cpu.extend(with_cpu);
                runs.push(records);
            }
        }
    }
    let statistics = denoiser.pipeline_statistics()?;
    let kernels_ms = |run: &Vec<KernelRecord>| run.iter().map(|record| record.microseconds).sum::<f64>() * 1e-3;
    let shares: Vec<f64> = runs.iter().zip(&profiled).map(|(run, pass)| kernels_ms(run) / pass).collect();
    let optional = |values: &[f64]| (!values.is_empty()).then(|| Summary::of(values));
    Ok(Measured {
        plain: Summary::of(&plain),
        cpu: optional(&cpu),
        profiled: Summary::of(&profiled),
        profiled_cpu: optional(&profiled_cpu),
        work,
        all: optional(&all_ms).map(|ms| (ms, optional(&all_cpu))),
        active: denoiser.active_tiles().cloned(),
        kernels_share: Summary::of(&shares),
        runs,
        statistics,
    })
}

/// The subcommand.
pub fn network(
    session: &Session,
    (name, head): (&str, Head),
    subject: &Subject,
    output: &Output,
) -> Result<(), Failure> {
    let arch = Arch::named(name).ok_or_else(|| Failure(format!("there is no network called {name}")))?;
    let arch = Arch { head, ..arch };
    let (extent, measured) = (subject.extent, measure(session, &arch, subject, true)?);
    let rows = rows::rows(&measured.runs, &session.roof);
    let title = format!("{name}, {}x{}", extent.width, extent.height);
    export::files(&title, export::middle(&measured.runs), &rows, output)?;
    if let Some(path) = &output.plot {
        let point = |row: &Row| Point {
            series: row.kernel.clone(),
            flop_per_byte: row.flop_per_byte,
            flop_per_second: row.gflop_per_second * 1e9,
        };
        // What takes next to no time would only stretch the axes.
        let shown = rows.iter().filter(|row| row.gflop > 0.0 && row.share > 1e-3);
        let points: Vec<_> = shown.map(point).collect();
        plot::roofline(path, &title, &session.roof, &points).map_err(Failure)?;
    }
    let by_stage = rows::sums(&rows, &session.roof, |row| &row.stage);
    let by_kernel = rows::sums(&rows, &session.roof, |row| &row.kernel);
    let kernels_ms = rows.iter().map(|row| row.microseconds.median).sum::<f64>() * 1e-3;
    if output.json {
        let report = json!({
            "session": session.header(), "network": name, "width": extent.width, "height": extent.height,
            "region": subject.region.map(|Region { x, y, width, height }| [x, y, width, height]), "work": measured.work,
            "converged": measured.active.as_ref().map(|active| converged_json(&measured, active, extent)),
            "pass_ms": measured.plain, "pass_cpu_ms": measured.cpu,
            "profiled_pass_ms": measured.profiled, "profiled_pass_cpu_ms": measured.profiled_cpu, "kernels_ms": kernels_ms, "kernels_share": measured.kernels_share,
            "kernels": rows, "by_stage": by_stage, "by_kernel": by_kernel,
            "pipeline_statistics": measured.statistics.iter().map(statistic_json).collect::<Vec<_>>(),
        });
        println!("{report:#}");
        return Ok(());
    }
    print!("{title}\n{}", session.header().text());
    let Summary { median, min, spread } = measured.plain;
    if measured.work < 1.0 {
        print!("{:.1} % of the work of a whole frame with all features; ", 100.0 * measured.work);
    }
    if let (Some(active), Some((all, all_cpu))) = (&measured.active, &measured.all) {
        let saved = |own: f64, all: f64| 100.0 * (1.0 - own / all);
        print!(
            "{:.1} % of the squares denoised; {:.1} % of {:.2} ms saved",
            100.0 * active.denoised(extent),
            saved(median, all.median),
            all.median
        );
        if let (Some(own), Some(all)) = (measured.cpu, all_cpu) {
            print!(" ({:.1} % of CPU time)", saved(own.median, all.median));
        }
        println!("\nactive tiles:");
        for (at, (part, count)) in active.parts.iter().enumerate() {
            let Part { stage, tile_pixels, tiles, sampled } = part;
            let with = if *sampled { ", with a sample of what is converged" } else { "" };
            println!(
                "  {stage:10} {tile_pixels:4} pixels {:6.1} %  {count} of {tiles}{with}",
                100.0 * active.share(at)
            );
        }
    }
    print!("whole pass {median:.2} ms (min {min:.2}, spread {spread:.2})");
    if !rows.is_empty() {
        let with = measured.profiled.median;
        print!(", with timestamps {with:.2} ms ({:+.1} %)", 100.0 * (with / median - 1.0));
        let share = 100.0 * measured.kernels_share.median;
        print!("; its kernels add up to {kernels_ms:.2} ms, in each run to {share:.1} % of its pass");
        if let (Some(plain), Some(with)) = (measured.cpu, measured.profiled_cpu) {
            let slower = 100.0 * (with.median / plain.median - 1.0);
            print!("\nCPU time {:.2} ms, with timestamps {:.2} ms ({slower:+.1} %)", plain.median, with.median);
        }
        print!("\n\n{}", table::kernels(&rows));
        print!("\n{}\n{}", table::sums("stage", &by_stage), table::sums("kernel", &by_kernel));
    }
    println!();
    if measured.statistics.is_empty() {
        println!("The device tells nothing of its pipelines (VK_KHR_pipeline_executable_properties).");
    }
    for PipelineStatistic { variant, executable, name, value } in &measured.statistics {
        println!("{variant}, {executable}: {name} {value}");
    }
    Ok(())
}

fn converged_json(measured: &Measured, active: &ActiveTiles, extent: Extent) -> serde_json::Value {
    let part = |(at, (part, count)): (usize, &(Part, u32))| {
        let Part { stage, tile_pixels, tiles, sampled } = part;
        json!({ "stage": stage.to_string(), "sampled": sampled, "tile_pixels": tile_pixels, "active": count, "tiles": tiles, "share": active.share(at) })
    };
    let (all, all_cpu) = measured.all.map_or((None, None), |(all, cpu)| (Some(all), cpu));
    json!({
        "denoised": active.denoised(extent), "parts": active.parts.iter().enumerate().map(part).collect::<Vec<_>>(),
        "whole_pass_ms": all, "whole_pass_cpu_ms": all_cpu,
    })
}

fn statistic_json(statistic: &PipelineStatistic) -> serde_json::Value {
    let PipelineStatistic { variant, executable, name, value } = statistic;
    json!({ "variant": variant, "executable": executable, "name": name, "value": value.to_string() })
}

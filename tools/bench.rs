//! `vkdenoise-bench`: times the whole pass in CPU seconds and wall time, counts its memory and its errors, and puts it
//! under stress. CPU seconds are the steadier figure on CPU drivers and on shared machines.

#[path = "bench/budget/mod.rs"]
mod budget;
#[path = "bench/budget_command.rs"]
mod budget_command;
#[path = "bench/converged_command.rs"]
mod converged_command;
#[path = "bench/pareto/mod.rs"]
mod pareto;
#[path = "bench/pareto_command.rs"]
mod pareto_command;
#[path = "plotting.rs"]
mod plotting;
#[path = "bench/resize_command.rs"]
mod resize_command;
#[path = "bench/skip_command.rs"]
mod skip_command;
#[path = "bench/stress/mod.rs"]
mod stress;
#[path = "bench/stress_command.rs"]
mod stress_command;

use clap::{Parser, Subcommand};
use std::io::BufRead;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use vkdenoise::net::Folds;
use vkdenoise::{
    Denoiser, Device, DeviceSelector, Error, Extent, Features, Frame, Layout, Options, Plane, PlaneMut, Weights,
};

#[derive(Parser)]
#[command(version, about = "Benchmarks of vkdenoise")]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Time the host path on a synthetic frame with albedo, normal and depth. One JSON object a run.
    Pass {
        /// Frame size.
        #[arg(long, default_value = "512x512", value_parser = parse_size)]
        size: Extent,
        /// Timed runs.
        #[arg(long, default_value_t = 5)]
        repeat: u32,
        /// Runs before the first timed one.
        #[arg(long, default_value_t = 1)]
        warm_up: u32,
        /// Do one run for every line on standard input instead, so that another program can be timed in turn.
        #[arg(long)]
        on_request: bool,
        /// Device: an index or part of a name.
        #[arg(long, env = "VKDENOISE_DEVICE", default_value = "best")]
        device: DeviceSelector,
        /// Weights instead of the built-in ones.
        #[arg(long)]
        weights: Option<PathBuf>,
        #[command(flatten)]
        forms: Forms,
    },
    /// Show where precision goes: every dispatch on the device beside the same in f64.
    Budget(budget_command::BudgetArgs),
    /// Run time against error: every tier of every network on a directory of rendered pairs, with the Pareto front.
    Pareto(pareto_command::ParetoArgs),
    /// Try to break the denoiser: every stress case on every tier that the device runs, as a matrix of figures and
    /// bounds.
    Stress(stress_command::StressArgs),
    /// Time what is left out: a region, unchanged features, none; in turn with the whole. One JSON object a case.
    Skip(skip_command::SkipArgs),
    /// Leave out what is converged of an EXR file, by several rules in turn with all of it: time, and what that does to
    /// the picture.
    Converged(converged_command::ConvergedArgs),
    /// Time what a frame size costs the CPU in an arena that several share. One JSON object a size.
    Resize(resize_command::ResizeArgs),
    /// Print the device memory that a size takes, from the plan. Nothing is allocated for it.
    Memory {
        /// Frame size.
        #[arg(long, default_value = "1920x1080", value_parser = parse_size)]
        size: Extent,
        /// Device: an index or part of a name.
        #[arg(long, env = "VKDENOISE_DEVICE", default_value = "best")]
        device: DeviceSelector,
        #[command(flatten)]
        forms: Forms,
    },
}

/// Which of several forms the network runs in.
#[derive(clap::Args)]
struct Forms {
    /// MiB that a map between consecutive kernels may take before they run band by band.
    #[arg(long)]
    max_chain_mib: Option<u64>,
    /// Arithmetic and storage: auto, fp32, fp16 or matrix.
    #[arg(long, default_value = "auto")]
    precision: vkdenoise::Precision,
    /// Which operations are folded into others: all, none, or some of unembed, skip, unread and norm.
    #[arg(long, default_value = "all")]
    folds: Folds,
}

impl Forms {
    fn options(&self) -> Options {
        Options {
            max_chain_bytes: self.max_chain_mib.map(|mib| mib << 20),
            precision: self.precision,
            folds: Some(self.folds),
            ..Options::default()
        }
    }
}

fn parse_size(text: &str) -> Result<Extent, String> {
    let sides = text.split_once('x').and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    sides.map(|(w, h)| Extent::new(w, h)).ok_or_else(|| format!("'{text}' is not a size such as 512x512"))
}

fn main() -> ExitCode {
    let outcome: stress::Result<()> = match Arguments::parse().command {
        Command::Pass { size, repeat, warm_up, on_request, device, weights, forms } => {
            Device::open(&device).map_err(Into::into).and_then(|device| {
                let weights = weights.map_or_else(Weights::hybrid_kernels, |path| Ok(Weights::from_file(path)?))?;
                let denoiser = Denoiser::new(&device, &weights, &forms.options())?;
                Ok(pass(denoiser, size, (warm_up, repeat), on_request)?)
            })
        }
        Command::Budget(args) => budget_command::run(&args),
        Command::Pareto(args) => pareto_command::run(&args),
        Command::Stress(args) => stress_command::run(&args),
        Command::Skip(args) => skip_command::run(&args),
        Command::Converged(args) => converged_command::run(&args),
        Command::Resize(args) => resize_command::run(&args),
        Command::Memory { size, device, forms } => memory(&device, size, &forms.options()).map_err(Into::into),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn memory(device: &DeviceSelector, extent: Extent, options: &Options) -> Result<(), Error> {
    let denoiser = Denoiser::new(&Device::open(device)?, &Weights::hybrid_kernels()?, options)?;
    let needed = denoiser.memory_required(extent)?;
    let line = serde_json::json!({
        "width": extent.width, "height": extent.height,
        "arena_bytes": needed.arena, "persistent_bytes": needed.persistent, "weights_bytes": needed.weights,
        "staging_bytes": needed.staging,
        "pass_bytes": needed.pass(), "host_bytes": needed.host(),
    });
    println!("{line}");
    Ok(())
}

fn pass(mut denoiser: Denoiser, extent: Extent, (warm_up, repeat): (u32, u32), on_request: bool) -> Result<(), Error> {
    let device = denoiser.device().clone();
    let pixels = extent.pixels() as usize;
    // Any values do: the work does not depend on them.
    let noise = |i: usize| (i.wrapping_mul(2654435761) >> 16 & 0xffff) as f32 / 65536.0;
    let color: Vec<f32> = (0..3 * pixels).map(|i| noise(i) * noise(i / 3) * 4.0).collect();
    let albedo: Vec<f32> = (0..3 * pixels).map(|i| noise(i / 3000)).collect();
    let normal: Vec<f32> = (0..3 * pixels).map(|i| noise(i / 900) * 2.0 - 1.0).collect();
    let depth: Vec<f32> = (0..pixels).map(|i| 1.0 + noise(i / 500) * 10.0).collect();
    let mut output = vec![0.0; 3 * pixels];
    let rgb = Layout::interleaved(extent, 3);
    let frame = Frame {
        extent,
        color: Plane::f32(&color, rgb),
        features: Features {
            albedo: Some(Plane::f32(&albedo, rgb)),
            normal: Some(Plane::f32(&normal, rgb)),
            depth: Some(Plane::f32(&depth, Layout::interleaved(extent, 1))),
            noise: None,
        },
    };
    let mut run = |print: bool| -> Result<(), Error> {
        let (cpu, wall) = (cpu_time::ProcessTime::now(), Instant::now());
        let report = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb))?;
        if print {
            let line = serde_json::json!({
                "device": device.info().name, "driver": device.info().driver,
                "width": extent.width, "height": extent.height,
                "cpu_s": cpu.elapsed().as_secs_f64(), "wall_s": wall.elapsed().as_secs_f64(),
                "gpu_ms": report.gpu_ms, "device_bytes": report.device_bytes,
            });
            println!("{line}");
        }
        Ok(())
    };
    for _ in 0..warm_up {
        run(false)?;
    }
    if on_request {
        for line in std::io::stdin().lock().lines() {
            if line.is_err() {
                break;
            }
            run(true)?;
        }
    } else {
        for _ in 0..repeat {
            run(true)?;
        }
    }
    Ok(())
}

//! `vkdenoise`: denoises OpenEXR renders from the command line.
//!
//! Arguments and files are checked before the device is opened. Results (JSON, figures against a reference) go to
//! standard output, everything else to standard error. Exit code 0: everything was written whole; 3: some images
//! failed, the others were written; 1: all failed; 2: the command line was wrong; 130: interrupted.

#[path = "denoise/args.rs"]
mod args;
#[path = "denoise/devices.rs"]
mod devices;
#[path = "denoise/frames.rs"]
mod frames;
#[path = "denoise/interrupt.rs"]
mod interrupt;
#[path = "denoise/jobs.rs"]
mod jobs;
#[path = "denoise/preview.rs"]
mod preview;
#[path = "denoise/ranges.rs"]
mod ranges;
#[path = "denoise/report.rs"]
mod report;
#[path = "denoise/reporter.rs"]
mod reporter;
#[path = "denoise/session.rs"]
mod session;
#[path = "denoise/work.rs"]
mod work;

use args::Args;
use clap::Parser;
use std::process::ExitCode;

/// Why the program ends without success.
enum Failure {
    /// The command line asks for something that cannot be meant.
    Usage(String),
    /// Nothing was written.
    Failed(String),
    /// Some images failed, the others are written.
    Some(String),
    /// It was told to stop.
    Interrupted(String),
}

/// The exit code of a program that was told to stop.
const INTERRUPTED: u8 = 130;

impl Failure {
    fn failed(error: impl std::fmt::Display) -> Self {
        Self::Failed(error.to_string())
    }
}

fn main() -> ExitCode {
    let args = Args::parse();
    let filter = tracing_subscriber::EnvFilter::try_from_default_env();
    let filter =
        filter.unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(if args.quiet { "error" } else { "warn" }));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).without_time().init();

    let result = if args.list_devices { devices::list(args.json) } else { denoise(&args) };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Failed(message)) => {
            eprintln!("vkdenoise: {message}");
            ExitCode::from(1)
        }
        Err(Failure::Some(message)) => {
            eprintln!("vkdenoise: {message}");
            ExitCode::from(3)
        }
        Err(Failure::Interrupted(message)) => {
            eprintln!("vkdenoise: {message}");
            ExitCode::from(INTERRUPTED)
        }
        Err(Failure::Usage(message)) => {
            eprintln!("vkdenoise: {message}\nTry 'vkdenoise --help'.");
            ExitCode::from(2)
        }
    }
}

fn denoise(args: &Args) -> Result<(), Failure> {
    interrupt::install()?;
    let plan = jobs::plan(args)?;
    work::run(args, &plan)
}

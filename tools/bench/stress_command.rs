//! `vkdenoise-bench stress`: every case on every tier, and on peers beside them.

use crate::stress::light::is_of_training;
use crate::stress::subject::{Peer, PeerSpec, Subject, Tier, in_and_out_alone};
use crate::stress::table::Matrix;
use crate::stress::{Case, Effort, Result, cases};
use std::path::PathBuf;
use vkdenoise::{Device, DeviceSelector, Weights};

/// Options of `vkdenoise-bench stress`.
#[derive(clap::Args)]
pub struct StressArgs {
    /// Device: an index or part of a name.
    #[arg(long, env = "VKDENOISE_DEVICE", default_value = "best")]
    device: DeviceSelector,
    /// Weights instead of the built-in ones.
    #[arg(long)]
    weights: Option<PathBuf>,
    /// Only the cases whose names contain this.
    #[arg(long, default_value = "")]
    case: String,
    /// Only the tier of this name; may be given again.
    #[arg(long)]
    tier: Vec<String>,
    /// Only what the test suite has time for.
    #[arg(long)]
    sample: bool,
    /// Put the pre- and post-processing alone beside the tiers, a network that adds a residual of zero, where a network
    /// may spoil a figure.
    #[arg(long)]
    frame_alone: bool,
    /// A program to put beside the tiers, as NAME=COMMAND; may be given again. tools/measure/oidn_peer.py is one.
    #[arg(long)]
    peer: Vec<PeerSpec>,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Write a Markdown table.
    #[arg(long)]
    markdown: Option<PathBuf>,
}

/// Runs it. The engine's figures must all be inside their bounds; a peer's are only shown.
pub fn run(args: &StressArgs) -> Result<()> {
    let device = Device::open(&args.device)?;
    let weights = args.weights.as_ref().map_or_else(Weights::hybrid_kernels, |path| Ok(Weights::from_file(path)?))?;
    let effort = if args.sample { Effort::Sample } else { Effort::Everything };
    let cases: Vec<Case> = cases().into_iter().filter(|case| case.name.contains(&args.case)).collect();
    let wanted = |tier: &Tier| args.tier.is_empty() || args.tier.iter().any(|name| name == tier.name);
    let tiers: Vec<Tier> = Tier::all(&device).into_iter().filter(wanted).collect();

    let mut matrix = Matrix::default();
    for tier in &tiers {
        matrix.add_subject(tier.name);
        measure(&mut matrix, tier.name, &mut Subject::engine(&device, &weights, *tier)?, &cases, effort)?;
    }
    if let Some(tier) = tiers.first().filter(|_| args.frame_alone) {
        let name = "in and out alone";
        matrix.add_subject(name);
        let mut subject = Subject::engine(&device, &in_and_out_alone(&weights)?, *tier)?;
        let cases: Vec<Case> = cases.iter().filter(|case| is_of_training(case.name)).cloned().collect();
        measure(&mut matrix, name, &mut subject, &cases, effort)?;
    }
    for peer in &args.peer {
        matrix.add_subject(&peer.name);
        measure(&mut matrix, &peer.name, &mut Subject::peer(Peer::start(&peer.command)?), &cases, effort)?;
    }
    if let Some(path) = &args.markdown {
        std::fs::write(path, matrix.markdown())?;
    }
    if args.json {
        println!("{:#}", matrix.json());
    } else {
        print!("{}", matrix.text());
    }
    match matrix.broken(tiers.len()).as_slice() {
        [] => Ok(()),
        broken => Err(format!("{} bounds are broken:\n{}", broken.len(), broken.join("\n")).into()),
    }
}

fn measure(matrix: &mut Matrix, name: &str, subject: &mut Subject, cases: &[Case], effort: Effort) -> Result<()> {
    let progress = indicatif::ProgressBar::new(cases.len() as u64).with_prefix(name.to_owned());
    progress.set_style(indicatif::ProgressStyle::with_template("{prefix} {wide_bar} {pos}/{len} {msg}")?);
    for case in cases {
        progress.set_message(case.name);
        for measured in case.measure(subject, effort)? {
            matrix.add(case.name, measured);
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(())
}

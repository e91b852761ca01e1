//! `vkdenoise-profile`: where the time goes, kernel by kernel.

#[path = "profile/args.rs"]
mod args;
#[path = "profile/blocks.rs"]
mod blocks;
#[path = "profile/conv.rs"]
mod conv;
#[path = "profile/export.rs"]
mod export;
#[path = "profile/network.rs"]
mod network;
#[path = "profile/parts.rs"]
mod parts;
#[path = "profile/plan.rs"]
mod plan;
#[path = "profile/plot.rs"]
mod plot;
#[path = "plotting.rs"]
mod plotting;
#[path = "profile/rows.rs"]
mod rows;
#[path = "profile/session.rs"]
mod session;
#[path = "profile/summary.rs"]
mod summary;
#[path = "profile/table.rs"]
mod table;
#[path = "profile/tables.rs"]
mod tables;
#[path = "profile/thesis.rs"]
mod thesis;

use args::{Arguments, Command};
use clap::Parser;
use session::Session;
use std::process::ExitCode;
use vkdenoise::Options;

/// What is told to the user.
pub struct Failure(String);

impl From<vkdenoise::Error> for Failure {
    fn from(error: vkdenoise::Error) -> Self {
        Self(error.to_string())
    }
}

fn main() -> ExitCode {
    match run(Arguments::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure(message)) => {
            eprintln!("error: {message}");
            ExitCode::FAILURE
        }
    }
}

fn run(command: Command) -> Result<(), Failure> {
    match command {
        Command::Network {
            arch,
            head,
            size,
            folds,
            conv,
            separable,
            attention,
            ffn,
            max_chain_mib,
            precision,
            region,
            converged,
            converged_mode,
            features,
            common,
            output,
        } => {
            let (conv, separable) = (conv.map(Into::into), separable.map(Into::into));
            let options = Options {
                precision,
                folds: Some(folds),
                conv,
                separable,
                attention: attention.map(Into::into),
                ffn: ffn.map(Into::into),
                max_chain_bytes: max_chain_mib.map(|mib| mib << 20),
                ..Options::default()
            };
            let converged = converged.map(|share| (share, converged_mode));
            let subject = network::Subject { extent: size, options, region, converged, features };
            network::network(&Session::open(&common)?, (&arch, head), &subject, &output)
        }
        Command::Conv { size, channels, common, output } => {
            conv::conv(&Session::open(&common)?, size, channels, &output)
        }
        Command::Blocks { sizes, channels, common, json } => {
            blocks::blocks(&Session::open(&common)?, &sizes, &channels, json)
        }
        Command::Tables { size, common, json } => tables::tables(&Session::open(&common)?, size, json),
        Command::Plan { arch, head, size, precision, ffn, target, common, json } => {
            let machine = plan::Machine::find(&target, &common)?;
            plan::plan_of((&arch, head), size, precision, ffn.map(Into::into), &machine, json)
        }
        Command::Roof { common, json } => {
            let header = Session::open(&common)?.header();
            if json {
                println!("{:#}", serde_json::json!(header));
            } else {
                print!("{}", header.text());
            }
            Ok(())
        }
    }
}

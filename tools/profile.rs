//! `vkdenoise-profile`: where the time goes, kernel by kernel.

#[path = "profile/args.rs"]
mod args;
#[path = "profile/export.rs"]
mod export;
#[path = "profile/network.rs"]
mod network;
#[path = "profile/plot.rs"]
mod plot;
#[path = "profile/rows.rs"]
mod rows;
#[path = "profile/session.rs"]
mod session;
#[path = "profile/summary.rs"]
mod summary;
#[path = "profile/table.rs"]
mod table;

use args::{Arguments, Command};
use clap::Parser;
use session::Session;
use std::process::ExitCode;

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
        Command::Network { arch, size, common, output } => {
            network::network(&Session::open(&common)?, &arch, size, &output)
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

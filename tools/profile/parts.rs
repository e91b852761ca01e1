//! Parts of networks, several ways in turn, so that what else the machine does falls on all alike.

use crate::Failure;
use crate::network::weights;
use crate::session::Session;
use crate::summary::Summary;
use vkdenoise::microbench::PartRunner;
use vkdenoise::net::Graph;
use vkdenoise::target::Target;
use vkdenoise::{Extent, KernelRecord, Precision};

/// Something to run, and what it is called.
pub struct Candidate {
    pub name: String,
    pub graph: Graph,
    pub options: Target,
    pub precision: Precision,
}

/// What one of them measured.
pub struct Measured {
    pub name: String,
    /// Milliseconds of the whole.
    pub whole: Summary,
    /// Milliseconds of CPU time of the whole, on CPU drivers.
    pub cpu: Option<Summary>,
    /// Its cost over that of the first candidate, the median of the pairs of a turn: of CPU time on CPU drivers, else
    /// of time.
    pub ratio: f64,
    /// The kernels of every run; none without timestamps.
    pub runs: Vec<Vec<KernelRecord>>,
}

/// Runs of one candidate.
#[derive(Default)]
struct Runs {
    whole: Vec<f64>,
    cpu: Vec<f64>,
    records: Vec<Vec<KernelRecord>>,
}

impl Runs {
    fn cost(&self) -> &[f64] {
        if self.cpu.is_empty() { &self.whole } else { &self.cpu }
    }
}

/// Runs all candidates on maps of `extent` tokens.
pub fn measure(session: &Session, extent: Extent, candidates: Vec<Candidate>) -> Result<Vec<Measured>, Failure> {
    let mut runners = Vec::new();
    for Candidate { name, graph, options, precision } in candidates {
        let weights = weights(&graph.arch)?;
        let runner = PartRunner::new(&session.device, &graph, &weights, extent, &options, precision)?;
        runners.push((name, runner, Runs::default()));
    }
    for turn in 0..session.warm_up + session.repeat {
        for (_, runner, runs) in &mut runners {
            let (timed, cpu) = session.cpu_ms(|| runner.run())?;
            if turn >= session.warm_up {
                runs.whole.push(timed.milliseconds);
                runs.cpu.extend(cpu);
                runs.records.push(timed.records);
            }
        }
    }
    let base = runners.first().map(|(_, _, runs)| runs.cost().to_vec()).unwrap_or_default();
    let measured = |(name, _, runs): (String, PartRunner, Runs)| {
        let ratios: Vec<f64> = runs.cost().iter().zip(&base).map(|(cost, base)| cost / base).collect();
        Measured {
            name,
            whole: Summary::of(&runs.whole),
            cpu: (!runs.cpu.is_empty()).then(|| Summary::of(&runs.cpu)),
            ratio: Summary::of(&ratios).median,
            runs: runs.records,
        }
    };
    Ok(runners.into_iter().map(measured).collect())
}

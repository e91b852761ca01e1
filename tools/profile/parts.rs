//! Parts of networks, several ways in turn, so that what else the machine does falls on all alike.

use crate::Failure;
use crate::network::weights;
use crate::session::Session;
use crate::summary::Summary;
use vkdenoise::net::Graph;
use vkdenoise::plan::PlanOptions;
use vkdenoise::profile::PartRunner;
use vkdenoise::{Extent, KernelRecord};

/// Something to run, and what it is called.
pub struct Candidate {
    pub name: String,
    pub graph: Graph,
    pub options: PlanOptions,
}

/// What one of them measured.
pub struct Result {
    pub name: String,
    /// Milliseconds of the whole.
    pub whole: Summary,
    /// The kernels of every run; none without timestamps.
    pub runs: Vec<Vec<KernelRecord>>,
}

/// Runs all candidates on maps of `extent` tokens.
pub fn measure(
    session: &Session,
    extent: Extent,
    candidates: Vec<Candidate>,
) -> std::result::Result<Vec<Result>, Failure> {
    let mut runners = Vec::new();
    for Candidate { name, graph, options } in candidates {
        let weights = weights(&graph.arch)?;
        runners.push((name, PartRunner::new(&session.device, &graph, &weights, extent, &options)?));
    }
    let (mut wholes, mut runs) = (vec![Vec::new(); runners.len()], vec![Vec::new(); runners.len()]);
    for turn in 0..session.warm_up + session.repeat {
        for (i, (_, runner)) in runners.iter_mut().enumerate() {
            let timed = runner.run()?;
            if turn >= session.warm_up {
                wholes[i].push(timed.milliseconds);
                runs[i].push(timed.records);
            }
        }
    }
    let results = runners.into_iter().zip(wholes).zip(runs);
    Ok(results.map(|(((name, _), whole), runs)| Result { name, whole: Summary::of(&whole), runs }).collect())
}

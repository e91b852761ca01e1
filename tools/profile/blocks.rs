//! `blocks`: the thesis's Table 4.3, the FiLM-CNN block against the SH-JSA block.

use crate::parts::{self, Candidate, Measured};
use crate::session::Session;
use crate::table::{self, number};
use crate::{Failure, thesis};
use serde_json::json;
use vkdenoise::net::{Block, Convolution, Graph};
use vkdenoise::target::Target;
use vkdenoise::{Extent, Precision};

/// The thesis does not state the share of channels that attend; in its Hybrid it is this.
const RATIO: f64 = 0.25;

fn candidates(channels: u32) -> Result<Vec<Candidate>, Failure> {
    let kinds = [
        ("FiLM-CNN", Block::FilmCnn { conv: Convolution::Standard }),
        ("FiLM-CNN, separable", Block::FilmCnn { conv: Convolution::Separable }),
        ("SH-JSA", Block::ShJsa { ratio: RATIO }),
    ];
    let candidate = |(name, kind): (&str, _)| {
        let graph = Graph::of_block(kind, channels).map_err(|error| Failure(error.to_string()))?;
        Ok(Candidate { name: name.into(), graph, options: Target::default(), precision: Precision::F32 })
    };
    kinds.into_iter().map(candidate).collect()
}

/// The subcommand.
pub fn blocks(session: &Session, sides: &[u32], channels: &[u32], json: bool) -> Result<(), Failure> {
    let head = [
        "channels",
        "side",
        "FiLM-CNN ms",
        "CPU ms",
        "separable ms",
        "CPU ms",
        "SH-JSA ms",
        "CPU ms",
        "SH-JSA / FiLM-CNN",
        "faster",
        "thesis: FiLM-CNN ms",
        "SH-JSA ms",
        "SH-JSA / FiLM-CNN",
        "faster",
    ];
    let winner = |ratio: f64| String::from(if ratio > 1.0 { "FiLM-CNN" } else { "SH-JSA" });
    let (mut lines, mut reports) = (vec![head.map(String::from).to_vec()], Vec::new());
    for &channels in channels {
        for &side in sides {
            let results = parts::measure(session, Extent::new(side, side), candidates(channels)?)?;
            let published = thesis::blocks(channels, side);
            let block =
                |r: &Measured| json!({ "block": r.name, "ms": r.whole, "cpu_ms": r.cpu, "times_film_cnn": r.ratio });
            reports.push(json!({
                "channels": channels, "side": side, "measured": results.iter().map(block).collect::<Vec<_>>(),
                "thesis_ms": published.map(|(film, attention)| json!({ "FiLM-CNN": film, "SH-JSA": attention })),
            }));
            let mut line = vec![channels.to_string(), side.to_string()];
            for result in &results {
                line.push(number(result.whole.median));
                line.push(result.cpu.map_or("-".into(), |cpu| number(cpu.median)));
            }
            let ratio = results.last().map_or(1.0, |attention| attention.ratio);
            line.extend([format!("{ratio:.2}"), winner(ratio)]);
            if let Some((film, attention)) = published {
                line.extend([number(film), number(attention), format!("{:.2}", attention / film)]);
                line.push(winner(attention / film));
            }
            lines.push(line);
        }
    }
    if json {
        println!("{:#}", json!({ "session": session.header(), "blocks": reports }));
        return Ok(());
    }
    print!("one block alone, SH-JSA on {RATIO} of the channels\n{}\n", session.header().text());
    print!("{}", table::aligned(&lines, 0));
    Ok(())
}

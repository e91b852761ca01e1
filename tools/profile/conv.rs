//! `conv`: the thesis's section 4.3.1, a standard convolution against a depthwise-separable one, every way there is.

use crate::args::Output;
use crate::parts::{self, Candidate};
use crate::plot::{self, Point};
use crate::rows::{self, Row};
use crate::session::Session;
use crate::table::{self, number};
use crate::{Failure, export, thesis};
use serde_json::json;
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::net::{Convolution, Graph};
use vkdenoise::options::{ConvAlgorithm, SeparableForm};
use vkdenoise::target::Target;
use vkdenoise::{Extent, KernelRecord, Precision};

/// Lanes that share an instruction where the thesis counted.
const WARP: f64 = 32.0;
/// Ends the names of what runs in halves, on cooperative matrices.
const ON_MATRICES: &str = "on matrices";

fn candidates(channels: u32, matrices: bool) -> Result<Vec<Candidate>, Failure> {
    let standard = |name: &str, conv| (name.to_owned(), Convolution::Standard, Target { conv, ..Target::default() });
    let separable =
        |name: &str, separable| (name.to_owned(), Convolution::Separable, Target { separable, ..Target::default() });
    let mut all = vec![
        standard("direct", ConvAlgorithm::Direct),
        standard("F(2x2,3x3)", ConvAlgorithm::Winograd(WinogradTile::F2)),
        standard("F(4x4,3x3)", ConvAlgorithm::Winograd(WinogradTile::F4)),
        separable("two kernels", SeparableForm::TwoKernels),
        separable("fused", SeparableForm::Fused),
    ];
    if matrices {
        all.push(standard(&format!("direct {ON_MATRICES}"), ConvAlgorithm::Direct));
        all.push(separable(&format!("two kernels {ON_MATRICES}"), SeparableForm::TwoKernels));
    }
    let candidate = |(name, conv, options): (String, _, _)| {
        let graph = Graph::of_convolution(conv, channels).map_err(|error| Failure(error.to_string()))?;
        let precision = if name.ends_with(ON_MATRICES) { Precision::Matrix } else { Precision::F32 };
        Ok(Candidate { name, graph, options, precision })
    };
    all.into_iter().map(candidate).collect()
}

/// The subcommand.
pub fn conv(session: &Session, extent: Extent, channels: u32, output: &Output) -> Result<(), Failure> {
    let results = parts::measure(session, extent, candidates(channels, session.device.has_matrices())?)?;
    let title = format!("one 3x3 convolution, {channels} channels, {}x{}", extent.width, extent.height);
    let mut rows: Vec<Row> = Vec::new();
    for result in &results {
        let named = rows::rows(&result.runs, &session.roof).into_iter();
        rows.extend(named.map(|row| Row { stage: result.name.clone(), ..row }));
    }
    let sums = rows::sums(&rows, &session.roof, |row| &row.stage);
    // A run of each, one after another.
    let mut run: Vec<KernelRecord> = Vec::new();
    for result in &results {
        let end = run.last().map_or(0.0, |last| last.start + last.microseconds);
        let mut records = export::middle(&result.runs).to_vec();
        records.iter_mut().for_each(|record| record.start += end);
        run.append(&mut records);
    }
    export::files(&title, &run, &rows, output)?;
    if let Some(path) = &output.plot {
        let point = |series: &str, row: &Row| Point {
            series: series.into(),
            flop_per_byte: row.flop_per_byte,
            flop_per_second: row.gflop_per_second * 1e9,
        };
        let mut points: Vec<_> = sums.iter().map(|sum| point(&sum.layer, sum)).collect();
        let halves = rows.iter().filter(|row| row.stage == "two kernels");
        points.extend(halves.map(|row| point(&format!("two kernels: {}", row.kernel), row)));
        plot::roofline(path, &title, &session.roof, &points).map_err(Failure)?;
    }
    if output.json {
        let wholes: Vec<_> = results
            .iter()
            .map(|r| json!({ "name": r.name, "ms": r.whole, "cpu_ms": r.cpu, "times_direct": r.ratio }))
            .collect();
        let report = json!({
            "session": session.header(), "width": extent.width, "height": extent.height, "channels": channels,
            "variants": wholes, "kernels": rows, "sums": sums,
        });
        println!("{report:#}");
        return Ok(());
    }
    print!("{title}\n{}\n", session.header().text());
    let head = [
        "variant",
        "kernel",
        "ms",
        "min",
        "spread",
        "CPU ms",
        "times direct",
        "GFLOP",
        "MB",
        "FLOP/B",
        "GFLOP/s",
        "GB/s",
        "of roof",
        "global M",
        "shared M",
    ];
    let count = |count: Option<f64>| count.map_or("-".into(), number);
    let mut lines = vec![head.map(String::from).to_vec()];
    for result in &results {
        let mut line = vec![result.name.clone(), String::new()];
        line.extend([result.whole.median, result.whole.min, result.whole.spread].map(number));
        line.push(count(result.cpu.map(|cpu| cpu.median)));
        line.push(format!("{:.2}", result.ratio));
        lines.push(line);
        for row in rows.iter().filter(|row| row.stage == result.name) {
            let (ms, bytes) = (row.microseconds.times(1e-3), row.mb_read + row.mb_written);
            let mut line = vec![String::new(), row.variant.clone()];
            line.extend([ms.median, ms.min, ms.spread].map(number));
            line.extend([String::new(), String::new()]);
            line.extend([row.gflop, bytes, row.flop_per_byte, row.gflop_per_second, row.gb_per_second].map(number));
            line.push(format!("{:.1} %", row.percent_of_roof));
            line.extend([row.global_accesses, row.shared_accesses].map(count));
            lines.push(line);
        }
    }
    print!("{}", table::aligned(&lines, 2));
    println!(
        "\nTimes direct: the median of runs in turn, of CPU time on a CPU driver. Accesses are loads and stores of invocations, in millions; the thesis counts instructions of {WARP} lanes: a\n\
         {WARP}th of them. The thesis, 1024x1024, NVIDIA L40S:"
    );
    thesis::CONVOLUTIONS.iter().for_each(|line| println!("  {line}"));
    Ok(())
}

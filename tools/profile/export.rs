//! CSV and Chrome traces.

use crate::Failure;
use crate::args::Output;
use crate::rows::Row;
use serde_json::{Value, json};
use std::path::Path;
use vkdenoise::KernelRecord;

/// Writes the CSV and the trace of a run that `output` asks for.
pub fn files(title: &str, run: &[KernelRecord], rows: &[Row], output: &Output) -> Result<(), Failure> {
    let write = |path: &Path, text: String| {
        std::fs::write(path, text).map_err(|error| Failure(format!("{}: {error}", path.display())))
    };
    if let Some(path) = &output.csv {
        write(path, csv(rows))?;
    }
    if let Some(path) = &output.trace {
        write(path, trace(title, run).to_string())?;
    }
    Ok(())
}

/// The run of the median total; empty where there is none.
pub fn middle(runs: &[Vec<KernelRecord>]) -> &[KernelRecord] {
    let total = |run: &&Vec<KernelRecord>| run.iter().map(|record| record.microseconds).sum::<f64>();
    let mut sorted: Vec<_> = runs.iter().collect();
    sorted.sort_by(|a, b| total(a).total_cmp(&total(b)));
    sorted.get(sorted.len() / 2).map_or(&[], |run| run.as_slice())
}

/// The rows as CSV, a head first. No cell needs quotes: names are of letters, digits and dots.
pub fn csv(rows: &[Row]) -> String {
    let mut text = String::from(
        "stage,layer,kernel,variant,shape,groups,us_median,us_min,us_spread,share,gflop,mb_read,mb_written,\
         gflop_per_second,gb_per_second,flop_per_byte,percent_of_roof,global_accesses_m,shared_accesses_m\n",
    );
    for row in rows {
        let optional = |value: Option<f64>| value.map(|v| v.to_string()).unwrap_or_default();
        let cells = [
            row.stage.clone(),
            row.layer.clone(),
            row.kernel.clone(),
            row.variant.clone(),
            row.shape.clone(),
            row.groups.to_string(),
            row.microseconds.median.to_string(),
            row.microseconds.min.to_string(),
            row.microseconds.spread.to_string(),
            row.share.to_string(),
            row.gflop.to_string(),
            row.mb_read.to_string(),
            row.mb_written.to_string(),
            row.gflop_per_second.to_string(),
            row.gb_per_second.to_string(),
            row.flop_per_byte.to_string(),
            row.percent_of_roof.to_string(),
            optional(row.global_accesses),
            optional(row.shared_accesses),
        ];
        text += &cells.join(",");
        text.push('\n');
    }
    text
}

/// One run as complete events of the Trace Event Format, which chrome://tracing and Perfetto read: stages in one track,
/// kernels in another.
pub fn trace(title: &str, records: &[KernelRecord]) -> Value {
    let name =
        |what, tid: u32, text: &str| json!({"ph": "M", "pid": 1, "tid": tid, "name": what, "args": {"name": text}});
    let mut events =
        vec![name("process_name", 0, title), name("thread_name", 1, "stages"), name("thread_name", 2, "kernels")];
    for stage in records.chunk_by(|a, b| a.stage == b.stage) {
        let (Some(first), Some(last)) = (stage.first(), stage.last()) else { continue };
        events.push(json!({
            "ph": "X", "pid": 1, "tid": 1, "name": first.stage.to_string(), "cat": "stage",
            "ts": first.start, "dur": last.start + last.microseconds - first.start,
        }));
    }
    for record in records {
        events.push(json!({
            "ph": "X", "pid": 1, "tid": 2, "name": record.name, "cat": record.kernel,
            "ts": record.start, "dur": record.microseconds,
            "args": {
                "variant": record.variant, "shape": record.shape.to_string(), "groups": record.groups,
                "flops": record.flops, "bytes_read": record.bytes_read, "bytes_written": record.bytes_written,
            },
        }));
    }
    json!({ "traceEvents": events, "displayTimeUnit": "ns" })
}

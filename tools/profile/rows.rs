//! Kernels as rows: what a record says, with times of many runs and the rates that follow.

use crate::summary::Summary;
use serde::Serialize;
use vkdenoise::KernelRecord;
use vkdenoise::profile::Roof;

/// One kernel, or a sum of kernels.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    pub stage: String,
    pub layer: String,
    pub kernel: String,
    pub variant: String,
    /// On cooperative matrices; of a sum: all of it.
    pub matrix: bool,
    pub shape: String,
    pub groups: u64,
    pub microseconds: Summary,
    /// Of the time of all rows.
    pub share: f64,
    pub gflop: f64,
    pub mb_read: f64,
    pub mb_written: f64,
    pub gflop_per_second: f64,
    pub gb_per_second: f64,
    pub flop_per_byte: f64,
    /// Of what the device could do at this intensity; of its bandwidth where there are no FLOPs.
    pub percent_of_roof: f64,
    /// Loads and stores of the invocations, in millions; absent where they depend on the frame.
    pub global_accesses: Option<f64>,
    pub shared_accesses: Option<f64>,
}

impl Row {
    /// Fills in what follows from time, FLOPs and bytes.
    fn rated(mut self, total: f64, roof: &Roof) -> Self {
        let seconds = (self.microseconds.median * 1e-6).max(1e-12);
        let bytes = (self.mb_read + self.mb_written) * 1e6;
        self.share = self.microseconds.median / total.max(1e-12);
        self.gflop_per_second = self.gflop / seconds;
        self.gb_per_second = bytes * 1e-9 / seconds;
        self.flop_per_byte = self.gflop * 1e9 / bytes.max(1.0);
        self.percent_of_roof = 100.0
            * if self.gflop > 0.0 {
                let at = if self.matrix { Roof::of_matrices_at } else { Roof::at };
                self.gflop_per_second * 1e9 / at(roof, self.flop_per_byte)
            } else {
                self.gb_per_second * 1e9 / roof.bytes_f32
            };
        self
    }
}

/// A row for each kernel, from the records of every run.
pub fn rows(runs: &[Vec<KernelRecord>], roof: &Roof) -> Vec<Row> {
    let kernels = runs.first().map_or(&[][..], Vec::as_slice);
    let times = |i: usize| runs.iter().filter_map(|run| run.get(i)).map(|r| r.microseconds).collect::<Vec<_>>();
    let summaries: Vec<_> = (0..kernels.len()).map(|i| Summary::of(&times(i))).collect();
    let total = summaries.iter().map(|summary| summary.median).sum();
    let row = |(record, microseconds): (&KernelRecord, Summary)| Row {
        stage: record.stage.to_string(),
        layer: record.name.clone(),
        kernel: record.kernel.into(),
        variant: record.variant.into(),
        matrix: record.matrix,
        shape: record.shape.to_string(),
        groups: record.groups.iter().map(|&n| u64::from(n)).product(),
        microseconds,
        share: 0.0,
        gflop: record.flops as f64 * 1e-9,
        mb_read: record.bytes_read as f64 * 1e-6,
        mb_written: record.bytes_written as f64 * 1e-6,
        gflop_per_second: 0.0,
        gb_per_second: 0.0,
        flop_per_byte: 0.0,
        percent_of_roof: 0.0,
        global_accesses: record.accesses.map(|a| a.global() as f64 * 1e-6),
        shared_accesses: record.accesses.map(|a| a.shared() as f64 * 1e-6),
    };
    kernels.iter().zip(summaries).map(|pair| row(pair).rated(total, roof)).collect()
}

/// Sums of rows that `key` gives one name, in the order in which the names first occur. Their times are sums of times.
pub fn sums(rows: &[Row], roof: &Roof, key: impl Fn(&Row) -> &str) -> Vec<Row> {
    let total = rows.iter().map(|row| row.microseconds.median).sum();
    let mut sums: Vec<Row> = Vec::new();
    for row in rows {
        let name = key(row);
        let Some(sum) = sums.iter_mut().find(|sum| sum.layer == name) else {
            sums.push(Row { layer: name.into(), ..row.clone() });
            continue;
        };
        sum.groups += row.groups;
        sum.matrix &= row.matrix;
        sum.microseconds.median += row.microseconds.median;
        sum.microseconds.min += row.microseconds.min;
        // Of independent parts; theirs may be less so.
        sum.microseconds.spread = sum.microseconds.spread.hypot(row.microseconds.spread);
        sum.gflop += row.gflop;
        sum.mb_read += row.mb_read;
        sum.mb_written += row.mb_written;
        sum.global_accesses = sum.global_accesses.zip(row.global_accesses).map(|(a, b)| a + b);
        sum.shared_accesses = sum.shared_accesses.zip(row.shared_accesses).map(|(a, b)| a + b);
    }
    sums.into_iter().map(|sum| sum.rated(total, roof)).collect()
}

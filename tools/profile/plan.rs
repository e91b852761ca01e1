//! `plan`: what a network's pass asks of a device that need not be there. A plan is data, and so is what a device can
//! do: every kernel's FLOPs and bytes, the time that a roofline gives it, and what it is predicted to add to the pass.
//!
//! Kernels between two waits run at once: they share the device's rates, and one latency. So a wait costs itself and a
//! latency, and every kernel its share of the roof.

use crate::session::Session;
use crate::table::{self, number};
use crate::{Failure, args::Common};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::BTreeMap;
use vkdenoise::kernels::{Arithmetic, Storage};
use vkdenoise::net::{Arch, Graph, Head};
use vkdenoise::options::FfnForm;
use vkdenoise::plan::{Dispatch, plan};
use vkdenoise::profile::{Roof, Shape};
use vkdenoise::target::Target;
use vkdenoise::{Extent, Precision};

/// What a device can do, in GFLOP/s, GB/s and microseconds.
#[derive(Clone, Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Machine {
    pub name: String,
    /// Multiply-adds of 32-bit floats, counted twice.
    pub gflop_per_second: f64,
    /// The same of products of halves on cooperative matrices, summed in 32-bit floats; absent where there are none.
    pub matrix_gflop_per_second: Option<f64>,
    /// Bytes read and written by a copy.
    pub gb_per_second: f64,
    /// A dispatch that waits for the one before it.
    pub barrier_us: f64,
    /// One that does not.
    pub dispatch_us: f64,
    /// What kernels between two waits take at least, whatever they compute.
    #[serde(default)]
    pub latency_us: f64,
    /// Share of the roof that kernels reach beside that.
    #[serde(default = "whole")]
    pub of_roof: f64,
}

fn whole() -> f64 {
    1.0
}

/// Measured on an NVIDIA H100 80GB, driver 580.159.04, latency and share of the roof fitted to whole passes
/// (`docs/performance.md`); the second is a mid-range card of 2023 by its data sheet, with the H100's.
fn named(name: &str) -> Option<Machine> {
    let target = |gflop_per_second, matrix, gb_per_second| Machine {
        name: name.into(),
        gflop_per_second,
        matrix_gflop_per_second: Some(matrix),
        gb_per_second,
        barrier_us: 1.6,
        dispatch_us: 0.2,
        latency_us: 10.3,
        of_roof: 0.296,
    };
    match name {
        "h100" => Some(target(61_500.0, 607_000.0, 2930.0)),
        "mid-range" => Some(target(29_000.0, 58_000.0, 504.0)),
        _ => None,
    }
}

impl Machine {
    /// By a built-in name, from a JSON file of the same fields, or, as "device", measured on the device at hand.
    pub fn find(name: &str, common: &Common) -> Result<Self, Failure> {
        if name == "device" {
            let session = Session::open(common)?;
            let Roof { flops_f32, bytes_f32, flops_matrix, .. } = session.roof;
            return Ok(Self {
                name: session.device.info().name.clone(),
                gflop_per_second: flops_f32 * 1e-9,
                matrix_gflop_per_second: flops_matrix.map(|rate| rate * 1e-9),
                gb_per_second: bytes_f32 * 1e-9,
                barrier_us: 0.0,
                dispatch_us: 0.0,
                latency_us: 0.0,
                of_roof: 1.0,
            });
        }
        if let Some(target) = named(name) {
            return Ok(target);
        }
        let text = std::fs::read_to_string(name).map_err(|error| {
            Failure(format!(
                "--target {name}: {error}; give h100, mid-range, device or a JSON file with a target's fields"
            ))
        })?;
        let target: Self = serde_json::from_str(&text).map_err(|error| Failure(format!("--target {name}: {error}")))?;
        let rates = [Some(target.gflop_per_second), target.matrix_gflop_per_second, Some(target.gb_per_second)];
        let times = [target.barrier_us, target.dispatch_us, target.latency_us];
        if !(target.of_roof > 0.0 && target.of_roof <= 1.0) {
            return Err(Failure(format!("--target {name}: of_roof must be above 0 and at most 1")));
        }
        if rates.into_iter().flatten().any(|rate| !(rate.is_finite() && rate > 0.0))
            || times.iter().any(|us| us.is_nan() || *us < 0.0)
        {
            return Err(Failure(format!("--target {name}: rates must be above 0 and times not below it")));
        }
        Ok(target)
    }

    /// How a device of this kind runs a network.
    fn target(&self, precision: Precision) -> Result<Target, Failure> {
        let (storage, arithmetic) = match precision {
            Precision::F32 => (Storage::F32, Arithmetic::Floats),
            Precision::F16 => (Storage::F16, Arithmetic::Floats),
            Precision::Matrix if self.matrix_gflop_per_second.is_none() => {
                return Err(Failure(format!("the target {} has no matrices", self.name)));
            }
            Precision::Auto if self.matrix_gflop_per_second.is_none() => (Storage::F16, Arithmetic::Floats),
            Precision::Auto | Precision::Matrix => (Storage::F16, Arithmetic::Matrices),
        };
        Ok(Target::for_gpu(storage, arithmetic))
    }
}

/// One dispatch.
#[derive(Serialize)]
struct Row {
    stage: String,
    layer: String,
    variant: &'static str,
    shape: String,
    groups: u32,
    gflop: f64,
    mb_read: f64,
    mb_written: f64,
    /// The larger of what its FLOPs and its bytes take.
    roof_us: f64,
    /// What it adds to the pass: by the share of the roof that is reached, with the dispatch itself, and where it waits
    /// with a latency.
    predicted_us: f64,
}

impl Row {
    /// Of a dispatch; the pass's `first` waits for what was before.
    fn new(dispatch: &Dispatch, first: bool, machine: &Machine) -> Self {
        let (contract, traffic) = (dispatch.variant.contract, dispatch.traffic());
        let megabytes = |touched: &[(_, u64)]| touched.iter().map(|(_, bytes)| *bytes as f64 * 1e-6).sum::<f64>();
        let (mb_read, mb_written) = (megabytes(&traffic.reads), megabytes(&traffic.writes));
        let matrices = machine.matrix_gflop_per_second.filter(|_| contract.needs_matrix());
        let gflop = dispatch.flops as f64 * 1e-9;
        let by_flops = gflop / matrices.unwrap_or(machine.gflop_per_second) * 1e6;
        let roof_us = by_flops.max((mb_read + mb_written) / machine.gb_per_second * 1e3);
        let own_us = match first || dispatch.barrier {
            true => machine.barrier_us + machine.latency_us,
            false => machine.dispatch_us,
        };
        Self {
            stage: dispatch.stage.to_string(),
            layer: dispatch.name.clone(),
            variant: contract.name,
            shape: Shape::of(&dispatch.call).to_string(),
            groups: dispatch.groups.into_iter().product(),
            gflop,
            mb_read,
            mb_written,
            roof_us,
            predicted_us: roof_us / machine.of_roof + own_us,
        }
    }

    fn numbers(&self) -> Vec<String> {
        [self.gflop, self.mb_read, self.mb_written, self.roof_us, self.predicted_us].map(number).to_vec()
    }

    fn add(&mut self, other: &Self) {
        self.gflop += other.gflop;
        self.mb_read += other.mb_read;
        self.mb_written += other.mb_written;
        self.roof_us += other.roof_us;
        self.predicted_us += other.predicted_us;
        self.groups += 1;
    }
}

/// Sums by variant, and of all; `groups` counts dispatches.
fn sums(rows: &[Row]) -> Vec<Row> {
    let empty = |variant| Row {
        stage: String::new(),
        layer: String::new(),
        variant,
        shape: String::new(),
        groups: 0,
        gflop: 0.0,
        mb_read: 0.0,
        mb_written: 0.0,
        roof_us: 0.0,
        predicted_us: 0.0,
    };
    let (mut by_variant, mut all) = (BTreeMap::new(), empty("all"));
    for row in rows {
        by_variant.entry(row.variant).or_insert_with(|| empty(row.variant)).add(row);
        all.add(row);
    }
    by_variant.into_values().chain([all]).collect()
}

/// The subcommand.
pub fn plan_of(
    (name, head): (&str, Head),
    extent: Extent,
    precision: Precision,
    ffn: Option<FfnForm>,
    machine: &Machine,
    as_json: bool,
) -> Result<(), Failure> {
    let arch = Arch::named(name).ok_or_else(|| Failure(format!("there is no network called {name}")))?;
    let graph = Graph::new(&Arch { head, ..arch }).map_err(|error| Failure(error.to_string()))?;
    let suitable = machine.target(precision)?;
    let plan = plan(&graph, extent, &Target { ffn: ffn.unwrap_or(suitable.ffn), ..suitable })?;
    let dispatches = plan.dispatches.iter().enumerate();
    let rows: Vec<Row> = dispatches.map(|(i, dispatch)| Row::new(dispatch, i == 0, machine)).collect();
    let waits = plan.dispatches.iter().filter(|dispatch| dispatch.barrier).count();
    let sums = sums(&rows);
    if as_json {
        let report = json!({
            "target": machine, "network": name, "width": extent.width, "height": extent.height,
            "device_bytes": plan.bytes(), "arena_bytes": plan.blocks.iter().sum::<u64>(), "dispatches": rows.len(),
            "waits": waits, "kernels": rows, "sums": sums,
        });
        println!("{report:#}");
        return Ok(());
    }
    println!(
        "{name}, {}x{} on {}: {} dispatches, {waits} waits, {:.0} MiB of device memory",
        extent.width,
        extent.height,
        machine.name,
        rows.len(),
        plan.bytes() as f64 / f64::from(1 << 20)
    );
    let rates = ["GFLOP", "MB read", "MB written", "roof us", "predicted us"];
    let head = |first: &[&str]| vec![first.iter().chain(&rates).map(|cell| cell.to_string()).collect::<Vec<_>>()];
    let mut lines = head(&["stage", "layer", "variant", "shape", "groups"]);
    for row in &rows {
        let first =
            [row.stage.clone(), row.layer.clone(), row.variant.into(), row.shape.clone(), row.groups.to_string()];
        lines.push(first.into_iter().chain(row.numbers()).collect());
    }
    println!("{}", table::aligned(&lines, 4));
    let mut lines = head(&["variant", "dispatches"]);
    for sum in &sums {
        lines.push([sum.variant.to_owned(), sum.groups.to_string()].into_iter().chain(sum.numbers()).collect());
    }
    print!("{}", table::aligned(&lines, 1));
    Ok(())
}

//! `vkdenoise-bench pareto`: run time against error over a directory of rendered pairs.

use crate::pareto::frames::Pair;
use crate::pareto::front::{Metric, points};
use crate::pareto::measure::{Exact, Network, Setting, measure};
use crate::pareto::store::{Header, Store};
use crate::pareto::{Record, Result, frames, plot, table};
use crate::stress::subject::{PeerSpec, Tier};
use std::path::PathBuf;
use vkdenoise::{Device, DeviceSelector, Weights};

/// Options of `vkdenoise-bench pareto`.
#[derive(clap::Args)]
pub struct ParetoArgs {
    /// Rendered pairs: <scene>/<view>/spp####.exr beside a ref.exr.
    folder: PathBuf,
    /// Results file, a JSON line a record. A sweep that was stopped goes on with it.
    #[arg(long, default_value = "pareto.jsonl")]
    results: PathBuf,
    /// A known network (hybrid_kernels, which ships; hybrid, expanded_patch) or another as NAME=WEIGHTS; may be given
    /// again. All that are known, where none is named.
    #[arg(long)]
    network: Vec<NetworkSpec>,
    /// Only the tier of this name; may be given again. All that the device runs, where none is named.
    #[arg(long)]
    tier: Vec<String>,
    /// Only these scenes, comma separated.
    #[arg(long, value_delimiter = ',')]
    scenes: Vec<String>,
    /// Only these sample counts, comma separated.
    #[arg(long, value_delimiter = ',')]
    spp: Vec<u32>,
    /// Timed runs of every setting on every frame, after one that warms up.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    repeat: u32,
    /// Side of the upper left part that is compared with f64, in pixels; 128x128 takes ten seconds on two cores. 0:
    /// nothing is compared.
    #[arg(long, default_value_t = 128)]
    exact_side: u32,
    /// A program to measure beside the engine, as NAME=COMMAND; may be given again. tools/measure/oidn_peer.py and
    /// pytorch_peer.py are such programs.
    #[arg(long)]
    peer: Vec<PeerSpec>,
    /// The error that the front is drawn in.
    #[arg(long, value_enum, default_value_t = Metric::Psnr)]
    metric: Metric,
    /// Device: an index or part of a name.
    #[arg(long, env = "VKDENOISE_DEVICE", default_value = "best")]
    device: DeviceSelector,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Write the table as CSV.
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Write the table as Markdown.
    #[arg(long)]
    markdown: Option<PathBuf>,
    /// Draw time against error as SVG.
    #[arg(long)]
    plot: Option<PathBuf>,
}

/// A network's name, and its file where it is not known.
#[derive(Clone)]
struct NetworkSpec {
    name: String,
    file: Option<PathBuf>,
}

impl std::str::FromStr for NetworkSpec {
    type Err = std::convert::Infallible;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text.split_once('=') {
            Some((name, file)) => Self { name: name.into(), file: Some(file.into()) },
            None => Self { name: text.into(), file: None },
        })
    }
}

/// Runs it.
pub fn run(args: &ParetoArgs) -> Result<()> {
    let device = Device::open(&args.device)?;
    let pairs = frames::find(&args.folder, &args.scenes, &args.spp)?;
    let tiers = tiers(&device, &args.tier)?;
    let networks = networks(&args.network)?;
    let info = device.info();
    let (name, driver) = (info.name.clone(), info.driver.clone());
    let header = Header { device: name, driver, version: env!("CARGO_PKG_VERSION").into() };
    let mut store = Store::open(&args.results, &header)?;

    let settings: Vec<Setting> = networks
        .iter()
        .flat_map(|network| tiers.iter().map(move |tier| Setting::Engine(network, *tier)))
        .chain(args.peer.iter().map(Setting::Peer))
        .collect();
    let progress = indicatif::ProgressBar::new(pairs.len() as u64);
    progress.set_style(indicatif::ProgressStyle::with_template("{wide_bar} {pos}/{len} {msg} {eta}")?);
    for pair in &pairs {
        progress.set_message(format!("{}/{} {} spp", pair.scene, pair.view, pair.spp));
        let missing: Vec<Setting> = settings
            .iter()
            .filter(|setting| !store.records.iter().any(|record| is_of(record, setting, pair)))
            .copied()
            .collect();
        for record in sweep(&device, &missing, &networks, pair, args)? {
            store.add(record)?;
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    // A results file may hold more than this sweep asked for.
    let asked = |record: &Record| settings.iter().any(|s| pairs.iter().any(|pair| is_of(record, s, pair)));
    let records: Vec<Record> = store.records.into_iter().filter(asked).collect();
    report(args, &header, &records)
}

fn is_of(record: &Record, setting: &Setting, pair: &Pair) -> bool {
    (record.network.as_str(), record.tier.as_str()) == setting.names()
        && (&record.scene, &record.view, record.spp) == (&pair.scene, &pair.view, pair.spp)
}

/// Measures settings on a pair; nothing is read where there are none.
fn sweep(
    device: &Device,
    settings: &[Setting],
    networks: &[Network],
    pair: &Pair,
    args: &ParetoArgs,
) -> Result<Vec<Record>> {
    if settings.is_empty() {
        return Ok(Vec::new());
    }
    let scene = pair.load()?;
    let is_used = |network: &&Network| settings.iter().any(|setting| setting.names().0 == network.name);
    let exact = networks
        .iter()
        .filter(|network| args.exact_side > 0 && is_used(network))
        .map(|network| Ok((network.name.as_str(), Exact::of(network, &scene, args.exact_side)?)))
        .collect::<Result<Vec<_>>>()?;
    let of_network = |name: &str| exact.iter().find(|(known, _)| *known == name).map(|(_, exact)| exact);
    measure(device, settings, of_network, (pair, &scene), args.repeat)
}

fn tiers(device: &Device, wanted: &[String]) -> Result<Vec<Tier>> {
    let all = Tier::swept(device);
    let names = all.iter().map(|tier| format!("'{}'", tier.name)).collect::<Vec<_>>().join(", ");
    if let Some(unknown) = wanted.iter().find(|name| all.iter().all(|tier| tier.name != **name)) {
        return Err(format!("no tier '{unknown}' on this device; there are {names}").into());
    }
    Ok(all.into_iter().filter(|tier| wanted.is_empty() || wanted.iter().any(|name| name == tier.name)).collect())
}

/// The thesis's Hybrid, which adds a residual to the colour.
const HYBRID: &[u8] = include_bytes!("../../weights/hybrid.safetensors");
/// The thesis's +Expanded Patch: full joint attention in every block.
const EXPANDED_PATCH: &[u8] = include_bytes!("../../weights/expanded_patch.safetensors");

fn networks(specs: &[NetworkSpec]) -> Result<Vec<Network>> {
    let network = |name: &str, weights| Network { name: name.into(), weights };
    let mut known = vec![
        network("hybrid_kernels", Weights::hybrid_kernels()?),
        network("hybrid", Weights::from_bytes(HYBRID)?),
        network("expanded_patch", Weights::from_bytes(EXPANDED_PATCH)?),
    ];
    if specs.is_empty() {
        return Ok(known);
    }
    let mut networks: Vec<Network> = Vec::new();
    for NetworkSpec { name, file } in specs {
        if networks.iter().any(|other| other.name == *name) {
            return Err(format!("two networks of the name '{name}': give each another").into());
        }
        networks.push(match file {
            Some(file) => {
                let weights = Weights::from_file(file).map_err(|error| format!("{}: {error}", file.display()))?;
                Network { name: name.clone(), weights }
            }
            None => match known.iter().position(|network| network.name == *name) {
                Some(at) => known.swap_remove(at),
                None => return Err(format!("no network '{name}' is known: give its file as {name}=WEIGHTS").into()),
            },
        });
    }
    Ok(networks)
}

fn report(args: &ParetoArgs, header: &Header, records: &[Record]) -> Result<()> {
    let points = points(records, args.metric);
    let write = |path: &PathBuf, text: String| {
        std::fs::write(path, text).map_err(|error| format!("{}: {error}", path.display()))
    };
    if let Some(path) = &args.csv {
        write(path, table::csv(&points))?;
    }
    if let Some(path) = &args.markdown {
        write(path, table::markdown(&points))?;
    }
    if let Some(path) = &args.plot {
        plot::draw(path, &format!("{}, {}", header.device, header.driver), args.metric, &points)?;
    }
    if args.json {
        println!("{:#}", serde_json::json!({ "device": header, "metric": args.metric, "points": points }));
    } else {
        print!("{}", table::text(&points));
    }
    Ok(())
}

//! `tables`: the thesis's Tables 4.1, 4.2, 4.4 and 4.5, its ten networks.

use crate::network;
use crate::network::Subject;
use crate::session::Session;
use crate::table::{self, number};
use crate::thesis::NETWORKS;
use crate::{Failure, thesis::NetworkRow};
use serde_json::json;
use vkdenoise::Extent;
use vkdenoise::net::table::table_costs;
use vkdenoise::net::{Arch, Graph, cost};

/// The subcommand.
pub fn tables(session: &Session, extent: Extent, json: bool) -> Result<(), Failure> {
    let head = [
        "network",
        "param M",
        "thesis",
        "GFLOP 128^2",
        "thesis",
        "true GFLOP",
        "ms",
        "min",
        "spread",
        "CPU ms",
        "of baseline",
        "thesis: s 1024^2",
        "of baseline",
        "PSNR",
        "SSIM",
    ];
    let (mut lines, mut reports) = (vec![head.map(String::from).to_vec()], Vec::new());
    let mut baseline = None;
    for NetworkRow { name, parameters_m, gflop, seconds, psnr, ssim } in NETWORKS {
        let arch = Arch::named(name).ok_or_else(|| Failure(format!("there is no network called {name}")))?;
        let graph = Graph::new(&arch).map_err(|error| Failure(error.to_string()))?;
        let costs = table_costs(&graph);
        let multiple = arch.pad_multiple();
        let (width, height) = (extent.width.next_multiple_of(multiple), extent.height.next_multiple_of(multiple));
        let true_gflop = cost::flops(&graph, width, height).total() as f64 * 1e-9;
        let measured = network::measure(session, &arch, &Subject::whole(extent), false)?;
        let (time, cost) = (measured.plain, measured.cpu.unwrap_or(measured.plain).median);
        let base = *baseline.get_or_insert(cost);
        let mut line = vec![name.to_owned()];
        line.extend([costs.parameters as f64 * 1e-6, parameters_m].map(|value| format!("{value:.2}")));
        line.extend([costs.flops as f64 * 1e-9, gflop].map(|value| format!("{value:.2}")));
        line.extend([true_gflop, time.median, time.min, time.spread].map(number));
        line.push(measured.cpu.map_or("-".into(), |cpu| number(cpu.median)));
        line.push(format!("{:.3}", cost / base));
        line.extend([seconds, seconds / NETWORKS[0].seconds, psnr, ssim].map(|value| format!("{value:.3}")));
        lines.push(line);
        reports.push(json!({
            "network": name, "parameters": costs.parameters, "table_flops_128": costs.flops,
            "true_flops": true_gflop * 1e9, "ms": time, "cpu_ms": measured.cpu, "of_baseline": cost / base,
            "thesis": {
                "parameters_m": parameters_m, "gflop_128": gflop, "seconds_1024": seconds,
                "of_baseline": seconds / NETWORKS[0].seconds, "psnr": psnr, "ssim": ssim,
            },
        }));
    }
    if json {
        let report = json!({
            "session": session.header(), "width": extent.width, "height": extent.height, "networks": reports,
        });
        println!("{report:#}");
        return Ok(());
    }
    print!("the ten networks at {}x{}\n{}\n", extent.width, extent.height, session.header().text());
    print!("{}", table::aligned(&lines, 1));
    Ok(())
}

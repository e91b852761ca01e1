use std::fmt::Write;
use vkdenoise::kernels::*;
use vkdenoise::net::*;
use vkdenoise::plan::*;
use vkdenoise::target::*;
use vkdenoise::{Extent, QuietMode, Region};
#[test]
fn dump() {
    let mut s = String::new();
    for name in Arch::NAMES.iter().map(|n| n.to_string()).chain(["kernels".into()]) {
        let arch = if name == "kernels" {
            vkdenoise::Weights::hybrid_kernels().unwrap().arch().clone()
        } else {
            Arch::named(&name).unwrap()
        };
        let graph = Graph::new(&arch).unwrap();
        for (cpu, base) in [
            (true, Target::default()),
            (false, Target::default()),
            (true, Target { folds: Folds::ALL, separable: SeparableForm::Narrow, ..Target::default() }),
            (false, Target::for_gpu(Storage::F16, Arithmetic::Matrices)),
            (false, Target { max_chain_bytes: 1 << 20, ..Target::default() }),
            (false, Target { quiet: Some(QuietMode::Exact), ..Target::default() }),
            (false, Target { quiet: Some(QuietMode::default()), ..Target::default() }),
            (true, Target { conv: ConvAlgorithm::Winograd(winograd::WinogradTile::F2), ..Target::default() }),
        ] {
            let base = Target { kernels: KernelTarget { cpu, ..KernelTarget::default() }, ..base };
            for extent in [Extent::new(256, 256), Extent::new(299, 517)] {
                let plan = plan(&graph, extent, &base).unwrap();
                let region = plan.of_region(Region { x: 70, y: 100, width: 61, height: 90 });
                writeln!(
                    s,
                    "## {name} {cpu} {:?} {:?} {:?} {extent:?} blocks {:?}",
                    base.storage,
                    base.max_chain_bytes,
                    base.quiet.is_some(),
                    plan.blocks
                )
                .unwrap();
                for (what, list) in [
                    ("all", &plan.dispatches),
                    ("bare", plan.without_features.as_ref().unwrap_or(&plan.dispatches)),
                    ("region", &region),
                ] {
                    for d in list {
                        let mut t = d.traffic();
                        t.reads.sort();
                        t.writes.sort();
                        let quiet_tiles = d.call.grid().map(|g| (g.tiles, g.width, g.height));
                        writeln!(
                            s,
                            "{what} {} {} {:?} {:?} {:?} {} {} {} {:?} {:?}",
                            d.name,
                            d.variant.contract.name,
                            d.variant.special,
                            d.groups,
                            d.variant.tiles_a_group,
                            d.barrier,
                            d.flops,
                            d.skipped,
                            quiet_tiles,
                            t
                        )
                        .unwrap();
                    }
                }
            }
        }
    }
    std::fs::write("/tmp/plan_new.txt", s).unwrap();
}

//! Parameters and FLOPs of the ten networks, in the thesis's convention and true, are those of the thesis and of
//! PyTorch.

use std::collections::BTreeMap;

use vkdenoise::net::{Arch, Graph, Stage, cost, table};

/// Name; parameters in M and GFLOP as the thesis prints them; true parameters and GFLOP. All FLOPs at 128x128.
const ROWS: [(&str, &str, &str, u64, &str); 10] = [
    ("jsa_baseline", "33.29", "29.20", 31_595_632, "30.412"),
    ("shsa_100", "28.06", "24.45", 28_068_550, "26.243"),
    ("shsa_075", "25.77", "22.34", 25_776_078, "23.666"),
    ("shsa_050", "24.13", "20.83", 24_135_254, "21.680"),
    ("shsa_025", "23.14", "19.92", 23_146_078, "20.285"),
    ("film_cnn", "33.43", "30.57", 31_760_035, "30.312"),
    ("symmetric_decoder", "33.05", "21.32", 31_368_365, "21.127"),
    ("three_stage", "6.01", "12.19", 5_743_389, "12.190"),
    ("expanded_patch", "6.07", "3.70", 5_798_749, "3.695"),
    ("hybrid", "4.44", "3.03", 4_445_489, "2.902"),
];

fn graph(name: &str) -> Graph {
    Graph::new(&Arch::named(name).unwrap()).unwrap()
}

#[test]
fn the_thesis_tables_come_out() {
    for (name, parameters, gflop, ..) in ROWS {
        let costs = table::table_costs(&graph(name));
        let found = (format!("{:.2}", costs.parameters as f64 / 1e6), format!("{:.2}", costs.flops as f64 / 1e9));
        assert_eq!(found, (parameters.into(), gflop.into()), "{name}");
    }
}

#[test]
fn the_true_counts_come_out() {
    for (name, _, _, parameters, gflop) in ROWS {
        let graph = graph(name);
        let found = format!("{:.3}", cost::flops(&graph, 128, 128).total() as f64 / 1e9);
        assert_eq!((cost::parameters(&graph), found), (parameters, gflop.into()), "{name}");
    }
}

/// The hybrid at 1024x1024, by form of operation and by stage.
#[test]
fn the_work_of_the_hybrid_divides_as_designed() {
    let graph = graph("hybrid");
    let giga = |flops: u64| format!("{:.1}", flops as f64 / 1e9);

    let all = cost::flops(&graph, 1024, 1024);
    let forms = [all.total(), all.dense, all.pointwise, all.depthwise, all.attention].map(giga);
    assert_eq!(forms, ["185.7", "85.8", "92.1", "5.6", "2.3"]);

    let mut stages = BTreeMap::<Stage, u64>::new();
    for op in &graph.ops {
        *stages.entry(op.stage).or_default() += cost::op_flops(&graph, op, 1024, 1024).total();
    }
    let found: Vec<String> = stages.into_iter().map(|(stage, flops)| format!("{stage} {}", giga(flops))).collect();
    let expected = [
        "input 24.5",
        "enc0 14.6",
        "enc1 15.8",
        "enc2 25.7",
        "bottleneck 10.2",
        "dec0 20.5",
        "dec1 21.7",
        "dec2 31.6",
        "output 21.1",
    ];
    assert_eq!(found, expected);
}

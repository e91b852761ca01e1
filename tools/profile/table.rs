//! Tables of text.

use crate::rows::Row;

/// Lines of cells, columns aligned: the first ones to the left as many as `left` says, the rest to the right.
pub fn aligned(lines: &[Vec<String>], left: usize) -> String {
    let columns = lines.iter().map(Vec::len).max().unwrap_or(0);
    let width =
        |i: usize| lines.iter().filter_map(|line| line.get(i)).map(|cell| cell.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut text = String::new();
    for line in lines {
        let cells = line
            .iter()
            .zip(&widths)
            .enumerate()
            .map(|(i, (cell, width))| if i < left { format!("{cell:<width$}") } else { format!("{cell:>width$}") });
        text += cells.collect::<Vec<_>>().join("  ").trim_end();
        text.push('\n');
    }
    text
}

const RATES: [&str; 12] = [
    "ms",
    "min",
    "spread",
    "share",
    "GFLOP",
    "MB read",
    "MB written",
    "GFLOP/s",
    "GB/s",
    "FLOP/B",
    "of roof",
    "active",
];

fn rates(row: &Row) -> Vec<String> {
    let ms = row.microseconds.times(1e-3);
    vec![
        number(ms.median),
        number(ms.min),
        number(ms.spread),
        format!("{:.1} %", 100.0 * row.share),
        number(row.gflop),
        number(row.mb_read),
        number(row.mb_written),
        number(row.gflop_per_second),
        number(row.gb_per_second),
        number(row.flop_per_byte),
        format!("{:.1} %", row.percent_of_roof),
        row.active().map_or("-".into(), |share| format!("{:.1} %", 100.0 * share)),
    ]
}

/// Every kernel.
pub fn kernels(rows: &[Row]) -> String {
    let head = ["stage", "layer", "variant", "shape", "groups"].into_iter().chain(RATES);
    let mut lines = vec![head.map(String::from).collect::<Vec<_>>()];
    for row in rows {
        let mut line =
            vec![row.stage.clone(), row.layer.clone(), row.variant.clone(), row.shape.clone(), row.groups.to_string()];
        line.extend(rates(row));
        lines.push(line);
    }
    aligned(&lines, 4)
}

/// Sums, by what `title` says.
pub fn sums(title: &str, rows: &[Row]) -> String {
    let head = [title].into_iter().chain(RATES);
    let mut lines = vec![head.map(String::from).collect::<Vec<_>>()];
    for row in rows {
        lines.push([row.layer.clone()].into_iter().chain(rates(row)).collect());
    }
    aligned(&lines, 1)
}

/// Four digits, never an exponent.
pub fn number(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if size >= 999.5 => format!("{value:.0}"),
        size if size >= 99.95 => format!("{value:.1}"),
        size if size >= 9.995 => format!("{value:.2}"),
        _ => format!("{value:.3}"),
    }
}

//! The error budget as a table.

use super::Line;
use std::fmt::Write;

/// A Markdown table.
pub fn markdown(lines: &[Line]) -> String {
    let mut out = String::from(
        "| dispatch | kernel | NMSE | worst window: NMSE, at | largest value | of fp16's range | below fp16's normals | rounding to fp16 alone: NMSE | largest score, product |\n\
         |---|---|---|---|---|---|---|---|---|\n",
    );
    for line in lines {
        let Line { name, kernel, nmse, largest, half_range, below_normal, rounded_to_half, worst_window, scores } =
            line;
        let window = worst_window.map_or("–".into(), |((x, y), nmse)| format!("{nmse:.1e}, {x},{y}"));
        let scores = scores.map_or("–".into(), |(single, product)| format!("{single:.3}, {product:.3}"));
        let _ = writeln!(
            out,
            "| {name} | {kernel} | {nmse:.1e} | {window} | {largest:.3} | {:.3} % | {:.2} % | {rounded_to_half:.1e} | {scores} |",
            100.0 * half_range,
            100.0 * below_normal,
        );
    }
    out
}

/// The same for people, without the Markdown.
pub fn text(lines: &[Line]) -> String {
    let table = markdown(lines);
    let rows: Vec<Vec<&str>> =
        table.lines().map(|line| line.trim_matches('|').split('|').map(str::trim).collect()).collect();
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..rows[0].len()).map(width).collect();
    let mut out = String::new();
    // The second row is Markdown's rule.
    for row in rows.iter().enumerate().filter(|(i, _)| *i != 1).map(|(_, row)| row) {
        for (cell, width) in row.iter().zip(&widths) {
            let _ = write!(out, "{cell:<width$}  ");
        }
        out.truncate(out.trim_end().len());
        out.push('\n');
    }
    out
}

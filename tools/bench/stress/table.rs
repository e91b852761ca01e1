//! The matrix of cases and subjects: for people, as JSON, as Markdown.

use super::{Bound, Measured};
use std::fmt::Write;

/// One bound on one case, with what each subject made of it.
pub struct Row {
    case: String,
    what: &'static str,
    bound: Bound,
    /// By subject; `None` where a subject has no such case.
    cells: Vec<Option<Measured>>,
}

/// Everything that was measured.
#[derive(Default)]
pub struct Matrix {
    subjects: Vec<String>,
    rows: Vec<Row>,
}

impl Matrix {
    /// Adds a subject, whose figures follow with [`Matrix::add`].
    pub fn add_subject(&mut self, name: &str) {
        self.subjects.push(name.into());
        for row in &mut self.rows {
            row.cells.push(None);
        }
    }

    /// Adds a figure of the latest subject.
    pub fn add(&mut self, case: &str, measured: Measured) {
        let found = self.rows.iter().position(|row| row.case == case && row.what == measured.what);
        let at = found.unwrap_or_else(|| {
            let cells = self.subjects.iter().map(|_| None).collect();
            self.rows.push(Row { case: case.into(), what: measured.what, bound: measured.bound, cells });
            self.rows.len() - 1
        });
        if let Some(cell) = self.rows[at].cells.last_mut() {
            *cell = Some(measured);
        }
    }

    /// Figures of the first `subjects` subjects that are outside their bounds.
    pub fn broken(&self, subjects: usize) -> Vec<String> {
        let cells =
            self.rows.iter().flat_map(|row| row.cells.iter().take(subjects).flatten().map(move |cell| (row, cell)));
        cells
            .filter(|(_, cell)| !cell.is_within())
            .map(|(row, cell)| format!("{}: {} is {} for {}", row.case, row.what, cell.shown(), row.bound))
            .collect()
    }

    /// A table for people.
    pub fn text(&self) -> String {
        let mut lines = vec![self.header()];
        lines.extend(self.rows.iter().map(|row| self.cells(row)));
        let columns = lines[0].len();
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..columns).map(width).collect();
        let mut out = String::new();
        for line in lines {
            for (cell, width) in line.iter().zip(&widths) {
                let _ = write!(out, "{cell:<width$}  ");
            }
            out.truncate(out.trim_end().len());
            out.push('\n');
        }
        out
    }

    /// A Markdown table.
    pub fn markdown(&self) -> String {
        let header = self.header();
        let mut out = format!("| {} |\n|{}\n", header.join(" | "), "---|".repeat(header.len()));
        for row in &self.rows {
            let _ = writeln!(out, "| {} |", self.cells(row).join(" | "));
        }
        out
    }

    /// `[{case, what, bound, subjects: {name: {value, worst, within}}}]`.
    pub fn json(&self) -> serde_json::Value {
        let row = |row: &Row| {
            let cells = self.subjects.iter().zip(&row.cells).filter_map(|(name, cell)| {
                let cell = cell.as_ref()?;
                // JSON has no NaN: null.
                let value = serde_json::json!({ "value": cell.value, "worst": cell.worst, "within": cell.is_within() });
                Some((name.clone(), value))
            });
            serde_json::json!({
                "case": row.case, "what": row.what, "bound": row.bound.to_string(),
                "subjects": cells.collect::<serde_json::Map<_, _>>(),
            })
        };
        self.rows.iter().map(row).collect()
    }

    fn header(&self) -> Vec<String> {
        let fixed = ["case", "measure", "bound"].map(String::from);
        fixed.into_iter().chain(self.subjects.iter().cloned()).collect()
    }

    fn cells(&self, row: &Row) -> Vec<String> {
        let fixed = [row.case.clone(), row.what.into(), row.bound.to_string()];
        let shown = |cell: &Option<Measured>| cell.as_ref().map_or_else(|| "–".into(), Measured::shown);
        fixed.into_iter().chain(row.cells.iter().map(shown)).collect()
    }
}

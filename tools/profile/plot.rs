//! The roofline as a picture: FLOPs a byte against FLOPs a second, both axes logarithmic.

use crate::plotting::{COLORS, legend};
use plotters::prelude::*;
use std::path::Path;
use vkdenoise::profile::Roof;

/// A kernel in the picture.
pub struct Point {
    /// Points of one series share a colour and a line of the legend.
    pub series: String,
    pub flop_per_byte: f64,
    pub flop_per_second: f64,
}

/// Of the second roof.
const GREY: RGBColor = RGBColor(150, 150, 150);
const SIZE: (u32, u32) = (960, 600);

/// Draws the points under the roof.
///
/// # Errors
/// What the file system or the drawing says.
pub fn roofline(path: &Path, title: &str, roof: &Roof, points: &[Point]) -> Result<(), String> {
    let said = |error: DrawingAreaErrorKind<_>| format!("{}: {error}", path.display());
    let area = SVGBackend::new(path, SIZE).into_drawing_area();
    area.fill(&WHITE).map_err(said)?;
    let ridge = roof.flops_f32 / roof.bytes_f32;
    let top = roof.flops_matrix.unwrap_or(0.0).max(roof.flops_f32);
    let least = |start: f64, of: fn(&Point) -> f64| points.iter().map(of).fold(start, f64::min);
    let most = |start: f64, of: fn(&Point) -> f64| points.iter().map(of).fold(start, f64::max);
    let x = least(ridge, |p| p.flop_per_byte) / 2.0..most(ridge, |p| p.flop_per_byte) * 2.0;
    // With room below for the legend.
    let y = least(roof.at(x.start), |p| p.flop_per_second) / 2e10..most(top, |p| p.flop_per_second) * 2e-9;
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(x.clone().log_scale(), y.log_scale())
        .map_err(said)?;
    chart
        .configure_mesh()
        .x_desc("FLOP per byte of memory traffic")
        .y_desc("GFLOP/s")
        .light_line_style(BLACK.mix(0.06))
        .max_light_lines(4)
        .draw()
        .map_err(said)?;
    let [flops, bytes] = [roof.flops_f32, roof.bytes_f32].map(|rate| rate * 1e-9);
    let mut roofs =
        vec![(format!("roof: {flops:.1} GFLOP/s of multiply-adds, {bytes:.1} GB/s of copies"), ridge, BLACK)];
    if let Some(flops) = roof.flops_matrix {
        roofs.push((format!("of matrices: {:.1} GFLOP/s", flops * 1e-9), flops / roof.bytes_f32, GREY));
    }
    // Behind the first, with which the next shares its slope.
    for (label, ridge, color) in roofs.into_iter().rev() {
        // The ridge is a corner: a line of three points, straight on these axes.
        let at = |intensity: f64| (intensity, intensity.min(ridge) * bytes);
        let corners = [x.start, ridge.clamp(x.start, x.end), x.end].map(at);
        chart
            .draw_series(LineSeries::new(corners, color.stroke_width(2)))
            .map_err(said)?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
    }
    let mut names: Vec<&str> = Vec::new();
    for point in points {
        if !names.contains(&point.series.as_str()) {
            names.push(&point.series);
        }
    }
    for (i, name) in names.into_iter().enumerate() {
        let color = COLORS[i % COLORS.len()].mix(0.85);
        let of_series = points.iter().filter(|point| point.series == name);
        let mark = |point: &Point| Circle::new((point.flop_per_byte, point.flop_per_second * 1e-9), 4, color.filled());
        chart
            .draw_series(of_series.map(mark))
            .map_err(said)?
            .label(name)
            .legend(move |(x, y)| Circle::new((x + 9, y), 4, color.filled()));
    }
    legend(&mut chart, SeriesLabelPosition::LowerRight).map_err(said)?;
    area.present().map_err(said)
}

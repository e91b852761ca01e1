//! Time against error as a picture: one colour a sample count, the front as a line.

use super::front::{Metric, Point};
use crate::plotting::{COLORS, legend};
use plotters::prelude::*;
use std::path::Path;

const SIZE: (u32, u32) = (1000, 640);

/// Draws the points.
///
/// # Errors
/// What the file system or the drawing says.
pub fn draw(path: &Path, title: &str, metric: Metric, points: &[Point]) -> Result<(), String> {
    let said = |error: DrawingAreaErrorKind<_>| format!("{}: {error}", path.display());
    let at = |point: &Point| (point.seconds_per_megapixel, metric.of(point));
    let (mut x, mut y) = ((f64::INFINITY, 0.0f64), (f64::INFINITY, f64::NEG_INFINITY));
    for (seconds, value) in points.iter().map(at) {
        x = (x.0.min(seconds), x.1.max(seconds));
        y = (y.0.min(value), y.1.max(value));
    }
    let margin = ((y.1 - y.0) * 0.08).max(1e-6);
    let area = SVGBackend::new(path, SIZE).into_drawing_area();
    area.fill(&WHITE).map_err(said)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        // Names stand to the right of their points.
        .build_cartesian_2d((x.0 / 1.3..x.1 * 2.5).log_scale(), y.0 - margin..y.1 + margin)
        .map_err(said)?;
    chart
        .configure_mesh()
        .x_desc("seconds a million pixels")
        .y_desc(metric.title())
        .light_line_style(BLACK.mix(0.06))
        .draw()
        .map_err(said)?;
    let mut names = Names::default();
    let mut counts: Vec<u32> = points.iter().map(|point| point.spp).collect();
    counts.dedup();
    for (i, spp) in counts.into_iter().enumerate() {
        let color = COLORS[i % COLORS.len()];
        let of_count = || points.iter().filter(move |point| point.spp == spp);
        let front = of_count().filter(|point| point.front).map(at);
        chart
            .draw_series(LineSeries::new(front, color.stroke_width(2)))
            .map_err(said)?
            .label(format!("{spp} spp, the front"))
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
        for point in of_count() {
            let style = if point.front { color.filled() } else { color.stroke_width(1) };
            let font = ("sans-serif", 11).into_font().color(&color);
            let name = if names.fits(chart.backend_coord(&at(point)), &point.setting) { &point.setting } else { "" };
            let mark =
                EmptyElement::at(at(point)) + Circle::new((0, 0), 4, style) + Text::new(name.to_owned(), (8, -5), font);
            chart.draw_series(std::iter::once(mark)).map_err(said)?;
        }
    }
    legend(&mut chart, SeriesLabelPosition::LowerLeft).map_err(said)?;
    area.present().map_err(said)
}

/// The names that stand already, as pixels from, to and height: of settings that lie together the fastest has one.
#[derive(Default)]
struct Names(Vec<(i32, i32, i32)>);

impl Names {
    /// Whether a name has room beside a point; then it stands.
    fn fits(&mut self, (x, y): (i32, i32), name: &str) -> bool {
        // As wide as the font's letters are on average, and as high.
        let (from, to, height) = (x, x + 12 + 5 * name.len() as i32, 12);
        let free = self.0.iter().all(|(left, right, at)| to < *left || *right < from || (y - at).abs() >= height);
        if free {
            self.0.push((from, to, y));
        }
        free
    }
}

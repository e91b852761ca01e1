//! The points as a table: for people, as Markdown, as CSV.

use super::Clock;
use super::front::Point;

const HEADS: [&str; 10] =
    ["spp", "setting", "s / Mpixel", "PSNR", "SSIM", "relMSE", "FLIP", "NMSE to f64", "worst sample", "front"];

fn cells(point: &Point) -> [String; 10] {
    let optional = |value: Option<f64>| value.map_or("–".into(), |v| format!("{v:.1e}"));
    let device = match point.clock {
        Clock::Cpu => " CPU",
        Clock::Device => "",
    };
    [
        point.spp.to_string(),
        point.setting.clone(),
        format!("{:.4}{device}", point.seconds_per_megapixel),
        format!("{:.2}", point.psnr),
        point.ssim.map_or("–".into(), |ssim| format!("{ssim:.3}")),
        format!("{:.4}", point.relmse),
        format!("{:.4}", point.flip),
        optional(point.nmse),
        optional(point.worst),
        if point.front { "yes".into() } else { String::new() },
    ]
}

/// Columns of equal width.
pub fn text(points: &[Point]) -> String {
    let mut lines = vec![HEADS.map(String::from)];
    lines.extend(points.iter().map(cells));
    let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..HEADS.len()).map(width).collect();
    let line = |cells: &[String; 10]| {
        let padded = cells.iter().zip(&widths).map(|(cell, &width)| format!("{cell:width$}"));
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
    };
    lines.iter().map(line).collect()
}

/// A Markdown table.
pub fn markdown(points: &[Point]) -> String {
    let row = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let rule = format!("|{}\n", "---|".repeat(HEADS.len()));
    row(&HEADS.map(String::from)) + &rule + &points.iter().map(|point| row(&cells(point))).collect::<String>()
}

/// One line a point under a line of names, all digits. Settings are quoted: they hold commas.
pub fn csv(points: &[Point]) -> String {
    let mut text =
        String::from("spp,setting,frames,clock,seconds_per_megapixel,psnr,ssim,relmse,flip,nmse,worst,front\n");
    for p in points {
        let optional = |value: Option<f64>| value.map(|v| v.to_string()).unwrap_or_default();
        let clock = match p.clock {
            Clock::Cpu => "cpu",
            Clock::Device => "device",
        };
        let setting = format!("\"{}\"", p.setting.replace('"', "\"\""));
        text += &format!(
            "{},{setting},{},{clock},{},{},{},{},{},{},{},{}\n",
            p.spp,
            p.frames,
            p.seconds_per_megapixel,
            p.psnr,
            optional(p.ssim),
            p.relmse,
            p.flip,
            optional(p.nmse),
            optional(p.worst),
            p.front
        );
    }
    text
}

//! Means over the frames, and which settings no other beats in both time and error.

use super::{Clock, Record};
use serde::Serialize;

/// The error that a front is drawn in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Metric {
    /// PSNR in dB, more is better.
    Psnr,
    /// SSIM, more is better.
    Ssim,
    /// relMSE, less is better.
    Relmse,
    /// FLIP, less is better.
    Flip,
}

impl Metric {
    /// Its name and unit.
    pub fn title(self) -> &'static str {
        match self {
            Self::Psnr => "PSNR, dB",
            Self::Ssim => "SSIM",
            Self::Relmse => "relMSE",
            Self::Flip => "FLIP",
        }
    }

    /// A point's value of it.
    pub fn of(self, point: &Point) -> f64 {
        match self {
            Self::Psnr => point.psnr,
            Self::Ssim => point.ssim.unwrap_or(f64::NAN),
            Self::Relmse => point.relmse,
            Self::Flip => point.flip,
        }
    }

    /// The same so that less is better.
    fn loss(self, point: &Point) -> f64 {
        match self {
            Self::Psnr | Self::Ssim => -self.of(point),
            Self::Relmse | Self::Flip => self.of(point),
        }
    }
}

/// The means of one setting at one sample count.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Point {
    /// Network and tier.
    pub setting: String,
    /// Samples per pixel.
    pub spp: u32,
    /// Frames of the means.
    pub frames: usize,
    /// What the seconds were taken with.
    pub clock: Clock,
    /// Seconds a million pixels.
    pub seconds_per_megapixel: f64,
    /// PSNR in dB.
    pub psnr: f64,
    /// SSIM, where every frame has one.
    pub ssim: Option<f64>,
    /// relMSE.
    pub relmse: f64,
    /// FLIP.
    pub flip: f64,
    /// Largest NMSE to f64, where there is any.
    pub nmse: Option<f64>,
    /// Largest difference of a sample to f64 in the log domain.
    pub worst: Option<f64>,
    /// Whether no other setting of the same sample count is both faster and closer.
    pub front: bool,
}

/// One point for each setting and sample count, in order of sample count and then time.
pub fn points(records: &[Record], metric: Metric) -> Vec<Point> {
    let mut groups: Vec<(String, u32, Vec<&Record>)> = Vec::new();
    for record in records {
        let setting = record.setting();
        match groups.iter_mut().find(|(name, spp, _)| *name == setting && *spp == record.spp) {
            Some((_, _, group)) => group.push(record),
            None => groups.push((setting, record.spp, vec![record])),
        }
    }
    let mut points: Vec<Point> = groups.into_iter().map(|(setting, spp, group)| point(setting, spp, &group)).collect();
    points.sort_by(|a, b| a.spp.cmp(&b.spp).then(a.seconds_per_megapixel.total_cmp(&b.seconds_per_megapixel)));
    let on_front: Vec<bool> = points.iter().map(|point| is_on_front(point, &points, metric)).collect();
    points.iter_mut().zip(on_front).for_each(|(point, front)| point.front = front);
    points
}

fn point(setting: String, spp: u32, group: &[&Record]) -> Point {
    let mean = |of: fn(&Record) -> f64| group.iter().map(|record| of(record)).sum::<f64>() / group.len() as f64;
    let largest = |of: fn(&Record) -> Option<f64>| group.iter().filter_map(|record| of(record)).reduce(f64::max);
    let ssim = group.iter().map(|record| record.ssim).sum::<Option<f64>>().map(|sum| sum / group.len() as f64);
    Point {
        setting,
        spp,
        frames: group.len(),
        clock: group[0].clock,
        seconds_per_megapixel: mean(Record::seconds_per_megapixel),
        psnr: mean(|record| record.psnr),
        ssim,
        relmse: mean(|record| record.relmse),
        flip: mean(|record| record.flip),
        nmse: largest(|record| record.nmse),
        worst: largest(|record| record.worst),
        front: false,
    }
}

fn is_on_front(point: &Point, all: &[Point], metric: Metric) -> bool {
    let at = |point: &Point| (point.seconds_per_megapixel, metric.loss(point));
    let (seconds, loss) = at(point);
    let beaten = |other: &Point| {
        let (s, l) = at(other);
        s <= seconds && l <= loss && (s < seconds || l < loss)
    };
    !all.iter().any(|other| other.spp == point.spp && beaten(other))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(network: &str, spp: u32, seconds: f64, psnr: f64) -> Record {
        Record {
            network: network.into(),
            tier: String::new(),
            scene: "s".into(),
            view: "v".into(),
            spp,
            pixels: 500_000,
            clock: Clock::Cpu,
            seconds,
            seconds_min: seconds,
            runs: 1,
            psnr,
            ssim: Some(0.5),
            relmse: 1.0,
            flip: 0.1,
            nmse: None,
            worst: None,
        }
    }

    #[test]
    fn means_and_the_front() {
        let records = [
            record("slow and close", 4, 2.0, 30.0),
            record("slow and close", 4, 4.0, 32.0),
            record("fast and far", 4, 1.0, 20.0),
            record("beaten", 4, 3.5, 30.5),
            record("alone", 1, 9.0, 1.0),
        ];
        let points = points(&records, Metric::Psnr);
        let shown: Vec<_> =
            points.iter().map(|p| (p.setting.as_str(), p.seconds_per_megapixel, p.psnr, p.front)).collect();
        assert_eq!(
            shown,
            [
                ("alone", 18.0, 1.0, true),
                ("fast and far", 2.0, 20.0, true),
                ("slow and close", 6.0, 31.0, true),
                ("beaten", 7.0, 30.5, false),
            ]
        );
    }

    #[test]
    fn less_is_better_where_it_is() {
        let mut records = [record("a", 4, 1.0, 20.0), record("b", 4, 2.0, 30.0)];
        (records[0].relmse, records[1].relmse) = (0.1, 0.2);
        let front = |metric| points(&records, metric).iter().map(|p| p.front).collect::<Vec<_>>();
        assert_eq!(front(Metric::Psnr), [true, true]);
        assert_eq!(front(Metric::Relmse), [true, false]);
    }
}

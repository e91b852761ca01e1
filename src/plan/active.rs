//! What a pass that leaves converged tiles out has denoised, read after it has run.

use super::Dispatch;
use crate::frame::Extent;
use crate::kernels::BufferId;
use crate::kernels::converged::MapSize;
use crate::net::op::Stage;

/// A part of the network whose dispatches share a list of tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    /// Which.
    pub stage: Stage,
    /// Pixels of a tile, on a side.
    pub tile_pixels: u32,
    /// Its tiles, active or not.
    pub tiles: u32,
    /// Whether a sample of what is converged is active too, for what is taken of the whole frame.
    pub sampled: bool,
}

/// Where the device tells of active tiles.
#[derive(Clone, Debug, PartialEq)]
pub struct Activity {
    /// 32-bit integers: for every square of the map 1 where it was denoised, else 0; then the number of active tiles of
    /// every part.
    pub buffer: BufferId,
    /// The map's size.
    pub size: MapSize,
    /// The parts.
    pub parts: Vec<Part>,
}

/// What was denoised of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ActiveTiles {
    /// Squares of 16 pixels, of the padded frame.
    pub size: MapSize,
    /// For every square whether it was denoised, row by row.
    pub map: Vec<bool>,
    /// The parts of the network, each with its active tiles.
    pub parts: Vec<(Part, u32)>,
}

impl Activity {
    /// Integers in the buffer.
    pub fn words(&self) -> u64 {
        u64::from(self.size.tiles()) + self.parts.len() as u64
    }

    /// What the buffer says; what is missing of `words` counts as not active.
    pub fn read(&self, words: &[u32]) -> ActiveTiles {
        let word = |at: usize| words.get(at).copied().unwrap_or(0);
        let squares = self.size.tiles() as usize;
        let counts = (squares..).map(word);
        ActiveTiles {
            size: self.size,
            map: (0..squares).map(|at| word(at) != 0).collect(),
            parts: self.parts.iter().copied().zip(counts).collect(),
        }
    }
}

impl ActiveTiles {
    /// The share of the squares of a frame that were denoised.
    pub fn denoised(&self, frame: Extent) -> f64 {
        let size = MapSize::of(frame);
        let rows = self.map.chunks(self.size.columns.max(1) as usize).take(size.rows as usize);
        let active = rows.flat_map(|row| row.iter().take(size.columns as usize)).filter(|active| **active).count();
        active as f64 / f64::from(size.tiles().max(1))
    }

    /// The share of a part's tiles that were active; 0 for a part that there is not.
    pub fn share(&self, part: usize) -> f64 {
        self.parts.get(part).map_or(0.0, |(part, active)| f64::from(*active) / f64::from(part.tiles.max(1)))
    }
}

/// The FLOPs of a recording: what is done whatever is converged, and for each part of the network what it is with all
/// tiles active.
pub(crate) struct Work {
    fixed: f64,
    parts: Vec<f64>,
}

impl Work {
    /// Of these dispatches, signals beside the colour aside.
    pub fn of(dispatches: &[Dispatch]) -> Self {
        let mut work = Self { fixed: 0.0, parts: Vec::new() };
        for dispatch in dispatches.iter().filter(|dispatch| !dispatch.of_signals) {
            let flops = dispatch.flops as f64;
            match dispatch.indirect {
                None => work.fixed += flops,
                Some(groups) => {
                    work.parts.resize(work.parts.len().max(groups.list + 1), 0.0);
                    work.parts[groups.list] += flops;
                }
            }
        }
        work
    }

    /// FLOPs with these active tiles; `None`: all.
    pub fn flops(&self, active: Option<&ActiveTiles>) -> f64 {
        let share = |part: usize| active.map_or(1.0, |active| active.share(part));
        self.fixed + self.parts.iter().enumerate().map(|(part, flops)| flops * share(part)).sum::<f64>()
    }
}

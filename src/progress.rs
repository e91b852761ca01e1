//! Progress of the host path, and how a pass is cut into submissions that it can stop between.

use crate::error::{Error, Result};
use crate::frame::Extent;
use crate::kernels::Call;
use crate::plan::Dispatch;
use crate::vk::caps::DeviceKind;
use std::ops::ControlFlow;

/// What [`crate::Denoiser::denoise_with`] calls on the caller's own thread, with the share of the work that is done: 0
/// before the first submission, then once after each, growing, 1 after the last. [`ControlFlow::Break`] ends the call
/// with [`Error::Cancelled`].
pub type Progress<'a> = dyn FnMut(f32) -> ControlFlow<()> + 'a;

/// Says how much is done.
///
/// # Errors
/// [`Error::Cancelled`] where the answer is to stop.
pub(crate) fn tell(progress: &mut Progress, done: f64) -> Result<()> {
    match progress(done.clamp(0.0, 1.0) as f32) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(Error::Cancelled),
    }
}

/// What a submission is to take, in milliseconds: half of the longest that an answer may take, as kernels differ in how
/// well their work predicts their time.
const TARGET_MS: f64 = 50.0;
/// Work in a millisecond before anything was measured: that of a small integrated GPU.
const FIRST_RATE: f64 = 1e8;
/// FLOPs in whose time a byte of memory traffic goes, and those of a pixel of the caller's planes, whose traffic no
/// plan counts.
const FLOPS_A_BYTE: f64 = 16.0;
const FLOPS_A_PIXEL: f64 = 512.0;

/// Predicted work of each dispatch of a pass over a frame of `extent` with so many signals: at least 1, and 0 for those
/// that are left out. What runs for one signal after the other is one piece of work: that of its first dispatch.
pub(crate) fn works(dispatches: &[Dispatch], extent: Extent, signals: usize) -> Vec<f64> {
    let work = |dispatch: &Dispatch| {
        if dispatch.skipped {
            return 0.0;
        }
        let share = dispatch.call.grid().map_or(1.0, |grid| {
            let [count, all] = grid.counts();
            f64::from(count) / f64::from(all.max(1))
        });
        let traffic = dispatch.traffic();
        let bytes: u64 = traffic.reads.iter().chain(&traffic.writes).map(|(_, bytes)| bytes).sum();
        let pixels = if reads_planes(&dispatch.call) { extent.pixels() } else { 0 };
        1.0 + dispatch.flops as f64 + share * (FLOPS_A_BYTE * bytes as f64 + FLOPS_A_PIXEL * pixels as f64)
    };
    let mut works: Vec<f64> = dispatches.iter().map(work).collect();
    let mut at = 0;
    for run in dispatches.chunk_by(|a, b| a.of_signals == b.of_signals) {
        let of_run = &mut works[at..at + run.len()];
        at += run.len();
        if run.iter().any(|dispatch| dispatch.of_signals) {
            let all: f64 = of_run.iter_mut().map(std::mem::take).sum();
            of_run.iter_mut().take(1).for_each(|first| *first = signals as f64 * all);
        }
    }
    works
}

/// Whether a kernel reads or writes planes of the caller's.
fn reads_planes(call: &Call) -> bool {
    matches!(
        call,
        Call::StatsHistogram(_)
            | Call::StatsTiles(_)
            | Call::TileNoise(_)
            | Call::InputColor(_)
            | Call::InputAux(_)
            | Call::Output(_)
            | Call::InputSignal(_)
            | Call::OutputSignal(_)
    )
}

/// Cuts a pass into submissions.
pub(crate) struct Pieces {
    /// Whether every dispatch is one by itself: on a CPU the submission costs nothing beside it.
    single: bool,
    /// Work in a millisecond: what the slowest kernels do, as far as is known.
    rate: f64,
}

impl Pieces {
    pub fn new(kind: DeviceKind) -> Self {
        Self { single: kind == DeviceKind::Cpu, rate: FIRST_RATE }
    }

    /// Where the piece ends that begins with dispatch `from`: it has one at least, and those that are left out add
    /// nothing.
    pub fn end(&self, works: &[f64], from: usize) -> usize {
        let most = self.rate * TARGET_MS;
        let mut sum = 0.0;
        for (at, work) in works.iter().enumerate().skip(from) {
            if *work > 0.0 && sum > 0.0 && (self.single || sum + work > most) {
                return at;
            }
            sum += work;
        }
        works.len()
    }

    /// A piece of so much work took so long: those to come are cut by that. The next may be of slower kernels, so that
    /// a fast one does not make them much longer.
    pub fn took(&mut self, work: f64, milliseconds: f64) {
        if work > 0.0 && milliseconds > 0.0 {
            self.rate = (work / milliseconds).min(2.0 * self.rate);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ends(pieces: &Pieces, works: &[f64]) -> Vec<usize> {
        let mut ends = vec![0];
        while ends[ends.len() - 1] < works.len() {
            ends.push(pieces.end(works, ends[ends.len() - 1]));
        }
        ends
    }

    #[test]
    fn pieces_are_as_long_as_the_rate_allows() {
        let mut pieces = Pieces::new(DeviceKind::DiscreteGpu);
        pieces.took(10.0, 10.0);
        let works = [20.0, 20.0, 20.0, 0.0, 70.0, 1.0, 0.0, 49.0];
        assert_eq!(ends(&pieces, &works), [0, 2, 4, 5, 8]);
        // No more than twice as much at once, however fast.
        pieces.took(10.0, 0.1);
        assert_eq!(ends(&pieces, &works), [0, 4, 7, 8]);
        pieces.took(10.0, 0.1);
        assert_eq!(ends(&pieces, &works), [0, 8]);
    }

    #[test]
    fn on_a_cpu_every_dispatch_is_one() {
        let pieces = Pieces::new(DeviceKind::Cpu);
        assert_eq!(ends(&pieces, &[0.0, 1.0, 0.0, 2.0, 3.0, 0.0]), [0, 3, 4, 6]);
    }
}

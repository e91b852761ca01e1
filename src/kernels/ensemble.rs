//! A frame and the same frame turned by half a circle, whose results are averaged ([`crate::Options::self_ensemble`]).

use super::{BufferId, Traffic, flags};
use crate::frame::Extent;

/// Which of the two an output is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Member {
    /// The turned frame, which comes first: its result is kept.
    Turned,
    /// The frame itself, whose result is averaged with that and goes to the caller.
    Upright,
}

impl Member {
    /// The flag that says so to an output.
    pub(super) fn flag(member: Option<Self>) -> u32 {
        match member {
            None => 0,
            Some(Self::Turned) => flags::TURNED,
            Some(Self::Upright) => flags::UPRIGHT,
        }
    }

    /// What it touches of the turned frame's result.
    pub(super) fn traffic(self, traffic: &mut Traffic, result: BufferId, bytes: u64) {
        let touched = match self {
            Self::Turned => &mut traffic.writes,
            Self::Upright => &mut traffic.reads,
        };
        touched.push((result, bytes));
    }
}

/// Bytes of the turned frame's result: 32-bit floats.
pub(crate) fn result_bytes(extent: Extent, channels: u64) -> u64 {
    4 * channels * extent.pixels()
}

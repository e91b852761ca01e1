//! Which dispatches run side by side: all between two waits are independent of each other, and there are as few waits
//! as the longest chain of dependencies asks for.
//!
//! Every dispatch goes to the first group before which all that it depends on is done (as soon as possible). So the
//! maps of the features are made beside those of the colour, which is what counts where a kernel lasts as long as one
//! tile, whatever there is of the frame.

use super::{Buffer, Dispatch, Place};
use crate::kernels::{BufferId, Call};
use std::collections::HashMap;

/// Dispatches in their order, each with the number of its group; groups follow each other.
#[derive(Clone, Default)]
pub(super) struct Scheduled {
    pub dispatches: Vec<Dispatch>,
    pub groups: Vec<usize>,
}

/// From which group on a buffer may be read, and from which on it may be overwritten.
#[derive(Clone, Copy, Default)]
struct Ready {
    to_read: usize,
    to_write: usize,
}

/// Puts dispatches that may run in the given order into groups. Those that touch a buffer of more than `overlap_bytes`,
/// and those of chains that run band by band, keep their order and share no group: side by side they would need their
/// maps at once. What is for signals, and the outputs after it, come after all that is before them.
pub(super) fn schedule(dispatches: Vec<Dispatch>, buffers: &[Buffer], overlap_bytes: u64) -> Scheduled {
    let mut ready: HashMap<BufferId, Ready> = HashMap::new();
    let (mut fence, mut end, mut ordered, mut of_signals) = (0, 0, 0, false);
    let mut grouped = Vec::new();
    for dispatch in dispatches {
        // An output may go where the frame's planes are.
        if dispatch.of_signals != of_signals || matches!(dispatch.call, Call::Output(_)) {
            (fence, of_signals) = (end, dispatch.of_signals);
        }
        let traffic = dispatch.traffic();
        let of = |id: &BufferId| ready.get(id).copied().unwrap_or_default();
        let reads = traffic.reads.iter().map(|(id, _)| of(id).to_read);
        let writes = traffic.writes.iter().map(|(id, _)| of(id).to_write);
        let mut group = reads.chain(writes).fold(fence, usize::max);
        let touched = traffic.reads.iter().chain(&traffic.writes).map(|(id, _)| &buffers[id.0]);
        let mut maps = touched.filter(|buffer| !matches!(buffer.place, Place::Weights { .. }));
        if dispatch.band.is_some() || maps.any(|buffer| buffer.bytes > overlap_bytes) {
            group = group.max(ordered);
            ordered = group + 1;
        }
        for (id, _) in &traffic.reads {
            let ready = ready.entry(*id).or_default();
            ready.to_write = ready.to_write.max(group + 1);
        }
        for (id, _) in &traffic.writes {
            ready.insert(*id, Ready { to_read: group + 1, to_write: group + 1 });
        }
        end = end.max(group + 1);
        grouped.push((group, dispatch));
    }
    // Stable: within a group as they came.
    grouped.sort_by_key(|(group, _)| *group);
    let (groups, dispatches) = grouped.into_iter().unzip();
    Scheduled { dispatches, groups }
}

//! Which dispatches depend on the features alone: albedo, normal, depth, and nothing that changes with the colour. What
//! they computed for one frame holds for the next as long as the features do.

use super::Dispatch;
use crate::kernels::BufferId;
use std::collections::HashSet;

/// Sets [`Dispatch::of_features`]. A dispatch counts that reads neither colour nor options of the frame, nor a buffer
/// that one that does not count has written, and whose own results no such one overwrites.
///
/// `is_weights` tells the buffers that nobody writes.
pub fn mark(dispatches: &mut [Dispatch], is_weights: impl Fn(BufferId) -> bool) {
    for dispatch in dispatches.iter_mut() {
        dispatch.of_features = !dispatch.call.kernel().reads_color();
    }
    let touched: Vec<_> = dispatches.iter().map(Dispatch::traffic).collect();
    // What no dispatch writes is filled from outside, with what is not known here.
    let written: HashSet<BufferId> = touched.iter().flat_map(|t| &t.writes).map(|(id, _)| *id).collect();
    loop {
        let others = dispatches.iter().zip(&touched).filter(|(dispatch, _)| !dispatch.of_features);
        let theirs: HashSet<BufferId> = others.flat_map(|(_, t)| &t.writes).map(|(id, _)| *id).collect();
        let foreign = |id: BufferId| theirs.contains(&id) || !(written.contains(&id) || is_weights(id));
        let mut settled = true;
        for (dispatch, traffic) in dispatches.iter_mut().zip(&touched).filter(|(dispatch, _)| dispatch.of_features) {
            if traffic.reads.iter().chain(&traffic.writes).any(|(id, _)| foreign(*id)) {
                dispatch.of_features = false;
                settled = false;
            }
        }
        if settled {
            return;
        }
    }
}

/// The buffers of features that other dispatches read: what must be kept for these to run alone.
pub fn kept<'a>(dispatches: impl Iterator<Item = &'a Dispatch>) -> Vec<BufferId> {
    let (of_features, others): (Vec<_>, Vec<_>) = dispatches.partition(|dispatch| dispatch.of_features);
    let written: HashSet<BufferId> = of_features.iter().flat_map(|d| d.traffic().writes).map(|(id, _)| id).collect();
    let read: HashSet<BufferId> = others.iter().flat_map(|d| d.traffic().reads).map(|(id, _)| id).collect();
    let mut kept: Vec<_> = written.intersection(&read).copied().collect();
    kept.sort_unstable();
    kept
}

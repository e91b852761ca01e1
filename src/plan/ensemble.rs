//! A frame and the same frame turned by half a circle, one pass after the other, whose results are averaged: the
//! geometric self-ensemble of Lim et al., "Enhanced Deep Residual Networks for Single Image Super-Resolution" (2017),
//! of two members. The turned frame comes first, as the caller's output may lie where the colour does. It goes through
//! the same network, in the same memory, or through one of its own: networks differ in more of their errors than one
//! does from itself.

use super::schedule::Scheduled;
use super::{Buffer, Dispatch, Place};
use crate::frame::{Extent, Region};
use crate::kernels::Call;
use crate::kernels::ensemble::Member;

/// The dispatches of the frame itself, after those of the turned one.
pub(super) fn both(mut upright: Vec<Dispatch>) -> Vec<Dispatch> {
    let mut both = upright.clone();
    for dispatch in &mut both {
        dispatch.turned = true;
        match &mut dispatch.call {
            Call::Output(output) => output.ensemble = output.ensemble.map(|(_, result)| (Member::Turned, result)),
            Call::OutputSignal(output) => output.member = output.member.map(|_| Member::Turned),
            _ => {}
        }
    }
    // In the same memory.
    upright.iter_mut().take(1).for_each(|dispatch| dispatch.barrier = true);
    both.append(&mut upright);
    both
}

/// Marks the buffers of the network that the turned frame goes through.
pub(super) fn of_turned(buffers: &mut [Buffer]) {
    for buffer in buffers {
        if let Place::Weights { turned, .. } = &mut buffer.place {
            *turned = true;
        }
    }
}

/// What one network makes of the turned frame, then what another makes of the frame itself, for frames with and without
/// features.
pub(super) fn joined(turned: Vec<Scheduled>, upright: Vec<Scheduled>) -> Vec<Scheduled> {
    let count = turned.len().max(upright.len());
    let of = |lists: &[Scheduled], at: usize| lists.get(at).or(lists.first()).cloned().unwrap_or_default();
    let join = |at: usize| {
        let (mut first, then) = (of(&turned, at), of(&upright, at));
        first.dispatches.iter_mut().for_each(|dispatch| dispatch.turned = true);
        let groups = first.groups.last().map_or(0, |last| last + 1);
        first.groups.extend(then.groups.iter().map(|group| groups + group));
        first.dispatches.extend(then.dispatches);
        first
    };
    (0..count).map(join).collect()
}

/// The dispatches of the turned frame, where there are any, and of the frame itself, each with where a region lies.
pub(crate) fn members(dispatches: &mut [Dispatch], region: Region, extent: Extent) -> [(&mut [Dispatch], Region); 2] {
    let (turned, upright) = dispatches.split_at_mut(dispatches.partition_point(|dispatch| dispatch.turned));
    [(turned, region.turned(extent)), (upright, region)]
}

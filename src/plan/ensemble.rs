//! A frame and the same frame turned by half a circle, one pass after the other, whose results are averaged: the
//! geometric self-ensemble of Lim et al., "Enhanced Deep Residual Networks for Single Image Super-Resolution" (2017),
//! of two members. The turned frame comes first, as the caller's output may lie where the colour does.

use super::Dispatch;
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

/// The dispatches of the turned frame, where there are any, and of the frame itself, each with where a region lies.
pub(crate) fn members(
    dispatches: &mut [Dispatch],
    region: Region,
    extent: Extent,
) -> [(&mut [Dispatch], Region); 2] {
    let (turned, upright) = dispatches.split_at_mut(dispatches.partition_point(|dispatch| dispatch.turned));
    [(turned, region.turned(extent)), (upright, region)]
}

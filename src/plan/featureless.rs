//! Frames without albedo, normal and depth. Their features are the same at every pixel, so all that is computed of them
//! is the same at every token, but for the borders, where convolutions read zeros. It is enough to compute a small
//! frame's and to repeat its middle.

use super::{Buffer, Dispatch, Place};
use crate::frame::Extent;
use crate::kernels::expand::Expand;
use crate::kernels::{Access, BufferId, Call, HALF_TILE, KernelTarget, Tiles, View};
use crate::net::op::Stage;
use std::collections::{HashMap, HashSet};

/// Which frames a dispatch is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum For {
    /// All.
    Every,
    /// Those with a feature at least.
    Features,
    /// Those without.
    NoFeatures,
}

/// Adds to the dispatches of a frame those of one without features, of which some stand for some of the others. The
/// dispatches are those of a frame padded to `padded`, a multiple of `multiple`, and know which of them depend on
/// features alone. New buffers are appended.
pub fn merge(
    dispatches: Vec<Dispatch>,
    buffers: &mut Vec<Buffer>,
    padded: Extent,
    multiple: u32,
    target: KernelTarget,
) -> Vec<(Dispatch, For)> {
    let chain = chain(&dispatches, padded);
    let small = small_size(&dispatches, &chain, padded, multiple);
    let Some(small) = small.filter(|_| is_complete(&dispatches, &chain)) else {
        return dispatches.into_iter().map(|dispatch| (dispatch, For::Every)).collect();
    };
    let mut maker = Maker { padded, small, buffers, copies: HashMap::new() };
    let others = || dispatches.iter().zip(&chain).filter(|(_, part)| !**part).map(|(dispatch, _)| dispatch);
    let read: HashSet<BufferId> = others().flat_map(|d| d.traffic().reads).map(|(id, _)| id).collect();
    // The small maps come all before the large ones, so that they share their memory.
    let (mut copies, mut rest) = (Vec::new(), Vec::new());
    let first = chain.iter().position(|part| *part).unwrap_or_default();
    for (dispatch, part) in dispatches.iter().zip(&chain) {
        if !part {
            rest.push((dispatch.clone(), For::Every));
            continue;
        }
        rest.push((dispatch.clone(), For::Features));
        if dispatch.band.is_some_and(|band| band > 0) {
            continue; // The small map is one band.
        }
        let mut copy = dispatch.clone();
        copy.call.kernel_mut().maps(&mut |view, access| {
            let small = maker.small(view);
            if access.writes() && read.contains(&view.buffer) {
                let call = Call::Expand(Expand { src: small, dst: maker.whole(view), tiles: Tiles::All });
                rest.push((dispatch.with_call(call, target), For::NoFeatures));
            }
            *view = small;
        });
        if let Call::InputAux(input) = &mut copy.call {
            (input.width, input.height) = (small.width, small.height);
        }
        copy.call.set_tiles(Tiles::All);
        if let (Some(before), Some(now)) = (dispatch.call.grid(), copy.call.grid()) {
            let [before, now] = [before, now].map(|grid| u64::from(grid.counts()[0]));
            copy.flops = dispatch.flops * now / before.max(1);
        }
        copies.push((copy, For::NoFeatures));
    }
    rest.splice(first..first, copies);
    rest
}

/// Whether it is of features alone and not made again for the output stage
/// ([`Graph::rematerialized`](crate::net::Graph::rematerialized)): what is exists in bands alone, and is left as it is.
fn is_early(dispatch: &Dispatch) -> bool {
    dispatch.of_features && dispatch.stage != Stage::Output
}

/// The early dispatches that a convolution of features follows, with these, and Linears of their results at full size:
/// what else comes after is no work to speak of.
fn chain(dispatches: &[Dispatch], padded: Extent) -> Vec<bool> {
    let mut read: HashSet<BufferId> = HashSet::new();
    let mut chain = vec![false; dispatches.len()];
    for (dispatch, part) in dispatches.iter().zip(&mut chain).rev() {
        let maps = dispatch.call.maps();
        let traffic = dispatch.traffic();
        let feeds = traffic.writes.iter().any(|(id, _)| read.contains(id));
        let spatial = maps.iter().any(|(_, access)| access.reads_around());
        *part = is_early(dispatch) && !maps.is_empty() && (feeds || spatial);
        if *part {
            read.extend(traffic.reads.iter().map(|(id, _)| *id));
        }
    }
    let parts = dispatches.iter().zip(&chain).filter(|(_, part)| **part);
    let mut written: HashSet<BufferId> = parts.flat_map(|(d, _)| d.traffic().writes).map(|(id, _)| id).collect();
    for (dispatch, part) in dispatches.iter().zip(&mut chain) {
        let at_full_size = dispatch.call.result().is_some_and(|result| result.width == padded.width);
        let maps = dispatch.call.maps();
        let ready = || maps.iter().all(|(view, access)| access.writes() || written.contains(&view.buffer));
        if !*part && is_early(dispatch) && at_full_size && matches!(dispatch.call, Call::Linear(_)) && ready() {
            *part = true;
            written.extend(dispatch.traffic().writes.iter().map(|(id, _)| *id));
        }
    }
    chain
}

/// Whether every map that the chain reads is one that it writes.
fn is_complete(dispatches: &[Dispatch], chain: &[bool]) -> bool {
    let parts = || dispatches.iter().zip(chain).filter(|(_, part)| **part).flat_map(|(d, _)| d.call.maps());
    let written: HashSet<BufferId> =
        parts().filter(|(_, access)| access.writes()).map(|(view, _)| view.buffer).collect();
    parts().all(|(view, _)| written.contains(&view.buffer))
}

/// The least frame whose maps all have a half tile in the middle that no border reaches; `None` where it is no smaller.
fn small_size(dispatches: &[Dispatch], chain: &[bool], padded: Extent, multiple: u32) -> Option<Extent> {
    let mut margins: HashMap<BufferId, u32> = HashMap::new();
    let mut least = 0;
    for (dispatch, _) in dispatches.iter().zip(chain).filter(|(_, part)| **part) {
        let maps = dispatch.call.maps();
        let felt = |(view, access): &(View, Access)| access.margin(margins.get(&view.buffer).copied().unwrap_or(0));
        let reached = maps.iter().filter_map(felt).max().unwrap_or(0);
        for (view, access) in &maps {
            let Access::Write(scale) = access else { continue };
            let margin = margins.entry(view.buffer).or_default();
            *margin = (*margin).max(scale.margin(reached));
            // The half tile from the middle on, and the margins on both sides of it.
            let stride = padded.width / view.width;
            least = least.max(2 * (*margin + HALF_TILE) * stride);
        }
    }
    let least = if least == 0 { u32::MAX } else { least.next_multiple_of(multiple) };
    let small = Extent::new(padded.width.min(least), padded.height.min(least));
    (small != padded).then_some(small)
}

/// Makes small copies of maps.
struct Maker<'a> {
    padded: Extent,
    small: Extent,
    buffers: &'a mut Vec<Buffer>,
    copies: HashMap<BufferId, BufferId>,
}

impl Maker<'_> {
    /// The same channels of the small map, all of its rows.
    fn small(&mut self, view: &View) -> View {
        let stride = self.padded.width / view.width;
        let (width, height) = (self.small.width / stride, self.small.height / stride);
        let buffer = *self.copies.entry(view.buffer).or_insert_with(|| {
            let name = format!("{}.small", self.buffers[view.buffer.0].name);
            let bytes = u64::from(width) * u64::from(height) * u64::from(view.stride) * view.storage.bytes();
            self.buffers.push(Buffer {
                name,
                bytes,
                storage: view.storage,
                place: Place::Arena { block: 0, offset: 0 },
            });
            BufferId(self.buffers.len() - 1)
        });
        View { buffer, width, height, top: 0, ..*view }
    }

    /// The same channels of the whole map.
    fn whole(&self, view: &View) -> View {
        View { height: self.padded.height / (self.padded.width / view.width), top: 0, ..*view }
    }
}

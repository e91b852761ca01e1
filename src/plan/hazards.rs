//! Finds the dispatches that must wait: those that read or overwrite what an unfinished one writes, or overwrite what
//! an unfinished one reads. Memory is compared, not names: buffers share the arena.

use super::{Buffer, Dispatch, Place};
use crate::kernels::BufferId;

/// Bytes `start..end` of one block, persistent or of the arena.
type Span = ((bool, usize), u64, u64);

/// Sets [`Dispatch::barrier`] wherever a dependency asks for it, and nowhere else.
pub fn mark(dispatches: &mut [Dispatch], buffers: &[Buffer]) {
    let mut read: Vec<Span> = Vec::new();
    let mut written: Vec<Span> = Vec::new();
    for dispatch in dispatches {
        let traffic = dispatch.traffic();
        let reads = spans(&traffic.reads, buffers);
        let writes = spans(&traffic.writes, buffers);
        dispatch.barrier = overlap(&reads, &written) || overlap(&writes, &written) || overlap(&writes, &read);
        if dispatch.barrier {
            read.clear();
            written.clear();
        }
        read.extend(reads);
        written.extend(writes);
    }
}

/// Where the buffers lie; weights are never written.
fn spans(touched: &[(BufferId, u64)], buffers: &[Buffer]) -> Vec<Span> {
    touched
        .iter()
        .filter_map(|(id, _)| match buffers[id.0].place {
            Place::Arena { block, offset } => Some(((false, block), offset, offset + buffers[id.0].bytes)),
            Place::Persistent { block, offset } => Some(((true, block), offset, offset + buffers[id.0].bytes)),
            Place::Weights { .. } => None,
        })
        .collect()
}

fn overlap(a: &[Span], b: &[Span]) -> bool {
    a.iter().any(|x| b.iter().any(|y| x.0 == y.0 && x.1 < y.2 && y.1 < x.2))
}

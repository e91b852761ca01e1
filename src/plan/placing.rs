//! Where the buffers of a plan lie: what outlives a recording by itself, all else in the arena, where buffers of other
//! times share memory.

use super::arena::{self, Limits, Placement, Request};
use super::schedule::Scheduled;
use super::{Buffer, Dispatch, Place};
use crate::kernels::BufferId;
use crate::target::Target;

/// The buffers of a plan, and what decides where they lie.
pub(super) struct Placing<'a> {
    /// The lists of dispatches, of which one runs or the other.
    pub lists: &'a [Scheduled],
    /// What outlives a recording, or is filled before it.
    pub outlives: &'a [BufferId],
    /// What keeps its place throughout.
    pub kept: &'a [BufferId],
    pub options: &'a Target,
    pub arena: Limits<'a>,
}

impl Placing<'_> {
    /// Places the buffers; returns the bytes of each block of the arena and of persistent memory. Fails with the size
    /// of a buffer that no block holds.
    pub fn place(&self, buffers: &mut [Buffer]) -> Result<(Vec<u64>, Vec<u64>), u64> {
        let times = self.times(buffers.len());
        let used = (0..buffers.len()).filter(|&i| matches!(buffers[i].place, Place::Arena { .. }) && times[i].is_some());
        let (persistent, in_arena): (Vec<_>, Vec<_>) = used.partition(|i| self.outlives.contains(&BufferId(*i)));
        let place = |which: &[usize], always: bool, limits: Limits, buffers: &[Buffer]| {
            let request = |&i: &usize| match times[i].filter(|_| !always && !self.kept.contains(&BufferId(i))) {
                Some(times) => Request { bytes: buffers[i].bytes, times },
                None => Request { bytes: buffers[i].bytes, times: ALWAYS },
            };
            arena::place(&which.iter().map(request).collect::<Vec<_>>(), limits)
        };
        let (placements, blocks) = place(&in_arena, self.options.keep_all, self.arena, buffers)?;
        let own = Limits::Each(self.options.max_block_bytes);
        let (own_placements, own_blocks) = place(&persistent, true, own, buffers)?;
        let mut put = |which: &[usize], placements: Vec<Placement>, place: fn(Placement) -> Place| {
            which.iter().zip(placements).for_each(|(i, placement)| buffers[*i].place = place(placement));
        };
        put(&in_arena, placements, |(block, offset)| Place::Arena { block, offset });
        put(&persistent, own_placements, |(block, offset)| Place::Persistent { block, offset });
        Ok((blocks, own_blocks))
    }

    /// The first and the last group of each list that touch a buffer; `None` where nothing does.
    fn times(&self, buffers: usize) -> Vec<Option<arena::Times>> {
        let mut times: Vec<Option<arena::Times>> = vec![None; buffers];
        for (list, Scheduled { dispatches, groups }) in self.lists.iter().enumerate() {
            for (dispatch, &group) in dispatches.iter().zip(groups) {
                let traffic = dispatch.traffic();
                for (id, _) in traffic.reads.iter().chain(&traffic.writes) {
                    let time = times[id.0].get_or_insert_default()[list].get_or_insert((group, group));
                    time.1 = group;
                }
            }
            // What signals read stays for the next of them.
            for turned in [true, false] {
                let of_signals = |(_, dispatch): &(_, &Dispatch)| dispatch.of_signals && dispatch.turned == turned;
                let mut of_signals = groups.iter().zip(dispatches).filter(of_signals).map(|(&group, _)| group);
                let (Some(first), Some(last)) = (of_signals.next(), of_signals.next_back()) else { continue };
                for time in times.iter_mut().flatten().filter_map(|times| times[list].as_mut()) {
                    if time.0 < first && time.1 >= first {
                        time.1 = time.1.max(last);
                    }
                }
            }
        }
        times
    }
}

/// Of what keeps its place throughout.
const ALWAYS: arena::Times = [Some((0, usize::MAX)); 2];

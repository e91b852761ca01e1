//! What is known of one dispatch once it has run.

use super::shape::Shape;
use crate::kernels::{Accesses, Call, Traffic};
use crate::net::op::Stage;
use crate::plan::Dispatch;
use crate::plan::active::ActiveTiles;

/// One dispatch: what it was, what it had to do, how long it took.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct KernelRecord {
    /// The op that it comes from, e.g. `enc.1.0.qkv`.
    pub name: String,
    /// Part of the network.
    pub stage: Stage,
    /// The kernel, e.g. `conv3x3`.
    pub kernel: &'static str,
    /// The variant of it that ran, e.g. `conv3x3_s2_cpu`.
    pub variant: &'static str,
    /// Whether it runs on cooperative matrices, whose rate is its roof then.
    pub matrix: bool,
    /// Size of the result and channels.
    pub shape: Shape,
    /// Whether it was left out, as nothing depended on it or its result was known; it then has no FLOPs, groups or
    /// bytes.
    pub skipped: bool,
    /// Tiles that it worked on and those of its whole map, each counted once; `None` for kernels without tiles.
    pub tiles: Option<[u32; 2]>,
    /// Workgroups; where the device makes the list of tiles, for all of them.
    pub groups: [u32; 3],
    /// Multiplications and additions of the network's own channels, as the thesis counts them: what the op
    /// asks for, however the kernel computes it.
    pub flops: u64,
    /// Bytes that it needs to read once, weights included; planes of the caller's are left out.
    pub bytes_read: u64,
    /// Bytes that it writes.
    pub bytes_written: u64,
    /// Loads and stores of its invocations; `None` for kernels over the caller's planes.
    pub accesses: Option<Accesses>,
    /// Microseconds from the first dispatch's start to this one's.
    pub start: f64,
    /// Microseconds from the end of everything before it to its own end.
    pub microseconds: f64,
    /// The list of tiles that it runs over, where the device makes it.
    list: Option<usize>,
}

impl KernelRecord {
    /// A dispatch that started and ended at these microseconds.
    pub(super) fn new(dispatch: &Dispatch, start: f64, end: f64) -> Self {
        let contract = dispatch.variant.contract;
        let traffic = if dispatch.skipped { Traffic::default() } else { dispatch.traffic() };
        let accesses = dispatch.call.kernel().accesses(&dispatch.variant);
        let bytes = |touched: &[(_, u64)]| touched.iter().map(|(_, bytes)| bytes).sum();
        Self {
            name: dispatch.name.clone(),
            stage: dispatch.stage,
            kernel: contract.kernel(),
            variant: contract.name,
            matrix: contract.needs_matrix(),
            shape: Shape::of(&dispatch.call),
            skipped: dispatch.skipped,
            tiles: dispatch.call.grid().filter(|_| !matches!(dispatch.call, Call::Fill(_))).map(|grid| {
                let [active, all] = grid.counts();
                [if dispatch.skipped { 0 } else { active }, all]
            }),
            groups: if dispatch.skipped { [0; 3] } else { dispatch.groups },
            flops: dispatch.flops,
            bytes_read: bytes(&traffic.reads),
            bytes_written: bytes(&traffic.writes),
            accesses: if dispatch.skipped { accesses.map(|_| Accesses::default()) } else { accesses },
            start,
            microseconds: (end - start).max(0.0),
            list: dispatch.indirect.filter(|groups| !groups.idle).map(|groups| groups.list),
        }
    }

    /// Counts the tiles, FLOPs and bytes of those tiles that were active, where the device alone knew which; until then
    /// they are those of all tiles.
    pub fn count_active(&mut self, active: &ActiveTiles) {
        let Some(list) = self.list else { return };
        let share = active.share(list);
        let part = |all: u64| (all as f64 * share).round() as u64;
        (self.flops, self.bytes_read, self.bytes_written) =
            (part(self.flops), part(self.bytes_read), part(self.bytes_written));
        if let (Some([tiles, _]), Some((_, count))) = (&mut self.tiles, active.parts.get(list)) {
            *tiles = *count;
        }
        self.accesses = self.accesses.map(|accesses| accesses.part(share));
    }

    /// Bytes read and written.
    pub fn bytes(&self) -> u64 {
        self.bytes_read + self.bytes_written
    }

    /// FLOPs for each byte: its place on a roofline.
    pub fn intensity(&self) -> f64 {
        self.flops as f64 / self.bytes().max(1) as f64
    }
}

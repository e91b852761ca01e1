//! The plan: one network at one frame size as a list of dispatches over buffers. Pure data, no Vulkan: it is printed,
//! costed, recorded, and computed again on the CPU in f64 from the same list.

pub mod active;
pub(crate) mod arena;
mod bands;
pub mod converged;
mod converged_reach;
pub(crate) mod ensemble;
mod featureless;
mod features;
mod fuse;
mod halves;
mod hazards;
mod lower;
mod of_frame;
mod ops;
pub mod pack;
mod packing;
mod placing;
mod predicted;
mod region;
mod schedule;
mod signals;
mod steps;
pub mod tile;
mod unembed;
mod winograd;

use crate::frame::Extent;
use crate::kernels::converged::{GROUPS_BYTES, list_bytes};
use crate::kernels::{BufferId, Call, Grid, KernelTarget, Storage, Tiles, Traffic, Variant, View};
use crate::net::op::Stage;
use pack::Pack;

pub use of_frame::{Networks, plan, plan_in, plan_part};
pub use packing::Packing;
pub use steps::{packing, packing_after, packing_of_part};

/// Where a buffer of the plan lies.
#[derive(Clone, Debug, PartialEq)]
pub enum Place {
    /// In the arena, which buffers of other times share.
    Arena {
        /// Which block of the arena.
        block: usize,
        /// Bytes from the block's start.
        offset: u64,
    },
    /// In memory of the pass's own, which nothing else uses: what outlives a recording, or is filled before it.
    Persistent {
        /// Which block of it.
        block: usize,
        /// Bytes from the block's start.
        offset: u64,
    },
    /// Packed weights.
    Weights {
        /// What is packed and how.
        pack: Pack,
        /// Bytes from the start of the weights.
        offset: u64,
        /// Whether they are of the network that the turned frame goes through, where that is another.
        turned: bool,
    },
}

/// A buffer of the plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Buffer {
    /// For people: the graph's name of what it holds.
    pub name: String,
    /// Size in bytes.
    pub bytes: u64,
    /// Type of its elements.
    pub storage: Storage,
    /// Where it lies.
    pub place: Place,
}

/// One kernel to run.
#[derive(Clone, Debug, PartialEq)]
pub struct Dispatch {
    /// The op that it comes from, e.g. `enc.1.0.qkv`; unique together with its kernel.
    pub name: String,
    /// Part of the network.
    pub stage: Stage,
    /// Kernel and arguments.
    pub call: Call,
    /// The variant of the kernel that runs.
    pub variant: Variant,
    /// Its workgroups, where the host knows how many there are.
    pub groups: [u32; 3],
    /// Whether it must wait for the dispatches before it.
    pub barrier: bool,
    /// Multiplications and additions of the network's own channels ([`crate::net::cost`]).
    pub flops: u64,
    /// Which band of the frame's rows it works on, where it is one of a chain that runs band by band.
    pub band: Option<u32>,
    /// Whether it works on the frame turned by half a circle ([`Target::self_ensemble`]). These come first.
    pub turned: bool,
    /// Whether it depends on albedo, normal and depth alone.
    pub of_features: bool,
    /// Whether it serves the depth plane alone, and is left out where there is none.
    pub of_depth: bool,
    /// Whether it is for signals beside the colour: recorded once for each of them. These follow each other.
    pub of_signals: bool,
    /// Where the device says how many workgroups there are; `None`: the host knows.
    pub indirect: Option<converged::IndirectGroups>,
    /// Whether it is left out of this frame. It keeps its place in the list, and its barrier holds for what comes next.
    pub skipped: bool,
}

impl Dispatch {
    /// One that the host knows all of, in a place of its own.
    pub fn new(name: &str, stage: Stage, flops: u64, call: Call, target: KernelTarget) -> Self {
        let variant = call.kernel().choose(target);
        Self {
            name: name.to_owned(),
            stage,
            groups: call.kernel().groups(&variant),
            variant,
            call,
            barrier: false,
            flops,
            band: None,
            turned: false,
            of_features: false,
            of_depth: false,
            of_signals: false,
            indirect: None,
            skipped: false,
        }
    }

    /// Another call in its place, which costs no FLOPs of the network's.
    fn with_call(&self, call: Call, target: KernelTarget) -> Self {
        let mut dispatch = Self { call, flops: 0, ..self.clone() };
        dispatch.choose(target);
        dispatch
    }

    /// Chooses the variant anew: after a change of the call, or for another target.
    pub(crate) fn choose(&mut self, target: KernelTarget) {
        let kernel = self.call.kernel();
        self.variant = kernel.choose(target);
        self.groups = kernel.groups(&self.variant);
    }

    /// Has it work on some tiles alone.
    pub(crate) fn set_tiles(&mut self, tiles: Tiles) {
        self.call.set_tiles(tiles);
        self.groups = self.call.kernel().groups(&self.variant);
    }

    /// Memory that it touches, with the list of its tiles.
    pub fn traffic(&self) -> Traffic {
        let mut traffic = self.call.traffic();
        if let Some(Grid { tiles: Tiles::List { buffer, at_most }, .. }) = self.call.grid() {
            traffic.reads.push((buffer, list_bytes(at_most)));
        }
        traffic.reads.extend(self.indirect.map(|groups| (groups.buffer, GROUPS_BYTES)));
        traffic
    }

    /// Leaves it out.
    fn skip(&mut self) {
        (self.skipped, self.flops) = (true, 0);
    }
}

/// Which features a frame has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Present {
    /// Albedo.
    pub albedo: bool,
    /// Normal.
    pub normal: bool,
    /// Depth.
    pub depth: bool,
}

impl Present {
    /// Whether there is one at least.
    pub fn any(self) -> bool {
        self.albedo || self.normal || self.depth
    }
}

/// Leaves out what serves the depth plane alone.
pub(crate) fn skip_depth(dispatches: &mut [Dispatch]) {
    dispatches.iter_mut().filter(|dispatch| dispatch.of_depth).for_each(Dispatch::skip);
}

/// Leaves out what depends on the features alone: the last frame's are kept.
pub(crate) fn skip_features(dispatches: &mut [Dispatch]) {
    dispatches.iter_mut().filter(|dispatch| dispatch.of_features).for_each(Dispatch::skip);
}

/// A forward pass.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Size of the frame.
    pub extent: Extent,
    /// Size that the network works on: the frame padded right and bottom.
    pub padded: Extent,
    /// Everything the dispatches name.
    pub buffers: Vec<Buffer>,
    /// What runs, in order.
    pub dispatches: Vec<Dispatch>,
    /// What runs in place of it for a frame without albedo, normal and depth, with the same bits; `None`: nothing else.
    pub without_features: Option<Vec<Dispatch>>,
    /// Bytes of each block of the arena, whose content a recording neither expects nor leaves to the next.
    pub blocks: Vec<u64>,
    /// Bytes of each block of persistent memory.
    pub persistent: Vec<u64>,
    /// Bytes of all packed weights.
    pub weights_bytes: u64,
    /// The network's colour input c.
    pub log_color: View,
    /// The network's auxiliary input.
    pub aux: View,
    /// The network's result r; nowhere in whole, where the head runs in bands.
    pub residual: View,
    /// The frame's statistics ([`crate::kernels::stats`]).
    pub stats: BufferId,
    /// What the device says of tiles that need no denoising; `None` where all are denoised.
    pub converged: Option<active::Activity>,
    /// Where a tile of a larger frame takes what is of the whole from; `None`: it is the whole.
    pub given: Option<tile::Given>,
    /// Whether what depends on the features alone is persistent ([`Target::keep_features`]).
    pub keeps_features: bool,
}

impl Plan {
    /// A buffer of this plan.
    pub fn buffer(&self, id: BufferId) -> &Buffer {
        &self.buffers[id.0]
    }

    /// The dispatches for a frame with these features, whole.
    pub fn for_features(&self, features: Present) -> &[Dispatch] {
        match &self.without_features {
            Some(dispatches) if !features.any() => dispatches,
            _ => &self.dispatches,
        }
    }

    /// What tells of a pass after it has run: the statistics, and where converged tiles are left out
    /// [`active::Activity`]; of a tile its sums.
    pub fn read_back(&self) -> Vec<BufferId> {
        let activity = self.converged.as_ref().map(|converged| converged.buffer);
        let sums = self.given.iter().flat_map(|given| given.sums.iter().map(|sums| sums.buffer));
        std::iter::once(self.stats).chain(activity).chain(sums).collect()
    }

    /// Device memory of arena, persistent buffers and weights, in bytes.
    pub fn bytes(&self) -> u64 {
        self.blocks.iter().chain(&self.persistent).sum::<u64>() + self.weights_bytes
    }
}

//! The projection of albedo, normal and depth as one kernel, for matrices: as nine, its maps at full resolution would
//! go through memory nine times.

use super::accesses::Accesses;
use super::contracts::{self, AUX_SUBGROUPS};
use super::on_matrices::DEPTH;
use super::pushes::AuxProjectionPush;
use super::{
    Access, Addresses, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, TILE, Tiles, Traffic, Variant,
    View, groups,
};

/// Channels of the source, seven and a zero.
pub const AUX_CHANNELS: u32 = 8;
/// Channels of the result, and of everything between.
pub const CHANNELS: u32 = 32;
/// Tokens around its own that a token of the result depends on.
pub const REACH: u32 = 3;

/// `lrelu(W [s0 | s1 | s2] + bias)`, `s_i = lrelu(depthwise3x3(pointwise(s_(i-1))))` with the source for the first,
/// each zero-padded at the map's borders; slope 0.01. Rows of the map in whole tiles, not a list of tiles.
#[derive(Clone, Debug, PartialEq)]
pub struct AuxProjection {
    /// [`AUX_CHANNELS`] channels in halves.
    pub src: View,
    /// [`CHANNELS`] channels in halves.
    pub dst: View,
    /// Packed weights of each step's pointwise convolution ([`crate::plan::pack::Pack::Halves`]).
    pub pointwise: [BufferId; 3],
    /// Packed weights of each step's depthwise convolution ([`crate::plan::pack::Pack::Depthwise`]).
    pub depthwise: [BufferId; 3],
    /// Packed weights of each step's part of the last convolution ([`crate::plan::pack::Pack::Halves`]); the third has
    /// the bias.
    pub out: [BufferId; 3],
    /// Tiles of the map.
    pub tiles: Tiles,
}

impl AuxProjection {
    /// Whether the kernel takes such maps: whole vectors of halves, of its own numbers of channels.
    pub fn fits_matrices(src: &View, dst: &View) -> bool {
        src.is_vectors_of_halves()
            && (src.channels, dst.channels, dst.storage) == (AUX_CHANNELS, CHANNELS, Storage::F16)
    }

    /// Columns and rows of tiles.
    fn cells(&self) -> [u32; 2] {
        match self.tiles {
            Tiles::Rect(rect) => [rect.columns, rect.rows],
            Tiles::All | Tiles::List { .. } => [self.dst.width, self.dst.height].map(|side| side.div_ceil(TILE)),
        }
    }
}

impl Kernel for AuxProjection {
    fn choose(&self, _: KernelTarget) -> Variant {
        Variant::plain(&contracts::AUX_PROJECTION_MATRIX)
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        let [columns, rows] = self.cells();
        groups(columns.div_ceil(2) * rows * 2, 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let [columns, rows] = self.cells();
        let [pointwise, depthwise, out] = [self.pointwise, self.depthwise, self.out].map(|ids| ids.map(|id| at.of(id)));
        PushBytes::new(&AuxProjectionPush {
            src: at.view(&self.src),
            dst: at.view(&self.dst),
            pointwise_0: pointwise[0],
            pointwise_1: pointwise[1],
            pointwise_2: pointwise[2],
            depthwise_0: depthwise[0],
            depthwise_1: depthwise[1],
            depthwise_2: depthwise[2],
            out_0: out[0],
            out_1: out[1],
            out_2: out[2],
            width: self.dst.width,
            height: self.dst.height,
            src_stride: self.src.stride / 4,
            dst_stride: self.dst.stride / 4,
            first_tile: self.tiles.first(),
            tile_columns: columns,
            tile_rows: rows,
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.src, Access::around(1, REACH));
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        let channels = u64::from(CHANNELS);
        let dense = |inputs: u32| (2 * u64::from(inputs) + 4) * channels;
        let mut reads = vec![(self.pointwise[0], dense(AUX_CHANNELS))];
        reads.extend(self.pointwise[1..].iter().chain(&self.out).map(|id| (*id, dense(CHANNELS))));
        reads.extend(self.depthwise.map(|id| (id, 40 * channels)));
        Traffic::reading(reads)
    }

    /// Of a workgroup's 16x4 tokens with what is made around them.
    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let (columns, vectors) = (u64::from(CHANNELS / 4), u64::from(CHANNELS / 8));
        let size = |reach: u32| u64::from((2 * TILE + 2 * reach) * (TILE / 2 + 2 * reach));
        let own = size(0);
        let (mut loads, mut shared_loads, mut shared_stores) = (size(REACH) * u64::from(AUX_CHANNELS / 8), 0, 0);
        for step in 0..REACH {
            let (from, to) = (size(REACH - step), size(REACH - step - 1));
            let inputs = u64::from(if step == 0 { DEPTH } else { CHANNELS });
            // Subgroups load the weights of sixteen outputs each; runs of two rows load four of three tokens; an
            // invocation nine taps and two biases.
            let matrices = u64::from(AUX_SUBGROUPS) * 16 * (inputs + u64::from(CHANNELS)) / 8;
            loads += matrices + 11 * u64::from(AUX_SUBGROUPS) * 32;
            shared_loads += 2 * (from * inputs + own * u64::from(CHANNELS)) / 8 + to / 2 * 12 * columns;
            shared_stores += from * vectors + to * columns;
        }
        let results = own * columns;
        let groups: u64 = self.groups(variant).into_iter().map(u64::from).product();
        Some(Accesses {
            global_loads: groups * (loads + results),
            global_stores: groups * results,
            shared_loads: groups * (shared_loads + results),
            shared_stores: groups * (shared_stores + 2 * size(REACH) + results),
        })
    }
}

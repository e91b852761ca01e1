//! How kernels on cooperative matrices cut their work: what their own files, where each says how it does, have in
//! common. Shared memory is to hold what a workgroup stages (`glsl/shared/matrix_dense.glsl`).

use super::contract::Specialisation;
use super::contracts::MATRIX_SUBGROUPS;
use super::dense::TILE_CHANNELS;
use super::{TILE, Variant, View, groups};

/// Shared memory of a workgroup in bytes: what every device with matrices has.
pub(super) const SHARED_BYTES: u32 = 32 << 10;
/// Input channels are filled up with zeros to whole matrices of this depth, the largest that a device may have.
pub const DEPTH: u32 = 16;
/// Tokens of a tile.
pub(super) const TOKENS: u32 = TILE * TILE;

/// Whether a workgroup's shared memory holds so many tokens of so many channels, each padded by a vector of 16 bytes,
/// and so many rows of weights for its outputs.
pub(super) fn holds(tokens: u32, channels: u32, rows: u32, outputs: u32) -> bool {
    tokens * (2 * channels + 16) + 2 * rows * outputs <= SHARED_BYTES
}

/// Tiles of a workgroup whose subgroups share none.
pub(super) const MOST_TILES: u32 = MATRIX_SUBGROUPS;

/// Tiles of a workgroup: its subgroups share a tile where that has outputs for them.
pub(super) fn tiles_for(outputs: u32) -> u32 {
    match outputs.div_ceil(TILE_CHANNELS) {
        1 => MOST_TILES,
        2 => MOST_TILES / 2,
        _ => 1,
    }
}

/// The most of `inputs` that a workgroup of so many outputs stages at a time for so many tokens, with `taps` rows of
/// weights for each.
pub(super) fn staged(inputs: u32, tokens: u32, at_most: u32, taps: u32, outputs: u32) -> Option<u32> {
    let sizes = [128, 64, 32, 16].into_iter().filter(|size| *size <= at_most);
    sizes.into_iter().find(|size| inputs.is_multiple_of(*size) && holds(tokens, *size, taps * size, outputs))
}

/// Outputs of a workgroup of so many tiles.
pub(super) fn outputs_of(tiles: u32) -> u32 {
    TILE_CHANNELS * MOST_TILES / tiles
}

/// Workgroups for so many tiles and outputs.
pub(super) fn groups_of(special: Specialisation, tiles: u32, outputs: u32) -> [u32; 3] {
    groups(tiles.div_ceil(special.tiles), outputs.div_ceil(outputs_of(special.tiles)))
}

/// Workgroups of a variant of a dense kernel; without matrices and shared memory each computes `tile_channels` of the
/// channels.
pub(super) fn dense_groups(variant: &Variant, tiles: u32, channels: u32, tile_channels: u32) -> [u32; 3] {
    let tile_channels = variant.stages().unwrap_or(tile_channels);
    match variant.is_on_matrices() {
        true => groups_of(variant.special, tiles, channels),
        false => groups(tiles.div_ceil(variant.tiles_a_group), channels.div_ceil(tile_channels)),
    }
}

/// Workgroups up to which more subgroups share a tile: as many as a large GPU has multiprocessors.
const FEW_GROUPS: u32 = 128;

/// The same cut, for so many tiles and outputs of a dense kernel.
pub(super) fn cut_for(special: Specialisation, tiles: u32, outputs: u32) -> Specialisation {
    let groups: u32 = groups_of(special, tiles, outputs).into_iter().product();
    Specialisation { few: groups <= FEW_GROUPS, ..special }
}

/// Whether kernels on matrices can load from all of these maps.
pub(super) fn can_load<'a>(views: impl IntoIterator<Item = &'a View>) -> bool {
    views.into_iter().all(View::is_vectors_of_halves)
}

//! How kernels on cooperative matrices cut their work: by what their maps are, so that shared memory holds what a
//! workgroup stages (`glsl/shared/matrix_dense.glsl`).

use super::contract::Specialisation;
use super::contracts::MATRIX_SUBGROUPS;
use super::dense::TILE_CHANNELS;
use super::unembed::TAPS;
use super::{TILE, View, groups};

/// Shared memory of a workgroup in bytes: what every device with matrices has.
const SHARED_BYTES: u32 = 32 << 10;
/// Input channels are filled up with zeros to whole matrices of this depth, the largest that a device may have.
pub const DEPTH: u32 = 16;
/// Tokens of a tile.
const TOKENS: u32 = TILE * TILE;

/// Whether a workgroup's shared memory holds so many tokens of so many channels, each padded by a vector of 16 bytes,
/// and so many rows of weights for its outputs.
fn holds(tokens: u32, channels: u32, rows: u32, outputs: u32) -> bool {
    tokens * (2 * channels + 16) + 2 * rows * outputs <= SHARED_BYTES
}

/// Tiles of a workgroup whose subgroups share none.
pub(super) const MOST_TILES: u32 = MATRIX_SUBGROUPS;

/// Tiles of a workgroup: its subgroups share a tile where that has outputs for them.
fn tiles_for(outputs: u32) -> u32 {
    match outputs.div_ceil(TILE_CHANNELS) {
        1 => MOST_TILES,
        2 => MOST_TILES / 2,
        _ => 1,
    }
}

/// The most of `inputs` that a workgroup of so many outputs stages at a time for so many tokens, with `taps` rows of
/// weights for each.
fn staged(inputs: u32, tokens: u32, at_most: u32, taps: u32, outputs: u32) -> Option<u32> {
    let sizes = [128, 64, 32, 16].into_iter().filter(|size| *size <= at_most);
    sizes.into_iter().find(|size| inputs.is_multiple_of(*size) && holds(tokens, *size, taps * size, outputs))
}

/// Outputs of a workgroup of so many tiles.
fn outputs_of(tiles: u32) -> u32 {
    TILE_CHANNELS * MOST_TILES / tiles
}

/// Of a pointwise convolution; `None` where no kernel on matrices takes such maps.
pub(super) fn linear(inputs: u32, outputs: u32, norm: bool) -> Option<Specialisation> {
    let mut tiles = tiles_for(outputs);
    if !norm {
        let inputs = staged(inputs.next_multiple_of(DEPTH), tiles * TOKENS, 128, 1, outputs_of(tiles))?;
        return Some(Specialisation { tiles, inputs, ..Specialisation::default() });
    }
    // All inputs at once; a power of two of invocations share a token.
    if !inputs.is_multiple_of(DEPTH) || !inputs.is_power_of_two() {
        return None;
    }
    let fits = |tiles: u32| holds(tiles * TOKENS, inputs, inputs.min(NORMED_ROWS), outputs_of(tiles));
    while tiles > 1 && !fits(tiles) {
        tiles /= 2;
    }
    fits(tiles).then(|| Specialisation { tiles, inputs, ..Specialisation::default() })
}

/// Rows of weights that are staged at a time for normed tokens.
const NORMED_ROWS: u32 = 32;

/// Of a dense 3x3 convolution.
pub(super) fn conv3x3(inputs: u32, outputs: u32, stride: u32) -> Option<Specialisation> {
    let tiles = tiles_for(outputs);
    let tokens = tiles * TILE * (stride * (TILE - 1) + 3);
    let inputs = staged(inputs, tokens, 32, 3, outputs_of(tiles))?;
    Some(Specialisation { tiles, inputs, ..Specialisation::default() })
}

/// Of a dense 3x3 convolution of the four channels of the network's input.
pub(super) fn conv3x3_first(outputs: u32) -> Specialisation {
    Specialisation { tiles: tiles_for(outputs), ..Specialisation::default() }
}

/// Of a depthwise and a pointwise convolution in one: every invocation makes some of the depthwise results.
pub(super) fn separable(inputs: u32, outputs: u32) -> Option<Specialisation> {
    let tiles = tiles_for(outputs);
    let inputs = staged(inputs, tiles * TOKENS, outputs_of(tiles), 1, outputs_of(tiles))?;
    Some(Specialisation { tiles, inputs, ..Specialisation::default() })
}

/// Of tokens to pixels.
pub(super) fn unembed(inputs: u32) -> Option<Specialisation> {
    let tokens = MOST_TILES * TILE * (TILE - 1 + TAPS);
    staged(inputs, tokens, 32, 0, 0).map(|inputs| Specialisation { inputs, ..Specialisation::default() })
}

/// Of joint window attention.
pub(super) fn window_attention(keys: u32, values: u32) -> Option<Specialisation> {
    let fits = keys.is_multiple_of(8) && keys <= 32 && values.is_multiple_of(16) && values <= 64;
    fits.then(|| Specialisation { keys, values, ..Specialisation::default() })
}

/// Of a block's attention with its Linears, of so many channels of queries, of values and in all: `inputs` is what the
/// projection stages at a time of the channels that do not attend.
pub(super) fn attention_block(keys: u32, values: u32, channels: u32) -> Option<Specialisation> {
    let rest = channels.checked_sub(values)?;
    // Within a workgroup's outputs a matrix of queries, keys or values crosses no block of weights.
    if ![8, 16, 32].contains(&keys) || ![16, 32, 64].contains(&values) {
        return None;
    }
    let inputs = [48, 32, 16].into_iter().find(|inputs| rest.is_multiple_of(*inputs))?;
    let rows = |channels: u32| TOKENS * (2 * channels + 16);
    let queries_and_keys = 4 * rows(keys.next_multiple_of(DEPTH));
    let scores = TOKENS * (4 * TOKENS + 16);
    let projection = rows(inputs) + 2 * inputs.max(32) * outputs_of(1);
    // A subgroup's sums of half its tokens, 32 bits each, padded.
    let sums = MOST_TILES * TOKENS / 2 * (4 * TILE_CHANNELS + 16);
    let most = [queries_and_keys, scores, projection, sums].into_iter().max()?;
    let fits = most + rows(values) + 4 * TOKENS <= SHARED_BYTES;
    fits.then(|| Specialisation { tiles: 1, inputs, keys, values, ..Specialisation::default() })
}

/// Workgroups for so many tiles and outputs.
pub(super) fn groups_of(special: Specialisation, tiles: u32, outputs: u32) -> [u32; 3] {
    groups(tiles.div_ceil(special.tiles), outputs.div_ceil(outputs_of(special.tiles)))
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

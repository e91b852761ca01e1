//! Accesses of the dense kernels on matrices: vectors of 16 bytes, in shared memory too.

use super::{Accesses, epilogue_loads};
use crate::kernels::contracts::MATRIX_SUBGROUPS;
use crate::kernels::dense::{Conv3x3, Linear, TILE_CHANNELS};
use crate::kernels::{Shuffle, TILE};

const TOKENS: u64 = (TILE * TILE) as u64;
const OUTPUTS: u64 = TILE_CHANNELS as u64;
const SUBGROUPS: u64 = MATRIX_SUBGROUPS as u64;

/// What one workgroup stages, block by block.
struct Staging {
    blocks: u64,
    /// Input channels of a block.
    inputs: u64,
    /// Tokens that a tile needs of the source for each of its blocks.
    tokens: u64,
    /// Taps that a block serves.
    taps: u64,
    /// Vectors of inputs in all of a token's blocks, once.
    vectors: u64,
    /// How often a token's inputs are staged.
    times: u64,
}

impl Staging {
    /// Accesses of `groups` workgroups whose epilogue loads and stores so much for each vector of outputs.
    fn accesses(&self, groups: u64, epilogue: u64, stores: u64) -> Accesses {
        let Self { blocks, inputs, tokens, taps, vectors, times } = *self;
        let weights = times * taps * 4 * vectors * (OUTPUTS / 4);
        let results = SUBGROUPS * TOKENS * OUTPUTS / 4;
        let staged_weights = taps * inputs * OUTPUTS / 8;
        Accesses {
            global_loads: groups * (SUBGROUPS * tokens * times * vectors + weights + results * (1 + epilogue)),
            global_stores: groups * results * stores,
            shared_loads: groups * (blocks * SUBGROUPS * (taps * TOKENS * inputs / 8 + staged_weights) + results),
            shared_stores: groups * (blocks * (SUBGROUPS * tokens * inputs / 8 + staged_weights) + results),
        }
    }
}

/// Workgroups for so many tiles and channels.
fn workgroups(tiles: u32, channels: u32) -> u64 {
    u64::from(tiles.div_ceil(MATRIX_SUBGROUPS)) * u64::from(channels.div_ceil(TILE_CHANNELS))
}

pub(super) fn linear(call: &Linear) -> Accesses {
    let vectors = u64::from((call.src.channels + call.src_b.map_or(0, |b| b.channels)) / 4);
    let staging = Staging { blocks: vectors.div_ceil(8), inputs: 32, tokens: TOKENS, taps: 1, vectors, times: 1 };
    let groups = workgroups(call.tiles.count(call.dst.width, call.dst.height), call.dst.channels);
    staging.accesses(groups, epilogue_loads(call.film.is_some(), call.residual.is_some()), 1)
}

pub(super) fn conv3x3(call: &Conv3x3) -> Accesses {
    let (width, height) = call.result_size();
    let vectors = u64::from(call.src.channels / 4);
    // A block for each column of taps.
    let staging = Staging {
        blocks: 3 * vectors.div_ceil(4),
        inputs: 16,
        tokens: u64::from(8 * (7 * call.stride + 3)),
        taps: 3,
        vectors,
        times: 3,
    };
    let groups = workgroups(call.tiles.count(width, height), call.channels);
    // An unshuffle scatters scalars.
    let stores = if call.shuffle == Shuffle::Unshuffle { 4 } else { 1 };
    staging.accesses(groups, epilogue_loads(call.film.is_some(), call.residual.is_some()), stores)
}

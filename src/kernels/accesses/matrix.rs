//! Accesses of the kernels on matrices: vectors of 16 bytes, in shared memory too, but for the epilogues of the dense
//! ones, which load and store vectors of four halves.

use super::{Accesses, epilogue_loads};
use crate::kernels::attention_block::AttentionBlock;
use crate::kernels::aux_projection::{AUX_CHANNELS, CHANNELS, REACH};
use crate::kernels::contract::Specialisation;
use crate::kernels::contracts::{AUX_SUBGROUPS, MATRIX_SUBGROUPS};
use crate::kernels::dense::{Conv3x3, Linear, TILE_CHANNELS};
use crate::kernels::on_matrices::{DEPTH, groups_of};
use crate::kernels::predicted::{KernelInputs, MATRIX_ROWS, PredictKernels};
use crate::kernels::separable::Separable3x3;
use crate::kernels::unembed::{TAPS, Unembed};
use crate::kernels::window_attention::WindowAttention;
use crate::kernels::{Storage, TILE};

const TOKENS: u64 = (TILE * TILE) as u64;
const OUTPUTS: u64 = TILE_CHANNELS as u64;
const SUBGROUPS: u64 = MATRIX_SUBGROUPS as u64;

/// What a tile asks for.
struct Work {
    /// Loads that its inputs take.
    loads: u64,
    /// Vectors that are staged of them.
    staged: u64,
    /// Rows of weights.
    rows: u64,
    /// Loads of the epilogue for each vector of four outputs.
    epilogue: u64,
}

impl Work {
    fn accesses(&self, special: Specialisation, tiles: u32, channels: u32) -> Accesses {
        let groups: u64 = groups_of(special, tiles, channels).into_iter().map(u64::from).product();
        let tiles = groups * u64::from(special.tiles);
        let subgroups = groups * SUBGROUPS;
        let results = groups * SUBGROUPS * TOKENS * OUTPUTS / 4;
        // Staged once for the subgroups that share the outputs.
        let weights = groups * SUBGROUPS / u64::from(special.tiles) * self.rows * OUTPUTS / 8;
        Accesses {
            global_loads: tiles * self.loads + weights + results * (1 + self.epilogue),
            global_stores: results,
            shared_loads: subgroups * (TOKENS + OUTPUTS) * self.rows / 8 + results,
            shared_stores: tiles * self.staged + weights + results,
        }
    }
}

pub(super) fn linear(call: &Linear, special: Specialisation) -> Accesses {
    let rows = u64::from(call.inputs().next_multiple_of(DEPTH));
    let epilogue = epilogue_loads(call.film.is_some(), call.residual.is_some());
    let work = Work { loads: TOKENS * u64::from(call.inputs()) / 8, staged: TOKENS * rows / 8, rows, epilogue };
    work.accesses(special, call.tiles.count(call.dst.width, call.dst.height), call.dst.channels)
}

pub(super) fn conv3x3(call: &Conv3x3, special: Specialisation) -> Accesses {
    let (width, height) = call.result_size();
    let epilogue = epilogue_loads(call.film.is_some(), call.residual.is_some());
    let inputs = u64::from(call.src.channels);
    let work = if call.src.storage == Storage::F32 {
        let rows = u64::from((9 * call.src.channels).next_multiple_of(DEPTH));
        Work { loads: TOKENS * rows / 4, staged: TOKENS * rows / 8, rows, epilogue }
    } else {
        let source_rows = u64::from((TILE - 1) * call.stride + 3);
        let staged = 3 * source_rows * u64::from(TILE) * inputs / 8;
        Work { loads: staged, staged, rows: 9 * inputs, epilogue }
    };
    work.accesses(special, call.tiles.count(width, height), call.channels)
}

pub(super) fn separable3x3(call: &Separable3x3, special: Specialisation) -> Accesses {
    let Linear { tiles, dst, film, residual, .. } = &call.pointwise;
    let inputs = u64::from(call.depthwise.src.channels);
    let columns = u64::from(TILE) * inputs / 4;
    // Three tokens in each of ten rows, nine taps and a bias for every column of tokens and four channels.
    let loads = columns * (3 * u64::from(TILE + 2) + 10);
    let epilogue = epilogue_loads(film.is_some(), residual.is_some());
    let work = Work { loads, staged: TOKENS * inputs / 4, rows: inputs, epilogue };
    work.accesses(special, tiles.count(dst.width, dst.height), dst.channels)
}

pub(super) fn window_attention(call: &WindowAttention) -> Accesses {
    let windows = u64::from(call.tiles.count(call.dst.width, call.dst.height)) * u64::from(call.heads);
    let (keys, values) = (u64::from(call.key_width), u64::from(call.value_width));
    let padded = keys.next_multiple_of(DEPTH.into());
    // Both factors of both scores once for each subgroup's queries and their bias; then the row of a softmax, and the
    // values.
    let scores = TOKENS * TOKENS / 4;
    Accesses {
        global_loads: windows * (TOKENS * (4 * keys + values) / 8 + scores),
        global_stores: windows * TOKENS * values / 4,
        shared_loads: windows
            * (2 * (TOKENS + SUBGROUPS * TOKENS) * padded / 8
                + scores
                + scores / 2
                + SUBGROUPS * TOKENS * values / 8
                + TOKENS * values / 4),
        shared_stores: windows * (TOKENS * (4 * padded + values) / 8 + scores + scores / 2 + TOKENS * values / 4),
    }
}

/// Of a window and up to 128 outputs each: its norms and Linears, its attention, its projection.
pub(super) fn attention_block(call: &AttentionBlock, groups: [u32; 3]) -> Accesses {
    let groups: u64 = groups.into_iter().map(u64::from).product();
    let (keys, values) = (u64::from(call.key_width), u64::from(call.value_width));
    let channels = u64::from(call.x.channels);
    let padded = keys.next_multiple_of(DEPTH.into());
    let outputs = 4 * padded + values;
    // Every subgroup loads all weights and biases of its queries' Linears; the projection's are staged.
    let weights = SUBGROUPS * outputs * values / 8 + SUBGROUPS * 4 * outputs;
    let scores = TOKENS * TOKENS / 4;
    let results = SUBGROUPS * TOKENS * OUTPUTS / 4;
    let staged_weights = SUBGROUPS * OUTPUTS * channels / 8;
    let rest = TOKENS * (channels - values) / 8;
    Accesses {
        global_loads: groups * (TOKENS * 2 * values / 8 + weights + scores + rest + staged_weights + 2 * results),
        global_stores: groups * results,
        shared_loads: groups
            * (TOKENS * 2 * values / 8
                + 2 * (TOKENS + SUBGROUPS * TOKENS) * padded / 8
                + scores
                + scores / 2
                + SUBGROUPS * TOKENS * values / 8
                + TOKENS * values / 4
                + SUBGROUPS * (TOKENS + OUTPUTS) * channels / 8
                + results),
        shared_stores: groups
            * (TOKENS * 2 * values / 8
                + TOKENS * outputs / 8
                + scores
                + scores / 2
                + TOKENS * values / 4
                + TOKENS * values / 8
                + rest
                + staged_weights
                + results),
    }
}

/// Away from the border, where a workgroup takes several sets of weights.
pub(super) fn unembed(call: &Unembed) -> Accesses {
    let tiles = u64::from(call.tiles.count(call.src.width, call.src.height));
    let (inputs, taps) = (u64::from(call.src.channels), u64::from(TAPS));
    let staged = taps * (u64::from(TILE) - 1 + taps) * u64::from(TILE) * inputs / 8;
    let rows = taps * taps * inputs;
    Accesses {
        global_loads: tiles * (staged + 2 * rows),
        global_stores: tiles * TOKENS * 4,
        shared_loads: tiles * (TOKENS * rows / 8 + TOKENS * 4),
        shared_stores: tiles * (staged + TOKENS * 4),
    }
}

/// Four pixels a token, 32 hidden numbers each.
pub(super) fn kernel_inputs(call: &KernelInputs) -> Accesses {
    let tiles = u64::from(call.tiles.count(call.tokens.width, call.tokens.height));
    let (pixels, rows) = (4 * TOKENS, MATRIX_ROWS as u64);
    // Of a token its channels, of a pixel colour and residual; of these two vectors each. Then every phase's weights.
    let staged = TOKENS * OUTPUTS / 8 + 2 * pixels + SUBGROUPS * rows * OUTPUTS / 8;
    let results = pixels * OUTPUTS / 4;
    Accesses {
        global_loads: tiles * (staged + 3 * results + 3 * pixels),
        global_stores: tiles * (results + pixels),
        shared_loads: tiles * (SUBGROUPS * (TOKENS + OUTPUTS) * rows / 8 + results + pixels),
        shared_stores: tiles * (staged + results + pixels),
    }
}

/// 48 outputs a pixel by two subgroups, and 25 and nine taps.
pub(super) fn predict_kernels(call: &PredictKernels) -> Accesses {
    let tiles = u64::from(call.tiles.count(call.dst.width, call.dst.height));
    let (rows, outputs) = (OUTPUTS, 48);
    let staged = TOKENS * rows / 8 + 2 * u64::from((TILE + 4) * (TILE + 4)) + rows * outputs / 8;
    let results = TOKENS * outputs / 4;
    Accesses {
        global_loads: tiles * (staged + results),
        global_stores: tiles * TOKENS * 3,
        shared_loads: tiles * ((TOKENS + 2 * outputs) * rows / 8 + results + TOKENS * (25 + 9)),
        shared_stores: tiles * (staged + results),
    }
}

/// Of a workgroup's 16x4 tokens with what is made around them.
pub(super) fn aux_projection(groups: [u32; 3]) -> Accesses {
    let (columns, vectors) = (u64::from(CHANNELS / 4), u64::from(CHANNELS / 8));
    let size = |reach: u32| u64::from((2 * TILE + 2 * reach) * (TILE / 2 + 2 * reach));
    let own = size(0);
    let (mut loads, mut shared_loads, mut shared_stores) = (size(REACH) * u64::from(AUX_CHANNELS / 8), 0, 0);
    for step in 0..REACH {
        let (from, to) = (size(REACH - step), size(REACH - step - 1));
        let inputs = u64::from(if step == 0 { DEPTH } else { CHANNELS });
        // Subgroups load the weights of sixteen outputs each; runs of two rows load four of three tokens; an invocation
        // nine taps and two biases.
        let matrices = u64::from(AUX_SUBGROUPS) * 16 * (inputs + u64::from(CHANNELS)) / 8;
        loads += matrices + 11 * u64::from(AUX_SUBGROUPS) * 32;
        shared_loads += 2 * (from * inputs + own * u64::from(CHANNELS)) / 8 + to / 2 * 12 * columns;
        shared_stores += from * vectors + to * columns;
    }
    let results = own * columns;
    let groups: u64 = groups.into_iter().map(u64::from).product();
    Accesses {
        global_loads: groups * (loads + results),
        global_stores: groups * results,
        shared_loads: groups * (shared_loads + results),
        shared_stores: groups * (shared_stores + 2 * size(REACH) + results),
    }
}

//! The same of kernels on matrices: vectors of 16 bytes, in shared memory too, but for the epilogues of the dense
//! ones, which load and store vectors of four halves.

use super::Accesses;
use crate::kernels::contract::Specialisation;
use crate::kernels::contracts::MATRIX_SUBGROUPS;
use crate::kernels::dense::TILE_CHANNELS;
use crate::kernels::on_matrices::{self, groups_of};

/// Tokens of a tile.
pub const TOKENS: u64 = on_matrices::TOKENS as u64;
/// Outputs of a subgroup.
pub const OUTPUTS: u64 = TILE_CHANNELS as u64;
/// Subgroups of a workgroup.
pub const SUBGROUPS: u64 = MATRIX_SUBGROUPS as u64;

/// What a tile asks for.
pub struct Work {
    /// Loads that its inputs take.
    pub loads: u64,
    /// Vectors that are staged of them.
    pub staged: u64,
    /// Loads from shared memory to make rows of inputs of what is staged.
    pub taps: u64,
    /// Rows of weights.
    pub rows: u64,
    /// Loads of the epilogue for each vector of four outputs.
    pub epilogue: u64,
}

impl Work {
    /// What all tiles of a dense kernel ask for together.
    pub fn accesses(&self, special: Specialisation, tiles: u32, channels: u32) -> Accesses {
        let groups: u64 = groups_of(special, tiles, channels).into_iter().map(u64::from).product();
        let tiles = groups * u64::from(special.tiles);
        let subgroups = groups * SUBGROUPS;
        let results = groups * SUBGROUPS * TOKENS * OUTPUTS / 4;
        // Staged once for the subgroups that share the outputs.
        let weights = groups * SUBGROUPS / u64::from(special.tiles) * self.rows * OUTPUTS / 8;
        Accesses {
            global_loads: tiles * self.loads + weights + results * (1 + self.epilogue),
            global_stores: results,
            shared_loads: subgroups * (TOKENS + OUTPUTS) * self.rows / 8 + tiles * self.taps + results,
            shared_stores: tiles * self.staged + weights + results,
        }
    }
}

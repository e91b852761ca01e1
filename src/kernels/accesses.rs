//! How often a kernel's invocations ask for memory, counted from the loops of its shader ([`super::Kernel::accesses`]):
//! what caches have to serve, where [`super::Traffic`] is what memory has to. Here is what the kernels' counts share.

pub(super) mod matrix;

use super::contract::Contract;
use super::{TILE, Tiles, Variant, View};

/// Loads and stores of all invocations of a dispatch together, each of a vector of four floats or, in shared memory and
/// where the shader works on scalars, of one. Loads that only fetch arguments (tile lists) are left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Accesses {
    /// Loads from buffers.
    pub global_loads: u64,
    /// Stores to buffers.
    pub global_stores: u64,
    /// Loads from shared memory.
    pub shared_loads: u64,
    /// Stores to shared memory.
    pub shared_stores: u64,
}

impl Accesses {
    /// Both kinds of access to buffers.
    pub fn global(&self) -> u64 {
        self.global_loads + self.global_stores
    }

    /// Both kinds of access to shared memory.
    pub fn shared(&self) -> u64 {
        self.shared_loads + self.shared_stores
    }

    /// A share of them.
    pub(crate) fn part(self, share: f64) -> Self {
        let part = |all: u64| (all as f64 * share).round() as u64;
        let Self { global_loads, global_stores, shared_loads, shared_stores } = self;
        let [global_loads, global_stores] = [global_loads, global_stores].map(part);
        let [shared_loads, shared_stores] = [shared_loads, shared_stores].map(part);
        Self { global_loads, global_stores, shared_loads, shared_stores }
    }

    pub(super) fn each(invocations: u64, global_loads: u64, global_stores: u64) -> Self {
        Self { global_loads: invocations * global_loads, global_stores: invocations * global_stores, ..Self::default() }
    }
}

/// Outputs of one invocation: tokens in x and y, vectors of four channels.
pub(super) struct Block {
    pub x: u64,
    pub y: u64,
    pub vectors: u64,
}

impl Block {
    pub fn of(contract: &Contract) -> Self {
        let [x, y, vectors] = ["TX", "TY", "NV"].map(|name| contract.define(name));
        Self { x, y, vectors }
    }

    pub fn outputs(&self) -> u64 {
        self.x * self.y * self.vectors
    }

    /// Loads of the weights of four input channels: all of them, or an eighth where the lanes hand them round.
    pub fn weight_loads(&self, contract: &Contract) -> u64 {
        row_loads(contract, 4 * self.vectors)
    }

    /// Invocations for `tiles` of 8x8 tokens and `channels`.
    pub fn invocations(&self, tiles: u32, channels: u32) -> u64 {
        u64::from(tiles) * u64::from(TILE * TILE) / (self.x * self.y)
            * u64::from(channels.div_ceil(4)).div_ceil(self.vectors)
    }
}

/// What a kernel that stages floats (`glsl/shared/staged_products.glsl`) does for a tile.
pub(super) struct Staged {
    /// Loads of inputs.
    pub loads: u64,
    /// Vectors that are staged of them, or of parts of their sums.
    pub stores: u64,
    /// Loads from shared memory before there are products.
    pub norm_loads: u64,
    /// Rows of weights, each of one input channel and tap.
    pub rows: u64,
    /// Loads and stores of the epilogue for each vector of four outputs.
    pub epilogue: [u64; 2],
}

impl Staged {
    /// Of all workgroups together. For every four rows an invocation takes eight vectors of inputs and eight of
    /// weights.
    pub fn accesses(&self, variant: &Variant, groups: [u32; 3]) -> Accesses {
        let groups: u64 = groups.into_iter().map(u64::from).product();
        let (tiles, outputs) = (u64::from(variant.tiles_a_group), variant.stages().map_or(0, u64::from));
        let (invocations, weights) = (2 * outputs, self.rows * outputs / 4);
        let results = tiles * u64::from(TILE * TILE) * outputs / 4;
        let [epilogue, stores] = self.epilogue;
        Accesses {
            global_loads: groups * (tiles * self.loads + weights + 2 * invocations + results * epilogue),
            global_stores: groups * results * stores,
            shared_loads: groups * (tiles * self.norm_loads + 4 * invocations * self.rows),
            shared_stores: groups * (tiles * self.stores + weights),
        }
    }
}

/// What the epilogue loads for each vector of outputs.
pub(super) fn epilogue_loads(film: bool, residual: bool) -> u64 {
    2 * u64::from(film) + u64::from(residual)
}

/// Loads of so many vectors of weights that all invocations need: an eighth each where the lanes hand them round.
pub(super) fn row_loads(contract: &Contract, vectors: u64) -> u64 {
    if contract.has("LANES_SHARE") { vectors.div_ceil(8) } else { vectors }
}

/// Tokens of the tiles of a map that a kernel works on.
pub(super) fn tokens(tiles: &Tiles, map: &View) -> u64 {
    u64::from(tiles.count(map.width, map.height)) * u64::from(TILE * TILE)
}

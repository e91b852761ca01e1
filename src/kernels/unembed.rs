//! Tokens of 2x2 pixels to pixels of three channels.

use super::accesses::matrix::TOKENS;
use super::accesses::{self, Accesses};
use super::contract::Specialisation;
use super::contracts;
use super::on_matrices;
use super::pushes::UnembedPush;
use super::{
    Access, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, TILE, TexelRange,
    Tiles, Traffic, Variant, View, groups,
};

/// Rows of tokens that a pixel takes.
pub const ROWS: u32 = 4;
/// Sets of weights for each of a token's two rows of pixels: away from the frame's border in y and on it, times away
/// from the border in x, at the left, at the right.
pub const SETS: u32 = 6;
/// Vectors of weights for four input channels and one row of tokens.
pub const BLOCK: u32 = 32;

/// `conv3x3(shuffle(conv3x3(src)))`, to four times the channels and to three; both zero-padded at the map's borders.
#[derive(Clone, Debug, PartialEq)]
pub struct Unembed {
    /// Input.
    pub src: View,
    /// Output, of twice the size, in 32-bit floats: three channels and a zero.
    pub dst: View,
    /// Packed weights ([`crate::plan::pack::Pack::Unembed`]), on matrices [`crate::plan::pack::Pack::UnembedMatrix`].
    pub weights: BufferId,
    /// Tiles of the input.
    pub tiles: Tiles,
    /// What it computes with; on matrices it [`Unembed::fits_matrices`].
    pub arithmetic: Arithmetic,
}

/// Tokens of each direction that a token's four pixels take.
pub const TAPS: u32 = 5;
/// Sets of weights on matrices: away from the frame's border in y, at the top, at the bottom, times the same in x.
pub const MATRIX_SETS: u32 = 9;
/// Outputs on matrices: four for each of four pixels.
pub const MATRIX_OUTPUTS: u32 = 16;

impl Unembed {
    /// Whether there is a kernel on matrices for its map: whole vectors of halves.
    pub fn fits_matrices(&self) -> bool {
        self.on_matrices().is_some()
    }

    fn on_matrices(&self) -> Option<Specialisation> {
        let tokens = on_matrices::MOST_TILES * TILE * (TILE - 1 + TAPS);
        let inputs = on_matrices::staged(self.src.channels, tokens, 32, 0, 0)?;
        on_matrices::can_load([&self.src]).then(|| Specialisation { inputs, ..Specialisation::default() })
    }

    fn chosen(&self) -> Option<Specialisation> {
        self.on_matrices().filter(|_| self.arithmetic == Arithmetic::Matrices)
    }

    fn accesses_on_matrices(&self) -> Accesses {
        let tiles = u64::from(self.tiles.count(self.src.width, self.src.height));
        let (inputs, taps) = (u64::from(self.src.channels), u64::from(TAPS));
        let staged = taps * (u64::from(TILE) - 1 + taps) * u64::from(TILE) * inputs / 8;
        let rows = taps * taps * inputs;
        Accesses {
            global_loads: tiles * (staged + 2 * rows),
            global_stores: tiles * TOKENS * 4,
            shared_loads: tiles * (TOKENS * rows / 8 + TOKENS * 4),
            shared_stores: tiles * (staged + TOKENS * 4),
        }
    }
}

impl Kernel for Unembed {
    fn choose(&self, target: KernelTarget) -> Variant {
        if let Some(special) = self.chosen() {
            // One for each subgroup.
            let tiles_a_group = on_matrices::MOST_TILES;
            return Variant { special, tiles_a_group, ..Variant::plain(&contracts::UNEMBED_MATRIX) };
        }
        let contract = match (target.cpu_with(&self.texels()), self.src.storage) {
            (true, _) => &contracts::UNEMBED_CPU,
            (false, Storage::F32) => &contracts::UNEMBED,
            (false, Storage::F16) => &contracts::UNEMBED_FROM_F16,
        };
        // Of 64 invocations, each with so many tokens in a row.
        Variant { tiles_a_group: contract.define("TX") as u32, ..Variant::plain(contract) }
    }

    fn groups(&self, variant: &Variant) -> [u32; 3] {
        // Without matrices one of a token's two rows of pixels.
        let rows = if variant.is_on_matrices() { 1 } else { 2 };
        groups(self.tiles.count(self.src.width, self.src.height).div_ceil(variant.tiles_a_group), rows)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.src))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&UnembedPush {
            src: at.view(&self.src),
            dst: at.view(&self.dst),
            weights: at.of(self.weights),
            tiles: at.tiles(&self.tiles),
            width: self.src.width,
            height: self.src.height,
            src_stride: self.src.stride / 4,
            channels: self.src.channels / 4,
            dst_stride: self.dst.stride / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.src.width, self.src.height),
            flags: self.tiles.flags(self.src.width),
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.src, Access::around(1, 2));
        visit(&mut self.dst, Access::Write(Scale::Double));
    }

    fn others(&self) -> Traffic {
        // Almost every token takes the weights of no border.
        let weights = match self.chosen() {
            Some(_) => u64::from(TAPS * TAPS * self.src.channels * MATRIX_OUTPUTS) * 2 + 16,
            None => u64::from(2 * ROWS * self.src.channels / 4 * BLOCK + 1) * 16,
        };
        Traffic::reading([(self.weights, weights)])
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.src).into(), self.weights.into()]
    }

    /// Away from the border, where several sets of weights are taken.
    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        if variant.is_on_matrices() {
            return Some(self.accesses_on_matrices());
        }
        let contract = variant.contract;
        let tokens = contract.define("TX");
        let loads = 1 + 4 * u64::from(self.src.channels / 4) * (tokens + 4 + accesses::row_loads(contract, 32));
        Some(Accesses::each(2 * accesses::tokens(&self.tiles, &self.src) / tokens, loads, 2 * tokens))
    }
}

//! Dense 3x3 convolution of stride 1 by Winograd's minimal filtering.

use super::accesses::{Accesses, Block};
use super::contract::Specialisation;
use super::contracts::{self, halves};
use super::dense::Conv3x3;
use super::{
    Access, Addresses, Grid, Kernel, KernelTarget, PushBytes, Tiles, Traffic, Variant, View, by_storage, groups,
};
use serde::{Deserialize, Serialize};

/// Outputs of one Winograd tile on a side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum WinogradTile {
    /// F(2x2, 3x3): 16 products for 4 outputs where the definition takes 36.
    F2,
    /// F(4x4, 3x3): 36 products for 16 outputs where the definition takes 144.
    F4,
}

impl WinogradTile {
    /// Outputs on a side.
    pub const fn outputs(self) -> u32 {
        match self {
            Self::F2 => 2,
            Self::F4 => 4,
        }
    }

    /// Inputs on a side, and points of the transform.
    pub const fn inputs(self) -> u32 {
        self.outputs() + 2
    }
}

/// What the packer pads the output channels to: no variant computes more at once.
pub const WINOGRAD_CHANNELS: u32 = 16;

/// The same as a [`Conv3x3`] of stride 1 to more than four channels; its weights are packed as
/// [`crate::plan::pack::Pack::Winograd3x3`].
#[derive(Clone, Debug, PartialEq)]
pub struct Winograd3x3 {
    /// What it computes.
    pub conv: Conv3x3,
    /// How.
    pub tile: WinogradTile,
}

impl Kernel for Winograd3x3 {
    fn choose(&self, _: KernelTarget) -> Variant {
        let of = |f32, f16| by_storage(self.conv.dst.storage, f32, f16);
        let contract = match self.tile {
            WinogradTile::F2 => of(&contracts::WINOGRAD3X3_F2, &halves::WINOGRAD3X3_F2),
            WinogradTile::F4 => of(&contracts::WINOGRAD3X3_F4, &halves::WINOGRAD3X3_F4),
        };
        // Of 64 invocations, each with so many outputs of a tile's 64.
        let tiles_a_group = self.tile.outputs().pow(2) * contract.define("TX") as u32;
        let special = Specialisation { epilogue: self.conv.epilogue(), ..Specialisation::default() };
        Variant { contract, special, tiles_a_group }
    }

    fn groups(&self, variant: &Variant) -> [u32; 3] {
        let (width, height) = self.conv.result_size();
        let tiles = self.conv.tiles.count(width, height).div_ceil(variant.tiles_a_group);
        groups(tiles, self.conv.channels.div_ceil(4 * variant.contract.define("NV") as u32))
    }

    fn grid(&self) -> Option<Grid> {
        // A result of one of its tiles has rounding errors of everything that the tile reads.
        self.conv.grid().map(|grid| Grid { grain: self.tile.outputs(), ..grid })
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        self.conv.tiles_mut()
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        self.conv.push_with(at, self.conv.channels.next_multiple_of(WINOGRAD_CHANNELS) / 4)
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        self.conv.maps(visit);
    }

    fn others(&self) -> Traffic {
        let points = u64::from(self.tile.inputs().pow(2));
        let weights = (u64::from(self.conv.src.channels) * points + 1) * u64::from(self.conv.channels) * 4;
        self.conv.others_with(weights)
    }

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let (tiles, vectors) = (variant.contract.define("TX"), variant.contract.define("NV"));
        let (outputs, inputs) = (u64::from(self.tile.outputs()), u64::from(self.tile.inputs()));
        let block = Block { x: outputs * tiles, y: outputs, vectors };
        let per_four_inputs = inputs * (outputs * tiles + 2) + vectors * 4 * inputs * inputs;
        let [epilogue, stores] = self.conv.epilogue_accesses();
        let loads = vectors + u64::from(self.conv.src.channels / 4) * per_four_inputs + block.outputs() * epilogue;
        let (width, height) = self.conv.result_size();
        let invocations = block.invocations(self.conv.tiles.count(width, height), self.conv.channels);
        Some(Accesses::each(invocations, loads, block.outputs() * stores))
    }
}

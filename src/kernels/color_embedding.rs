//! The colour's projection and its embedding in tokens as one kernel, for matrices: the projected pixels, 32 channels at
//! full size, are the largest map of a network beside the features', and nothing else reads them.

use super::accesses::Accesses;
use super::accesses::matrix::{OUTPUTS, SUBGROUPS, TOKENS};
use super::contract::Specialisation;
use super::dense::{Conv3x3, Linear};
use super::on_matrices::DEPTH;
use super::pushes::ColorEmbeddingPush;
use super::{
    Access, Activation, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Shuffle,
    Storage, Tiles, Traffic, Variant, View, contracts, groups,
};

/// Channels of projected pixels, and of the tokens.
const CHANNELS: u32 = 32;
/// Pixels of a tile's column of taps, in whole matrices.
const PIXELS: u64 = 144;
/// Inputs of the projection, nine taps of four channels, in whole matrices.
const INPUTS: u32 = (9 * 4u32).next_multiple_of(DEPTH);

/// `embedding(projection(color))`: convolutions, the second of stride 2; and what [`Early`] says.
#[derive(Clone, Debug, PartialEq)]
pub struct ColorEmbedding {
    /// The colour, four channels of 32-bit floats.
    pub color: View,
    /// Tokens of 2x2 pixels, 32 channels.
    pub dst: View,
    /// Packed weights of the projection to 32 channels ([`crate::plan::pack::Pack::Halves`]), which ends in a leaky
    /// rectifier.
    pub projection: BufferId,
    /// Its biases once more ([`crate::plan::pack::Pack::BiasRows`]).
    pub biases: BufferId,
    /// Packed weights of the embedding ([`crate::plan::pack::Pack::Halves`]).
    pub embedding: BufferId,
    /// What else is made of the projected pixels.
    pub early: Option<Early>,
    /// Tiles of the tokens.
    pub tiles: Tiles,
}

/// `before + W projection(color)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Early {
    /// A map at full size, 32 channels.
    pub before: View,
    /// Packed weights ([`crate::plan::pack::Pack::Halves`]).
    pub weights: BufferId,
    /// The result.
    pub dst: View,
}

impl ColorEmbedding {
    /// Two convolutions that follow each other as one, with a Linear of what lies between, but for its biases; `None`
    /// where they are something else or no kernel takes them.
    pub fn joined(projection: &Conv3x3, early: Option<&Linear>, embedding: &Conv3x3) -> Option<Self> {
        let plain = |conv: &Conv3x3| {
            conv.arithmetic == Arithmetic::Matrices
                && (conv.film, conv.residual, conv.shuffle) == (None, None, Shuffle::None)
                && conv.channels == CHANNELS
                && conv.dst.storage == Storage::F16
        };
        let is_embedding = [projection, embedding].into_iter().all(plain)
            && (projection.stride, projection.activation) == (1, Activation::LeakyRelu)
            && (embedding.stride, embedding.activation) == (2, Activation::None)
            && embedding.src == projection.dst
            && (projection.src.storage, projection.src.channels) == (Storage::F32, 4);
        let early = match early {
            None => None,
            Some(linear) => Some(Self::early(projection, linear)?),
        };
        is_embedding.then_some(Self {
            color: projection.src,
            dst: embedding.dst,
            projection: projection.weights,
            biases: BufferId(0),
            embedding: embedding.weights,
            early,
            tiles: embedding.tiles,
        })
    }

    fn early(projection: &Conv3x3, linear: &Linear) -> Option<Early> {
        let plain = linear.arithmetic == Arithmetic::Matrices
            && (linear.src, linear.src_b, linear.norm) == (projection.dst, None, false)
            && (linear.film, linear.activation) == (None, Activation::None)
            && (linear.dst.channels, linear.dst.storage) == (CHANNELS, Storage::F16);
        let before = linear.residual.filter(|_| plain)?;
        Some(Early { before, weights: linear.weights, dst: linear.dst })
    }
}

impl Kernel for ColorEmbedding {
    fn choose(&self, _: KernelTarget) -> Variant {
        let contract = match self.early {
            Some(_) => &contracts::COLOR_EMBEDDING_EARLY_MATRIX,
            None => &contracts::COLOR_EMBEDDING_MATRIX,
        };
        Variant::on_matrices(contract, Specialisation::default())
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let early = self.early.as_ref();
        PushBytes::new(&ColorEmbeddingPush {
            color: at.view(&self.color),
            dst: at.view(&self.dst),
            projection: at.of(self.projection),
            biases: at.of(self.biases),
            weights: at.of(self.embedding),
            early: at.view_or_null(early.map(|early| &early.dst)),
            before: at.view_or_null(early.map(|early| &early.before)),
            early_weights: early.map_or(0, |early| at.of(early.weights)),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            height: self.dst.height,
            color_stride: self.color.stride / 4,
            dst_stride: self.dst.stride / 4,
            early_stride: early.map_or(0, |early| early.dst.stride / 4),
            before_stride: early.map_or(0, |early| early.before.stride / 4),
            dst_channels: CHANNELS / 4,
            bias_vectors: CHANNELS / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.color, Access::around(2, 2));
        if let Some(early) = &mut self.early {
            visit(&mut early.before, Access::Residual(Scale::Double));
        }
        visit(&mut self.dst, Access::Write(Scale::Same));
        if let Some(early) = &mut self.early {
            visit(&mut early.dst, Access::Write(Scale::Double));
        }
    }

    fn others(&self) -> Traffic {
        let dense = |inputs: u32| u64::from(CHANNELS * (2 * inputs + 4));
        let early = self.early.as_ref().map(|early| (early.weights, dense(CHANNELS)));
        let always = [
            (self.projection, dense(INPUTS)),
            (self.biases, u64::from(4 * DEPTH * CHANNELS)),
            (self.embedding, dense(9 * CHANNELS)),
        ];
        Traffic::reading(always.into_iter().chain(early))
    }

    /// Of a tile, for each column of taps: its pixels' taps, their projection, its products.
    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let groups: u64 = self.groups(variant).into_iter().map(u64::from).product();
        let (channels, inputs) = (u64::from(CHANNELS), u64::from(INPUTS));
        let early = u64::from(self.early.is_some());
        let (taps, projected) = (PIXELS * inputs / 8, PIXELS * channels / 8);
        let weights = (inputs + 9 * channels + 2 * early * channels) * OUTPUTS / 8;
        let results = TOKENS * OUTPUTS / 4;
        let all_results = (1 + 4 * early) * results;
        // Matrices of 16 rows: every subgroup loads the weights of what it computes, and the inputs of that.
        let of_projection = 3 * (taps + PIXELS / 16 * inputs * OUTPUTS / 8);
        let of_products = (3 * 3 + 4 * early) * (TOKENS * channels / 8 + SUBGROUPS * channels * OUTPUTS / 8);
        Some(Accesses {
            global_loads: groups * (3 * 2 * taps + weights + all_results + 4 * early * results),
            global_stores: groups * all_results,
            shared_loads: groups * (of_projection + of_products + all_results),
            shared_stores: groups * (3 * (taps + projected) + weights + all_results),
        })
    }
}

//! The embedding of pixels in tokens as one kernel with what comes before it or beside it, for matrices: the colour's
//! projection, and the Linears that a head of kernels takes of pixels. Pixels are the largest maps of a network, 32
//! channels at full size: the colour's are never stored, the features' read once.

use super::accesses::Accesses;
use super::accesses::matrix::{OUTPUTS, SUBGROUPS, TOKENS};
use super::attention_block::BIAS_ROWS;
use super::contract::Specialisation;
use super::dense::{Conv3x3, Linear};
use super::on_matrices::{self, DEPTH};
use super::pushes::EmbeddingPush;
use super::{
    Access, Activation, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Shuffle,
    Storage, Tiles, Traffic, Variant, View, contracts, groups,
};

/// Channels of projected pixels, and of the tokens.
const CHANNELS: u32 = 32;
/// Pixels of a tile's column of taps, in whole matrices.
const PIXELS: u64 = 144;
/// Colours of a tile and around it that its pixels are projected from.
const COLORS: u64 = 19 * 19;
/// Inputs of the projection, nine taps of four channels, in whole matrices.
const INPUTS: u32 = (9 * 4u32).next_multiple_of(DEPTH);

/// `embedding(pixels)`, a convolution of stride 2, and what else is made of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Embedding {
    /// What the pixels are made of, or the pixels: [`Pixels`].
    pub src: View,
    /// What they are.
    pub pixels: Pixels,
    /// Tokens of 2x2 pixels, 32 channels.
    pub dst: View,
    /// Packed weights of the embedding ([`crate::plan::pack::Pack::Halves`]).
    pub embedding: BufferId,
    /// Tiles of the tokens.
    pub tiles: Tiles,
}

/// Pixels of 32 channels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Pixels {
    /// The leaky rectifier of a 3x3 convolution of the source, which has four channels of 32-bit floats.
    Projected {
        /// Packed weights of the convolution ([`crate::plan::pack::Pack::Halves`]).
        weights: BufferId,
        /// Its biases once more ([`crate::plan::pack::Pack::BiasRows`]).
        biases: BufferId,
        /// `before + W pixels`, and what it is added to, a map at full size.
        early: Option<(Early, View)>,
    },
    /// The source itself, a map of halves.
    Stored {
        /// `W pixels`.
        early: Option<Early>,
    },
}

/// A Linear of the pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Early {
    /// Packed weights ([`crate::plan::pack::Pack::Halves`]).
    pub weights: BufferId,
    /// The result, a map at full size of 32 channels.
    pub dst: View,
}

impl Embedding {
    /// Two convolutions that follow each other as one, with a Linear of what lies between, but for its biases; `None`
    /// where they are something else or no kernel takes them.
    pub fn of_projected(projection: &Conv3x3, early: Option<&Linear>, embedding: &Conv3x3) -> Option<Self> {
        let is_projection = is_plain(projection)
            && (projection.stride, projection.activation) == (1, Activation::LeakyRelu)
            && (projection.src.storage, projection.src.channels) == (Storage::F32, 4);
        let early = match early {
            None => None,
            Some(linear) => Some((Early::of(&projection.dst, linear)?, linear.residual?)),
        };
        let pixels = Pixels::Projected { weights: projection.weights, biases: BufferId(0), early };
        let joined = Self::joined(&projection.dst, pixels, embedding)?;
        is_projection.then_some(Self { src: projection.src, ..joined })
    }

    /// The embedding of a map, with a Linear of the same one; `None` where they are something else or no kernel takes
    /// them.
    pub fn of_stored(early: Option<&Linear>, embedding: &Conv3x3) -> Option<Self> {
        let src = embedding.src;
        let adds = early.is_some_and(|linear| linear.residual.is_some());
        let early = match early {
            None => None,
            Some(linear) => Some(Early::of(&src, linear)?),
        };
        let fits = !adds && on_matrices::can_load([&src]) && src.channels == CHANNELS;
        Self::joined(&src, Pixels::Stored { early }, embedding).filter(|_| fits)
    }

    fn joined(pixels: &View, of: Pixels, embedding: &Conv3x3) -> Option<Self> {
        let is_embedding = is_plain(embedding)
            && (embedding.stride, embedding.activation) == (2, Activation::None)
            && embedding.src == *pixels;
        is_embedding.then_some(Self {
            src: *pixels,
            pixels: of,
            dst: embedding.dst,
            embedding: embedding.weights,
            tiles: embedding.tiles,
        })
    }

    fn early(&self) -> Option<&Early> {
        match &self.pixels {
            Pixels::Projected { early, .. } => early.as_ref().map(|(early, _)| early),
            Pixels::Stored { early } => early.as_ref(),
        }
    }
}

impl Early {
    /// A Linear of these pixels, whatever it adds to; `None` where it is another.
    fn of(pixels: &View, linear: &Linear) -> Option<Self> {
        let is_early = linear.arithmetic == Arithmetic::Matrices
            && (linear.src, linear.src_b, linear.norm) == (*pixels, None, false)
            && (linear.film, linear.activation) == (None, Activation::None)
            && (linear.dst.channels, linear.dst.storage) == (CHANNELS, Storage::F16);
        is_early.then_some(Self { weights: linear.weights, dst: linear.dst })
    }
}

/// Whether a convolution on matrices makes a map of 32 channels, and nothing more of it.
fn is_plain(conv: &Conv3x3) -> bool {
    conv.arithmetic == Arithmetic::Matrices
        && (conv.film, conv.residual, conv.shuffle) == (None, None, Shuffle::None)
        && conv.channels == CHANNELS
        && conv.dst.storage == Storage::F16
}

impl Kernel for Embedding {
    fn choose(&self, _: KernelTarget) -> Variant {
        let contract = match self.pixels {
            Pixels::Projected { early: None, .. } => &contracts::COLOR_EMBEDDING_MATRIX,
            Pixels::Projected { .. } => &contracts::COLOR_EMBEDDING_EARLY_MATRIX,
            Pixels::Stored { early: None } => &contracts::EMBEDDING_MATRIX,
            Pixels::Stored { .. } => &contracts::EMBEDDING_EARLY_MATRIX,
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
        let (projection, biases, before) = match &self.pixels {
            Pixels::Projected { weights, biases, early } => {
                (at.of(*weights), at.of(*biases), early.as_ref().map(|(_, before)| before))
            }
            Pixels::Stored { .. } => (0, 0, None),
        };
        let early = self.early();
        PushBytes::new(&EmbeddingPush {
            src: at.view(&self.src),
            dst: at.view(&self.dst),
            projection,
            biases,
            weights: at.of(self.embedding),
            early: at.view_or_null(early.map(|early| &early.dst)),
            before: at.view_or_null(before),
            early_weights: early.map_or(0, |early| at.of(early.weights)),
            tiles: at.tiles(&self.tiles),
            width: self.dst.width,
            height: self.dst.height,
            src_stride: self.src.stride / 4,
            dst_stride: self.dst.stride / 4,
            early_stride: early.map_or(0, |early| early.dst.stride / 4),
            before_stride: before.map_or(0, |before| before.stride / 4),
            dst_channels: CHANNELS / 4,
            bias_vectors: CHANNELS / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        match &mut self.pixels {
            Pixels::Projected { early, .. } => {
                visit(&mut self.src, Access::around(2, 2));
                early.iter_mut().for_each(|(_, before)| visit(before, Access::Residual(Scale::Double)));
            }
            Pixels::Stored { .. } => visit(&mut self.src, Access::around(2, 1)),
        }
        visit(&mut self.dst, Access::Write(Scale::Same));
        match &mut self.pixels {
            Pixels::Projected { early: Some((early, _)), .. } | Pixels::Stored { early: Some(early) } => {
                visit(&mut early.dst, Access::Write(Scale::Double));
            }
            Pixels::Projected { early: None, .. } | Pixels::Stored { early: None } => {}
        }
    }

    fn others(&self) -> Traffic {
        let dense = |inputs: u32| u64::from(CHANNELS * (2 * inputs + 4));
        let early = self.early().map(|early| (early.weights, dense(CHANNELS)));
        let projection = match self.pixels {
            Pixels::Projected { weights, biases, .. } => {
                vec![(weights, dense(INPUTS)), (biases, u64::from(4 * BIAS_ROWS * CHANNELS))]
            }
            Pixels::Stored { .. } => Vec::new(),
        };
        Traffic::reading([(self.embedding, dense(9 * CHANNELS))].into_iter().chain(early).chain(projection))
    }

    /// Of a tile, for each column of taps: its pixels, projected where they are of colours staged once, and its
    /// products.
    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let groups: u64 = self.groups(variant).into_iter().map(u64::from).product();
        let (channels, inputs) = (u64::from(CHANNELS), u64::from(INPUTS));
        let is_projected = matches!(self.pixels, Pixels::Projected { .. });
        let (early, adds) = (u64::from(self.early().is_some()), u64::from(is_projected));
        let (taps, pixels) = (PIXELS * inputs / 8, PIXELS * channels / 8);
        let weights = (adds * inputs + 9 * channels + 2 * early * channels) * OUTPUTS / 8;
        let results = TOKENS * OUTPUTS / 4;
        let all_results = (1 + 4 * early) * results;
        let loaded = if is_projected { COLORS } else { 3 * pixels };
        let staged = if is_projected { COLORS / 2 + 3 * (taps + pixels) } else { 3 * pixels };
        // Every subgroup loads the weights of what it computes, and the inputs of that; these are made of colours.
        let of_projection = 3 * adds * (9 * PIXELS + taps + PIXELS / 16 * inputs * OUTPUTS / 8);
        let of_products = (3 * 3 + 4 * early) * (TOKENS * channels / 8 + SUBGROUPS * channels * OUTPUTS / 8);
        Some(Accesses {
            global_loads: groups * (loaded + weights + all_results + 4 * early * adds * results),
            global_stores: groups * all_results,
            shared_loads: groups * (of_projection + of_products + all_results),
            shared_stores: groups * (staged + weights + all_results),
        })
    }
}

//! A layer normalisation and the dense 3x3 convolution after it as one kernel, on cooperative matrices alone: others do
//! not stage a token's channels, and would norm it anew for every tap.

use super::accesses::Accesses;
use super::contracts;
use super::dense::{Conv3x3, TILE_CHANNELS};
use super::maps::LayerNorm;
use super::on_matrices;
use super::pushes::NormedConv3x3Push;
use super::{
    Access, Addresses, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Shuffle, Storage, Tiles, Traffic,
    Variant, View,
};

/// `conv(norm(src))`: the normed map is not stored, so neither the norm's target nor the convolution's source is
/// touched.
#[derive(Clone, Debug, PartialEq)]
pub struct NormedConv3x3 {
    /// Gain and bias of the norm.
    pub norm: BufferId,
    /// The convolution, on matrices, of stride 1 and without a shuffle. Its source is what is normed.
    pub conv: Conv3x3,
}

impl NormedConv3x3 {
    /// The two as one; `None` where no kernel takes them: it stages all channels of a token at once, a power of two of
    /// them.
    pub fn joined(norm: LayerNorm, conv: Conv3x3) -> Option<Self> {
        let (_, special) = conv.chosen()?;
        let fits = conv.src.storage == Storage::F16
            && conv.stride == 1
            && conv.shuffle == Shuffle::None
            && special.inputs == conv.src.channels
            && special.inputs.is_power_of_two()
            && norm.src.storage == Storage::F16
            && on_matrices::can_load([&norm.src]);
        fits.then_some(Self { norm: norm.weights, conv: Conv3x3 { src: norm.src, ..conv } })
    }
}

impl Kernel for NormedConv3x3 {
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant { contract: &contracts::CONV3X3_NORM_MATRIX, ..self.conv.choose(target) }
    }

    fn groups(&self, variant: &Variant) -> [u32; 3] {
        self.conv.groups(variant)
    }

    fn grid(&self) -> Option<Grid> {
        self.conv.grid()
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        self.conv.tiles_mut()
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let Self { norm, conv } = self;
        let src = &conv.src;
        let (width, height) = conv.result_size();
        PushBytes::new(&NormedConv3x3Push {
            src: at.view(src),
            dst: at.view(&conv.dst),
            weights: at.of(conv.weights),
            film: conv.film.map_or(0, |film| at.of(film)),
            residual: at.view_or_null(conv.residual.as_ref()),
            tiles: at.tiles(&conv.tiles),
            norm: at.of(*norm),
            src_width: width,
            src_height: height,
            src_stride: src.stride / 4,
            src_channels: src.channels / 4,
            dst_width: width,
            dst_stride: conv.dst.stride / 4,
            dst_channels: conv.channels / 4,
            residual_stride: conv.residual.map_or(0, |residual| residual.stride / 4),
            bias_vectors: conv.channels.next_multiple_of(TILE_CHANNELS) / 4,
            first_tile: conv.tiles.first(),
            tile_count: conv.tiles.count(width, height),
            flags: conv.tiles.flags(width),
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.conv.src, Access::around(1, 1));
        self.conv.residual.iter_mut().for_each(|residual| visit(residual, Access::Residual(Scale::Same)));
        visit(&mut self.conv.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        let mut others = self.conv.others();
        others.reads.push((self.norm, u64::from(self.conv.src.channels) * 8));
        others
    }

    /// Gain and bias of the norm stay in registers.
    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        Some(self.conv.accesses_on_matrices(variant.special))
    }
}

//! A depthwise 3x3 convolution and the pointwise convolution after it as one kernel.

use super::contract::{Contract, Specialisation};
use super::contracts::{self, halves};
use super::dense::{Linear, TILE_CHANNELS, dense_groups, dense_texels, tiles_a_group};
use super::maps::Depthwise3x3;
use super::on_matrices;
use super::pushes::Separable3x3Push;
use super::{
    Addresses, Arithmetic, Kernel, PushBytes, Storage, TexelRange, Traffic, Variants, activation_flag, by_storage,
};

/// `pointwise(depthwise(src))`: the depthwise result is not stored, so neither its target nor the source of the pointwise
/// one is touched.
#[derive(Clone, Debug, PartialEq)]
pub struct Separable3x3 {
    /// The first part, with its activation.
    pub depthwise: Depthwise3x3,
    /// The second part, of one source.
    pub pointwise: Linear,
}

impl Separable3x3 {
    /// Whether there is a kernel on matrices for its maps: from whole vectors of halves to a map of halves.
    pub fn fits_matrices(&self) -> bool {
        self.on_matrices().is_some()
    }

    fn on_matrices(&self) -> Option<Specialisation> {
        let (src, dst) = (&self.depthwise.src, &self.pointwise.dst);
        let special = on_matrices::separable(src.channels, dst.channels)?;
        (dst.storage == Storage::F16 && on_matrices::can_load([src])).then_some(special)
    }

    fn chosen(&self) -> Option<Specialisation> {
        self.on_matrices().filter(|_| self.pointwise.arithmetic == Arithmetic::Matrices)
    }
}

impl Kernel for Separable3x3 {
    fn contract(&self, variants: Variants) -> &'static Contract {
        if self.chosen().is_some() {
            return &contracts::SEPARABLE3X3_MATRIX;
        }
        match variants.for_texels(&self.texels()).cpu {
            true => by_storage(self.pointwise.dst.storage, &contracts::SEPARABLE3X3_CPU, &halves::SEPARABLE3X3_CPU),
            false => by_storage(self.pointwise.dst.storage, &contracts::SEPARABLE3X3, &halves::SEPARABLE3X3),
        }
    }

    fn specialisation(&self) -> Specialisation {
        let inner = activation_flag(self.depthwise.activation);
        let epilogue = self.pointwise.specialisation().epilogue;
        Specialisation { inner, epilogue, ..self.chosen().unwrap_or_default() }
    }

    fn groups(&self, variants: Variants) -> [u32; 3] {
        let Linear { tiles, dst, .. } = &self.pointwise;
        if let Some(special) = self.chosen() {
            return on_matrices::groups_of(special, tiles.count(dst.width, dst.height), dst.channels);
        }
        dense_groups(tiles.count(dst.width, dst.height), dst.channels, TILE_CHANNELS, self.contract(variants))
    }

    fn tiles_a_group(&self, variants: Variants) -> u32 {
        self.chosen().map_or_else(|| tiles_a_group(self.contract(variants)), |special| special.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let (src, pointwise) = (&self.depthwise.src, &self.pointwise);
        PushBytes::new(&Separable3x3Push {
            src: at.view(src),
            dst: at.view(&pointwise.dst),
            weights: at.of(pointwise.weights),
            film: pointwise.film.map_or(0, |film| at.of(film)),
            residual: at.view_or_null(pointwise.residual.as_ref()),
            depthwise: at.of(self.depthwise.weights),
            tiles: at.tiles(&pointwise.tiles),
            width: src.width,
            height: src.height,
            src_stride: src.stride / 4,
            src_channels: src.channels / 4,
            dst_stride: pointwise.dst.stride / 4,
            dst_channels: pointwise.dst.channels / 4,
            residual_stride: pointwise.residual.map_or(0, |r| r.stride / 4),
            bias_vectors: pointwise.dst.channels.next_multiple_of(TILE_CHANNELS) / 4,
            first_tile: pointwise.tiles.first(),
            tile_count: pointwise.tiles.count(src.width, src.height),
            flags: pointwise.tiles.flags(src.width),
            unused: 0,
        })
    }

    fn texels(&self) -> Vec<TexelRange> {
        let pointwise = &self.pointwise;
        let residual = pointwise.residual.as_ref();
        let mut ranges = dense_texels(&self.depthwise.src, pointwise.weights, pointwise.film, residual);
        ranges.push(self.depthwise.weights.into());
        ranges
    }

    fn traffic(&self) -> Traffic {
        let mut traffic = Linear { src: self.depthwise.src, ..self.pointwise.clone() }.traffic();
        traffic.reads.push((self.depthwise.weights, u64::from(self.depthwise.src.channels) * 40));
        traffic
    }
}

//! The frame's way into the network and out of it.

use super::contracts::{self, halves};
use super::energy;
use super::ensemble::{self, Member};
use super::pushes::{InputAuxPush, InputColorPush, OutputPush};
use super::stats::STATS_FLOATS;
use super::{
    Access, Addresses, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, TILE, Tiles, Traffic, Variant, View,
    by_storage, flags, groups,
};
use crate::error::{Error, Result};
use crate::frame::{Extent, Region};
use std::str::FromStr;

/// What is done with fireflies: pixels much brighter than all of their neighbours but one. To the network they are
/// noise, and a path that found a lamp by chance is; a star is not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fireflies {
    /// [`Fireflies::Mend`] where the surroundings are noisy, [`Fireflies::Keep`] where they are clean: where of the lit
    /// pixels in the 3x3 tiles of 8x8 pixels around no more than a quarter differ from the mean of their left and right
    /// neighbours by more than 8 % of what the three have. Where fewer than 32 pixels are lit, the whole frame's count.
    #[default]
    Auto,
    /// Those above 8 keys and 8 times their second-brightest neighbour keep their light: the network is given the mean
    /// of their good neighbours, and the rest is added to its result.
    Keep,
    /// Those above 1000 keys and 100 times their second-brightest neighbour are taken for missing.
    Mend,
}

impl FromStr for Fireflies {
    type Err = Error;

    /// `auto`, `keep` or `mend`.
    fn from_str(text: &str) -> Result<Self> {
        match text {
            "auto" => Ok(Self::Auto),
            "keep" => Ok(Self::Keep),
            "mend" => Ok(Self::Mend),
            other => Err(Error::InvalidOption {
                option: "fireflies",
                reason: format!("'{other}'; it can be auto, keep or mend"),
            }),
        }
    }
}

/// Colour to `log1p(colour * exposure)`: samples mended, at most 2048 before the logarithm, reflected into the padding.
/// One group per tile.
///
/// A negative sample is 0. NaN, -Inf, and all channels of a pixel above 1e8 keys and 100 times its brightest neighbour
/// or of a firefly ([`Fireflies`]) are missing: they take the mean of that channel's good samples in the nearest of
/// four rings of pixels that has any, else their tile's. +Inf is the brightest sample of the 3x3 pixels around, or
/// where two of these are infinite too, a lamp that overflowed, the frame's largest.
#[derive(Clone, Debug, PartialEq)]
pub struct InputColor {
    /// The statistics.
    pub stats: BufferId,
    /// What is known of every tile ([`super::stats::TileStats`]).
    pub tile_stats: BufferId,
    /// Three channels and a mark for [`Output`]: 0 where no light goes around the network; else 1 and `log1p` of what
    /// samples that are not finite count for, exposed, where there are any; negative in a lamp of +Inf. Padded size.
    pub dst: View,
    /// Size of the frame in pixels.
    pub width: u32,
    /// Size of the frame in pixels.
    pub height: u32,
    /// Tiles of the padded frame.
    pub tiles: Tiles,
}

impl Kernel for InputColor {
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(if target.images { &contracts::INPUT_COLOR_IMAGE } else { &contracts::INPUT_COLOR })
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
        PushBytes::new(&InputColorPush {
            planes: at.frame.planes,
            stats: at.of(self.stats),
            tile_stats: at.of(self.tile_stats),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.width,
            height: self.height,
            tiles_x: self.width.div_ceil(TILE),
            dst_width: self.dst.width,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: firefly_flags(at.frame.fireflies) | self.tiles.flags(self.dst.width),
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        // Of tiles nothing, where nothing is bright or missing.
        Traffic::reading([(self.stats, STATS_FLOATS * 4), (self.tile_stats, 0)])
    }

    fn reads_color(&self) -> bool {
        true
    }
}

pub(super) fn firefly_flags(fireflies: Fireflies) -> u32 {
    match fireflies {
        Fireflies::Auto => 0,
        Fireflies::Mend => flags::MEND_FIREFLIES,
        Fireflies::Keep => flags::KEEP_FIREFLIES,
    }
}

/// Albedo, normal and depth to the network's seven auxiliary channels and a zero. Albedo is a mean of 7x7 pixels where
/// it and the normals are noisy (`docs/neutral.md`).
#[derive(Clone, Debug, PartialEq)]
pub struct InputAux {
    /// One float.
    pub depth_scale: BufferId,
    /// Whether albedo is taken as it is.
    pub clean: bool,
    /// Eight channels, padded size.
    pub dst: View,
    /// Size of the frame in pixels.
    pub width: u32,
    /// Size of the frame in pixels.
    pub height: u32,
    /// Tiles of the padded frame.
    pub tiles: Tiles,
}

impl Kernel for InputAux {
    fn choose(&self, target: KernelTarget) -> Variant {
        let (floats, halves) = match (target.images, self.clean) {
            (true, true) => (&contracts::INPUT_AUX_IMAGE, &halves::INPUT_AUX_IMAGE),
            (false, true) => (&contracts::INPUT_AUX, &halves::INPUT_AUX),
            (true, false) => (&contracts::INPUT_AUX_FILTERED_IMAGE, &halves::INPUT_AUX_FILTERED_IMAGE),
            (false, false) => (&contracts::INPUT_AUX_FILTERED, &halves::INPUT_AUX_FILTERED),
        };
        Variant::plain(by_storage(self.dst.storage, floats, halves))
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
        PushBytes::new(&InputAuxPush {
            planes: at.frame.planes,
            depth_scale: at.of(self.depth_scale),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.width,
            height: self.height,
            dst_width: self.dst.width,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        Traffic::reading([(self.depth_scale, 4)])
    }
}

/// `max(expm1(c + r) / exposure, 0)`, or where the network makes radiance `max(r / exposure, 0)` with what squares of
/// it get back of the light ([`super::energy::EnergyGains`]), at most the frame's largest sample of the channel, mixed
/// with the noisy colour by `blend`, cropped to the frame; then what of the caller's pixel was not in c is added, where
/// c is marked, or is all of it in a lamp of +Inf ([`InputColor`]).
#[derive(Clone, Debug, PartialEq)]
pub struct Output {
    /// The network's result r, three channels and padding.
    pub residual: View,
    /// The frame's row that its first one is: of a band's another than 0.
    pub residual_top: u32,
    /// Where that is exposed radiance, [`super::energy::EnergyGains::dst`] of the whole frame.
    pub gains: Option<View>,
    /// The network's colour input c.
    pub log_color: View,
    /// The statistics.
    pub stats: BufferId,
    /// Size of the frame in pixels.
    pub width: u32,
    /// Size of the frame in pixels.
    pub height: u32,
    /// Tiles of the frame.
    pub tiles: Tiles,
    /// The pixels to write.
    pub region: Region,
    /// Map of what is to be denoised ([`super::converged::ConvergedMap`]). Converged pixels are the caller's own
    /// colour, but for a blend of [`super::converged::BLEND_PIXELS`] beside the others. `None`: everything is denoised.
    pub converged: Option<BufferId>,
    /// Which result it is of those that are averaged, and where that of the turned frame lies: three floats a pixel.
    /// `None`: the only one.
    pub ensemble: Option<(Member, BufferId)>,
}

impl Kernel for Output {
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(match (target.images, target.output_half) {
            (false, false) => &contracts::OUTPUT_F32,
            (false, true) => &contracts::OUTPUT_F16,
            (true, false) => &contracts::OUTPUT_IMAGE_F32,
            (true, true) => &contracts::OUTPUT_IMAGE_F16,
        })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.width, self.height), 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::new(self.tiles, self.width, self.height))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&OutputPush {
            residual: at.view(&self.residual),
            log_color: at.view(&self.log_color),
            stats: at.of(self.stats),
            planes: at.frame.planes,
            tiles: at.tiles(&self.tiles),
            map: self.converged.map_or(0, |map| at.of(map)),
            turned: self.ensemble.map_or(0, |(_, result)| at.of(result)),
            gains: at.view_or_null(self.gains.as_ref()),
            left: self.region.x,
            top: self.region.y,
            right: self.region.right(),
            bottom: self.region.bottom(),
            src_width: self.residual.width,
            residual_stride: self.residual.stride / 4,
            residual_top: self.residual_top,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.width, self.height),
            flags: self.tiles.flags(self.width)
                | self.converged.map_or(0, |_| flags::CONVERGED)
                | self.gains.map_or(0, |_| flags::RADIANCE)
                | Member::flag(self.ensemble.map(|(member, _)| member)),
            blend: at.frame.blend,
            width: self.width,
            height: self.height,
            pixels: self.width * self.height,
            gain_columns: self.gains.map_or(0, |gains| gains.width),
            unused: 0,
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.residual, Access::SAME);
        visit(&mut self.log_color, Access::SAME);
        self.gains.iter_mut().for_each(|gains| visit(gains, energy::BESIDE_PIXELS));
    }

    fn others(&self) -> Traffic {
        let extent = Extent::new(self.width, self.height);
        let map = self.converged.map(|map| (map, extent.pixels() / 64));
        let mut traffic = Traffic::reading([(self.stats, STATS_FLOATS * 4)].into_iter().chain(map));
        if let Some((member, result)) = self.ensemble {
            member.traffic(&mut traffic, result, ensemble::result_bytes(extent, 3));
        }
        traffic
    }

    fn reads_color(&self) -> bool {
        true
    }
}

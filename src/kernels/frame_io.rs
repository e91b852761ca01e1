//! The frame's way into the network and out of it.

use super::contract::Contract;
use super::contracts::{self, halves};
use super::pushes::{InputAuxPush, InputColorPush, OutputPush};
use super::stats::STATS_FLOATS;
use super::{
    Addresses, BufferId, Kernel, PlaneArgs, PushBytes, Tiles, Traffic, Variants, View, by_storage, flags, groups,
};
use crate::frame::Region;

pub(super) fn color_flags(plane: &PlaneArgs) -> u32 {
    plane_flags(plane, flags::COLOR, flags::COLOR_HALF)
}

pub(super) fn depth_flags(plane: &PlaneArgs) -> u32 {
    plane_flags(plane, flags::DEPTH, flags::DEPTH_HALF)
}

fn plane_flags(plane: &PlaneArgs, present: u32, half: u32) -> u32 {
    (if plane.present { present } else { 0 }) | (if plane.half { half } else { 0 })
}

/// Colour to `log1p(colour * exposure)`: bad pixels mended, reflected into the padding. One group per tile.
///
/// A pixel is bad that is not finite, negative, of a channel above 1e8 keys, or isolated: its brightest channel is above 1000
/// keys and 100 times that of its second-brightest neighbour. It takes the mean of its good neighbours among the 3x3, else 0.
#[derive(Clone, Debug, PartialEq)]
pub struct InputColor {
    /// The statistics.
    pub stats: BufferId,
    /// Three channels and a zero, padded size.
    pub dst: View,
    /// Size of the frame in pixels.
    pub width: u32,
    /// Size of the frame in pixels.
    pub height: u32,
    /// Tiles of the padded frame.
    pub tiles: Tiles,
}

impl Kernel for InputColor {
    fn contract(&self, variants: Variants) -> &'static Contract {
        if variants.images { &contracts::INPUT_COLOR_IMAGE } else { &contracts::INPUT_COLOR }
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&InputColorPush {
            color: at.frame.color.address,
            stats: at.of(self.stats),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            color_offset: at.frame.color.offset,
            color_pixel: at.frame.color.pixel,
            color_row: at.frame.color.row,
            color_channel: at.frame.color.channel,
            width: self.width,
            height: self.height,
            dst_width: self.dst.width,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: color_flags(&at.frame.color) | self.tiles.flags(self.dst.width),
        })
    }

    fn reads_color(&self) -> bool {
        true
    }

    fn traffic(&self) -> Traffic {
        Traffic { reads: vec![(self.stats, STATS_FLOATS * 4)], writes: vec![(self.dst.buffer, self.dst.bytes())] }
    }
}

/// Albedo, normal and depth to the network's seven auxiliary channels and a zero.
#[derive(Clone, Debug, PartialEq)]
pub struct InputAux {
    /// One float.
    pub depth_scale: BufferId,
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
    fn contract(&self, variants: Variants) -> &'static Contract {
        match variants.images {
            true => by_storage(self.dst.storage, &contracts::INPUT_AUX_IMAGE, &halves::INPUT_AUX_IMAGE),
            false => by_storage(self.dst.storage, &contracts::INPUT_AUX, &halves::INPUT_AUX),
        }
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        let planes = plane_flags(&at.frame.albedo, flags::ALBEDO, flags::ALBEDO_HALF)
            | plane_flags(&at.frame.normal, flags::NORMAL, flags::NORMAL_HALF)
            | depth_flags(&at.frame.depth)
            | self.tiles.flags(self.dst.width);
        PushBytes::new(&InputAuxPush {
            albedo: at.frame.albedo.address,
            normal: at.frame.normal.address,
            depth: at.frame.depth.address,
            depth_scale: at.of(self.depth_scale),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            albedo_offset: at.frame.albedo.offset,
            albedo_pixel: at.frame.albedo.pixel,
            albedo_row: at.frame.albedo.row,
            albedo_channel: at.frame.albedo.channel,
            normal_offset: at.frame.normal.offset,
            normal_pixel: at.frame.normal.pixel,
            normal_row: at.frame.normal.row,
            normal_channel: at.frame.normal.channel,
            depth_offset: at.frame.depth.offset,
            depth_pixel: at.frame.depth.pixel,
            depth_row: at.frame.depth.row,
            width: self.width,
            height: self.height,
            dst_width: self.dst.width,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: planes,
            unused: 0,
        })
    }

    fn traffic(&self) -> Traffic {
        Traffic { reads: vec![(self.depth_scale, 4)], writes: vec![(self.dst.buffer, self.dst.bytes())] }
    }
}

/// `max(expm1(c + r) / exposure, 0)`, or where the network makes radiance `max(r / exposure, 0)`, mixed with the noisy colour
/// by `blend`, cropped to the frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Output {
    /// The network's result r, three channels and padding.
    pub residual: View,
    /// Whether that is exposed radiance.
    pub radiance: bool,
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
    /// Map of what is to be denoised ([`super::quiet::QuietMap`]). Quiet pixels are the caller's own colour, but for a blend of
    /// [`super::quiet::BLEND_PIXELS`] beside the others. `None`: everything is denoised.
    pub quiet: Option<BufferId>,
}

impl Kernel for Output {
    fn contract(&self, variants: Variants) -> &'static Contract {
        match (variants.images, variants.output_half) {
            (false, false) => &contracts::OUTPUT_F32,
            (false, true) => &contracts::OUTPUT_F16,
            (true, false) => &contracts::OUTPUT_IMAGE_F32,
            (true, true) => &contracts::OUTPUT_IMAGE_F16,
        }
    }

    fn groups(&self, _: Variants) -> [u32; 3] {
        groups(self.tiles.count(self.width, self.height), 1)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&OutputPush {
            residual: at.view(&self.residual),
            log_color: at.view(&self.log_color),
            stats: at.of(self.stats),
            dst: at.frame.output.address,
            tiles: at.tiles(&self.tiles),
            dst_offset: at.frame.output.offset,
            dst_pixel: at.frame.output.pixel,
            dst_row: at.frame.output.row,
            dst_channel: at.frame.output.channel,
            color: at.frame.color.address,
            map: self.quiet.map_or(0, |map| at.of(map)),
            color_offset: at.frame.color.offset,
            color_pixel: at.frame.color.pixel,
            color_row: at.frame.color.row,
            color_channel: at.frame.color.channel,
            left: self.region.x,
            top: self.region.y,
            right: self.region.right(),
            bottom: self.region.bottom(),
            src_width: self.residual.width,
            residual_stride: self.residual.stride / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.width, self.height),
            flags: self.tiles.flags(self.width)
                | color_flags(&at.frame.color)
                | self.quiet.map_or(0, |_| flags::QUIET)
                | if self.radiance { flags::RADIANCE } else { 0 },
            blend: at.frame.blend,
        })
    }

    fn reads_color(&self) -> bool {
        true
    }

    fn traffic(&self) -> Traffic {
        let pixels = u64::from(self.width) * u64::from(self.height);
        let map = |view: &View| pixels * 4 * view.storage.bytes();
        let mut reads = vec![
            (self.residual.buffer, map(&self.residual)),
            (self.log_color.buffer, map(&self.log_color)),
            (self.stats, STATS_FLOATS * 4),
        ];
        reads.extend(self.quiet.map(|quiet| (quiet, pixels / 64)));
        Traffic { reads, writes: vec![] }
    }
}

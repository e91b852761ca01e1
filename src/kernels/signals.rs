//! Signals beside the colour, on their way to the kernels that were predicted for it and from there
//! ([`crate::signals`]).

use super::contracts;
use super::energy;
use super::ensemble::Member;
use super::frame_io::firefly_flags;
use super::planes::PlaneArgs;
use super::pushes::{InputSignalPush, OutputSignalPush};
use super::stats::STATS_FLOATS;
use super::{
    Access, Addresses, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage, Tiles, Traffic, Variant, View,
    by_storage, flags, groups,
};
use crate::error::{Error, Result};
use crate::frame::Region;

/// What a signal is to the colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SignalKind {
    /// A part of the light, three channels of linear radiance: a light group, direct or indirect light, a material's
    /// part. It is filtered as the colour is, the same share of it divided by the albedo and multiplied again, so that
    /// parts that add up to the colour do so afterwards: within 1e-5 of the colour where all of them are finite.
    /// Negative samples count as they are, but where the colour is negative the part is 0 too.
    Light,
    /// Anything else, one or three channels: averaged as it is.
    Value,
    /// Coverage, one channel: averaged as it is, and in [0, 1] afterwards.
    Alpha,
}

impl SignalKind {
    pub(crate) fn check(self, channels: u32) -> Result<()> {
        let (allowed, what) = match self {
            Self::Light => (channels == 3, "a part of the light has 3 channels"),
            Self::Value => (channels == 1 || channels == 3, "a signal has 1 channel or 3"),
            Self::Alpha => (channels == 1, "alpha has 1 channel"),
        };
        if allowed {
            return Ok(());
        }
        Err(Error::InvalidOption { option: "signal", reason: format!("{channels} channels; {what}") })
    }
}

/// A signal that is bound: its planes as rows of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalRows {
    /// What it is.
    pub kind: SignalKind,
    /// Channels, 1 or 3.
    pub channels: u32,
    /// The caller's samples.
    pub plane: PlaneArgs,
    /// Where they go; of halves where [`KernelTarget::output_half`] says so.
    pub output: PlaneArgs,
}

/// A signal of one recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SignalArgs {
    /// What it is.
    pub kind: SignalKind,
    /// Channels, 1 or 3.
    pub channels: u32,
    /// Device address of its rows in the table of planes: its samples, then where they go.
    pub planes: u64,
    /// Device address of the turned frame's result, where results are averaged: its channels for each pixel.
    pub turned: u64,
}

impl SignalArgs {
    /// The flags that say what the signal is.
    fn flags(&self) -> u32 {
        let flags = [
            (self.channels == 1, flags::SIGNAL_ONE),
            (self.kind == SignalKind::Light, flags::LIGHT),
            (self.kind == SignalKind::Alpha, flags::ALPHA),
        ];
        flags.into_iter().filter(|(is, _)| *is).map(|(_, flag)| flag).sum()
    }
}

/// The signal that is being recorded; one that is not there has no samples.
fn signal(at: &Addresses) -> SignalArgs {
    let none = SignalArgs { kind: SignalKind::Value, channels: 1, planes: at.frame.planes, turned: 0 };
    at.frame.signal.unwrap_or(none)
}

/// A signal to what predicted kernels read: the reliability times the image, and the reliability. Then what goes
/// around the kernels. One group per tile.
///
/// The image of a part of the light is as the colour's: exposed, by the albedo, at most as much of it as the network
/// is given of the colour; where the colour is mended ([`super::frame_io::InputColor`]) the mean of the same pixels.
/// Another signal's is the signal. A sample that is not finite is the mean of those of the nearest of four rings of
/// pixels that are, else 0.
#[derive(Clone, Debug, PartialEq)]
pub struct InputSignal {
    /// The statistics.
    pub stats: BufferId,
    /// What is known of every tile of the colour.
    pub tile_stats: BufferId,
    /// The colour's reliability times its image, and the reliability; 32-bit floats.
    pub taps: View,
    /// Albedo in the first three channels.
    pub albedo: View,
    /// Eight channels of padded size, 32-bit floats: as `taps`; then what is added to the result, exposed where it is
    /// light, and a bit for each channel of which it is all.
    pub dst: View,
    /// Size of the frame in pixels.
    pub width: u32,
    /// Size of the frame in pixels.
    pub height: u32,
    /// Tiles of the padded frame.
    pub tiles: Tiles,
}

impl InputSignal {
    /// What predicted kernels read of it.
    pub fn image(&self) -> View {
        View { channels: 4, ..self.dst }
    }
}

impl Kernel for InputSignal {
    fn choose(&self, target: KernelTarget) -> Variant {
        let (f32, f16) = match target.images {
            false => (&contracts::INPUT_SIGNAL, &contracts::INPUT_SIGNAL_FROM_F16),
            true => (&contracts::INPUT_SIGNAL_IMAGE, &contracts::INPUT_SIGNAL_IMAGE_FROM_F16),
        };
        Variant::plain(by_storage(self.albedo.storage, f32, f16))
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
        let signal = signal(at);
        PushBytes::new(&InputSignalPush {
            planes: at.frame.planes,
            signal: signal.planes,
            stats: at.of(self.stats),
            tile_stats: at.of(self.tile_stats),
            taps: at.view(&self.taps),
            albedo: at.view(&self.albedo),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            width: self.width,
            height: self.height,
            dst_width: self.dst.width,
            strides: (self.taps.stride / 4) | ((self.albedo.stride / 4) << 8),
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: firefly_flags(at.frame.fireflies) | signal.flags() | self.tiles.flags(self.dst.width),
            blend: at.frame.blend,
        })
    }

    fn reads_color(&self) -> bool {
        true
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.taps, Access::SAME);
        visit(&mut self.albedo, Access::SAME);
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        // Of tiles nothing, where nothing of the colour is bright or missing.
        Traffic::reading([(self.stats, STATS_FLOATS * 4), (self.tile_stats, 0)])
    }
}

/// A signal that went through the colour's kernels to the caller's plane, cropped to the frame: mixed with the noisy
/// one by `blend`, with what goes around the kernels. A part of the light is multiplied by what the colour's result is
/// ([`super::energy::EnergyGains`]), and where that is cut at the frame's largest sample, cut by the same factor.
#[derive(Clone, Debug, PartialEq)]
pub struct OutputSignal {
    /// The filtered signal, four channels, exposed where it is light; 32-bit floats.
    pub filtered: View,
    /// The colour's result, as that.
    pub color: View,
    /// [`super::energy::EnergyGains::dst`] of that.
    pub gains: View,
    /// [`InputSignal::dst`].
    pub input: View,
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
    /// As [`super::frame_io::Output::converged`]: converged pixels are the caller's own samples, 0 where they are not
    /// finite.
    pub converged: Option<BufferId>,
    /// Which result it is of those that are averaged; `None`: the only one.
    pub member: Option<Member>,
}

impl Kernel for OutputSignal {
    fn choose(&self, target: KernelTarget) -> Variant {
        let storage = if target.output_half { Storage::F16 } else { Storage::F32 };
        Variant::plain(by_storage(storage, &contracts::OUTPUT_SIGNAL_F32, &contracts::OUTPUT_SIGNAL_F16))
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
        let signal = signal(at);
        PushBytes::new(&OutputSignalPush {
            filtered: at.view(&self.filtered),
            color: at.view(&self.color),
            direct: at.view(&self.input),
            stats: at.of(self.stats),
            signal: signal.planes,
            map: self.converged.map_or(0, |map| at.of(map)),
            tiles: at.tiles(&self.tiles),
            turned: signal.turned,
            gains: at.view(&self.gains),
            left: self.region.x,
            top: self.region.y,
            right: self.region.right(),
            bottom: self.region.bottom(),
            src_width: self.filtered.width,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.width, self.height),
            flags: self.tiles.flags(self.width)
                | signal.flags()
                | self.converged.map_or(0, |_| flags::CONVERGED)
                | Member::flag(self.member),
            blend: at.frame.blend,
            width: self.width,
            height: self.height,
            pixels: self.width * self.height,
            gain_columns: self.gains.width,
            unused: 0,
        })
    }

    fn reads_color(&self) -> bool {
        true
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        [&mut self.filtered, &mut self.color, &mut self.input].into_iter().for_each(|map| visit(map, Access::SAME));
        visit(&mut self.gains, energy::BESIDE_PIXELS);
    }

    fn others(&self) -> Traffic {
        let map = self.converged.map(|map| (map, u64::from(self.width) * u64::from(self.height) / 64));
        Traffic::reading([(self.stats, STATS_FLOATS * 4)].into_iter().chain(map))
    }
}

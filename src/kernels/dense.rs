//! The dense kernels: 3x3 and pointwise convolution, with bias, FiLM, residual, activation and pixel shuffles.

use super::contract::{Contract, Specialisation};
use super::contracts::{self, halves};
use super::on_matrices;
use super::pushes::{Conv3x3Push, LinearPush};
use super::{
    Access, Activation, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Shuffle,
    Storage, TexelRange, Tiles, Traffic, Variant, View, activation_flag, by_storage, flags, groups,
};

/// Output channels of one workgroup, and what the packer pads the weights to.
pub const TILE_CHANNELS: u32 = 32;
/// The same for convolutions to at most this many channels.
pub const NARROW_CHANNELS: u32 = 4;

/// Half a tile's channels: convolutions of stride 1 to no more compute that half alone.
pub const SMALL_CHANNELS: u32 = 16;

/// Output channels that a convolution to `channels` computes per workgroup.
pub fn conv_tile_channels(channels: u32) -> u32 {
    if channels <= NARROW_CHANNELS { NARROW_CHANNELS } else { TILE_CHANNELS }
}

/// `shuffle(act(film(conv3x3(src) + bias) + residual))`, zero padding at the map's borders.
#[derive(Clone, Debug, PartialEq)]
pub struct Conv3x3 {
    /// Input. Stored as the output is, but for a stride of 1: from 32-bit floats to halves, and to at most
    /// [`NARROW_CHANNELS`] channels from halves to 32-bit floats.
    pub src: View,
    /// Output, in its shape after the shuffle.
    pub dst: View,
    /// Output channels of the convolution itself.
    pub channels: u32,
    /// Packed weights ([`crate::plan::pack`]).
    pub weights: BufferId,
    /// Vector `[gamma | beta]`.
    pub film: Option<BufferId>,
    /// Added before the activation: a map like the output, after a pixel shuffle. Not with a pixel unshuffle.
    pub residual: Option<View>,
    /// 1 or 2.
    pub stride: u32,
    /// Applied to the sum.
    pub activation: Activation,
    /// Applied last.
    pub shuffle: Shuffle,
    /// Tiles of the convolution's own result (before the shuffle).
    pub tiles: Tiles,
    /// On matrices its weights are packed as halves ([`crate::plan::pack::Pack::Halves`]), and
    /// [`Conv3x3::fits_matrices`].
    pub arithmetic: Arithmetic,
}

impl Conv3x3 {
    /// Size of the convolution's own result, in tokens.
    pub fn result_size(&self) -> (u32, u32) {
        (self.src.width / self.stride, self.src.height / self.stride)
    }

    /// Whether there is a kernel on matrices for its maps: from whole vectors of halves, or from four channels of
    /// 32-bit floats, to a map of halves of more channels than a narrow one has.
    pub fn fits_matrices(&self) -> bool {
        self.on_matrices().is_some()
    }

    fn on_matrices(&self) -> Option<(&'static Contract, Specialisation)> {
        let (src, channels) = (&self.src, self.channels);
        if self.dst.storage != Storage::F16 || conv_tile_channels(channels) == NARROW_CHANNELS {
            return None;
        }
        if src.storage == Storage::F32 && src.channels == 4 && self.stride == 1 {
            return Some((&contracts::CONV3X3_FIRST_MATRIX, on_matrices::conv3x3_first(channels)));
        }
        let contract = if self.stride == 2 { &contracts::CONV3X3_S2_MATRIX } else { &contracts::CONV3X3_MATRIX };
        let special = on_matrices::conv3x3(src.channels, channels, self.stride);
        special.filter(|_| on_matrices::can_load([src])).map(|special| (contract, special))
    }

    pub(super) fn chosen(&self) -> Option<(&'static Contract, Specialisation)> {
        self.on_matrices().filter(|_| self.arithmetic == Arithmetic::Matrices)
    }

    fn on_floats(&self, target: KernelTarget) -> &'static Contract {
        // Texels are of any type.
        let of = |f32, f16| by_storage(self.dst.storage, f32, f16);
        let (alike, cpu) = (self.src.storage == self.dst.storage, target.cpu_with(&self.texels()));
        if conv_tile_channels(self.channels) == NARROW_CHANNELS {
            return match (cpu, alike) {
                (true, _) => of(&contracts::CONV3X3_N4_CPU, &halves::CONV3X3_N4_CPU),
                (false, true) => of(&contracts::CONV3X3_N4, &halves::CONV3X3_N4),
                (false, false) => &contracts::CONV3X3_N4_FROM_F16,
            };
        }
        let small = self.channels <= SMALL_CHANNELS && alike;
        match (self.stride, cpu) {
            (2, true) => of(&contracts::CONV3X3_S2_CPU, &halves::CONV3X3_S2_CPU),
            (2, false) => of(&contracts::CONV3X3_S2, &halves::CONV3X3_S2),
            (_, true) if small => of(&contracts::CONV3X3_N16_CPU, &halves::CONV3X3_N16_CPU),
            (_, true) => of(&contracts::CONV3X3_CPU, &halves::CONV3X3_CPU),
            (_, false) if small => of(&contracts::CONV3X3_N16, &halves::CONV3X3_N16),
            (_, false) if alike => of(&contracts::CONV3X3, &halves::CONV3X3),
            (_, false) => &contracts::CONV3X3_TO_F16,
        }
    }

    /// What becomes of its sums.
    pub(super) fn epilogue(&self) -> u32 {
        let shuffle = match self.shuffle {
            Shuffle::None => 0,
            Shuffle::Unshuffle => flags::UNSHUFFLE,
            Shuffle::Shuffle => flags::SHUFFLE,
        };
        shuffle | epilogue_flags(self.activation, self.film, self.residual.as_ref())
    }
}

/// Workgroups of a variant for tiles and channels; without matrices each computes `tile_channels` of them.
pub(super) fn dense_groups(variant: &Variant, tiles: u32, channels: u32, tile_channels: u32) -> [u32; 3] {
    match variant.is_on_matrices() {
        true => on_matrices::groups_of(variant.special, tiles, channels),
        false => groups(tiles.div_ceil(variant.tiles_a_group), channels.div_ceil(tile_channels)),
    }
}

impl Kernel for Conv3x3 {
    fn choose(&self, target: KernelTarget) -> Variant {
        let epilogue = self.epilogue();
        match self.chosen() {
            Some((contract, special)) => {
                let (width, height) = self.result_size();
                let special = on_matrices::cut_for(special, self.tiles.count(width, height), self.channels);
                Variant::on_matrices(contract, Specialisation { epilogue, ..special })
            }
            None => Variant::dense(self.on_floats(target), Specialisation { epilogue, ..Specialisation::default() }),
        }
    }

    fn groups(&self, variant: &Variant) -> [u32; 3] {
        let (width, height) = self.result_size();
        dense_groups(variant, self.tiles.count(width, height), self.channels, conv_tile_channels(self.channels))
    }

    fn grid(&self) -> Option<Grid> {
        let (width, height) = self.result_size();
        Some(Grid::new(self.tiles, width, height))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        self.push_with(at, self.channels.next_multiple_of(conv_tile_channels(self.channels)) / 4)
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.src, Access::around(self.stride, 1));
        let scale = match self.shuffle {
            Shuffle::None => Scale::Same,
            Shuffle::Shuffle => Scale::Double,
            Shuffle::Unshuffle => Scale::Half,
        };
        self.residual.iter_mut().for_each(|residual| visit(residual, Access::Residual(scale)));
        visit(&mut self.dst, Access::Write(scale));
    }

    fn others(&self) -> Traffic {
        self.others_with(weight_bytes(u64::from(self.src.channels) * 9, self.channels, self.arithmetic))
    }

    fn texels(&self) -> Vec<TexelRange> {
        dense_texels(&self.src, self.weights, self.film, self.residual.as_ref())
    }
}

impl Conv3x3 {
    /// Push constants; the packed weights begin with so many vectors of biases.
    pub(super) fn push_with(&self, at: &Addresses, bias_vectors: u32) -> PushBytes {
        let (width, height) = self.result_size();
        PushBytes::new(&Conv3x3Push {
            src: at.view(&self.src),
            dst: at.view(&self.dst),
            weights: at.of(self.weights),
            film: self.film.map_or(0, |film| at.of(film)),
            residual: at.view_or_null(self.residual.as_ref()),
            tiles: at.tiles(&self.tiles),
            src_width: self.src.width,
            src_height: self.src.height,
            src_stride: self.src.stride / 4,
            src_channels: self.src.channels / 4,
            dst_width: width,
            dst_stride: self.dst.stride / 4,
            dst_channels: self.channels / 4,
            residual_stride: self.residual.map_or(0, |r| r.stride / 4),
            bias_vectors,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(width, height),
            flags: self.tiles.flags(width),
        })
    }

    /// What it reads beside maps, so many bytes of it weights.
    pub(super) fn others_with(&self, weights: u64) -> Traffic {
        let film = self.film.map(|film| (film, u64::from(self.channels) * 8));
        Traffic::reading([(self.weights, weights)].into_iter().chain(film))
    }
}

/// Bytes of a matrix of so many inputs and outputs, and of its biases, as they are packed.
fn weight_bytes(inputs: u64, outputs: u32, arithmetic: Arithmetic) -> u64 {
    let element = match arithmetic {
        Arithmetic::Floats => Storage::F32,
        Arithmetic::Matrices => Storage::F16,
    };
    (inputs * element.bytes() + Storage::F32.bytes()) * u64::from(outputs)
}

/// `act(film(W norm([src | src_b]) + bias) + residual)` for every token.
#[derive(Clone, Debug, PartialEq)]
pub struct Linear {
    /// First input.
    pub src: View,
    /// Second input, its channels after the first's. Not with [`Linear::norm`].
    pub src_b: Option<View>,
    /// Whether every token is brought to mean 0 and variance 1 over its channels first (eps 1e-5). Gain and bias are in
    /// the weights.
    pub norm: bool,
    /// Output.
    pub dst: View,
    /// Packed weights ([`crate::plan::pack`]).
    pub weights: BufferId,
    /// Vector `[gamma | beta]`.
    pub film: Option<BufferId>,
    /// Added before the activation.
    pub residual: Option<View>,
    /// Applied to the sum.
    pub activation: Activation,
    /// Tiles of the map.
    pub tiles: Tiles,
    /// On matrices its weights are packed as halves ([`crate::plan::pack::Pack::Halves`]), and
    /// [`Linear::fits_matrices`].
    pub arithmetic: Arithmetic,
}

impl Linear {
    pub(super) fn inputs(&self) -> u32 {
        self.src.channels + self.src_b.map_or(0, |b| b.channels)
    }

    /// Whether there is a kernel on matrices for its maps: from whole vectors of halves to a map of halves; normed ones
    /// of a power of two of channels.
    pub fn fits_matrices(&self) -> bool {
        self.on_matrices().is_some()
    }

    fn on_matrices(&self) -> Option<Specialisation> {
        let special = on_matrices::linear(self.inputs(), self.dst.channels, self.norm)?;
        let fits =
            self.dst.storage == Storage::F16 && on_matrices::can_load([&self.src].into_iter().chain(&self.src_b));
        fits.then_some(special)
    }

    fn chosen(&self) -> Option<Specialisation> {
        self.on_matrices().filter(|_| self.arithmetic == Arithmetic::Matrices)
    }

    fn on_floats(&self, target: KernelTarget) -> &'static Contract {
        let of = |f32, f16| by_storage(self.dst.storage, f32, f16);
        let cpu = target.cpu_with(&self.texels());
        if let Some(stationary) = self.stationary().filter(|_| cpu) {
            return stationary;
        }
        match (self.norm, cpu) {
            (true, _) => of(&contracts::LINEAR_NORM, &halves::LINEAR_NORM),
            (false, true) => of(&contracts::LINEAR_CPU, &halves::LINEAR_CPU),
            (false, false) => of(&contracts::LINEAR, &halves::LINEAR),
        }
    }

    /// What becomes of its sums.
    pub(super) fn epilogue(&self) -> u32 {
        epilogue_flags(self.activation, self.film, self.residual.as_ref())
    }

    /// The variant for CPU drivers that holds all inputs, where there is one for so many.
    fn stationary(&self) -> Option<&'static Contract> {
        let of = |f32, f16| Some(by_storage(self.dst.storage, f32, f16));
        match (self.inputs(), self.norm, self.src_b.is_some()) {
            (8, false, false) => of(&contracts::LINEAR_K8_CPU, &halves::LINEAR_K8_CPU),
            (16, false, false) => of(&contracts::LINEAR_K16_CPU, &halves::LINEAR_K16_CPU),
            (16, true, false) => of(&contracts::LINEAR_K16_NORM_CPU, &halves::LINEAR_K16_NORM_CPU),
            (32, false, false) => of(&contracts::LINEAR_K32_CPU, &halves::LINEAR_K32_CPU),
            (32, true, false) => of(&contracts::LINEAR_K32_NORM_CPU, &halves::LINEAR_K32_NORM_CPU),
            (64, false, false) => of(&contracts::LINEAR_K64_CPU, &halves::LINEAR_K64_CPU),
            (64, true, false) => of(&contracts::LINEAR_K64_NORM_CPU, &halves::LINEAR_K64_NORM_CPU),
            (64, false, true) => of(&contracts::LINEAR_K64_TWO_CPU, &halves::LINEAR_K64_TWO_CPU),
            (128, true, false) => of(&contracts::LINEAR_K128_NORM_CPU, &halves::LINEAR_K128_NORM_CPU),
            _ => None,
        }
    }
}

impl Kernel for Linear {
    fn choose(&self, target: KernelTarget) -> Variant {
        let epilogue = self.epilogue();
        let Some(special) = self.chosen() else {
            return Variant::dense(self.on_floats(target), Specialisation { epilogue, ..Specialisation::default() });
        };
        let dst = &self.dst;
        let special = on_matrices::cut_for(special, self.tiles.count(dst.width, dst.height), dst.channels);
        let contract = if self.norm { &contracts::LINEAR_NORM_MATRIX } else { &contracts::LINEAR_MATRIX };
        Variant::on_matrices(contract, Specialisation { epilogue, ..special })
    }

    fn groups(&self, variant: &Variant) -> [u32; 3] {
        let outputs = self.dst.channels;
        let channels = if variant.contract.has("INPUTS") { outputs } else { TILE_CHANNELS };
        dense_groups(variant, self.tiles.count(self.dst.width, self.dst.height), outputs, channels)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&LinearPush {
            src: at.view(&self.src),
            src_b: at.view_or_null(self.src_b.as_ref()),
            dst: at.view(&self.dst),
            weights: at.of(self.weights),
            film: self.film.map_or(0, |film| at.of(film)),
            residual: at.view_or_null(self.residual.as_ref()),
            tiles: at.tiles(&self.tiles),
            src_stride: self.src.stride / 4,
            src_channels: self.src.channels / 4,
            src_b_stride: self.src_b.map_or(0, |b| b.stride / 4),
            src_b_channels: self.src_b.map_or(0, |b| b.channels / 4),
            width: self.dst.width,
            dst_stride: self.dst.stride / 4,
            dst_channels: self.dst.channels / 4,
            residual_stride: self.residual.map_or(0, |r| r.stride / 4),
            bias_vectors: self.dst.channels.next_multiple_of(TILE_CHANNELS) / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.src, Access::SAME);
        self.src_b.iter_mut().for_each(|source| visit(source, Access::SAME));
        self.residual.iter_mut().for_each(|residual| visit(residual, Access::Residual(Scale::Same)));
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn others(&self) -> Traffic {
        let weights = weight_bytes(self.inputs().into(), self.dst.channels, self.arithmetic);
        let film = self.film.map(|film| (film, u64::from(self.dst.channels) * 8));
        Traffic::reading([(self.weights, weights)].into_iter().chain(film))
    }

    fn texels(&self) -> Vec<TexelRange> {
        let mut ranges = dense_texels(&self.src, self.weights, self.film, self.residual.as_ref());
        ranges.push(self.src_b.as_ref().unwrap_or(&self.src).into());
        ranges
    }
}

fn epilogue_flags(activation: Activation, film: Option<BufferId>, residual: Option<&View>) -> u32 {
    activation_flag(activation) | film.map_or(0, |_| flags::FILM) | residual.map_or(0, |_| flags::RESIDUAL)
}

/// A descriptor must be valid although its buffer is never read: the source stands in for what is missing.
pub(super) fn dense_texels(
    src: &View,
    weights: BufferId,
    film: Option<BufferId>,
    residual: Option<&View>,
) -> Vec<TexelRange> {
    vec![src.into(), weights.into(), film.unwrap_or(weights).into(), residual.unwrap_or(src).into()]
}

//! Dense 3x3 convolution.

use super::{NARROW_CHANNELS, TILE_CHANNELS, conv_tile_channels, dense_texels, epilogue_flags, weight_bytes};
use crate::kernels::accesses::matrix::{TOKENS, Work};
use crate::kernels::accesses::{Accesses, Block, Staged, epilogue_loads};
use crate::kernels::contract::{Contract, Specialisation};
use crate::kernels::contracts::{self, halves};
use crate::kernels::on_matrices::{self, DEPTH, dense_groups};
use crate::kernels::pushes::Conv3x3Push;
use crate::kernels::{
    Access, Activation, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Shuffle,
    Storage, TILE, TexelRange, Tiles, Traffic, Variant, View, by_storage, flags,
};

/// Half a tile's channels: convolutions of stride 1 to no more compute that half alone.
pub const SMALL_CHANNELS: u32 = 16;

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
            return Some((
                &contracts::CONV3X3_FIRST_MATRIX,
                Specialisation { tiles: on_matrices::tiles_for(channels), ..Specialisation::default() },
            ));
        }
        let contract = if self.stride == 2 { &contracts::CONV3X3_S2_MATRIX } else { &contracts::CONV3X3_MATRIX };
        let special = self.cut().filter(|_| on_matrices::can_load([src]))?;
        Some((contract, special))
    }

    /// How the kernel on matrices cuts its work.
    fn cut(&self) -> Option<Specialisation> {
        let tiles = on_matrices::tiles_for(self.channels);
        let tokens = tiles * TILE * (self.stride * (TILE - 1) + 3);
        let inputs = on_matrices::staged(self.src.channels, tokens, 32, 3, on_matrices::outputs_of(tiles))?;
        Some(Specialisation { tiles, inputs, ..Specialisation::default() })
    }

    pub(crate) fn chosen(&self) -> Option<(&'static Contract, Specialisation)> {
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
        let wide = self.channels > TILE_CHANNELS && alike;
        match (self.stride, cpu) {
            (2, true) => of(&contracts::CONV3X3_S2_CPU, &halves::CONV3X3_S2_CPU),
            (2, false) => of(&contracts::CONV3X3_S2, &halves::CONV3X3_S2),
            (_, true) if small => of(&contracts::CONV3X3_N16_CPU, &halves::CONV3X3_N16_CPU),
            (_, true) => of(&contracts::CONV3X3_CPU, &halves::CONV3X3_CPU),
            (_, false) if small => of(&contracts::CONV3X3_N16, &halves::CONV3X3_N16),
            (_, false) if wide => of(&contracts::CONV3X3_WIDE, &halves::CONV3X3_WIDE),
            (_, false) if alike => of(&contracts::CONV3X3, &halves::CONV3X3),
            (_, false) => &contracts::CONV3X3_TO_F16,
        }
    }

    /// What becomes of its sums.
    pub(crate) fn epilogue(&self) -> u32 {
        let shuffle = match self.shuffle {
            Shuffle::None => 0,
            Shuffle::Unshuffle => flags::UNSHUFFLE,
            Shuffle::Shuffle => flags::SHUFFLE,
        };
        shuffle | epilogue_flags(self.activation, self.film, self.residual.as_ref())
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

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        if variant.is_on_matrices() {
            return Some(self.accesses_on_matrices(variant.special));
        }
        if variant.stages().is_some() {
            return Some(self.staged().accesses(variant, self.groups(variant)));
        }
        let contract = variant.contract;
        let (block, stride) = (Block::of(contract), u64::from(self.stride));
        let (width, height) = self.result_size();
        // All taps share what they load, or none, or those of a row do.
        let [columns, rows] = [block.x, block.y].map(|outputs| (outputs - 1) * stride + 3);
        let inputs = match (contract.has("ROLLED"), contract.has("BY_TAP")) {
            (true, _) => rows * columns,
            (_, true) => 9 * block.x * block.y,
            _ => 3 * block.y * columns,
        };
        let per_four_inputs = inputs + 9 * block.weight_loads(contract);
        let [epilogue, stores] = self.epilogue_accesses();
        let loads = block.vectors + u64::from(self.src.channels / 4) * per_four_inputs + block.outputs() * epilogue;
        let invocations = block.invocations(self.tiles.count(width, height), self.channels);
        Some(Accesses::each(invocations, loads, block.outputs() * stores))
    }
}

impl Conv3x3 {
    /// Push constants; the packed weights begin with so many vectors of biases.
    pub(crate) fn push_with(&self, at: &Addresses, bias_vectors: u32) -> PushBytes {
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

    /// What a vector of outputs loads and stores beside its sums: an unshuffle scatters scalars.
    pub(crate) fn epilogue_accesses(&self) -> [u64; 2] {
        let stores = if self.shuffle == Shuffle::Unshuffle { 4 } else { 1 };
        [epilogue_loads(self.film.is_some(), self.residual.is_some()), stores]
    }

    /// What a workgroup stages of a tile and around it.
    fn staged(&self) -> Staged {
        let inputs = u64::from(self.src.channels / 4);
        let loads = u64::from(((TILE - 1) * self.stride + 3).pow(2)) * inputs;
        Staged { loads, stores: loads, norm_loads: 0, rows: 9 * 4 * inputs, epilogue: self.epilogue_accesses() }
    }

    pub(crate) fn accesses_on_matrices(&self, special: Specialisation) -> Accesses {
        let (width, height) = self.result_size();
        let [epilogue, _] = self.epilogue_accesses();
        let inputs = u64::from(self.src.channels);
        let work = if self.src.storage == Storage::F32 {
            let rows = u64::from((9 * self.src.channels).next_multiple_of(DEPTH));
            let colors = u64::from((TILE + 2) * (TILE + 2));
            Work { loads: colors, staged: colors / 2 + TOKENS * rows / 8, taps: 9 * TOKENS, rows, epilogue }
        } else {
            let source_rows = u64::from((TILE - 1) * self.stride + 3);
            let staged = 3 * source_rows * u64::from(TILE) * inputs / 8;
            Work { loads: staged, staged, taps: 0, rows: 9 * inputs, epilogue }
        };
        work.accesses(special, self.tiles.count(width, height), self.channels)
    }

    /// What it reads beside maps, so many bytes of it weights.
    pub(crate) fn others_with(&self, weights: u64) -> Traffic {
        let film = self.film.map(|film| (film, u64::from(self.channels) * 8));
        Traffic::reading([(self.weights, weights)].into_iter().chain(film))
    }
}

//! Pointwise convolution.

use super::{TILE_CHANNELS, dense_texels, epilogue_flags, weight_bytes};
use crate::kernels::accesses::matrix::{TOKENS, Work};
use crate::kernels::accesses::{Accesses, Block, Staged, epilogue_loads};
use crate::kernels::contract::{Contract, Specialisation};
use crate::kernels::contracts::{self, halves};
use crate::kernels::on_matrices::{self, DEPTH, dense_groups, holds, outputs_of};
use crate::kernels::pushes::LinearPush;
use crate::kernels::{
    Access, Activation, Addresses, Arithmetic, BufferId, Grid, Kernel, KernelTarget, PushBytes, Scale, Storage,
    TexelRange, Tiles, Traffic, Variant, View, by_storage,
};

/// Rows of weights that are staged at a time for normed tokens.
const NORMED_ROWS: u32 = 32;

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
    pub(crate) fn inputs(&self) -> u32 {
        self.src.channels + self.src_b.map_or(0, |b| b.channels)
    }

    /// Whether there is a kernel on matrices for its maps: from whole vectors of halves to a map of halves; normed ones
    /// of a power of two of channels.
    pub fn fits_matrices(&self) -> bool {
        self.on_matrices().is_some()
    }

    fn on_matrices(&self) -> Option<Specialisation> {
        let special = self.cut()?;
        let fits =
            self.dst.storage == Storage::F16 && on_matrices::can_load([&self.src].into_iter().chain(&self.src_b));
        fits.then_some(special)
    }

    /// How the kernel on matrices cuts its work.
    fn cut(&self) -> Option<Specialisation> {
        let (inputs, mut tiles) = (self.inputs(), on_matrices::tiles_for(self.dst.channels));
        let tokens = |tiles: u32| tiles * on_matrices::TOKENS;
        if !self.norm {
            let inputs = inputs.next_multiple_of(DEPTH);
            let inputs = on_matrices::staged(inputs, tokens(tiles), 128, 1, outputs_of(tiles))?;
            return Some(Specialisation { tiles, inputs, ..Specialisation::default() });
        }
        // All inputs at once; a power of two of invocations share a token.
        if !inputs.is_multiple_of(DEPTH) || !inputs.is_power_of_two() {
            return None;
        }
        let fits = |tiles: u32| holds(tokens(tiles), inputs, inputs.min(NORMED_ROWS), outputs_of(tiles));
        while tiles > 1 && !fits(tiles) {
            tiles /= 2;
        }
        fits(tiles).then(|| Specialisation { tiles, inputs, ..Specialisation::default() })
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
        match (cpu, self.norm, self.dst.channels > TILE_CHANNELS) {
            (true, false, _) => of(&contracts::LINEAR_CPU, &halves::LINEAR_CPU),
            (true, true, _) => of(&contracts::LINEAR_NORM_CPU, &halves::LINEAR_NORM_CPU),
            (false, false, false) => of(&contracts::LINEAR, &halves::LINEAR),
            (false, false, true) => of(&contracts::LINEAR_WIDE, &halves::LINEAR_WIDE),
            (false, true, false) => of(&contracts::LINEAR_NORM, &halves::LINEAR_NORM),
            (false, true, true) => of(&contracts::LINEAR_NORM_WIDE, &halves::LINEAR_NORM_WIDE),
        }
    }

    pub(crate) fn epilogue_loads(&self) -> u64 {
        epilogue_loads(self.film.is_some(), self.residual.is_some())
    }

    fn accesses_on_matrices(&self, special: Specialisation) -> Accesses {
        let rows = u64::from(self.inputs().next_multiple_of(DEPTH));
        let (loads, staged) = (TOKENS * u64::from(self.inputs()) / 8, TOKENS * rows / 8);
        let work = Work { loads, staged, taps: 0, rows, epilogue: self.epilogue_loads() };
        work.accesses(special, self.tiles.count(self.dst.width, self.dst.height), self.dst.channels)
    }

    /// What a workgroup stages of its tokens, normed ones after two passes over them.
    fn staged(&self) -> Staged {
        let (inputs, norms) = (u64::from(self.inputs() / 4), u64::from(self.norm));
        Staged {
            loads: (1 + 2 * norms) * TOKENS * inputs,
            stores: TOKENS * (inputs.next_multiple_of(4) + 18 * norms),
            norm_loads: norms * TOKENS * (4 + 2 * inputs),
            rows: 4 * inputs,
            epilogue: [self.epilogue_loads(), 1],
        }
    }

    /// What becomes of its sums.
    pub(crate) fn epilogue(&self) -> u32 {
        epilogue_flags(self.activation, self.film, self.residual.as_ref())
    }

    /// The variant for CPU drivers that holds all inputs, where there is one for so many.
    fn stationary(&self) -> Option<&'static Contract> {
        let of = |f32, f16| Some(by_storage(self.dst.storage, f32, f16));
        if self.src_b.is_some() {
            return None;
        }
        match (self.inputs(), self.norm) {
            (8, false) => of(&contracts::LINEAR_K8_CPU, &halves::LINEAR_K8_CPU),
            (16, true) => of(&contracts::LINEAR_K16_NORM_CPU, &halves::LINEAR_K16_NORM_CPU),
            (32, false) => of(&contracts::LINEAR_K32_CPU, &halves::LINEAR_K32_CPU),
            (32, true) => of(&contracts::LINEAR_K32_NORM_CPU, &halves::LINEAR_K32_NORM_CPU),
            (64, true) => of(&contracts::LINEAR_K64_NORM_CPU, &halves::LINEAR_K64_NORM_CPU),
            (128, true) => of(&contracts::LINEAR_K128_NORM_CPU, &halves::LINEAR_K128_NORM_CPU),
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

    fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        if variant.is_on_matrices() {
            return Some(self.accesses_on_matrices(variant.special));
        }
        let (contract, inputs) = (variant.contract, u64::from(self.inputs() / 4));
        if variant.stages().is_some() {
            return Some(self.staged().accesses(variant, self.groups(variant)));
        }
        let mut block = Block::of(contract);
        // Inputs are loaded once, or for every block of outputs anew, and once for the mean and once for the deviation.
        let (tokens, weights) = match contract.has("INPUTS") {
            true => {
                block.vectors = u64::from(self.dst.channels / 4);
                (1, block.vectors * inputs.div_ceil(2))
            }
            false => (1 + 2 * u64::from(self.norm), inputs * block.weight_loads(contract)),
        };
        let loads =
            block.vectors + inputs * tokens * block.x * block.y + weights + block.outputs() * self.epilogue_loads();
        let tiles = self.tiles.count(self.dst.width, self.dst.height);
        Some(Accesses::each(block.invocations(tiles, self.dst.channels), loads, block.outputs()))
    }
}

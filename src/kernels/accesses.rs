//! How often a kernel's invocations ask for memory, counted from the loops of its shader: what caches have to serve,
//! where [`super::Traffic`] is what memory has to.

mod matrix;

use super::contract::Contract;
use super::dense::{Conv3x3, Linear};
use super::expand::Expand;
use super::film::{FilmVector, SUM_INVOCATIONS, TokenSum};
use super::maps::{Depthwise3x3, LayerNorm};
use super::predicted::{ApplyKernels, Halve, KernelInputs, MixLevels, PredictKernels};
use super::separable::Separable3x3;
use super::unembed::Unembed;
use super::window_attention::WindowAttention;
use super::winograd::Winograd3x3;
use super::{Call, TILE, Variant};

/// Loads and stores of all invocations of a dispatch together, each of a vector of four floats or, in shared memory and
/// where the shader works on scalars, of one. Loads that only fetch arguments (tile lists) are left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Accesses {
    /// Loads from buffers.
    pub global_loads: u64,
    /// Stores to buffers.
    pub global_stores: u64,
    /// Loads from shared memory.
    pub shared_loads: u64,
    /// Stores to shared memory.
    pub shared_stores: u64,
}

impl Accesses {
    /// Both kinds of access to buffers.
    pub fn global(&self) -> u64 {
        self.global_loads + self.global_stores
    }

    /// Both kinds of access to shared memory.
    pub fn shared(&self) -> u64 {
        self.shared_loads + self.shared_stores
    }

    /// A share of them.
    pub(crate) fn part(self, share: f64) -> Self {
        let part = |all: u64| (all as f64 * share).round() as u64;
        let Self { global_loads, global_stores, shared_loads, shared_stores } = self;
        let [global_loads, global_stores] = [global_loads, global_stores].map(part);
        let [shared_loads, shared_stores] = [shared_loads, shared_stores].map(part);
        Self { global_loads, global_stores, shared_loads, shared_stores }
    }

    fn each(invocations: u64, global_loads: u64, global_stores: u64) -> Self {
        Self { global_loads: invocations * global_loads, global_stores: invocations * global_stores, ..Self::default() }
    }
}

impl Call {
    /// What the invocations ask of memory; `None` for the kernels over the caller's planes and their statistics, for
    /// which it depends on the frame, and for what makes lists of active tiles.
    pub fn accesses(&self, variant: &Variant) -> Option<Accesses> {
        let Variant { contract, special, .. } = *variant;
        Some(match self {
            Self::Conv3x3(k) if contract.needs_matrix() => matrix::conv3x3(k, special),
            // Gain and bias stay in registers.
            Self::NormedConv3x3(k) => matrix::conv3x3(&k.conv, special),
            Self::Linear(k) if contract.needs_matrix() => matrix::linear(k, special),
            Self::Separable3x3(k) if contract.needs_matrix() => matrix::separable3x3(k, special),
            Self::WindowAttention(k) if contract.needs_matrix() => matrix::window_attention(k),
            Self::AttentionBlock(k) => matrix::attention_block(k, self.kernel().groups(variant)),
            Self::Unembed(k) if contract.needs_matrix() => matrix::unembed(k),
            Self::KernelInputs(k) if contract.needs_matrix() => matrix::kernel_inputs(k),
            Self::PredictKernels(k) if contract.needs_matrix() => matrix::predict_kernels(k),
            Self::AuxProjection(_) => matrix::aux_projection(self.kernel().groups(variant)),
            Self::Conv3x3(k) => conv3x3(k, contract),
            Self::Winograd3x3(k) => winograd3x3(k, contract),
            Self::Linear(k) => linear(k, contract),
            Self::Depthwise3x3(k) => depthwise3x3(k, contract),
            Self::Separable3x3(k) => separable3x3(k, contract),
            Self::Unembed(k) => unembed(k, contract),
            Self::KernelInputs(k) => kernel_inputs(k, contract),
            Self::PredictKernels(k) => predict_kernels(k, contract),
            Self::Halve(k) => halve(k),
            Self::ApplyKernels(k) => apply_kernels(k, contract),
            Self::MixLevels(k) => mix_levels(k),
            Self::LayerNorm(k) => layer_norm(k, contract),
            Self::WindowAttention(k) => window_attention(k, contract),
            Self::Expand(k) => expand(k),
            Self::TokenSum(k) => token_sum(k),
            Self::FilmVector(k) => film_vector(k),
            Self::StatsClear(_)
            | Self::StatsHistogram(_)
            | Self::StatsSelect(_)
            | Self::StatsTiles(_)
            | Self::StatsKey(_)
            | Self::InputColor(_)
            | Self::InputAux(_)
            | Self::Output(_)
            | Self::InputSignal(_)
            | Self::OutputSignal(_)
            | Self::TileNoise(_)
            | Self::ConvergedMap(_)
            | Self::TileList(_)
            | Self::Fill(_) => return None,
        })
    }
}

/// Outputs of one invocation: tokens in x and y, vectors of four channels.
struct Block {
    x: u64,
    y: u64,
    vectors: u64,
}

impl Block {
    fn of(contract: &Contract) -> Self {
        let [x, y, vectors] = ["TX", "TY", "NV"].map(|name| contract.define(name));
        Self { x, y, vectors }
    }

    fn outputs(&self) -> u64 {
        self.x * self.y * self.vectors
    }

    /// Loads of the weights of four input channels: all of them, or an eighth where the lanes hand them round (a
    /// sixteenth in subgroups of sixteen, which are counted as those of eight).
    fn weight_loads(&self, contract: &Contract) -> u64 {
        let vectors = 4 * self.vectors;
        if contract.has("LANES_SHARE") { vectors.div_ceil(8) } else { vectors }
    }

    /// Invocations for `tiles` of 8x8 tokens and `channels`.
    fn invocations(&self, tiles: u32, channels: u32) -> u64 {
        u64::from(tiles) * u64::from(TILE * TILE) / (self.x * self.y)
            * u64::from(channels.div_ceil(4)).div_ceil(self.vectors)
    }
}

/// What the epilogue loads for each vector of outputs.
fn epilogue_loads(film: bool, residual: bool) -> u64 {
    2 * u64::from(film) + u64::from(residual)
}

fn conv3x3(call: &Conv3x3, contract: &Contract) -> Accesses {
    let (block, stride) = (Block::of(contract), u64::from(call.stride));
    let (width, height) = call.result_size();
    // All taps share what they load, or none, or those of a row do.
    let [columns, rows] = [block.x, block.y].map(|outputs| (outputs - 1) * stride + 3);
    let inputs = match (contract.has("ROLLED"), contract.has("BY_TAP")) {
        (true, _) => rows * columns,
        (_, true) => 9 * block.x * block.y,
        _ => 3 * block.y * columns,
    };
    let per_four_inputs = inputs + 9 * block.weight_loads(contract);
    let loads = block.vectors
        + u64::from(call.src.channels / 4) * per_four_inputs
        + block.outputs() * epilogue_loads(call.film.is_some(), call.residual.is_some());
    // An unshuffle scatters scalars.
    let stores = block.outputs() * if call.shuffle == super::Shuffle::Unshuffle { 4 } else { 1 };
    Accesses::each(block.invocations(call.tiles.count(width, height), call.channels), loads, stores)
}

fn winograd3x3(call: &Winograd3x3, contract: &Contract) -> Accesses {
    let (tiles, vectors) = (contract.define("TX"), contract.define("NV"));
    let (outputs, inputs) = (u64::from(call.tile.outputs()), u64::from(call.tile.inputs()));
    let block = Block { x: outputs * tiles, y: outputs, vectors };
    let conv = &call.conv;
    let per_four_inputs = inputs * (outputs * tiles + 2) + vectors * 4 * inputs * inputs;
    let loads = vectors
        + u64::from(conv.src.channels / 4) * per_four_inputs
        + block.outputs() * epilogue_loads(conv.film.is_some(), conv.residual.is_some());
    let stores = block.outputs() * if conv.shuffle == super::Shuffle::Unshuffle { 4 } else { 1 };
    let (width, height) = conv.result_size();
    Accesses::each(block.invocations(conv.tiles.count(width, height), conv.channels), loads, stores)
}

fn separable3x3(call: &Separable3x3, contract: &Contract) -> Accesses {
    let (block, pointwise) = (Block::of(contract), &call.pointwise);
    let per_four_inputs = 10 + (block.x + 2) * (block.y + 2) + block.weight_loads(contract);
    let loads = block.vectors
        + u64::from(call.depthwise.src.channels / 4) * per_four_inputs
        + block.outputs() * epilogue_loads(pointwise.film.is_some(), pointwise.residual.is_some());
    let tiles = pointwise.tiles.count(pointwise.dst.width, pointwise.dst.height);
    Accesses::each(block.invocations(tiles, pointwise.dst.channels), loads, block.outputs())
}

fn linear(call: &Linear, contract: &Contract) -> Accesses {
    let inputs = u64::from(call.inputs() / 4);
    let mut block = Block::of(contract);
    // Inputs are loaded once, or for every block of outputs anew, and once for the mean and once for the deviation.
    let (tokens, weights) = match contract.has("INPUTS") {
        true => {
            block.vectors = u64::from(call.dst.channels / 4);
            (1, block.vectors * inputs.div_ceil(2))
        }
        false => (1 + 2 * u64::from(call.norm), inputs * block.weight_loads(contract)),
    };
    let loads = block.vectors
        + inputs * tokens * block.x * block.y
        + weights
        + block.outputs() * epilogue_loads(call.film.is_some(), call.residual.is_some());
    let tiles = call.tiles.count(call.dst.width, call.dst.height);
    Accesses::each(block.invocations(tiles, call.dst.channels), loads, block.outputs())
}

fn depthwise3x3(call: &Depthwise3x3, contract: &Contract) -> Accesses {
    let [x, y] = ["TX", "TY"].map(|name| contract.define(name));
    let tiles = call.tiles.count(call.dst.width, call.dst.height);
    let invocations = u64::from(tiles) * u64::from(TILE * TILE) / (x * y) * u64::from(call.dst.channels / 4);
    Accesses::each(invocations, 10 + (x + 2) * (y + 2), x * y)
}

/// Away from the border, where the tokens of a tile take several sets of weights.
fn unembed(call: &Unembed, contract: &Contract) -> Accesses {
    let tokens = contract.define("TX");
    let tiles = call.tiles.count(call.src.width, call.src.height);
    let weights = if contract.has("LANES_SHARE") { 4 } else { 32 };
    let loads = 1 + 4 * u64::from(call.src.channels / 4) * (tokens + 4 + weights);
    Accesses::each(2 * u64::from(tiles) * u64::from(TILE * TILE) / tokens, loads, 2 * tokens)
}

/// Loads of so many vectors of weights that all invocations need: an eighth each where the lanes hand them round.
fn row_loads(contract: &Contract, vectors: u64) -> u64 {
    if contract.has("LANES_SHARE") { vectors.div_ceil(8) } else { vectors }
}

fn kernel_inputs(call: &KernelInputs, contract: &Contract) -> Accesses {
    let tokens = contract.define("TX");
    let invocations = u64::from(call.tiles.count(call.tokens.width, call.tokens.height)) * 256 / tokens;
    let loads = 1 + tokens * (8 + 8 + 3) + 8 * (2 + row_loads(contract, 40));
    Accesses::each(invocations, loads, tokens * (8 + 1))
}

fn predict_kernels(call: &PredictKernels, contract: &Contract) -> Accesses {
    let pixels = contract.define("TX");
    let tiles = u64::from(call.tiles.count(call.dst.width, call.dst.height));
    let invocations = tiles * u64::from(TILE * TILE) / pixels;
    let loads = pixels * 8 + 12 * (1 + row_loads(contract, 32));
    let mut accesses = Accesses::each(invocations, loads, 3 * pixels);
    // Taps beyond the last one are read too.
    let taps = invocations * pixels * (28 + 12);
    match contract.has("TEXELS") {
        true => accesses.global_loads += taps,
        false => {
            accesses.global_loads += tiles * 2 * 144;
            (accesses.shared_loads, accesses.shared_stores) = (taps, tiles * 2 * 144);
        }
    }
    accesses
}

fn halve(call: &Halve) -> Accesses {
    let tokens = u64::from(call.tiles.count(call.dst.width, call.dst.height)) * u64::from(TILE * TILE);
    let vectors = u64::from(call.dst.channels / 4);
    Accesses::each(tokens, 4 * vectors, vectors)
}

fn apply_kernels(call: &ApplyKernels, contract: &Contract) -> Accesses {
    let tiles = u64::from(call.tiles.count(call.dst.width, call.dst.height)) * u64::from(call.dst.channels / 4);
    let mut accesses = Accesses::each(tiles * 64, 7, 1);
    match contract.has("TEXELS") {
        true => accesses.global_loads += tiles * 64 * 28,
        false => {
            accesses.global_loads += tiles * 144;
            (accesses.shared_loads, accesses.shared_stores) = (tiles * 64 * 28, tiles * 144);
        }
    }
    accesses
}

fn mix_levels(call: &MixLevels) -> Accesses {
    let pixels = u64::from(call.tiles.count(call.dst.width, call.dst.height)) * u64::from(TILE * TILE);
    let (images, levels) = (u64::from(call.dst.channels / 4), call.levels.len() as u64);
    let direct = 2 * u64::from(call.direct.is_some());
    Accesses::each(pixels, 2 + images * (1 + 4 * levels) + direct, images)
}

fn layer_norm(call: &LayerNorm, contract: &Contract) -> Accesses {
    let tokens = u64::from(call.tiles.count(call.dst.width, call.dst.height)) * u64::from(TILE * TILE);
    let vectors = u64::from(call.src.channels / 4);
    // Eight invocations share a token, but for CPU drivers, and add their parts of two sums.
    let shared = if contract.has("TEXELS") { 0 } else { 2 * 8 * tokens };
    Accesses { shared_loads: 8 * shared, shared_stores: shared, ..Accesses::each(tokens, 5 * vectors, vectors) }
}

fn window_attention(call: &WindowAttention, contract: &Contract) -> Accesses {
    let windows = u64::from(call.tiles.count(call.dst.width, call.dst.height)) * u64::from(call.heads);
    let (keys, values) = (u64::from(call.key_width / 4), u64::from(call.value_width / 4));
    if contract.has("QUERIES") {
        // Of every query its own and 64 biases; a lane loads one key in eight.
        let queries = contract.define("QUERIES");
        let loads = queries * (2 * keys + 64) + 8 * (2 * keys + values);
        return Accesses::each(windows * 64 / queries, loads, queries * values);
    }
    // 256 invocations make 4x4 scores each, 64 go over a row three times, 16 tasks for each vector of values.
    let (scores, rows, tasks) = (256, 64, 16 * values);
    Accesses {
        global_loads: windows * (scores * (16 * keys + 16) + tasks * 64),
        global_stores: windows * tasks * 4,
        shared_loads: windows * (rows * 128 + tasks * (64 * 4 + 4)),
        shared_stores: windows * (scores * 16 + rows * 65),
    }
}

fn expand(call: &Expand) -> Accesses {
    let tokens = u64::from(call.tiles.count(call.dst.width, call.dst.height)) * u64::from(TILE * TILE);
    let vectors = u64::from(call.dst.channels / 4);
    Accesses::each(tokens, vectors, vectors)
}

fn token_sum(call: &TokenSum) -> Accesses {
    let vectors = u64::from(call.src.channels / 4);
    // Of its first way an invocation keeps its own.
    let (ways, sums) = (u64::from(SUM_INVOCATIONS) / vectors, call.sums());
    // Mean, variance and sum each load a token; norms lie in shared memory.
    Accesses {
        global_loads: 3 * call.real_tokens() * vectors,
        global_stores: sums * vectors,
        shared_loads: 4 * sums * vectors * (ways - 1) + call.real_tokens() * vectors,
        shared_stores: 4 * sums * u64::from(SUM_INVOCATIONS) + call.real_tokens(),
    }
}

fn film_vector(call: &FilmVector) -> Accesses {
    let (channels, outputs) = (u64::from(call.channels), u64::from(call.outputs));
    let ways = (256 / channels).max(1);
    Accesses {
        global_loads: call.sums * channels + outputs * (channels + 1),
        global_stores: outputs,
        shared_loads: channels * ways + outputs * channels,
        shared_stores: channels * ways + channels,
    }
}

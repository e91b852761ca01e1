//! The kernels: for each its contract with the shader, its arguments as the plan states them, its dispatch size, push
//! constants, and what it reads, writes and computes.
//!
//! A kernel is four things of one name: `glsl/x.comp`, its contract in [`contracts`], its arguments here, and its f64
//! twin in [`crate::reference`]. The list of them is in this file, and nowhere else.

/// The kernels: hands a macro the list of them, each with its name in [`Call`] and the type of its arguments.
macro_rules! for_kernels {
    ($with:ident) => {
        $with! {
            /// Dense 3x3 convolution.
            Conv3x3(dense::Conv3x3),
            /// The same by Winograd's minimal filtering.
            Winograd3x3(winograd::Winograd3x3),
            /// Layer normalisation and dense 3x3 convolution in one.
            NormedConv3x3(normed_conv::NormedConv3x3),
            /// Pointwise convolution.
            Linear(dense::Linear),
            /// Depthwise 3x3 convolution.
            Depthwise3x3(maps::Depthwise3x3),
            /// Depthwise and pointwise convolution in one.
            Separable3x3(separable::Separable3x3),
            /// An FFN in one.
            Ffn(ffn::Ffn),
            /// Pixels embedded in tokens, with what comes before or beside.
            Embedding(embedding::Embedding),
            /// The features' projection in one.
            AuxProjection(aux_projection::AuxProjection),
            /// Tokens of 2x2 to pixels.
            Unembed(unembed::Unembed),
            /// What kernels are predicted from.
            KernelInputs(predicted::KernelInputs),
            /// Predicted kernels at full size.
            PredictKernels(predicted::PredictKernels),
            /// Means of 2x2 tokens.
            Halve(predicted::Halve),
            /// Predicted kernels over a level.
            ApplyKernels(predicted::ApplyKernels),
            /// The levels mixed.
            MixLevels(predicted::MixLevels),
            /// Layer normalisation.
            LayerNorm(maps::LayerNorm),
            /// Joint window attention.
            WindowAttention(window_attention::WindowAttention),
            /// A block's attention with its Linears in one.
            AttentionBlock(attention_block::AttentionBlock),
            /// A small map made large.
            Expand(expand::Expand),
            /// Partial sums over tokens.
            TokenSum(film::TokenSum),
            /// FiLM vectors from partial sums.
            FilmVector(film::FilmVector),
            /// Zeroed histograms.
            StatsClear(stats::Clear),
            /// Histograms of the frame.
            StatsHistogram(stats::Histogram),
            /// Median and depth scale.
            StatsSelect(stats::Select),
            /// Light and noise of tiles.
            StatsTiles(stats::TileStats),
            /// Key, exposure, noise and largest samples.
            StatsKey(stats::Key),
            /// Colour input.
            InputColor(frame_io::InputColor),
            /// Features' input.
            InputAux(frame_io::InputAux),
            /// What squares of the result get back of the light.
            EnergyGains(energy::EnergyGains),
            /// Output.
            Output(frame_io::Output),
            /// A signal beside the colour to what predicted kernels read.
            InputSignal(signals::InputSignal),
            /// A filtered signal to the caller's plane.
            OutputSignal(signals::OutputSignal),
            /// Noise of the map's squares.
            TileNoise(converged::TileNoise),
            /// Map of what is to be denoised.
            ConvergedMap(converged::ConvergedMap),
            /// List of active tiles.
            TileList(converged::TileList),
            /// Zeros beside active tiles.
            Fill(converged::Fill),
        }
    };
}
pub(crate) use for_kernels;

pub mod access;
mod accesses;
pub mod attention_block;
pub mod aux_projection;
mod call;
pub mod contract;
pub mod contracts;
pub mod converged;
pub mod dense;
pub mod ensemble;
pub mod embedding;
pub mod energy;
pub mod expand;
pub mod ffn;
pub mod film;
pub mod frame_io;
pub mod maps;
pub mod normed_conv;
pub mod on_matrices;
pub mod planes;
pub mod predicted;
mod push;
pub(crate) mod pushes;
pub mod separable;
pub mod signals;
pub mod spirv;
pub mod stats;
mod tiles;
pub mod unembed;
pub mod variant;
mod view;
pub mod window_attention;
pub mod winograd;

use contract::Specialisation;
use variant::by_storage;

pub use crate::net::op::{Activation, Shuffle};
pub use access::{Access, Footprint, Grid, Scale, Traffic};
pub use accesses::Accesses;
pub use call::Call;
pub use push::{Addresses, FrameArgs, PushBytes, TexelRange};
pub use tiles::{HALF_TILE, TILE, TileRect, Tiles, TokenRect};
pub use variant::{KernelTarget, Variant};
pub use view::{Arithmetic, BufferId, Storage, View};

/// Workgroups in x of one dispatch, the least that Vulkan guarantees; more go to z.
pub const MAX_GROUPS_X: u32 = 65535;

/// What a kernel says of itself. The plan, the recorder, the profiler and the cost model know nothing else of it.
pub trait Kernel {
    /// Which variant runs on a target.
    fn choose(&self, target: KernelTarget) -> Variant;
    /// Workgroups of that variant.
    fn groups(&self, variant: &Variant) -> [u32; 3];
    /// Push constants.
    fn push(&self, at: &Addresses) -> PushBytes;
    /// The tokens that it works on; `None` for kernels that do not work tile by tile.
    fn grid(&self) -> Option<Grid> {
        None
    }
    /// The tiles of its grid.
    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        None
    }
    /// Visits every map that it touches, reads before writes.
    fn maps(&mut self, _visit: &mut dyn FnMut(&mut View, Access)) {}
    /// What it touches beside maps: weights, vectors, lists, statistics.
    fn others(&self) -> Traffic {
        Traffic::default()
    }
    /// What the texel buffers of its contract hold, in their order, where the variant has any.
    fn texels(&self) -> Vec<TexelRange> {
        Vec::new()
    }
    /// How often the variant's loops ask for memory; `None` where it depends on the frame, and for what makes lists of
    /// active tiles.
    fn accesses(&self, _variant: &Variant) -> Option<Accesses> {
        None
    }
    /// Whether its result depends on the frame's colour, or on what may change with every frame: exposure and blend.
    fn reads_color(&self) -> bool {
        false
    }
}

/// Flag bits, as in `glsl/shared/*.glsl`.
mod flags {
    pub const TILE_LIST: u32 = 1;
    pub const RELU: u32 = 2;
    pub const GATED: u32 = 2;
    pub const NO_ALBEDO: u32 = 4;
    pub const GLOSS: u32 = 8;
    pub const LEAKY_RELU: u32 = 4;
    pub const RESIDUAL: u32 = 8;
    pub const FILM: u32 = 16;
    pub const SHUFFLE: u32 = 32;
    pub const UNSHUFFLE: u32 = 64;
    pub const CONVERGED: u32 = 16;
    pub const MEND_FIREFLIES: u32 = 2;
    pub const KEEP_FIREFLIES: u32 = 4;
    pub const GIVEN: u32 = 1;
    pub const TOLD: u32 = 2;
    pub const RADIANCE: u32 = 32;
    pub const TURNED: u32 = 64;
    pub const UPRIGHT: u32 = 128;
    pub const SIGNAL_ONE: u32 = 1 << 12;
    pub const LIGHT: u32 = 1 << 13;
    pub const ALPHA: u32 = 1 << 14;
}

impl std::fmt::Display for Specialisation {
    /// Nothing, or such as `+residual+relu`; on matrices with the shape, such as `/t2/i64`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let named = [
            (flags::FILM, "film"),
            (flags::RESIDUAL, "residual"),
            (flags::RELU, "relu"),
            (flags::LEAKY_RELU, "leaky_relu"),
            (flags::SHUFFLE, "shuffle"),
            (flags::UNSHUFFLE, "unshuffle"),
        ];
        let mut write_all = |prefix, bits| {
            let mut set = named.iter().filter(|(flag, _)| bits & flag != 0);
            set.try_for_each(|(_, name)| write!(f, "+{prefix}{name}"))
        };
        write_all("inner_", self.inner)?;
        write_all("", self.epilogue)?;
        let shape = [('t', self.tiles), ('i', self.inputs), ('k', self.keys), ('v', self.values)];
        shape.iter().filter(|(_, size)| *size > 0).try_for_each(|(name, size)| write!(f, "/{name}{size}"))?;
        if self.few { f.write_str("/few") } else { Ok(()) }
    }
}

fn activation_flag(activation: Activation) -> u32 {
    match activation {
        Activation::None => 0,
        Activation::Relu => flags::RELU,
        Activation::LeakyRelu => flags::LEAKY_RELU,
    }
}

/// Workgroups for `x` groups of work, split over x and z, times `y`.
fn groups(x: u32, y: u32) -> [u32; 3] {
    let z = x.div_ceil(MAX_GROUPS_X).max(1);
    [x.div_ceil(z), y, z]
}

//! The kernels: for each its contract with the shader, its arguments as the plan states them, its dispatch size, push
//! constants, and what it reads, writes and computes.
//!
//! A kernel is four things of one name: `glsl/x.comp`, its contract in [`contracts`], its arguments here, and its f64
//! twin in [`crate::reference`].

pub mod access;
mod accesses;
pub mod attention_block;
pub mod aux_projection;
mod call;
pub mod contract;
pub mod contracts;
pub mod dense;
pub mod expand;
pub mod film;
pub mod frame_io;
pub mod maps;
pub mod normed_conv;
pub mod on_matrices;
pub mod planes;
pub mod predicted;
pub(crate) mod pushes;
pub mod converged;
pub mod separable;
pub mod signals;
pub mod spirv;
pub mod stats;
mod tiles;
pub mod unembed;
pub mod variant;
pub mod window_attention;
pub mod winograd;

use contract::Specialisation;
use variant::by_storage;

pub use crate::net::op::{Activation, Shuffle};
pub use access::{Access, Footprint, Grid, Scale, Traffic};
pub use accesses::Accesses;
pub use call::Call;
pub use tiles::{HALF_TILE, TILE, TileRect, Tiles, TokenRect};
pub use variant::{KernelTarget, Variant};

/// Workgroups in x of one dispatch, the least that Vulkan guarantees; more go to z.
pub const MAX_GROUPS_X: u32 = 65535;

/// A buffer of a plan: its position in [`crate::plan::Plan::buffers`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct BufferId(pub usize);

/// How the elements of a map lie in memory. Arithmetic is in 32-bit floats throughout.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Storage {
    /// 32-bit floats.
    #[default]
    F32,
    /// 16-bit floats.
    F16,
}

impl Storage {
    /// Bytes of an element.
    pub const fn bytes(self) -> u64 {
        match self {
            Self::F32 => 4,
            Self::F16 => 2,
        }
    }
}

/// What dense kernels compute with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Arithmetic {
    /// 32-bit floats on ordinary cores.
    #[default]
    Floats,
    /// Products of halves on cooperative matrices, summed in 32-bit floats.
    Matrices,
}

/// Channels `first..first + channels` of `height` rows of a map, from row `top` on; rows of `width` tokens, `stride`
/// channels per token. `first`, `channels` and `stride` are multiples of four, `top` one of [`TILE`]; channels beyond
/// the network's own are zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct View {
    /// Where the map lies.
    pub buffer: BufferId,
    /// First channel.
    pub first: u32,
    /// Channels.
    pub channels: u32,
    /// Channels of a whole token in memory.
    pub stride: u32,
    /// Tokens in x, a multiple of [`TILE`].
    pub width: u32,
    /// Tokens in y, a multiple of [`TILE`].
    pub height: u32,
    /// The map's row that is the view's first.
    pub top: u32,
    /// How the elements are stored.
    pub storage: Storage,
}

impl View {
    /// Tokens.
    pub fn tokens(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }

    /// Whether every token's channels are whole vectors of eight halves that begin at such.
    pub(crate) fn is_vectors_of_halves(&self) -> bool {
        let counts = [self.first, self.channels, self.stride];
        self.storage == Storage::F16 && counts.iter().all(|count| count.is_multiple_of(8))
    }

    /// Elements that the view covers.
    pub fn elements(&self) -> u64 {
        self.tokens() * u64::from(self.channels)
    }

    /// Bytes that the view covers.
    pub fn bytes(&self) -> u64 {
        self.elements() * self.storage.bytes()
    }

    /// Bytes from the buffer's start to the view's first element.
    pub fn offset(&self) -> u64 {
        let above = u64::from(self.top) * u64::from(self.width) * u64::from(self.stride);
        (above + u64::from(self.first)) * self.storage.bytes()
    }
}

/// The frame of one recording: where its planes are told, and what may change from frame to frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameArgs {
    /// Device address of the table of planes ([`planes::Planes`]).
    pub planes: u64,
    /// Relative noise below which nothing is denoised, where the plan leaves that out.
    pub converged_threshold: f32,
    /// The signal beside the colour that is being recorded.
    pub signal: Option<signals::SignalArgs>,
    /// Factor on the colour; `None`: the frame's own.
    pub exposure: Option<f32>,
    /// Where a factor lies that comes before both, if it is a normal number above 0.
    pub exposure_at: Option<u64>,
    /// Where the frame's statistics are to be told ([`crate::FrameStatistics`]).
    pub told_at: Option<u64>,
    /// What is done with fireflies.
    pub fireflies: frame_io::Fireflies,
    /// Share of the noisy colour in the output, in [0, 1].
    pub blend: f32,
}

/// What a recording adds to the plan: where everything is.
pub struct Addresses<'a> {
    /// Device address of a plan's buffer.
    pub buffer: &'a dyn Fn(BufferId) -> u64,
    /// The frame.
    pub frame: FrameArgs,
}

impl Addresses<'_> {
    pub(crate) fn of(&self, buffer: BufferId) -> u64 {
        (self.buffer)(buffer)
    }

    fn view(&self, view: &View) -> u64 {
        self.of(view.buffer) + view.offset()
    }

    fn view_or_null(&self, view: Option<&View>) -> u64 {
        view.map_or(0, |view| self.view(view))
    }

    /// Where the list lies; without one some memory of the plan, as a driver may load a list's length before it asks
    /// whether there is a list (lavapipe of Mesa 26.1 does).
    fn tiles(&self, tiles: &Tiles) -> u64 {
        match tiles {
            Tiles::All | Tiles::Rect(_) => self.of(BufferId(0)),
            Tiles::List { buffer, .. } => self.of(*buffer),
        }
    }
}

/// What a kernel reads of a plan's buffer through a texel buffer: from `offset` to the buffer's end, four elements a
/// texel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TexelRange {
    /// The buffer.
    pub buffer: BufferId,
    /// Bytes from the buffer's start, a multiple of a texel.
    pub offset: u64,
    /// Type of the elements.
    pub storage: Storage,
}

impl From<&View> for TexelRange {
    fn from(view: &View) -> Self {
        Self { buffer: view.buffer, offset: view.offset(), storage: view.storage }
    }
}

impl From<BufferId> for TexelRange {
    fn from(buffer: BufferId) -> Self {
        Self { buffer, offset: 0, storage: Storage::F32 }
    }
}

/// The push constants of one dispatch.
#[derive(Clone, Copy, Debug)]
pub struct PushBytes {
    bytes: [u8; 128],
    len: usize,
}

impl PushBytes {
    fn new<T: bytemuck::Pod>(push: &T) -> Self {
        const { assert!(size_of::<T>() <= 128) };
        let mut bytes = [0; 128];
        let source = bytemuck::bytes_of(push);
        bytes[..source.len()].copy_from_slice(source);
        Self { bytes, len: source.len() }
    }

    /// The bytes as `vkCmdPushConstants` wants them.
    pub fn as_slice(&self) -> &[u8] {
        &self.bytes[..self.len]
    }
}

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

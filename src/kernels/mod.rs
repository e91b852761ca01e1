//! The kernels: for each its contract with the shader, its arguments as the plan states them, its dispatch size, push
//! constants, and what it reads, writes and computes.
//!
//! A kernel is four things of one name: `glsl/x.comp`, its contract in [`contracts`], its arguments here, and its f64
//! twin in [`crate::reference`].

mod accesses;
mod call;
pub mod contract;
pub mod contracts;
pub mod dense;
pub mod expand;
pub mod film;
pub mod frame_io;
pub mod maps;
pub mod predicted;
pub mod pushes;
pub mod quiet;
pub mod separable;
pub mod spirv;
pub mod stats;
mod tiles;
pub mod unembed;
pub mod window_attention;
pub mod winograd;

use contract::{Contract, Epilogue};

pub use crate::net::graph::{Activation, Shuffle};
pub use accesses::Accesses;
pub use call::Call;
pub use tiles::{HALF_TILE, TILE, TileRect, Tiles, TokenRect};

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

/// Channels `first..first + channels` of `height` rows of a map, from row `top` on; rows of `width` tokens, `stride` channels
/// per token. `first`, `channels` and `stride` are multiples of four, `top` one of [`TILE`]; channels beyond the network's
/// own are zero.
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

/// A plane of the frame, as the caller's buffer has it. Strides and offset count samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PlaneArgs {
    /// Device address, a multiple of 4 bytes.
    pub address: u64,
    /// First sample.
    pub offset: u32,
    /// From pixel to pixel.
    pub pixel: u32,
    /// From row to row.
    pub row: u32,
    /// From channel to channel.
    pub channel: u32,
    /// Whether samples are halves.
    pub half: bool,
    /// Whether there is such a plane.
    pub present: bool,
}

/// The frame of one recording: its planes, and what may change from frame to frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameArgs {
    /// The colour plane.
    pub color: PlaneArgs,
    /// The albedo plane.
    pub albedo: PlaneArgs,
    /// The normal plane.
    pub normal: PlaneArgs,
    /// The depth plane.
    pub depth: PlaneArgs,
    /// What is known of the colour's noise.
    pub noise: PlaneArgs,
    /// What that is.
    pub noise_kind: quiet::NoiseKind,
    /// Relative noise below which nothing is denoised, where the plan leaves that out.
    pub quiet_threshold: f32,
    /// The output plane.
    pub output: PlaneArgs,
    /// Factor on the colour; `None`: the frame's own.
    pub exposure: Option<f32>,
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

    /// Where the list lies; without one some memory of the plan, as a driver may load a list's length before it asks whether
    /// there is a list (lavapipe of Mesa 26.1 does).
    fn tiles(&self, tiles: &Tiles) -> u64 {
        match tiles {
            Tiles::All | Tiles::Rect(_) => self.of(BufferId(0)),
            Tiles::List { buffer, .. } => self.of(*buffer),
        }
    }
}

/// What a kernel reads and writes: (buffer, bytes).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Buffers read, each with the bytes that are needed of it once.
    pub reads: Vec<(BufferId, u64)>,
    /// Buffers written.
    pub writes: Vec<(BufferId, u64)>,
}

impl Traffic {
    /// Whether a buffer is read or written.
    pub fn touches(&self, buffer: BufferId) -> bool {
        self.reads.iter().chain(&self.writes).any(|(id, _)| *id == buffer)
    }
}

/// What a kernel reads of a plan's buffer through a texel buffer: from `offset` to the buffer's end, four elements a texel.
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

/// How the device prefers its kernels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variants {
    /// Kernels shaped for CPU drivers, on which loads cost more than arithmetic.
    pub cpu: bool,
    /// Dense kernels on cooperative matrices, before those for CPU drivers.
    pub matrix: bool,
    /// The frame's planes are images instead of buffers.
    pub images: bool,
    /// The output's samples are halves.
    pub output_half: bool,
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

impl Variants {
    /// The same for a kernel that reads these texels: those of halves begin, as all, at multiples of 16 bytes, or are read
    /// by address.
    fn for_texels(self, texels: &[TexelRange]) -> Self {
        Self { cpu: self.cpu && texels.iter().all(|range| range.offset.is_multiple_of(TEXEL_ALIGNMENT)), ..self }
    }
}

/// Bytes between the places where a texel buffer may begin.
const TEXEL_ALIGNMENT: u64 = 16;

/// One of two variants, by how the maps are stored.
fn by_storage(storage: Storage, f32: &'static Contract, f16: &'static Contract) -> &'static Contract {
    match storage {
        Storage::F32 => f32,
        Storage::F16 => f16,
    }
}

/// What every kernel tells the recorder, the planner and the cost model.
pub trait Kernel {
    /// The shader variant to run.
    fn contract(&self, variants: Variants) -> &'static Contract;
    /// What its pipeline is specialised for.
    fn epilogue(&self) -> Epilogue {
        Epilogue::default()
    }
    /// Workgroups to dispatch.
    fn groups(&self, variants: Variants) -> [u32; 3];
    /// Tiles of the map that a workgroup works on.
    fn tiles_a_group(&self, _: Variants) -> u32 {
        1
    }
    /// Push constants.
    fn push(&self, at: &Addresses) -> PushBytes;
    /// What the texel buffers of its contract hold, in their order, where the variant has any.
    fn texels(&self) -> Vec<TexelRange> {
        Vec::new()
    }
    /// Whether its result depends on the frame's colour, or on what may change with every frame: exposure and blend.
    fn reads_color(&self) -> bool {
        false
    }
    /// Memory that it touches.
    fn traffic(&self) -> Traffic;
}

/// Flag bits, as in `glsl/shared/*.glsl`.
mod flags {
    pub const TILE_LIST: u32 = 1;
    pub const RELU: u32 = 2;
    pub const GATED: u32 = 2;
    pub const LEAKY_RELU: u32 = 4;
    pub const RESIDUAL: u32 = 8;
    pub const FILM: u32 = 16;
    pub const SHUFFLE: u32 = 32;
    pub const UNSHUFFLE: u32 = 64;
    pub const QUIET: u32 = 16;
    pub const RADIANCE: u32 = 32;
    pub const COLOR_HALF: u32 = 1 << 8;
    pub const COLOR: u32 = 1 << 9;
    pub const ALBEDO_HALF: u32 = 1 << 10;
    pub const ALBEDO: u32 = 1 << 11;
    pub const NORMAL_HALF: u32 = 1 << 12;
    pub const NORMAL: u32 = 1 << 13;
    pub const DEPTH_HALF: u32 = 1 << 14;
    pub const DEPTH: u32 = 1 << 15;
    pub const NOISE_HALF: u32 = 1 << 16;
    pub const VARIANCE: u32 = 1 << 17;
    pub const SAMPLES: u32 = 1 << 18;
}

impl std::fmt::Display for Epilogue {
    /// Nothing, or such as `+residual+relu`.
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
        write_all("", self.flags)
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

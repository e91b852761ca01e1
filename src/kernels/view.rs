//! The maps of a plan, and how they are stored and computed with.

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

//! What a recording adds to a kernel: addresses, push constants, texel buffers.

use super::{BufferId, Storage, Tiles, View, frame_io, signals};

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

    pub(super) fn view(&self, view: &View) -> u64 {
        self.of(view.buffer) + view.offset()
    }

    pub(super) fn view_or_null(&self, view: Option<&View>) -> u64 {
        view.map_or(0, |view| self.view(view))
    }

    /// Where the list lies; without one some memory of the plan, as a driver may load a list's length before it asks
    /// whether there is a list (lavapipe of Mesa 26.1 does).
    pub(super) fn tiles(&self, tiles: &Tiles) -> u64 {
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
    pub(super) fn new<T: bytemuck::Pod>(push: &T) -> Self {
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

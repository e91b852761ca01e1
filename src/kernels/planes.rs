//! The frame's planes as one table: a row for each, which kernels read by name (`glsl/shared/planes.glsl`). It is
//! written when planes are bound, so that push constants carry one address whatever a frame has.

use crate::frame::{Extent, NoiseKind};
pub use crate::role::Role;
use std::ops::{Index, IndexMut};

/// What a plane's samples are, as shaders read it; by default: that there is no plane.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Format(u32);

/// Bits of a format: a number for what a sample is; how many lie in a word of 32 bits, as a power of two; the bits of
/// integers; and how samples are told, by `FORMAT_` in `glsl/shared/planes.glsl`.
const SHARE: u32 = 8;
const WIDTH: u32 = 10;
const PACKED: u32 = 1 << 16;
const VARIANCE: u32 = 1 << 17;
const COUNTS: u32 = 1 << 18;
const HALVED: u32 = 1 << 19;
const OCTAHEDRAL: u32 = 1 << 20;
const ORTHOGRAPHIC: u32 = 1 << 21;
const PERSPECTIVE: u32 = 1 << 22;
const REVERSED: u32 = 1 << 23;

impl Format {
    /// 32-bit floats.
    pub const F32: Self = Self(1);
    /// 16-bit floats.
    pub const F16: Self = Self(2 | 1 << SHARE);
    /// 8 bits from 0 to 1.
    pub const UNORM8: Self = Self(3 | 2 << SHARE | 8 << WIDTH);
    /// 16 bits from 0 to 1.
    pub const UNORM16: Self = Self(3 | 1 << SHARE | 16 << WIDTH);
    /// 16 bits from -1 to 1.
    pub const SNORM16: Self = Self(4 | 1 << SHARE | 16 << WIDTH);
    /// Three times 10 bits from 0 to 1.
    pub const RGB10A2: Self = Self(3 | 10 << WIDTH | PACKED);

    /// The same of what is known of noise.
    pub const fn of_noise(self, kind: NoiseKind) -> Self {
        match kind {
            NoiseKind::Variance => Self(self.0 | VARIANCE),
            NoiseKind::Samples => Self(self.0 | COUNTS),
        }
    }

    /// The same of normals: whether [-1, 1] is stored as [0, 1], and whether they are two numbers.
    pub const fn of_normals(self, halved: bool, octahedral: bool) -> Self {
        Self(self.0 | if halved { HALVED } else { 0 } | if octahedral { OCTAHEDRAL } else { 0 })
    }

    /// The same of a depth buffer: the distance, or of a perspective one over it, is linear in its numbers
    /// ([`PlaneArgs::scale`]); whether 0 is far.
    pub const fn of_projection(self, perspective: bool, reversed: bool) -> Self {
        let kind = if perspective { PERSPECTIVE } else { ORTHOGRAPHIC };
        Self(self.0 | kind | if reversed { REVERSED } else { 0 })
    }

    /// Whether samples are in [0, 1].
    pub const fn is_unsigned(self) -> bool {
        self.0 & 0xff == Self::UNORM8.0 & 0xff
    }

    /// Whether there is a plane.
    pub const fn is_present(self) -> bool {
        self.0 != 0
    }

    /// Whether samples are 16-bit floats.
    pub const fn is_half(self) -> bool {
        self.0 & 0xff == Self::F16.0 & 0xff
    }
}

/// A row of the table: a plane of the caller's, by default none. Strides and offset count samples; of images, which
/// have no address, pixel (x, y) is the texel (offset + x pixel, channel + y row). All of that is modulo 2^32.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct PlaneArgs {
    /// Device address, a multiple of 4 bytes; of images 0.
    pub address: u64,
    /// First sample.
    pub offset: u32,
    /// From pixel to pixel.
    pub pixel: u32,
    /// From row to row.
    pub row: u32,
    /// From channel to channel; 0 where there is one.
    pub channel: u32,
    /// What samples are.
    pub format: Format,
    /// Of depth buffers: from number to number.
    pub scale: f32,
    /// Of depth buffers: at 0.
    pub bias: f32,
    /// Of no meaning.
    pub unused: u32,
}

impl PlaneArgs {
    /// Of an image.
    pub const fn of_image(format: Format) -> Self {
        Self { address: 0, offset: 0, pixel: 1, row: 1, channel: 0, format, scale: 0.0, bias: 0.0, unused: 0 }
    }

    /// The same plane turned by half a circle: its first pixel is the last one.
    #[must_use]
    pub const fn turned(self, extent: Extent) -> Self {
        let across = self.pixel.wrapping_mul(extent.width - 1);
        let down = self.row.wrapping_mul(extent.height - 1);
        let (pixel, row) = (self.pixel.wrapping_neg(), self.row.wrapping_neg());
        match self.address {
            0 => Self { offset: self.offset + across, channel: self.channel + down, pixel, row, ..self },
            _ => Self { offset: self.offset.wrapping_add(across).wrapping_add(down), pixel, row, ..self },
        }
    }
}

/// The planes of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Planes([PlaneArgs; Role::ALL.len()]);

impl Planes {
    /// The table's rows.
    pub const fn rows(&self) -> &[PlaneArgs; Role::ALL.len()] {
        &self.0
    }

    /// The same planes turned by half a circle.
    #[must_use]
    pub fn turned(&self, extent: Extent) -> Self {
        Self(self.0.map(|row| if row.format.is_present() { row.turned(extent) } else { row }))
    }

    /// Says what the plane of noise holds.
    pub const fn tell_noise(&mut self, kind: NoiseKind) {
        let row = &mut self.0[Role::Noise as usize];
        row.format = row.format.of_noise(kind);
    }

    /// Whether there is such a plane.
    pub const fn has(&self, role: Role) -> bool {
        self.0[role as usize].format.is_present()
    }
}

impl Index<Role> for Planes {
    type Output = PlaneArgs;

    fn index(&self, role: Role) -> &PlaneArgs {
        &self.0[role as usize]
    }
}

impl IndexMut<Role> for Planes {
    fn index_mut(&mut self, role: Role) -> &mut PlaneArgs {
        &mut self.0[role as usize]
    }
}

//! The frame's planes as one table: a row for each, which kernels read by name (`glsl/shared/planes.glsl`). It is
//! written when planes are bound, so that push constants carry one address whatever a frame has.

use crate::frame::NoiseKind;
pub use crate::role::Role;
use std::ops::{Index, IndexMut};

/// What a plane's samples are, as shaders read it; by default: that there is no plane.
#[repr(transparent)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Format(u32);

impl Format {
    /// 32-bit floats.
    pub const F32: Self = Self::new(1, 0);
    /// 16-bit floats.
    pub const F16: Self = Self::new(2, 1);

    /// A number for what a sample is, and how many lie in a word of 32 bits, as a power of two.
    const fn new(kind: u32, share: u32) -> Self {
        Self(kind | share << 8)
    }

    /// The same of what is known of noise.
    pub const fn of_noise(self, kind: NoiseKind) -> Self {
        match kind {
            NoiseKind::Variance => Self(self.0 | 1 << 16),
            NoiseKind::Samples => Self(self.0 | 1 << 17),
        }
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

/// A row of the table: a plane of the caller's, by default none. Strides and offset count samples.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
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
    /// Of no meaning.
    pub unused: u32,
}

/// The planes of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Planes([PlaneArgs; Role::ALL.len()]);

impl Planes {
    /// The table's rows.
    pub const fn rows(&self) -> &[PlaneArgs; Role::ALL.len()] {
        &self.0
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

//! What the samples of a renderer's planes can be, and how normals and depths are told by them.

use crate::error::{Error, Result};
use crate::kernels::planes::{Format, PlaneArgs};
use crate::role::Role;

/// Sample format of a plane in a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SampleFormat {
    /// 32-bit floats: every plane.
    F32,
    /// 16-bit floats: every plane. Writing them needs `storageBuffer16BitAccess`.
    F16,
    /// Bytes from 0 to 1: albedo, normals. RGBA8 pixels have a pixel stride of 4, also as words with R in the lowest
    /// byte.
    Unorm8,
    /// 16 bits from 0 to 1: albedo, normals, depth.
    Unorm16,
    /// 16 bits from -1 to 1: normals.
    Snorm16,
    /// Words of 32 bits, a whole pixel each: from the lowest on ten bits from 0 to 1 for each of three channels
    /// (`VK_FORMAT_A2B10G10R10_UNORM_PACK32`): normals. Strides and offset count words; there is none between channels.
    Rgb10A2Unorm,
}

impl SampleFormat {
    /// Bytes of a sample.
    pub const fn bytes(self) -> u64 {
        match self {
            Self::Unorm8 => 1,
            Self::F16 | Self::Unorm16 | Self::Snorm16 => 2,
            Self::F32 | Self::Rgb10A2Unorm => 4,
        }
    }

    /// Whether a sample is a whole pixel.
    pub(crate) const fn is_packed(self) -> bool {
        matches!(self, Self::Rgb10A2Unorm)
    }

    /// What samples of a plane can be.
    pub(crate) const fn choices(role: Role) -> &'static [Self] {
        match role {
            Role::Color | Role::Noise | Role::Output => &[Self::F32, Self::F16],
            Role::Albedo => &[Self::F32, Self::F16, Self::Unorm8, Self::Unorm16],
            Role::Normal => &[Self::F32, Self::F16, Self::Unorm8, Self::Unorm16, Self::Snorm16, Self::Rgb10A2Unorm],
            Role::Depth => &[Self::F32, Self::F16, Self::Unorm16],
        }
    }

    pub(crate) const fn as_read(self) -> Format {
        match self {
            Self::F32 => Format::F32,
            Self::F16 => Format::F16,
            Self::Unorm8 => Format::UNORM8,
            Self::Unorm16 => Format::UNORM16,
            Self::Snorm16 => Format::SNORM16,
            Self::Rgb10A2Unorm => Format::RGB10A2,
        }
    }
}

/// Format of an image, by Vulkan's name in what follows `VK_FORMAT_`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ImageFormat {
    /// `R16G16B16A16_SFLOAT`: colour, albedo, normal, output.
    Rgba16F,
    /// `R32G32B32A32_SFLOAT`: colour, albedo, normal, output.
    Rgba32F,
    /// `R32_SFLOAT`: depth, noise.
    R32F,
    /// `R16_SFLOAT`: depth, noise.
    R16F,
    /// `B10G11R11_UFLOAT_PACK32`: colour, albedo.
    B10G11R11F,
    /// `R8G8B8A8_UNORM`: albedo, normal.
    Rgba8Unorm,
    /// `R8G8B8A8_SRGB`: albedo. The image is read as linear.
    Rgba8Srgb,
    /// `A2B10G10R10_UNORM_PACK32`: normal.
    Rgb10A2Unorm,
    /// `R16G16B16A16_SNORM`: normal.
    Rgba16Snorm,
    /// `R16G16_SNORM`: octahedral normal.
    Rg16Snorm,
    /// `R16G16_SFLOAT`: octahedral normal.
    Rg16F,
    /// `R32G32_SFLOAT`: octahedral normal.
    Rg32F,
    /// `D32_SFLOAT`, seen by its depth: depth of a projection.
    D32F,
    /// `D16_UNORM`: depth of a projection.
    D16Unorm,
}

impl ImageFormat {
    /// What a plane's image can be of.
    pub(crate) const fn choices(role: Role) -> &'static [Self] {
        match role {
            Role::Color => &[Self::Rgba16F, Self::Rgba32F, Self::B10G11R11F],
            Role::Albedo => &[Self::Rgba16F, Self::Rgba32F, Self::B10G11R11F, Self::Rgba8Unorm, Self::Rgba8Srgb],
            Role::Normal => &[
                Self::Rgba16F,
                Self::Rgba32F,
                Self::Rgba8Unorm,
                Self::Rgb10A2Unorm,
                Self::Rgba16Snorm,
                Self::Rg16Snorm,
                Self::Rg16F,
                Self::Rg32F,
            ],
            Role::Depth => &[Self::R32F, Self::R16F, Self::D32F, Self::D16Unorm],
            Role::Noise => &[Self::R32F, Self::R16F],
            Role::Output => &[Self::Rgba16F, Self::Rgba32F],
        }
    }

    const fn has_two_channels(self) -> bool {
        matches!(self, Self::Rg16Snorm | Self::Rg16F | Self::Rg32F)
    }

    /// Whether it is that of depth buffers.
    pub(crate) const fn is_depth(self) -> bool {
        matches!(self, Self::D32F | Self::D16Unorm)
    }

    pub(crate) const fn as_read(self) -> Format {
        match self {
            Self::Rgba16F | Self::R16F | Self::Rg16F => Format::F16,
            Self::Rgba32F | Self::R32F | Self::Rg32F | Self::D32F | Self::B10G11R11F => Format::F32,
            Self::Rgba8Unorm | Self::Rgba8Srgb => Format::UNORM8,
            Self::Rgb10A2Unorm => Format::RGB10A2,
            Self::Rgba16Snorm | Self::Rg16Snorm => Format::SNORM16,
            Self::D16Unorm => Format::UNORM16,
        }
    }
}

/// How a plane of normals tells them. Formats without a sign hold numbers in [-1, 1] as `x * 0.5 + 0.5`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum NormalEncoding {
    /// Three channels in [-1, 1]; zeros, as they are stored, are no normal.
    #[default]
    Vector,
    /// The same as `n * 0.5 + 0.5`, in floats too.
    Unsigned,
    /// Two channels in [-1, 1]: the octahedron's map (Cigolle et al., "A Survey of Efficient Representations for
    /// Independent Unit Vectors", 2014), `oct` there. `n / (|x| + |y| + |z|)` gives the two, of normals with a negative
    /// z folded over the diagonals.
    Octahedral,
}

impl NormalEncoding {
    /// Channels of a plane.
    pub(crate) const fn channels(self) -> usize {
        if matches!(self, Self::Octahedral) { 2 } else { 3 }
    }

    /// Has a plane's row tell how it is read.
    pub(crate) const fn tell(self, row: &mut PlaneArgs) {
        let halved = matches!(self, Self::Unsigned) || row.format.is_unsigned();
        row.format = row.format.of_normals(halved, matches!(self, Self::Octahedral));
    }

    /// Refuses images that have fewer channels.
    pub(crate) fn check(self, format: ImageFormat) -> Result<()> {
        if self != Self::Octahedral && format.has_two_channels() {
            return Err(Error::Binding(format!(
                "the normal image is {format:?}, of two channels, and normal_encoding {self:?}: set it to Octahedral, or \
                 take an image of three channels"
            )));
        }
        Ok(())
    }
}

/// How a plane of depths tells them. The network takes distances, along the ray or the view axis, in any unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub enum DepthEncoding {
    /// The distance itself. Planes of numbers from 0 to 1 (unsigned formats, depth buffers) are refused: they hold
    /// those of a projection.
    #[default]
    Linear,
    /// A depth buffer of a perspective projection, from 0 at `near` to 1 at `far`; from 1 at `near` to 0 at `far` where
    /// it is `reversed`. What lies at `far` is background.
    Perspective {
        /// Distance of the near plane, above 0.
        near: f32,
        /// Distance of the far plane, beyond `near`; it may be infinite.
        far: f32,
        /// Whether 1 is near.
        reversed: bool,
    },
    /// The same of an orthographic projection, which is linear between the planes; also distances that were scaled to
    /// [0, 1].
    Orthographic {
        /// Distance of the near plane, at least 0.
        near: f32,
        /// Distance of the far plane, beyond `near`, finite.
        far: f32,
        /// Whether 1 is near.
        reversed: bool,
    },
}

impl DepthEncoding {
    /// Has a plane's row tell how it is read.
    ///
    /// # Errors
    /// [`Error::InvalidOption`] where the planes of the projection are none, or a depth buffer would be taken for
    /// distances.
    pub(crate) fn tell(self, of_projection: bool, row: &mut PlaneArgs) -> Result<()> {
        let (near, far, reversed) = match self {
            Self::Linear if of_projection || row.format.is_unsigned() => {
                return Err(invalid(
                    "Linear, and the depth plane's numbers are from 0 to 1: those of a projection. Say which with \
                     Perspective or Orthographic, which for scaled distances has near 0"
                        .into(),
                ));
            }
            Self::Linear => return Ok(()),
            Self::Perspective { near, far, reversed } => {
                if !(near > 0.0 && near.is_normal() && far > near) {
                    return Err(invalid(format!("near {near} and far {far}; a perspective has 0 < near < far")));
                }
                (near.recip(), far.recip(), reversed)
            }
            Self::Orthographic { near, far, reversed } => {
                if !(near >= 0.0 && far > near && far.is_finite()) {
                    return Err(invalid(format!("near {near} and far {far}; it takes 0 <= near < far, both finite")));
                }
                (near, far, reversed)
            }
        };
        // Linear in the number: the distance or, of a perspective, one over it.
        let (at_zero, at_one) = if reversed { (far, near) } else { (near, far) };
        row.format = row.format.of_projection(matches!(self, Self::Perspective { .. }), reversed);
        (row.bias, row.scale) = (at_zero, at_one - at_zero);
        Ok(())
    }
}

fn invalid(reason: String) -> Error {
    Error::InvalidOption { option: "depth_encoding", reason }
}

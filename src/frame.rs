//! What the caller hands in: planes of samples in host memory, checked once against the frame's size.

mod extent;
mod plane;

use crate::error::Result;
use crate::role::Role;

pub use extent::{Extent, Region};
pub(crate) use plane::widen_half_depths;
pub use plane::{Layout, Plane, PlaneMut, Samples, SamplesMut};

/// What a plane says of the colour's noise.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum NoiseKind {
    /// Variance of a pixel's luminance, in the colour's own unit squared.
    #[default]
    Variance,
    /// Samples of a pixel. One sample is taken to deviate by its own size.
    Samples,
}

/// What a renderer knows of the colour's noise: a plane of one channel.
#[derive(Clone, Copy, Debug)]
pub struct Noise<P> {
    /// The plane.
    pub plane: P,
    /// What it holds.
    pub kind: NoiseKind,
}

/// The optional planes beside a frame's colour. Each of its G-buffer that is missing costs some quality.
#[derive(Clone, Copy, Debug, Default)]
pub struct Features<'a> {
    /// Albedo: three channels, used in [0, 1].
    pub albedo: Option<Plane<'a>>,
    /// Shading normal: three channels in [-1, 1], in world or camera space.
    pub normal: Option<Plane<'a>>,
    /// Depth: one channel, any unit, larger is farther; 0, negative, non-finite or at least 1e9 (in halves 65000) is
    /// background.
    pub depth: Option<Plane<'a>>,
    /// The colour's noise: which pixels need no denoising ([`crate::Options::converged`]; else not looked at).
    pub noise: Option<Noise<Plane<'a>>>,
}

impl<'a> Features<'a> {
    /// Those of what begins at a pixel, but for what is known of noise.
    pub(crate) fn part(&self, x: u32, y: u32) -> Self {
        let part = |plane: Option<Plane<'a>>| plane.map(|plane| plane.part(x, y));
        Self { albedo: part(self.albedo), normal: part(self.normal), depth: part(self.depth), noise: None }
    }

    /// The plane of a role; colour and output are none of these.
    pub(crate) fn plane(&self, role: Role) -> Option<&Plane<'a>> {
        match role {
            Role::Albedo => self.albedo.as_ref(),
            Role::Normal => self.normal.as_ref(),
            Role::Depth => self.depth.as_ref(),
            Role::Noise => self.noise.as_ref().map(|noise| &noise.plane),
            Role::Color | Role::Output => None,
        }
    }

    fn check(&self, extent: Extent) -> Result<()> {
        let planes = Role::ALL.into_iter().filter_map(|role| Some((role, self.plane(role)?)));
        planes.into_iter().try_for_each(|(role, plane)| plane.check(role.name(), extent, role.channels()))
    }
}

/// A noisy frame in host memory.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Size in pixels.
    pub extent: Extent,
    /// Colour: three channels of linear radiance (HDR). Samples that are not finite are mended, negative
    /// ones count as 0.
    pub color: Plane<'a>,
    /// Auxiliary features.
    pub features: Features<'a>,
}

impl Frame<'_> {
    /// Checks every plane against the extent.
    ///
    /// # Errors
    /// [`crate::Error::EmptyFrame`], [`crate::Error::PlaneMismatch`].
    pub fn check(&self) -> Result<()> {
        self.extent.check()?;
        self.color.check("colour", self.extent, 3)?;
        self.features.check(self.extent)
    }
}

/// Checks the features that come with a colour plane which is both input and output.
pub(crate) fn check_in_place(extent: Extent, color: &PlaneMut, features: &Features) -> Result<()> {
    extent.check()?;
    color.check("colour", extent, 3)?;
    features.check(extent)
}

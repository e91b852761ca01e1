//! The planes that a frame can have.

/// A plane of the frame; its position is its row in the table ([`crate::kernels::planes`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The noisy colour.
    Color,
    /// Albedo.
    Albedo,
    /// Shading normal.
    Normal,
    /// Depth.
    Depth,
    /// What is known of the colour's noise.
    Noise,
    /// Where the result goes.
    Output,
}

impl Role {
    /// All of them, in the table's order.
    pub const ALL: [Self; 6] = [Self::Color, Self::Albedo, Self::Normal, Self::Depth, Self::Noise, Self::Output];

    /// The name in messages.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Color => "colour",
            Self::Albedo => "albedo",
            Self::Normal => "normal",
            Self::Depth => "depth",
            Self::Noise => "noise",
            Self::Output => "output",
        }
    }

    /// Those beside the colour that the network is given: each may be missing.
    pub const FEATURES: [Self; 3] = [Self::Albedo, Self::Normal, Self::Depth];

    /// Channels.
    pub const fn channels(self) -> usize {
        match self {
            Self::Color | Self::Albedo | Self::Normal | Self::Output => 3,
            Self::Depth | Self::Noise => 1,
        }
    }

    /// The name of its image in shaders.
    pub const fn image(self) -> &'static str {
        match self {
            Self::Color => "color_image",
            Self::Albedo => "albedo_image",
            Self::Normal => "normal_image",
            Self::Depth => "depth_image",
            Self::Noise => "noise_image",
            Self::Output => "dst_image",
        }
    }
}

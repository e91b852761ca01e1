//! A kernel with its arguments, whichever it is.

use super::{
    Kernel, Tiles, View, aux_projection, dense, expand, film, frame_io, maps, predicted, quiet, separable, stats,
    unembed, window_attention, winograd,
};

/// One kernel with its arguments.
#[derive(Clone, Debug, PartialEq)]
pub enum Call {
    /// Dense 3x3 convolution.
    Conv3x3(dense::Conv3x3),
    /// The same by Winograd's minimal filtering.
    Winograd3x3(winograd::Winograd3x3),
    /// Pointwise convolution.
    Linear(dense::Linear),
    /// Depthwise 3x3 convolution.
    Depthwise3x3(maps::Depthwise3x3),
    /// Depthwise and pointwise convolution in one.
    Separable3x3(separable::Separable3x3),
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
    /// Output.
    Output(frame_io::Output),
    /// Noise of the map's squares.
    TileNoise(quiet::TileNoise),
    /// Map of what is to be denoised.
    QuietMap(quiet::QuietMap),
    /// List of active tiles.
    TileList(quiet::TileList),
    /// Zeros beside active tiles.
    Fill(quiet::Fill),
}

impl Call {
    /// The tiles that it works on, and the map in which they lie, in tokens; `None` for kernels without tiles.
    pub fn tiles(&self) -> Option<(Tiles, u32, u32)> {
        let of = |tiles: &Tiles, map: &View| Some((*tiles, map.width, map.height));
        let conv = |conv: &dense::Conv3x3| {
            let (width, height) = conv.result_size();
            Some((conv.tiles, width, height))
        };
        match self {
            Self::Conv3x3(k) => conv(k),
            Self::Winograd3x3(k) => conv(&k.conv),
            Self::Separable3x3(k) => of(&k.pointwise.tiles, &k.pointwise.dst),
            Self::Linear(k) => of(&k.tiles, &k.dst),
            Self::Depthwise3x3(k) => of(&k.tiles, &k.dst),
            Self::AuxProjection(k) => of(&k.tiles, &k.dst),
            Self::Unembed(k) => of(&k.tiles, &k.src),
            Self::KernelInputs(k) => of(&k.tiles, &k.tokens),
            Self::PredictKernels(k) => of(&k.tiles, &k.dst),
            Self::Halve(k) => of(&k.tiles, &k.dst),
            Self::ApplyKernels(k) => of(&k.tiles, &k.dst),
            Self::MixLevels(k) => of(&k.tiles, &k.dst),
            Self::LayerNorm(k) => of(&k.tiles, &k.dst),
            Self::WindowAttention(k) => of(&k.tiles, &k.dst),
            Self::Expand(k) => of(&k.tiles, &k.dst),
            Self::InputColor(k) => of(&k.tiles, &k.dst),
            Self::InputAux(k) => of(&k.tiles, &k.dst),
            Self::Output(k) => Some((k.tiles, k.width, k.height)),
            Self::Fill(k) => {
                let (width, height) = k.size();
                Some((k.tiles, width, height))
            }
            _ => None,
        }
    }

    /// The tiles that it works on; `None` for kernels without tiles.
    pub fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(match self {
            Self::Conv3x3(k) => &mut k.tiles,
            Self::Winograd3x3(k) => &mut k.conv.tiles,
            Self::Separable3x3(k) => &mut k.pointwise.tiles,
            Self::Linear(k) => &mut k.tiles,
            Self::Depthwise3x3(k) => &mut k.tiles,
            Self::AuxProjection(k) => &mut k.tiles,
            Self::Unembed(k) => &mut k.tiles,
            Self::KernelInputs(k) => &mut k.tiles,
            Self::PredictKernels(k) => &mut k.tiles,
            Self::Halve(k) => &mut k.tiles,
            Self::ApplyKernels(k) => &mut k.tiles,
            Self::MixLevels(k) => &mut k.tiles,
            Self::LayerNorm(k) => &mut k.tiles,
            Self::WindowAttention(k) => &mut k.tiles,
            Self::Expand(k) => &mut k.tiles,
            Self::InputColor(k) => &mut k.tiles,
            Self::InputAux(k) => &mut k.tiles,
            Self::Output(k) => &mut k.tiles,
            Self::Fill(k) => &mut k.tiles,
            _ => return None,
        })
    }

    /// The map that it writes, the first of several; `None` for kernels that write none.
    pub fn result(&self) -> Option<&View> {
        match self {
            Self::Conv3x3(k) => Some(&k.dst),
            Self::Winograd3x3(k) => Some(&k.conv.dst),
            Self::Separable3x3(k) => Some(&k.pointwise.dst),
            Self::Linear(k) => Some(&k.dst),
            Self::Depthwise3x3(k) => Some(&k.dst),
            Self::AuxProjection(k) => Some(&k.dst),
            Self::Unembed(k) => Some(&k.dst),
            Self::KernelInputs(k) => Some(&k.dst),
            Self::PredictKernels(k) => Some(&k.dst),
            Self::Halve(k) => Some(&k.dst),
            Self::ApplyKernels(k) => Some(&k.dst),
            Self::MixLevels(k) => Some(&k.dst),
            Self::LayerNorm(k) => Some(&k.dst),
            Self::Expand(k) => Some(&k.dst),
            Self::WindowAttention(k) => Some(&k.dst),
            Self::InputColor(k) => Some(&k.dst),
            Self::InputAux(k) => Some(&k.dst),
            Self::Fill(k) => Some(&k.dst),
            _ => None,
        }
    }

    /// All maps that it writes.
    pub fn results(&self) -> Vec<&View> {
        let more = match self {
            Self::KernelInputs(k) => Some(&k.taps),
            _ => None,
        };
        self.result().into_iter().chain(more).collect()
    }

    /// The maps of which it reads tokens around its own: mostly none or one.
    pub fn reads_around(&self) -> Vec<&View> {
        match self {
            Self::Conv3x3(k) => vec![&k.src],
            Self::Winograd3x3(k) => vec![&k.conv.src],
            Self::Separable3x3(k) => vec![&k.depthwise.src],
            Self::Depthwise3x3(k) => vec![&k.src],
            Self::AuxProjection(k) => vec![&k.src],
            Self::Unembed(k) => vec![&k.src],
            Self::PredictKernels(k) => vec![&k.taps, &k.albedo],
            Self::ApplyKernels(k) => vec![&k.sums],
            Self::MixLevels(k) => k.levels.iter().collect(),
            _ => vec![],
        }
    }

    /// The call as a kernel.
    pub fn kernel(&self) -> &dyn Kernel {
        match self {
            Self::Conv3x3(k) => k,
            Self::Winograd3x3(k) => k,
            Self::Linear(k) => k,
            Self::Depthwise3x3(k) => k,
            Self::Separable3x3(k) => k,
            Self::AuxProjection(k) => k,
            Self::Unembed(k) => k,
            Self::KernelInputs(k) => k,
            Self::PredictKernels(k) => k,
            Self::Halve(k) => k,
            Self::ApplyKernels(k) => k,
            Self::MixLevels(k) => k,
            Self::LayerNorm(k) => k,
            Self::WindowAttention(k) => k,
            Self::Expand(k) => k,
            Self::TokenSum(k) => k,
            Self::FilmVector(k) => k,
            Self::StatsClear(k) => k,
            Self::StatsHistogram(k) => k,
            Self::StatsSelect(k) => k,
            Self::StatsTiles(k) => k,
            Self::StatsKey(k) => k,
            Self::InputColor(k) => k,
            Self::InputAux(k) => k,
            Self::Output(k) => k,
            Self::TileNoise(k) => k,
            Self::QuietMap(k) => k,
            Self::TileList(k) => k,
            Self::Fill(k) => k,
        }
    }
}

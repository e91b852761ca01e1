//! A kernel with its arguments, whichever it is.

use super::{
    Access, Grid, Kernel, Tiles, Traffic, View, attention_block, aux_projection, dense, expand, film, frame_io, maps,
    normed_conv, predicted, converged, separable, signals, stats, unembed, window_attention, winograd,
};

/// Declares [`Call`]: a variant of the enum for each kernel.
macro_rules! calls {
    ($($(#[$doc:meta])* $name:ident($kernel:ty),)*) => {
        /// One kernel with its arguments.
        #[derive(Clone, Debug, PartialEq)]
        pub enum Call {
            $($(#[$doc])* $name($kernel),)*
        }

        impl Call {
            /// The call as a kernel.
            pub fn kernel(&self) -> &dyn Kernel {
                match self {
                    $(Self::$name(kernel) => kernel,)*
                }
            }

            /// The same, to be changed.
            pub fn kernel_mut(&mut self) -> &mut dyn Kernel {
                match self {
                    $(Self::$name(kernel) => kernel,)*
                }
            }
        }
    };
}

calls! {
    /// Dense 3x3 convolution.
    Conv3x3(dense::Conv3x3),
    /// The same by Winograd's minimal filtering.
    Winograd3x3(winograd::Winograd3x3),
    /// Layer normalisation and dense 3x3 convolution in one.
    NormedConv3x3(normed_conv::NormedConv3x3),
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
    /// A block's attention with its Linears in one.
    AttentionBlock(attention_block::AttentionBlock),
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
    /// A signal beside the colour to what predicted kernels read.
    InputSignal(signals::InputSignal),
    /// A filtered signal to the caller's plane.
    OutputSignal(signals::OutputSignal),
    /// Noise of the map's squares.
    TileNoise(converged::TileNoise),
    /// Map of what is to be denoised.
    ConvergedMap(converged::ConvergedMap),
    /// List of active tiles.
    TileList(converged::TileList),
    /// Zeros beside active tiles.
    Fill(converged::Fill),
}

impl Call {
    /// The tokens that it works on; `None` for kernels that do not work tile by tile.
    pub fn grid(&self) -> Option<Grid> {
        self.kernel().grid()
    }

    /// Has it work on some tiles of its grid, if it has one.
    pub fn set_tiles(&mut self, tiles: Tiles) {
        self.kernel_mut().tiles_mut().into_iter().for_each(|own| *own = tiles);
    }

    /// The maps that it touches, and how.
    pub fn maps(&self) -> Vec<(View, Access)> {
        let mut found = Vec::new();
        self.clone().kernel_mut().maps(&mut |view, access| found.push((*view, access)));
        found
    }

    /// All maps that it writes.
    pub fn results(&self) -> Vec<View> {
        self.maps().into_iter().filter(|(_, access)| access.writes()).map(|(view, _)| view).collect()
    }

    /// The map that it writes, the first of several; `None` for kernels that write none.
    pub fn result(&self) -> Option<View> {
        self.results().first().copied()
    }

    /// Memory that it touches.
    pub fn traffic(&self) -> Traffic {
        let mut traffic = Traffic::default();
        for (view, access) in self.maps() {
            let touched = if access.writes() { &mut traffic.writes } else { &mut traffic.reads };
            touched.push((view.buffer, view.bytes()));
        }
        let others = self.kernel().others();
        traffic.reads.extend(others.reads);
        traffic.writes.extend(others.writes);
        traffic
    }
}

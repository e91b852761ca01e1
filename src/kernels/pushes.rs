//! The push constants of every kernel, in the order in which its shader declares them.
//!
//! Strides and channel counts named `*_stride` and `*_channels` count vectors of four channels where maps are meant,
//! and samples where the caller's planes are meant.

use super::contract::push_constants;

push_constants! {
    /// Dense 3x3 convolution.
    Conv3x3Push {
        src: Address, dst: Address, weights: Address, film: Address, residual: Address, tiles: Address,
        src_width: U32, src_height: U32, src_stride: U32, src_channels: U32,
        dst_width: U32, dst_stride: U32, dst_channels: U32, residual_stride: U32,
        bias_vectors: U32, first_tile: U32, tile_count: U32, flags: U32,
    }
}

push_constants! {
    /// Pointwise convolution of one or two maps.
    LinearPush {
        src: Address, src_b: Address, dst: Address, weights: Address, film: Address, residual: Address, tiles: Address,
        src_stride: U32, src_channels: U32, src_b_stride: U32, src_b_channels: U32,
        width: U32, dst_stride: U32, dst_channels: U32, residual_stride: U32,
        bias_vectors: U32, first_tile: U32, tile_count: U32, flags: U32,
    }
}

push_constants! {
    /// Depthwise 3x3 convolution.
    Depthwise3x3Push {
        src: Address, dst: Address, weights: Address, tiles: Address,
        width: U32, height: U32, src_stride: U32, dst_stride: U32, channels: U32,
        first_tile: U32, tile_count: U32, flags: U32,
    }
}

push_constants! {
    /// The features' projection in one.
    AuxProjectionPush {
        src: Address, dst: Address, pointwise_0: Address, pointwise_1: Address, pointwise_2: Address,
        depthwise_0: Address, depthwise_1: Address, depthwise_2: Address, out_0: Address, out_1: Address, out_2: Address,
        width: U32, height: U32, src_stride: U32, dst_stride: U32,
        first_tile: U32, tile_columns: U32, tile_rows: U32, unused: U32,
    }
}

push_constants! {
    /// Depthwise and pointwise convolution in one.
    Separable3x3Push {
        src: Address, dst: Address, weights: Address, film: Address, residual: Address, depthwise: Address, tiles: Address,
        width: U32, height: U32, src_stride: U32, src_channels: U32,
        dst_stride: U32, dst_channels: U32, residual_stride: U32, bias_vectors: U32,
        first_tile: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// Tokens of 2x2 to pixels.
    UnembedPush {
        src: Address, dst: Address, weights: Address, tiles: Address,
        width: U32, height: U32, src_stride: U32, channels: U32, dst_stride: U32,
        first_tile: U32, tile_count: U32, flags: U32,
    }
}

push_constants! {
    /// What kernels of pixels are predicted from, and what they read.
    KernelInputsPush {
        early: Address, tokens: Address, albedo: Address, color: Address, residual: Address, weights: Address,
        hidden: Address, taps: Address, tiles: Address,
        width: U32, early_stride: U32, tokens_stride: U32, albedo_stride: U32, color_stride: U32, residual_stride: U32,
        hidden_stride: U32, taps_stride: U32, first_tile: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// Kernels of every pixel, predicted and applied.
    PredictKernelsPush {
        hidden: Address, taps: Address, albedo: Address, weights: Address, dst: Address, tiles: Address,
        width: U32, height: U32, hidden_stride: U32, taps_stride: U32, albedo_stride: U32, dst_stride: U32,
        first_tile: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// Means of 2x2 tokens.
    HalvePush {
        src: Address, dst: Address, tiles: Address,
        width: U32, src_stride: U32, dst_stride: U32, channels: U32,
        first_tile: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// Kernels of every token over images.
    ApplyKernelsPush {
        logits: Address, sums: Address, dst: Address, tiles: Address,
        width: U32, height: U32, logits_stride: U32, sums_stride: U32, dst_stride: U32, images: U32,
        first_tile: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// The levels of kernels to one picture.
    MixLevelsPush {
        pixels: Address, level_0: Address, level_1: Address, level_2: Address, level_3: Address,
        color: Address, residual: Address, dst: Address, tiles: Address,
        width: U32, height: U32, pixels_stride: U32, level_strides: U32, color_stride: U32, residual_stride: U32,
        dst_stride: U32, images: U32, levels: U32, first_tile: U32, tile_count: U32, flags: U32,
    }
}

push_constants! {
    /// Layer normalisation of every token.
    LayerNormPush {
        src: Address, dst: Address, weights: Address, tiles: Address,
        width: U32, src_stride: U32, dst_stride: U32, channels: U32,
        first_tile: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// Joint attention of one window and head.
    WindowAttentionPush {
        x: Address, f: Address, bias: Address, dst: Address, tiles: Address,
        width: U32, x_stride: U32, f_stride: U32, dst_stride: U32,
        heads: U32, key_vectors: U32, value_vectors: U32, scale: F32,
        first_tile: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// Sums of tokens, level one: one partial sum for every run of tokens.
    TokenSumPush {
        src: Address, dst: Address, map: Address, counts: Address,
        width: U32, real_width: U32, real_tokens: U32, src_stride: U32, channels: U32,
        tokens_per_sum: U32, sums: U32, map_columns: U32, token_pixels: U32, pitch: U32, skew: U32, unused: U32,
    }
}

push_constants! {
    /// Sums of tokens, level two, and the matrix that makes the FiLM vectors of their mean.
    FilmVectorPush {
        partials: Address, weights: Address, dst: Address, counts: Address,
        channels: U32, outputs: U32, sums: U32, tokens: U32, inverse_tokens: F32, counted: U32,
    }
}

push_constants! {
    /// A small map made large.
    ExpandPush {
        src: Address, dst: Address, tiles: Address,
        src_width: U32, src_height: U32, width: U32, height: U32, src_stride: U32, dst_stride: U32, channels: U32,
        first_tile: U32, tile_count: U32, flags: U32,
    }
}

push_constants! {
    /// Zeroes a histogram.
    StatsClearPush { histogram: Address, count: U32, unused: U32 }
}

push_constants! {
    /// Histogram of luminance or depth.
    StatsHistogramPush {
        color: Address, depth: Address, histogram: Address,
        color_offset: U32, color_pixel: U32, color_row: U32, color_channel: U32,
        depth_offset: U32, depth_pixel: U32, depth_row: U32,
        width: U32, height: U32, flags: U32,
    }
}

push_constants! {
    /// Median luminance or depth scale, from the histogram.
    StatsSelectPush { histogram: Address, dst: Address, of_depth: U32, unused: U32 }
}

push_constants! {
    /// Light and noise of every 8x8 tile of pixels.
    StatsTilesPush {
        color: Address, stats: Address, tile_stats: Address, runs: Address,
        color_offset: U32, color_pixel: U32, color_row: U32, color_channel: U32,
        width: U32, height: U32, tiles_x: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// Key, exposure, noise and largest samples of the frame.
    StatsKeyPush {
        runs: Address, tile_stats: Address, stats: Address, depth_scale: Address, given: Address, told: Address,
        run_count: U32, tiles_x: U32, tile_count: U32, fixed_exposure: F32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// Colour to the network's input.
    InputColorPush {
        color: Address, stats: Address, tile_stats: Address, dst: Address, tiles: Address,
        color_offset: U32, color_pixel: U32, color_row: U32, color_channel: U32,
        width: U32, height: U32, tiles_x: U32, dst_width: U32, first_tile: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// Albedo, normal and depth to the network's input.
    InputAuxPush {
        albedo: Address, normal: Address, depth: Address, depth_scale: Address, dst: Address, tiles: Address,
        albedo_offset: U32, albedo_pixel: U32, albedo_row: U32, albedo_channel: U32,
        normal_offset: U32, normal_pixel: U32, normal_row: U32, normal_channel: U32,
        depth_offset: U32, depth_pixel: U32, depth_row: U32,
        width: U32, height: U32, dst_width: U32, first_tile: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// The network's residual to the denoised colour.
    OutputPush {
        residual: Address, log_color: Address, stats: Address, dst: Address, tiles: Address, color: Address, map: Address,
        dst_offset: U32, dst_pixel: U32, dst_row: U32, dst_channel: U32,
        color_offset: U32, color_pixel: U32, color_row: U32, color_channel: U32,
        left: U32, top: U32, right: U32, bottom: U32, src_width: U32, residual_stride: U32,
        first_tile: U32, tile_count: U32, flags: U32, blend: F32,
    }
}

push_constants! {
    /// A signal beside the colour to what predicted kernels read.
    InputSignalPush {
        color: Address, stats: Address, tile_stats: Address, signal: Address, taps: Address, albedo: Address,
        dst: Address, tiles: Address,
        color_offset: U32, color_pixel: U32, color_row: U32, color_channel: U32,
        signal_pixel: U32, signal_row: U32, signal_channel: U32, width: U32, height: U32, dst_width: U32, strides: U32,
        first_tile: U32, tile_count: U32, flags: U32, blend: F32, unused: U32,
    }
}

push_constants! {
    /// A signal that went through the colour's kernels to the caller's plane.
    OutputSignalPush {
        filtered: Address, color: Address, direct: Address, stats: Address, dst: Address, signal: Address, map: Address,
        tiles: Address,
        dst_pixel: U32, dst_row: U32, dst_channel: U32, signal_pixel: U32, signal_row: U32, signal_channel: U32,
        left: U32, top: U32, right: U32, bottom: U32, src_width: U32,
        first_tile: U32, tile_count: U32, flags: U32, blend: F32, unused: U32,
    }
}

push_constants! {
    /// Relative noise of every square of the map.
    TileNoisePush {
        color: Address, depth: Address, noise: Address, stats: Address, dst: Address,
        color_offset: U32, color_pixel: U32, color_row: U32, color_channel: U32,
        depth_offset: U32, depth_pixel: U32, depth_row: U32,
        noise_offset: U32, noise_pixel: U32, noise_row: U32,
        width: U32, height: U32, columns: U32, tile_count: U32, flags: U32, unused: U32,
    }
}

push_constants! {
    /// The map of what is to be denoised, and its sums.
    QuietMapPush {
        src: Address, map: Address, sums: Address,
        columns: U32, rows: U32, left: U32, top: U32, right: U32, bottom: U32, threshold: F32,
        real_columns: U32, real_rows: U32, spread: U32,
    }
}

push_constants! {
    /// The list of active tiles, that of others that are read, and their workgroups.
    TileListPush {
        sums: Address, list: Address, idle: Address, groups: Address, counts: Address,
        reach_0: U32, reach_1: U32, reach_2: U32, reach_3: U32, reach_4: U32, reach_5: U32, reach_6: U32, reach_7: U32,
        map_columns: U32, map_rows: U32, columns: U32, rows: U32, tile_pixels: U32, max_y: U32, slot: U32,
        pitch: U32, skew: U32, real_columns: U32, real_rows: U32, unused: U32,
    }
}

push_constants! {
    /// Zeros.
    FillPush {
        dst: Address, tiles: Address,
        width: U32, dst_stride: U32, channels: U32, side: U32, tile_count: U32, flags: U32, first_tile: U32, unused: U32,
    }
}

push_constants! {
    /// Multiply-adds for their own sake.
    RoofFmaPush { dst: Address, rounds: U32, factor: F32 }
}

push_constants! {
    /// A copy for its own sake.
    RoofCopyPush { src: Address, dst: Address }
}

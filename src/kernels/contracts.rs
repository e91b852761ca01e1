//! Every kernel variant. `build.rs` compiles each from `glsl/`, reads push constants and descriptors off it and refuses
//! one whose specialisation constants are others.

use super::contract::{Constant, ConstantValue, Contract, Need};

const CPU: &[Need] = &[Need::CpuDriver];
const HALVES: &[Need] = &[Need::Storage16];
const CPU_HALVES: &[Need] = &[Need::CpuDriver, Need::Storage16];

const MATRICES: &[Need] = &[Need::Matrix];

/// As `glsl/shared/matrix.glsl` declares them.
const INVOCATIONS: Constant = Constant { name: "INVOCATIONS", value: ConstantValue::Subgroups(MATRIX_SUBGROUPS) };
const DENSE_INVOCATIONS: Constant = Constant { name: "INVOCATIONS", value: ConstantValue::DenseInvocations };
const WINDOW_INVOCATIONS: Constant = Constant { name: "INVOCATIONS", value: ConstantValue::WindowInvocations };
const AUX_INVOCATIONS: Constant = Constant { name: "INVOCATIONS", value: ConstantValue::Subgroups(AUX_SUBGROUPS) };
const ROWS: Constant = Constant { name: "ROWS", value: ConstantValue::MatrixRows };
const COLUMNS: Constant = Constant { name: "COLUMNS", value: ConstantValue::MatrixColumns };
const DEPTH: Constant = Constant { name: "DEPTH", value: ConstantValue::MatrixDepth };
/// As `glsl/shared/epilogue.glsl` does.
const EPILOGUE: Constant = Constant { name: "EPILOGUE", value: ConstantValue::Epilogue };
const INNER_EPILOGUE: Constant = Constant { name: "INNER_EPILOGUE", value: ConstantValue::InnerEpilogue };
const MATRIX: &[Constant] = &[INVOCATIONS, ROWS, COLUMNS, DEPTH];
const PREDICT_MATRIX: &[Constant] =
    &[Constant { name: "INVOCATIONS", value: ConstantValue::Subgroups(PREDICT_SUBGROUPS) }, ROWS, COLUMNS, DEPTH];
const AUX_MATRIX: &[Constant] = &[AUX_INVOCATIONS, ROWS, COLUMNS, DEPTH];
const TILES: Constant = Constant { name: "TILES", value: ConstantValue::Tiles };
const HALVES_OF_TILES: Constant = Constant { name: "HALVES", value: ConstantValue::Halves };
const INPUTS: Constant = Constant { name: "INPUTS", value: ConstantValue::Inputs };
const KEYS: Constant = Constant { name: "KEYS", value: ConstantValue::Keys };
const VALUES: Constant = Constant { name: "VALUES", value: ConstantValue::Values };
const FIRST_MATRIX: &[Constant] = &[DENSE_INVOCATIONS, ROWS, COLUMNS, DEPTH, EPILOGUE, TILES, HALVES_OF_TILES];
const DENSE_MATRIX_CUT: &[Constant] =
    &[DENSE_INVOCATIONS, ROWS, COLUMNS, DEPTH, EPILOGUE, TILES, HALVES_OF_TILES, INPUTS];
const SEPARABLE_MATRIX_CUT: &[Constant] =
    &[DENSE_INVOCATIONS, ROWS, COLUMNS, DEPTH, EPILOGUE, TILES, HALVES_OF_TILES, INPUTS, INNER_EPILOGUE];
const FFN_MATRIX_CUT: &[Constant] = &[INVOCATIONS, ROWS, COLUMNS, DEPTH, EPILOGUE, INPUTS];
const UNEMBED_MATRIX_CUT: &[Constant] = &[INVOCATIONS, ROWS, COLUMNS, DEPTH, INPUTS];
const ATTENTION_MATRIX_CUT: &[Constant] = &[WINDOW_INVOCATIONS, ROWS, COLUMNS, DEPTH, KEYS, VALUES];
const ATTENTION_BLOCK_CUT: &[Constant] = &[WINDOW_INVOCATIONS, ROWS, COLUMNS, DEPTH, KEYS, VALUES, INPUTS];
const DENSE: &[Constant] = &[EPILOGUE];
const SEPARABLE: &[Constant] = &[EPILOGUE, INNER_EPILOGUE];

/// Subgroups of a workgroup on matrices.
pub const MATRIX_SUBGROUPS: u32 = 4;
/// The same of the features' projection.
pub const AUX_SUBGROUPS: u32 = 8;
/// Subgroups of a workgroup of the kernel that predicts kernels on matrices.
const PREDICT_SUBGROUPS: u32 = 2;

macro_rules! contract {
    ($name:expr, $source:literal, $push:ident, [$(($key:literal, $value:literal)),*], $needs:expr) => {
        contract!($name, $source, $push, [$(($key, $value)),*], $needs, &[])
    };
    ($name:expr, $source:literal, $push:ident, [$(($key:literal, $value:literal)),*], $needs:expr, $constants:expr) => {
        Contract {
            name: $name, source: $source, defines: &[$(($key, $value)),*], push: stringify!($push), needs: $needs,
            constants: $constants,
        }
    };
}

/// Constants for the variants, those under `stored` twice: with maps of 32-bit floats and, in [`halves`], of halves.
/// Each has its name, its shader, the struct of its push constants, what it defines, needs and is specialised by.
macro_rules! contracts {
    (stored {$($(#[$stored_meta:meta])* $stored:ident = $stored_name:literal $stored_source:literal $stored_push:ident
       { $($stored_key:literal : $stored_value:literal),* } $stored_needs:expr, $half_needs:expr
       $(, $stored_constants:ident)?;)*}
     others {$($(#[$meta:meta])* $konst:ident = $name:literal $source:literal $push:ident
       { $($key:literal : $value:literal),* } $needs:expr $(, $constants:expr)?;)*}) => {
        $($(#[$stored_meta])* pub const $stored: Contract = contract!(
            $stored_name, $stored_source, $stored_push, [$(($stored_key, $stored_value)),*], $stored_needs
            $(, $stored_constants)?);)*
        $($(#[$meta])* pub const $konst: Contract = contract!(
            $name, $source, $push, [$(($key, $value)),*], $needs $(, $constants)?);)*

        /// The same variants over maps of halves.
        pub mod halves {
            use super::*;
            $($(#[$stored_meta])* pub const $stored: Contract = contract!(
                concat!($stored_name, "_f16"), $stored_source, $stored_push,
                [("SRC_F16", "1"), ("DST_F16", "1") $(, ($stored_key, $stored_value))*], $half_needs
                $(, $stored_constants)?);)*
        }

        /// Every variant that the build compiles.
        pub const ALL: &[&Contract] = &[$(&$stored, &halves::$stored,)* $(&$konst),*];
    };
}

// TX x TY outputs and 4 * NV channels an invocation: 2x2 keeps a GPU's registers, more suits CPU drivers, on which a
// load costs more than the arithmetic it feeds: there lanes share what they load (LANES_SHARE) and load whole vectors
// (TEXELS). Those with OUTPUTS channels a workgroup stage what its invocations share.
contracts! {
    stored {
        /// Convolution, stride 1, 32 channels a workgroup.
        CONV3X3 = "conv3x3" "conv3x3_staged.comp" Conv3x3Push { "STRIDE": "1", "OUTPUTS": "32" } &[], HALVES, DENSE;
        /// The same, 64 channels a workgroup.
        CONV3X3_WIDE = "conv3x3_wide" "conv3x3_staged.comp" Conv3x3Push { "STRIDE": "1", "OUTPUTS": "64" } &[], HALVES, DENSE;
        /// The same for CPU drivers, tiles of 32 channels.
        CONV3X3_CPU = "conv3x3_cpu" "conv3x3.comp" Conv3x3Push
            { "STRIDE": "1", "TX": "4", "TY": "2", "NV": "8", "LANES_SHARE": "1", "TEXELS": "1", "ROLLED": "1" } CPU, CPU_HALVES, DENSE;
        /// Convolution, stride 2, 32 channels a workgroup.
        CONV3X3_S2 = "conv3x3_s2" "conv3x3_staged.comp" Conv3x3Push { "STRIDE": "2", "OUTPUTS": "32" } &[], HALVES, DENSE;
        /// The same for CPU drivers, tiles of 32 channels.
        CONV3X3_S2_CPU = "conv3x3_s2_cpu" "conv3x3.comp" Conv3x3Push
            { "STRIDE": "2", "TX": "4", "TY": "2", "NV": "8", "LANES_SHARE": "1", "TEXELS": "1", "BY_TAP": "1" } CPU, CPU_HALVES, DENSE;
        /// Convolution, stride 1, to at most 16 channels.
        CONV3X3_N16 = "conv3x3_n16" "conv3x3.comp" Conv3x3Push
            { "STRIDE": "1", "TX": "2", "TY": "2", "NV": "4", "PACKED_NV": "8" } &[], HALVES, DENSE;
        /// The same for CPU drivers.
        CONV3X3_N16_CPU = "conv3x3_n16_cpu" "conv3x3.comp" Conv3x3Push
            { "STRIDE": "1", "TX": "4", "TY": "2", "NV": "4", "PACKED_NV": "8", "LANES_SHARE": "1", "TEXELS": "1", "ROLLED": "1" } CPU, CPU_HALVES, DENSE;
        /// Convolution to at most 4 channels.
        CONV3X3_N4 = "conv3x3_n4" "conv3x3.comp" Conv3x3Push
            { "STRIDE": "1", "TX": "4", "TY": "2", "NV": "1" } &[], HALVES, DENSE;
        /// The same for CPU drivers.
        CONV3X3_N4_CPU = "conv3x3_n4_cpu" "conv3x3.comp" Conv3x3Push
            { "STRIDE": "1", "TX": "4", "TY": "2", "NV": "1", "TEXELS": "1" } CPU, CPU_HALVES, DENSE;
        /// Convolution by F(2x2, 3x3).
        WINOGRAD3X3_F2 = "winograd3x3_f2" "winograd3x3.comp" Conv3x3Push { "OUT": "2", "TX": "1", "NV": "2" } &[], HALVES, DENSE;
        /// Convolution by F(4x4, 3x3).
        WINOGRAD3X3_F4 = "winograd3x3_f4" "winograd3x3.comp" Conv3x3Push { "OUT": "4", "TX": "1", "NV": "1" } &[], HALVES, DENSE;
        /// Depthwise and pointwise convolution in one, tiles of 32 channels.
        SEPARABLE3X3 = "separable3x3" "separable3x3.comp" Separable3x3Push { "TX": "2", "TY": "2", "NV": "8" } &[], HALVES, SEPARABLE;
        /// The same for CPU drivers.
        SEPARABLE3X3_CPU = "separable3x3_cpu" "separable3x3.comp" Separable3x3Push
            { "TX": "4", "TY": "2", "NV": "8", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES, SEPARABLE;
        /// Pointwise convolution, 32 channels a workgroup.
        LINEAR = "linear" "linear.comp" LinearPush { "OUTPUTS": "32" } &[], HALVES, DENSE;
        /// The same, 64 channels a workgroup.
        LINEAR_WIDE = "linear_wide" "linear.comp" LinearPush { "OUTPUTS": "64" } &[], HALVES, DENSE;
        /// The same for CPU drivers, tiles of 32 channels.
        LINEAR_CPU = "linear_cpu" "linear_cpu.comp" LinearPush
            { "TX": "2", "TY": "2", "NV": "8", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES, DENSE;
        /// Pointwise convolution of normed tokens, 32 channels a workgroup.
        LINEAR_NORM = "linear_norm" "linear.comp" LinearPush { "OUTPUTS": "32", "NORM": "1" } &[], HALVES, DENSE;
        /// The same, 64 channels a workgroup.
        LINEAR_NORM_WIDE = "linear_norm_wide" "linear.comp" LinearPush { "OUTPUTS": "64", "NORM": "1" } &[], HALVES, DENSE;
        /// The same for CPU drivers, tiles of 32 channels.
        LINEAR_NORM_CPU = "linear_norm_cpu" "linear_cpu.comp" LinearPush
            { "TX": "2", "TY": "2", "NV": "8", "NORM": "1" } CPU, CPU_HALVES, DENSE;
        /// Pointwise convolution from 8 channels, held, for CPU drivers.
        LINEAR_K8_CPU = "linear_k8_cpu" "linear_stationary.comp" LinearPush
            { "TX": "4", "TY": "2", "INPUTS": "2", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES, DENSE;
        /// Pointwise convolution of normed tokens from 16 channels, held, for CPU drivers.
        LINEAR_K16_NORM_CPU = "linear_k16_norm_cpu" "linear_stationary.comp" LinearPush
            { "TX": "4", "TY": "2", "INPUTS": "4", "NORM": "1", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES, DENSE;
        /// Pointwise convolution from 32 channels, held, for CPU drivers.
        LINEAR_K32_CPU = "linear_k32_cpu" "linear_stationary.comp" LinearPush
            { "TX": "4", "TY": "2", "INPUTS": "8", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES, DENSE;
        /// The same of normed tokens.
        LINEAR_K32_NORM_CPU = "linear_k32_norm_cpu" "linear_stationary.comp" LinearPush
            { "TX": "4", "TY": "2", "INPUTS": "8", "NORM": "1", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES, DENSE;
        /// Pointwise convolution of normed tokens from 64 channels, held, for CPU drivers.
        LINEAR_K64_NORM_CPU = "linear_k64_norm_cpu" "linear_stationary.comp" LinearPush
            { "TX": "2", "TY": "2", "INPUTS": "16", "NORM": "1", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES, DENSE;
        /// Pointwise convolution of normed tokens from 128 channels, held, for CPU drivers.
        LINEAR_K128_NORM_CPU = "linear_k128_norm_cpu" "linear_stationary.comp" LinearPush
            { "TX": "2", "TY": "1", "INPUTS": "32", "NORM": "1", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES, DENSE;
        /// Depthwise convolution.
        DEPTHWISE3X3 = "depthwise3x3" "depthwise3x3.comp" Depthwise3x3Push { "TX": "4", "TY": "2" } &[], HALVES, DENSE;
        /// The same for CPU drivers.
        DEPTHWISE3X3_CPU = "depthwise3x3_cpu" "depthwise3x3.comp" Depthwise3x3Push
            { "TX": "8", "TY": "4", "TEXELS": "1" } CPU, CPU_HALVES, DENSE;
        /// Layer normalisation.
        LAYER_NORM = "layer_norm" "layer_norm.comp" LayerNormPush {} &[], HALVES;
        /// The same for CPU drivers.
        LAYER_NORM_CPU = "layer_norm_cpu" "layer_norm.comp" LayerNormPush { "TEXELS": "1" } CPU, CPU_HALVES;
        /// Joint window attention.
        WINDOW_ATTENTION = "window_attention" "window_attention.comp" WindowAttentionPush {} &[], HALVES;
        /// The same for CPU drivers.
        WINDOW_ATTENTION_CPU = "window_attention_cpu" "window_attention.comp" WindowAttentionPush
            { "TEXELS": "1" } CPU, CPU_HALVES;
        /// Joint window attention, 8 channels of keys and 16 of values, for CPU drivers.
        WINDOW_ATTENTION_V16_CPU = "window_attention_v16_cpu" "window_attention_rows.comp" WindowAttentionPush
            { "KEYS": "2", "VALUES": "4", "QUERIES": "2", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES;
        /// Joint window attention, 16 channels of keys and 32 of values, for CPU drivers.
        WINDOW_ATTENTION_V32_CPU = "window_attention_v32_cpu" "window_attention_rows.comp" WindowAttentionPush
            { "KEYS": "4", "VALUES": "8", "QUERIES": "1", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES;
        /// Joint window attention, 32 channels of keys and of values a head, for CPU drivers.
        WINDOW_ATTENTION_HEADS_CPU = "window_attention_heads_cpu" "window_attention_rows.comp" WindowAttentionPush
            { "KEYS": "8", "VALUES": "8", "QUERIES": "1", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES;
        /// A small map made large.
        EXPAND = "expand" "expand.comp" ExpandPush {} &[], HALVES;
        /// The same for CPU drivers.
        EXPAND_CPU = "expand_cpu" "expand.comp" ExpandPush { "TEXELS": "1" } CPU, CPU_HALVES;
        /// What kernels of pixels are predicted from.
        KERNEL_INPUTS = "kernel_inputs" "kernel_inputs.comp" KernelInputsPush { "TX": "2" } &[], HALVES;
        /// The same for CPU drivers.
        KERNEL_INPUTS_CPU = "kernel_inputs_cpu" "kernel_inputs.comp" KernelInputsPush
            { "TX": "4", "LANES_SHARE": "1", "TEXELS": "1" } CPU, CPU_HALVES;
        /// Zeros.
        FILL = "fill" "fill.comp" FillPush {} &[], HALVES;
        /// Partial sums of tokens.
        TOKEN_SUM = "token_sum" "token_sum.comp" TokenSumPush {} &[], HALVES;
        /// Features' input.
        INPUT_AUX = "input_aux" "input_aux.comp" InputAuxPush {} &[], HALVES;
        /// Features' input from images.
        INPUT_AUX_IMAGE = "input_aux_image" "input_aux.comp" InputAuxPush { "IMAGES": "1" } &[], HALVES;
        /// Features' input, its albedo filtered where it is noisy.
        INPUT_AUX_FILTERED = "input_aux_filtered" "input_aux.comp" InputAuxPush { "FILTERED": "1" } &[], HALVES;
        /// The same from images.
        INPUT_AUX_FILTERED_IMAGE = "input_aux_filtered_image" "input_aux.comp" InputAuxPush
            { "FILTERED": "1", "IMAGES": "1" } &[], HALVES;
    }
    others {
        /// Convolution, stride 1, from a map of 32-bit floats to one of halves.
        CONV3X3_TO_F16 = "conv3x3_to_f16" "conv3x3_staged.comp" Conv3x3Push
            { "STRIDE": "1", "OUTPUTS": "32", "DST_F16": "1" } HALVES, DENSE;
        /// Convolution to at most 4 channels, from a map of halves to one of 32-bit floats.
        CONV3X3_N4_FROM_F16 = "conv3x3_n4_from_f16" "conv3x3.comp" Conv3x3Push
            { "STRIDE": "1", "TX": "4", "TY": "2", "NV": "1", "SRC_F16": "1" } &[], DENSE;
        /// Tokens of 2x2 to pixels.
        UNEMBED = "unembed" "unembed.comp" UnembedPush { "TX": "4" } &[];
        /// The same from a map of halves.
        UNEMBED_FROM_F16 = "unembed_from_f16" "unembed.comp" UnembedPush { "TX": "4", "SRC_F16": "1" } &[];
        /// The same from a map of halves on cooperative matrices.
        UNEMBED_MATRIX = "unembed_matrix" "unembed_matrix.comp" UnembedPush { "SRC_F16": "1" } MATRICES, UNEMBED_MATRIX_CUT;
        /// The same for CPU drivers, from a map of either.
        UNEMBED_CPU = "unembed_cpu" "unembed.comp" UnembedPush
            { "TX": "8", "LANES_SHARE": "1", "TEXELS": "1" } CPU;
        /// Kernels of every pixel.
        PREDICT_KERNELS = "predict_kernels" "predict_kernels.comp" PredictKernelsPush { "TX": "2" } &[];
        /// The same from maps of halves.
        PREDICT_KERNELS_FROM_F16 = "predict_kernels_from_f16" "predict_kernels.comp" PredictKernelsPush
            { "TX": "2", "SRC_F16": "1" } &[];
        /// The same for CPU drivers, from maps of either.
        PREDICT_KERNELS_CPU = "predict_kernels_cpu" "predict_kernels.comp" PredictKernelsPush
            { "TX": "4", "LANES_SHARE": "1", "TEXELS": "1" } CPU;
        /// Means of 2x2 tokens.
        HALVE = "halve" "halve.comp" HalvePush {} &[];
        /// The same, with an albedo of halves.
        HALVE_BY_F16 = "halve_by_f16" "halve.comp" HalvePush { "SRC_F16": "1" } &[];
        /// The same for CPU drivers.
        HALVE_CPU = "halve_cpu" "halve.comp" HalvePush { "TEXELS": "1" } CPU;
        /// Kernels of every token over images.
        APPLY_KERNELS = "apply_kernels" "apply_kernels.comp" ApplyKernelsPush {} &[];
        /// The same from logits of halves.
        APPLY_KERNELS_FROM_F16 = "apply_kernels_from_f16" "apply_kernels.comp" ApplyKernelsPush { "SRC_F16": "1" } &[];
        /// The same for CPU drivers, from logits of either.
        APPLY_KERNELS_CPU = "apply_kernels_cpu" "apply_kernels.comp" ApplyKernelsPush { "TEXELS": "1" } CPU;
        /// Levels of kernels to one picture.
        MIX_LEVELS = "mix_levels" "mix_levels.comp" MixLevelsPush {} &[];
        /// The same for CPU drivers.
        MIX_LEVELS_CPU = "mix_levels_cpu" "mix_levels.comp" MixLevelsPush { "TEXELS": "1" } CPU;
        /// What squares of the result get back of the light.
        ENERGY_GAINS = "energy_gains" "energy_gains.comp" EnergyGainsPush {} &[];
        /// The same for CPU drivers.
        ENERGY_GAINS_CPU = "energy_gains_cpu" "energy_gains.comp" EnergyGainsPush { "TEXELS": "1" } CPU;
        /// Convolution on cooperative matrices, stride 1.
        CONV3X3_MATRIX = "conv3x3_matrix" "conv3x3_matrix.comp" Conv3x3Push
            { "SRC_F16": "1", "DST_F16": "1", "STRIDE": "1" } MATRICES, DENSE_MATRIX_CUT;
        /// The same of normed tokens.
        CONV3X3_NORM_MATRIX = "conv3x3_norm_matrix" "conv3x3_matrix.comp" NormedConv3x3Push
            { "SRC_F16": "1", "DST_F16": "1", "STRIDE": "1", "NORM": "1" } MATRICES, DENSE_MATRIX_CUT;
        /// Convolution on cooperative matrices, stride 2.
        CONV3X3_S2_MATRIX = "conv3x3_s2_matrix" "conv3x3_matrix.comp" Conv3x3Push
            { "SRC_F16": "1", "DST_F16": "1", "STRIDE": "2" } MATRICES, DENSE_MATRIX_CUT;
        /// Convolution of the network's input on cooperative matrices.
        CONV3X3_FIRST_MATRIX = "conv3x3_first_matrix" "conv3x3_first_matrix.comp" Conv3x3Push
            { "DST_F16": "1" } MATRICES, FIRST_MATRIX;
        /// Pointwise convolution on cooperative matrices.
        LINEAR_MATRIX = "linear_matrix" "linear_matrix.comp" LinearPush
            { "SRC_F16": "1", "DST_F16": "1" } MATRICES, DENSE_MATRIX_CUT;
        /// The same of normed tokens.
        LINEAR_NORM_MATRIX = "linear_norm_matrix" "linear_matrix.comp" LinearPush
            { "SRC_F16": "1", "DST_F16": "1", "NORM": "1" } MATRICES, DENSE_MATRIX_CUT;
        /// Depthwise and pointwise convolution in one on cooperative matrices.
        SEPARABLE3X3_MATRIX = "separable3x3_matrix" "separable3x3_matrix.comp" Separable3x3Push
            { "SRC_F16": "1", "DST_F16": "1" } MATRICES, SEPARABLE_MATRIX_CUT;
        /// An FFN in one on cooperative matrices.
        FFN_MATRIX = "ffn_matrix" "ffn_matrix.comp" FfnPush
            { "SRC_F16": "1", "DST_F16": "1" } MATRICES, FFN_MATRIX_CUT;
        /// The features' projection in one on cooperative matrices.
        AUX_PROJECTION_MATRIX = "aux_projection_matrix" "aux_projection_matrix.comp" AuxProjectionPush
            { "SRC_F16": "1", "DST_F16": "1" } MATRICES, AUX_MATRIX;
        /// The colour's projection and embedding in one on cooperative matrices.
        COLOR_EMBEDDING_MATRIX = "color_embedding_matrix" "embedding_matrix.comp" EmbeddingPush
            { "DST_F16": "1", "PROJECTED": "1" } MATRICES, MATRIX;
        /// The same, with what a head of kernels takes of the projected pixels.
        COLOR_EMBEDDING_EARLY_MATRIX = "color_embedding_early_matrix" "embedding_matrix.comp" EmbeddingPush
            { "DST_F16": "1", "PROJECTED": "1", "EARLY": "1" } MATRICES, MATRIX;
        /// The embedding of pixels that are there.
        EMBEDDING_MATRIX = "embedding_matrix" "embedding_matrix.comp" EmbeddingPush
            { "SRC_F16": "1", "DST_F16": "1" } MATRICES, MATRIX;
        /// The same, with what a head of kernels takes of them.
        EMBEDDING_EARLY_MATRIX = "embedding_early_matrix" "embedding_matrix.comp" EmbeddingPush
            { "SRC_F16": "1", "DST_F16": "1", "EARLY": "1" } MATRICES, MATRIX;
        /// What kernels of pixels are predicted from, on cooperative matrices.
        KERNEL_INPUTS_MATRIX = "kernel_inputs_matrix" "kernel_inputs_matrix.comp" KernelInputsPush
            { "SRC_F16": "1", "DST_F16": "1" } MATRICES, MATRIX;
        /// Kernels of every pixel, on cooperative matrices.
        PREDICT_KERNELS_MATRIX = "predict_kernels_matrix" "predict_kernels_matrix.comp" PredictKernelsPush
            { "SRC_F16": "1" } MATRICES, PREDICT_MATRIX;
        /// Joint window attention on cooperative matrices.
        WINDOW_ATTENTION_MATRIX = "window_attention_matrix" "window_attention_matrix.comp" WindowAttentionPush
            { "SRC_F16": "1", "DST_F16": "1" } MATRICES, ATTENTION_MATRIX_CUT;
        /// A block's attention with its Linears in one on cooperative matrices.
        ATTENTION_BLOCK_MATRIX = "attention_block_matrix" "attention_block_matrix.comp" AttentionBlockPush
            { "SRC_F16": "1", "DST_F16": "1" } MATRICES, ATTENTION_BLOCK_CUT;
        /// FiLM vectors.
        FILM_VECTOR = "film_vector" "film_vector.comp" FilmVectorPush {} &[];
        /// A histogram to zero.
        STATS_CLEAR = "stats_clear" "stats_clear.comp" StatsClearPush {} &[];
        /// Histogram.
        STATS_HISTOGRAM = "stats_histogram" "stats_histogram.comp" StatsHistogramPush {} &[];
        /// Histogram of an image.
        STATS_HISTOGRAM_IMAGE = "stats_histogram_image" "stats_histogram.comp" StatsHistogramPush
            { "IMAGES": "1" } &[];
        /// Median or depth scale.
        STATS_SELECT = "stats_select" "stats_select.comp" StatsSelectPush {} &[];
        /// Light and noise of tiles.
        STATS_TILES = "stats_tiles" "stats_tiles.comp" StatsTilesPush {} &[];
        /// Light and noise of an image's tiles.
        STATS_TILES_IMAGE = "stats_tiles_image" "stats_tiles.comp" StatsTilesPush { "IMAGES": "1" } &[];
        /// Key, exposure, noise and largest samples.
        STATS_KEY = "stats_key" "stats_key.comp" StatsKeyPush {} &[];
        /// Noise of the map's squares.
        TILE_NOISE = "tile_noise" "tile_noise.comp" TileNoisePush {} &[];
        /// The same from images.
        TILE_NOISE_IMAGE = "tile_noise_image" "tile_noise.comp" TileNoisePush { "IMAGES": "1" } &[];
        /// Map of what is to be denoised.
        CONVERGED_MAP = "converged_map" "converged_map.comp" ConvergedMapPush {} &[];
        /// Lists of active tiles.
        TILE_LIST = "tile_list" "tile_list.comp" TileListPush {} &[];
        /// Colour input.
        INPUT_COLOR = "input_color" "input_color.comp" InputColorPush {} &[];
        /// Colour input from an image.
        INPUT_COLOR_IMAGE = "input_color_image" "input_color.comp" InputColorPush { "IMAGES": "1" } &[];
        /// A signal to what predicted kernels read.
        INPUT_SIGNAL = "input_signal" "input_signal.comp" InputSignalPush {} &[];
        /// The same beside albedo of halves.
        INPUT_SIGNAL_FROM_F16 = "input_signal_from_f16" "input_signal.comp" InputSignalPush { "SRC_F16": "1" } &[];
        /// The same beside colour in an image.
        INPUT_SIGNAL_IMAGE = "input_signal_image" "input_signal.comp" InputSignalPush { "IMAGES": "1" } &[];
        /// The same with albedo of halves.
        INPUT_SIGNAL_IMAGE_FROM_F16 = "input_signal_image_from_f16" "input_signal.comp" InputSignalPush
            { "IMAGES": "1", "SRC_F16": "1" } &[];
        /// A filtered signal to 32-bit planes.
        OUTPUT_SIGNAL_F32 = "output_signal_f32" "output_signal.comp" OutputSignalPush {} &[];
        /// A filtered signal to 16-bit planes.
        OUTPUT_SIGNAL_F16 = "output_signal_f16" "output_signal.comp" OutputSignalPush { "TARGET_F16": "1" } &[Need::Storage16];
        /// Output to 32-bit planes.
        OUTPUT_F32 = "output_f32" "output.comp" OutputPush { "TARGET_F32": "1" } &[];
        /// Output to 16-bit planes.
        OUTPUT_F16 = "output_f16" "output.comp" OutputPush { "TARGET_F16": "1" } &[Need::Storage16];
        /// Output to an rgba32f image.
        OUTPUT_IMAGE_F32 = "output_image_f32" "output.comp" OutputPush
            { "IMAGES": "1", "TARGET_FORMAT": "rgba32f" } &[];
        /// Output to an rgba16f image.
        OUTPUT_IMAGE_F16 = "output_image_f16" "output.comp" OutputPush
            { "IMAGES": "1", "TARGET_FORMAT": "rgba16f", "TARGET_MAX": "65504.0" } &[];
        /// Multiply-adds of 32-bit floats.
        ROOF_FMA_F32 = "roof_fma_f32" "roof_fma.comp" RoofFmaPush {} &[];
        /// Multiply-adds of pairs of halves.
        ROOF_FMA_F16 = "roof_fma_f16" "roof_fma.comp" RoofFmaPush { "HALF": "1" } &[Need::Float16];
        /// Products of matrices of halves.
        ROOF_MATRIX = "roof_matrix" "roof_matrix.comp" RoofFmaPush {} MATRICES, MATRIX;
        /// A copy of 32-bit floats.
        ROOF_COPY_F32 = "roof_copy_f32" "roof_copy.comp" RoofCopyPush {} &[];
        /// A copy of halves.
        ROOF_COPY_F16 = "roof_copy_f16" "roof_copy.comp" RoofCopyPush { "SRC_F16": "1", "DST_F16": "1" } HALVES;
    }
}

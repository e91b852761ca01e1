//! The command line.

use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::net::{Arch, Folds, Head};
use vkdenoise::options::{AttentionForm, ConvAlgorithm, FfnForm, SeparableForm};
use vkdenoise::{ConvergedMode, DeviceSelector, Extent, Precision, Region};

/// Where the time goes: networks, blocks and convolutions, kernel by kernel, by timestamps in the command buffer.
///
/// Every time is the median of the repeats after a warm-up, with the least and the spread (the distance between the
/// quartiles). FLOPs are those that the network asks for, two a multiply-add, whatever a kernel computes; bytes are
/// what a kernel must read and write once. Percent of the roof: of the multiply-add rate or of what the copy bandwidth
/// feeds at the kernel's intensity, whichever is less, both measured in the same run.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100)]
pub struct Arguments {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// Every kernel of a network
    Network {
        /// Which network
        #[arg(long, value_name = "A", default_value = "hybrid", value_parser = Arch::NAMES)]
        arch: String,
        /// How its last maps become the picture: residual, or predicted kernels: pure, with gloss (not all of the light
        /// is divided by the albedo), or gated with the residual
        #[arg(long, value_name = "H", default_value = "residual")]
        head: Head,
        /// Frame size
        #[arg(long, value_name = "WxH", default_value = "512x512", value_parser = size)]
        size: Extent,
        /// Which operations are folded into others: all, none, or some of unembed, skip, unread and norm
        #[arg(long, value_name = "F", default_value = "all")]
        folds: Folds,
        /// How dense 3x3 convolutions are computed; as suits the device where it is left out
        #[arg(long, value_name = "K")]
        conv: Option<Conv>,
        /// How depthwise-separable convolutions are computed; as suits the device where it is left out
        #[arg(long, value_name = "F")]
        separable: Option<Separable>,
        /// How a block's attention is computed on matrices; as suits the device where it is left out
        #[arg(long, value_name = "F")]
        attention: Option<Attention>,
        /// How an FFN is computed on matrices; as suits the device where it is left out
        #[arg(long, value_name = "F")]
        ffn: Option<Ffn>,
        /// Arithmetic: "auto" (as suits the device), "fp32" or "matrix" (dense convolutions on cooperative matrices)
        #[arg(long, value_name = "P", env = "VKDENOISE_PRECISION", default_value = "auto", value_parser = precision)]
        precision: Precision,
        /// Run chains of kernels band by band of the frame where a map between them would take more than this; as suits
        /// the device where it is left out
        #[arg(long, value_name = "MIB")]
        max_chain_mib: Option<u64>,
        /// Denoise these pixels alone: left column, top row, width, height
        #[arg(long, value_name = "X,Y,W,H")]
        region: Option<Region>,
        /// Have sample counts say that this share of the frame's rows needs no denoising, from 0 to 1
        #[arg(long, value_name = "SHARE", value_parser = share)]
        converged: Option<f64>,
        /// How that is left out: exact or approximate
        #[arg(long, value_name = "M", default_value = "approximate", value_parser = converged_mode, requires = "converged")]
        converged_mode: ConvergedMode,
        /// Albedo, normal and depth of the frame
        #[arg(long, value_name = "F", default_value = "all")]
        features: Given,
        #[command(flatten)]
        common: Common,
        #[command(flatten)]
        output: Output,
    },
    /// One convolution: standard (direct, Winograd) against depthwise-separable (two kernels, fused)
    Conv {
        /// Size of the map
        #[arg(long, value_name = "WxH", default_value = "1024x1024", value_parser = size)]
        size: Extent,
        /// Channels in and out
        #[arg(long, value_name = "C", default_value_t = 32)]
        channels: u32,
        #[command(flatten)]
        common: Common,
        #[command(flatten)]
        output: Output,
    },
    /// One block: FiLM-CNN against SH-JSA
    Blocks {
        /// Sides of the maps
        #[arg(long, value_name = "N,...", value_delimiter = ',', default_values_t = [128, 256, 512])]
        sizes: Vec<u32>,
        /// Channels
        #[arg(long, value_name = "C,...", value_delimiter = ',', default_values_t = [32, 64])]
        channels: Vec<u32>,
        #[command(flatten)]
        common: Common,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// The ten networks of the thesis: parameters, FLOPs, times
    Tables {
        /// Frame size
        #[arg(long, value_name = "WxH", default_value = "256x256", value_parser = size)]
        size: Extent,
        #[command(flatten)]
        common: Common,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// What a network asks of a device, kernel by kernel, and the time that a roofline gives it: nothing runs
    Plan {
        /// Which network
        #[arg(long, value_name = "A", default_value = "hybrid", value_parser = Arch::NAMES)]
        arch: String,
        /// How its last maps become the picture: residual, or predicted kernels: pure, with gloss (not all of the light
        /// is divided by the albedo), or gated with the residual
        #[arg(long, value_name = "H", default_value = "residual")]
        head: Head,
        /// Frame size
        #[arg(long, value_name = "WxH", default_value = "1024x1024", value_parser = size)]
        size: Extent,
        /// Arithmetic and storage: auto, fp32, fp16 or matrix
        #[arg(long, value_name = "P", env = "VKDENOISE_PRECISION", default_value = "auto", value_parser = precision)]
        precision: Precision,
        /// How an FFN is computed on matrices; as suits the device where it is left out
        #[arg(long, value_name = "F")]
        ffn: Option<Ffn>,
        /// Which device: "h100" (measured), "mid-range" (0.5 TB/s, 58 TFLOP/s on matrices), "device" (the one at hand),
        /// or a JSON file
        #[arg(long, value_name = "T", default_value = "h100")]
        target: String,
        #[command(flatten)]
        common: Common,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// What the device can do at most: multiply-adds and copies
    Roof {
        #[command(flatten)]
        common: Common,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

/// Which features a frame has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Given {
    /// All of them
    All,
    /// None
    None,
    /// All, the same as in the frame before: what depends on them alone is kept
    Unchanged,
}

/// Forms of dense 3x3 convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Conv {
    /// By the definition
    Direct,
    /// Winograd's F(2x2, 3x3)
    Winograd2,
    /// Winograd's F(4x4, 3x3)
    Winograd4,
}

impl From<Conv> for ConvAlgorithm {
    fn from(conv: Conv) -> Self {
        match conv {
            Conv::Direct => Self::Direct,
            Conv::Winograd2 => Self::Winograd(WinogradTile::F2),
            Conv::Winograd4 => Self::Winograd(WinogradTile::F4),
        }
    }
}

/// Forms of depthwise-separable convolution.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Separable {
    /// Depthwise, then pointwise
    TwoKernels,
    /// Both in one kernel
    Fused,
    /// Both in one kernel where the result has no more channels than a workgroup computes
    Narrow,
}

impl From<Separable> for SeparableForm {
    fn from(separable: Separable) -> Self {
        match separable {
            Separable::TwoKernels => Self::TwoKernels,
            Separable::Fused => Self::Fused,
            Separable::Narrow => Self::Narrow,
        }
    }
}

/// Forms of a block's attention.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Attention {
    /// With its Linears in one kernel
    Joined,
    /// Two Linears, the attention and its projection
    FourKernels,
}

impl From<Attention> for AttentionForm {
    fn from(attention: Attention) -> Self {
        match attention {
            Attention::Joined => Self::Joined,
            Attention::FourKernels => Self::FourKernels,
        }
    }
}

/// Forms of an FFN.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Ffn {
    /// All of it in one kernel, up to 64 channels
    Joined,
    /// The Linear to the hidden channels, and the rest
    TwoKernels,
}

impl From<Ffn> for FfnForm {
    fn from(ffn: Ffn) -> Self {
        match ffn {
            Ffn::Joined => Self::Joined,
            Ffn::TwoKernels => Self::TwoKernels,
        }
    }
}

/// What every measurement takes.
#[derive(Debug, Args)]
pub struct Common {
    /// Timed runs
    #[arg(long, value_name = "N", default_value_t = 7, value_parser = clap::value_parser!(u32).range(1..))]
    pub repeat: u32,
    /// Runs before the first timed one
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub warm_up: u32,
    /// Vulkan device: "best", an index or part of a name
    #[arg(long, value_name = "D", env = "VKDENOISE_DEVICE", default_value = "best")]
    pub device: DeviceSelector,
    /// Subgroups that share a tile's tokens in dense kernels on matrices: 1 or 2; as suits the device where it is left
    /// out
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=2))]
    pub matrix_halves: Option<u32>,
    /// Time whole passes on the host, and no kernels, as on a device without timestamps
    #[arg(long)]
    pub host_clock: bool,
}

/// Where a measurement goes: a table on standard output, or elsewhere.
#[derive(Debug, Args)]
pub struct Output {
    /// Print JSON in place of the table
    #[arg(long)]
    pub json: bool,
    /// Write the kernels as CSV
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Write one run as a Chrome trace (chrome://tracing, Perfetto)
    #[arg(long, value_name = "FILE")]
    pub trace: Option<PathBuf>,
    /// Draw the kernels under the roofline
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
}

fn share(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(share) if (0.0..=1.0).contains(&share) => Ok(share),
        _ => Err("give a number from 0 to 1".into()),
    }
}

fn converged_mode(text: &str) -> Result<ConvergedMode, String> {
    text.parse().map_err(|error: vkdenoise::Error| error.to_string())
}

fn precision(text: &str) -> Result<Precision, String> {
    text.parse().map_err(|error: vkdenoise::Error| error.to_string())
}

/// `512x256`, or one number for a square.
pub fn size(text: &str) -> Result<Extent, String> {
    let (width, height) = text.split_once('x').unwrap_or((text, text));
    match (width.parse(), height.parse()) {
        (Ok(width), Ok(height)) if width > 0 && height > 0 => Ok(Extent::new(width, height)),
        _ => Err(format!("'{text}' is not a size such as 512x512")),
    }
}

//! `vkdenoise-bench budget`: where precision goes, dispatch by dispatch.

use crate::budget::{Result, measure, result, table};
use std::path::PathBuf;
use vkdenoise::exr_io::{ExrFrame, LayerOptions};
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::options::ConvAlgorithm;
use vkdenoise::target::Target;
use vkdenoise::testing::Bench;
use vkdenoise::{Device, DeviceSelector, Extent, Frame, Weights};

/// Options of `vkdenoise-bench budget`.
#[derive(clap::Args)]
pub struct BudgetArgs {
    /// The frame: an EXR file with what features it has. Its upper left 256 x 256 pixels are used, or what --size says.
    frame: PathBuf,
    /// How much of the frame; the f64 reference takes half a minute for 256x256 on two cores.
    #[arg(long, default_value = "256x256", value_parser = crate::parse_size)]
    size: Extent,
    /// Device: an index or part of a name.
    #[arg(long, env = "VKDENOISE_DEVICE", default_value = "best")]
    device: DeviceSelector,
    /// Weights instead of the built-in ones.
    #[arg(long)]
    weights: Option<PathBuf>,
    /// How dense 3x3 convolutions are computed.
    #[arg(long, value_enum, default_value_t = Form::Direct)]
    conv: Form,
    /// Write the table as Markdown.
    #[arg(long)]
    markdown: Option<PathBuf>,
}

/// Forms of the dense 3x3 convolution.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Form {
    /// By the definition.
    Direct,
    /// Winograd F(2x2, 3x3).
    F2,
    /// Winograd F(4x4, 3x3).
    F4,
}

impl Form {
    fn target(self) -> Target {
        let conv = match self {
            Self::Direct => ConvAlgorithm::Direct,
            Self::F2 => ConvAlgorithm::Winograd(WinogradTile::F2),
            Self::F4 => ConvAlgorithm::Winograd(WinogradTile::F4),
        };
        Target { conv, ..Target::default() }
    }
}

/// Runs it.
pub fn run(args: &BudgetArgs) -> Result<()> {
    let device = Device::open(&args.device)?;
    let weights = args.weights.as_ref().map_or_else(Weights::hybrid_kernels, |path| Ok(Weights::from_file(path)?))?;
    let file = ExrFrame::read(&args.frame, &LayerOptions::default())?;
    let whole = file.frame();
    let extent = Extent::new(args.size.width.min(whole.extent.width), args.size.height.min(whole.extent.height));
    // The strides stay those of the whole frame.
    let frame = Frame { extent, ..whole };
    let target = Target { kernels: Bench::default_target(&device), ..args.conv.target() };
    let lines = measure(&device, &weights, &frame, &target)?;
    if let Some(path) = &args.markdown {
        std::fs::write(path, table::markdown(&lines))?;
    }
    print!("{}", table::text(&lines));
    if let Some(line) = result(&lines) {
        println!("result: NMSE {:.1e}", line.nmse);
    }
    Ok(())
}

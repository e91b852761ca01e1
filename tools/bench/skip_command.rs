//! `skip`: what is saved where a frame does not need everything.

use crate::{parse_size, stress};
use clap::Args;
use cpu_time::ProcessTime;
use vkdenoise::{
    Denoiser, Device, DeviceSelector, Error, Extent, Features, Frame, Layout, Options, Plane, PlaneMut, Region, Weights,
};

/// Arguments of `skip`.
#[derive(Args)]
pub struct SkipArgs {
    /// Frame size.
    #[arg(long, default_value = "1024x1024", value_parser = parse_size)]
    size: Extent,
    /// Side of the square region in the middle.
    #[arg(long, default_value_t = 128)]
    region: u32,
    /// Only this case beside the whole frame: region, "features unchanged" or "no features"; may be given again.
    #[arg(long, value_parser = CASES)]
    case: Vec<String>,
    /// Timed rounds; each runs every case once, in turn.
    #[arg(long, default_value_t = 7)]
    repeat: u32,
    /// Device: an index or part of a name.
    #[arg(long, env = "VKDENOISE_DEVICE", default_value = "best")]
    device: DeviceSelector,
}

/// The cases' names.
const CASES: [&str; 3] = ["region", "features unchanged", "no features"];

/// One way of leaving something out.
struct Case {
    name: &'static str,
    /// Whether the denoiser that keeps features runs it, and takes them as unchanged.
    unchanged: bool,
    features: bool,
    region: Option<Region>,
    /// Share of the FLOPs of the first case.
    work: f64,
    seconds: Vec<f64>,
}

/// CPU seconds of a whole call, case by case in turn; medians, and ratios to the whole frame's. One JSON object a case.
pub fn run(args: &SkipArgs) -> stress::Result<()> {
    let (extent, side) = (args.size, args.region.clamp(1, args.size.width.min(args.size.height)));
    let middle = Region { x: (extent.width - side) / 2, y: (extent.height - side) / 2, width: side, height: side };
    let case =
        |name, unchanged, features, region| Case { name, unchanged, features, region, work: 0.0, seconds: vec![] };
    let [region, unchanged, none] = CASES;
    let mut cases = vec![
        case("whole", false, true, None),
        case(region, false, true, Some(middle)),
        case(unchanged, true, true, None),
        case(none, false, false, None),
    ];
    let wanted = |name: &str| args.case.is_empty() || args.case.iter().any(|case| case == name);
    cases.retain(|case| case.name == "whole" || wanted(case.name));
    let device = Device::open(&args.device)?;
    let weights = Weights::hybrid_kernels()?;
    let keeping = Options { keep_features: true, ..Options::default() };
    let mut denoisers =
        [Denoiser::new(&device, &weights, &Options::default())?, Denoiser::new(&device, &weights, &keeping)?];
    let pixels = extent.pixels() as usize;
    // Any values do: the work does not depend on them.
    let noise = |i: usize| (i.wrapping_mul(2_654_435_761) >> 16 & 0xffff) as f32 / 65536.0;
    let color: Vec<f32> = (0..3 * pixels).map(|i| noise(i) * noise(i / 3) * 4.0).collect();
    let (rgb, one) = (Layout::interleaved(extent, 3), Layout::interleaved(extent, 1));
    let plane = Some(Plane::f32(&color, rgb));
    let features = Features { albedo: plane, normal: plane, depth: Some(Plane::f32(&color, one)), noise: None };
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features };
    let mut output = vec![0.0; color.len()];
    let mut denoise = |denoiser: &mut Denoiser, frame: &Frame| -> Result<(f64, f64), Error> {
        let clock = ProcessTime::now();
        let report = denoiser.denoise(frame, PlaneMut::f32(&mut output, rgb))?;
        Ok((clock.elapsed().as_secs_f64(), report.work))
    };
    if wanted(unchanged) {
        denoise(&mut denoisers[1], &frame)?;
    }
    // The first round compiles.
    for round in 0..=args.repeat {
        for case in &mut cases {
            let denoiser = &mut denoisers[usize::from(case.unchanged)];
            denoiser.set_features_unchanged(case.unchanged);
            denoiser.set_region(case.region);
            let features = if case.features { features } else { Features::default() };
            let (seconds, work) = denoise(denoiser, &Frame { features, ..frame })?;
            case.work = work;
            if round > 0 {
                case.seconds.push(seconds);
            }
        }
    }
    let whole = median(&cases[0].seconds);
    for case in &cases {
        let line = serde_json::json!({
            "device": device.info().name, "driver": device.info().driver,
            "width": extent.width, "height": extent.height, "region": case.region.map(|_| side),
            "case": case.name, "work": case.work,
            "cpu_s": median(&case.seconds), "ratio": median(&case.seconds) / whole,
        });
        println!("{line}");
    }
    Ok(())
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}

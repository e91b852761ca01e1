//! `resize`: what a frame size costs the CPU in an arena that several share, as a renderer changes its resolution.

use crate::{parse_size, stress};
use clap::Args;
use std::time::Instant;
use vkdenoise::{
    Arena, BufferFrame, BufferPlane, Denoiser, Device, DeviceSelector, Extent, Layout, MemoryHandle, Options, Quality,
    SampleFormat, SharedBuffer,
};

/// Arguments of `resize`.
#[derive(Args)]
pub struct ResizeArgs {
    /// The largest frame size.
    #[arg(long, default_value = "1920x1080", value_parser = parse_size)]
    size: Extent,
    /// The sizes in percent of its sides.
    #[arg(long, value_delimiter = ',', default_value = "100,83,75,67,50")]
    percent: Vec<u32>,
    /// Times that each is made; the best counts.
    #[arg(long, default_value_t = 5)]
    repeat: u32,
    /// fast, balanced or high.
    #[arg(long, default_value = "balanced")]
    quality: Quality,
    /// Device: an index or part of a name.
    #[arg(long, env = "VKDENOISE_DEVICE", default_value = "best")]
    device: DeviceSelector,
}

/// Milliseconds to plan a size, to make its pass, and to bind colour and output for the first time and again. One JSON
/// object a size.
pub fn run(args: &ResizeArgs) -> stress::Result<()> {
    let device = Device::open(&args.device)?;
    let options = Options {
        precision: args.quality.precision(&device),
        converged: args.quality.converged(),
        ..Options::default()
    };
    let denoiser = Denoiser::new(&device, &args.quality.weights()?, &options)?;
    let part = |percent: &u32| {
        let side = |side: u32| (u64::from(side) * u64::from(*percent) / 100).max(1) as u32;
        Extent::new(side(args.size.width), side(args.size.height))
    };
    let sizes: Vec<_> = args.percent.iter().map(part).collect();
    let required = denoiser.arena_required(&sizes)?;
    let arena = Arena::new(&device, &required)?;
    let most = sizes.iter().map(|size| size.pixels()).max().unwrap_or(1);
    let buffer = SharedBuffer::new(&device, 12 * most, MemoryHandle::OpaqueFd)?;
    for extent in sizes {
        let (layout, size) = (Layout::interleaved(extent, 3), buffer.size());
        let plane = BufferPlane { buffer: buffer.raw(), size, format: SampleFormat::F32, layout };
        let frame = BufferFrame::new(plane, plane);
        let mut best = [f64::INFINITY; 3];
        let mut first_bind = None;
        let mut own = 0;
        for _ in 0..args.repeat.max(1) {
            let mut clock = Instant::now();
            let mut lap = || std::mem::replace(&mut clock, Instant::now()).elapsed().as_secs_f64() * 1e3;
            denoiser.memory_required(extent)?;
            let plan = lap();
            let pass = denoiser.pass_in(&arena, extent)?;
            let make = lap();
            // SAFETY: the buffer outlives the binding; nothing is recorded.
            let binding = unsafe { pass.bind_buffers(&frame)? };
            let bind = lap();
            drop(binding);
            first_bind.get_or_insert(bind);
            own = pass.device_bytes();
            for (best, took) in best.iter_mut().zip([plan, make, bind]) {
                *best = best.min(took);
            }
        }
        let [plan, make, bind] = best;
        let line = serde_json::json!({
            "width": extent.width, "height": extent.height, "plan_ms": plan, "pass_ms": make,
            "first_bind_ms": first_bind, "bind_ms": bind, "own_bytes": own, "arena_bytes": arena.bytes(),
        });
        println!("{line}");
    }
    Ok(())
}

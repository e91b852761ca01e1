//! Times of kernels: on the host path, and in a renderer's command buffer with slots for two frames in flight.

mod common;

use common::case::PREPROCESSING;
use common::device::{assert_no_validation_messages, device};
use common::vulkan::Renderer;
use cpu_time::ProcessTime;
use std::sync::{Mutex, PoisonError};
use vkdenoise::microbench::PartRunner;
use vkdenoise::net::{Convolution, Graph};
use vkdenoise::profile::Roof;
use vkdenoise::target::Target;
use vkdenoise::{
    BufferFrame, BufferPlane, Denoiser, Device, DeviceKind, DeviceOptions, DeviceSelector, Error, Extent, Features,
    Frame, FrameOptions, KernelRecord, Layout, Options, Plane, PlaneMut, Precision, SampleFormat, Weights,
};

const EXTENT: Extent = Extent::new(150, 100);
/// The frame whose time is compared: what a timestamp costs and what lies between two dispatches (5.5 % of 256x256, 0.7
/// % of 1024x1024) does not grow with the kernels, and those of a small frame are shorter than any in use.
const TIMED: Extent = Extent::new(384, 384);

/// Held by whoever runs: other work on the same cores would show in the times.
static ALONE: Mutex<()> = Mutex::new(());

/// One run of the host path.
struct Run {
    /// By the timestamps around the pass.
    pass_ms: f64,
    /// What it cost: of the CPU's time on CPU drivers, which other work on the machine does not stretch; else of the
    /// pass.
    cost: f64,
    records: Vec<KernelRecord>,
}

fn run(denoiser: &mut Denoiser, extent: Extent, profile: bool) -> Run {
    let rgb = Layout::interleaved(extent, 3);
    let color: Vec<f32> = (0..3 * extent.pixels()).map(|i| (i * 7 % 13) as f32 * 0.1).collect();
    let mut output = vec![0.0; color.len()];
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features: Features::default() };
    denoiser.set_profiling(profile).unwrap();
    let clock = ProcessTime::now();
    let report = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
    let (cpu, pass_ms) = (clock.elapsed().as_secs_f64(), report.gpu_ms.unwrap());
    let cost = if denoiser.device().info().kind == DeviceKind::Cpu { cpu } else { pass_ms };
    Run { pass_ms, cost, records: denoiser.records().to_vec() }
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn total(records: &[KernelRecord]) -> f64 {
    records.iter().map(|record| record.microseconds * 1e-3).sum()
}

/// Both within 5 %, by the median of pairs of runs: as many pairs as it takes, to a limit, since times vary.
#[test]
fn the_kernels_add_up_to_the_pass_and_timing_them_costs_little() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut denoiser = Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    // Compiles.
    run(&mut denoiser, TIMED, true);
    let (mut shares, mut slowdowns) = (Vec::new(), Vec::new());
    let within = |shares: &[f64], slowdowns: &[f64]| median(shares) >= 0.95 && median(slowdowns) <= 1.05;
    while shares.len() < 3 || (shares.len() < 20 && !within(&shares, &slowdowns)) {
        let plain = run(&mut denoiser, TIMED, false);
        assert!(plain.records.is_empty());
        let profiled = run(&mut denoiser, TIMED, true);
        shares.push(total(&profiled.records) / profiled.pass_ms);
        slowdowns.push(profiled.cost / plain.cost);
    }
    let (share, slowdown) = (median(&shares), median(&slowdowns));
    println!("{} pairs: kernels {share:.4} of the pass, slower by {slowdown:.4}", shares.len());
    assert!(within(&shares, &slowdowns), "kernels are {share} of the pass, which is {slowdown} times slower");
    assert!(shares.iter().all(|share| *share <= 1.0), "{shares:?}");
    assert_no_validation_messages();
}

#[test]
fn a_record_for_every_dispatch_in_order() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let mut denoiser = Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let plan = denoiser.pass(EXTENT).unwrap().plan().clone();
    run(&mut denoiser, EXTENT, true);
    let records = run(&mut denoiser, EXTENT, true).records;
    assert_eq!(records.len(), plan.dispatches.len());
    for (record, dispatch) in records.iter().zip(&plan.dispatches) {
        assert_eq!((&record.name, record.stage, record.flops), (&dispatch.name, dispatch.stage, dispatch.flops));
        // There are no features, so no depths to count.
        assert_eq!(record.skipped, dispatch.of_depth, "{record:?}");
        assert!(record.skipped || (record.microseconds > 0.0 && record.bytes() > 0), "{record:?}");
    }
    assert!(records.windows(2).all(|pair| pair[0].start + pair[0].microseconds <= pair[1].start));

    // A time that belongs to another kernel would show here: most of the work is in the kernels that have FLOPs.
    let dense: Vec<_> = records.iter().filter(|record| record.flops > 0).cloned().collect();
    assert!(total(&dense) > 0.5 * total(&records), "{} ms of {}", total(&dense), total(&records));
    assert_no_validation_messages();
}

#[test]
fn a_renderers_frames_have_slots_of_their_own() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let renderer = Renderer::new();
    // SAFETY: the handles are the renderer's, which lives to the end of the test.
    let renderers_device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let denoiser = Denoiser::new(&renderers_device, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let pass = denoiser.pass(EXTENT).unwrap();
    let buffer = renderer.buffer(12 * EXTENT.pixels());
    let plane = BufferPlane {
        buffer: buffer.raw,
        size: buffer.size,
        format: SampleFormat::F32,
        layout: Layout::interleaved(EXTENT, 3),
    };
    let frame = BufferFrame::new(plane, plane);
    // SAFETY: the buffer lives to the end of the test.
    let binding = unsafe { pass.bind_buffers(&frame) }.unwrap();

    let profiler = pass.profiler(2).unwrap();
    assert!(profiler.read(0).unwrap().is_none(), "nothing was recorded");
    renderer.record_only(|commands| {
        // SAFETY: nothing of it is submitted.
        unsafe { pass.record_profiled(commands, &binding, &FrameOptions::default(), &profiler, 0) }.unwrap();
    });
    assert!(profiler.read(0).unwrap().is_none(), "nothing was submitted");
    // Both are submitted before either is waited for.
    let fences = [0, 1].map(|slot| {
        renderer.submit(|commands| {
            // SAFETY: everything bound lives until the fences are waited for.
            unsafe { pass.record_profiled(commands, &binding, &FrameOptions::default(), &profiler, slot) }.unwrap();
            renderer.barrier_to_host(commands);
        })
    });
    // Finished or not, this does not wait.
    profiler.read(1).unwrap();
    for (slot, fence) in (0..).zip(fences) {
        renderer.wait(fence);
        let records = profiler.read(slot).unwrap().expect("the fence was waited for");
        assert_eq!(records.len(), pass.plan().dispatches.len());
        assert!(records.iter().all(|record| record.microseconds > 0.0));
    }

    let other = denoiser.pass(Extent::new(8, 8)).unwrap();
    let refused = other.profiler(0);
    assert!(matches!(refused, Err(Error::InvalidOption { option: "slots", .. })));
    assert!(matches!(profiler.read(2), Err(Error::InvalidOption { option: "slot", .. })));
    renderer.record_only(|commands| {
        // SAFETY: nothing of it is submitted.
        let recorded = unsafe { pass.record_profiled(commands, &binding, &FrameOptions::default(), &profiler, 2) };
        assert!(matches!(recorded, Err(Error::InvalidOption { option: "slot", .. })));
    });
    drop((profiler, binding, other, pass, denoiser));

    let mut handles = renderer.handles();
    handles.host_query_reset = false;
    // SAFETY: as above.
    let without = unsafe { Device::from_renderer(handles) }.unwrap();
    let denoiser = Denoiser::new(&without, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let refused = denoiser.pass(Extent::new(8, 8)).unwrap().profiler(1);
    let Err(Error::Unsupported { missing, .. }) = refused else { panic!("timestamps that nobody can reset") };
    assert_eq!(missing, "hostQueryReset");
    drop((denoiser, without));
    renderer.assert_silent();
}

#[test]
fn without_timestamps_the_host_times_whole_passes() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let selector = DeviceSelector::from_env().unwrap_or_default();
    let options = DeviceOptions { selector, validation: true, host_clock: true, ..DeviceOptions::default() };
    let device = Device::open_with(&options).unwrap();
    assert!(!device.has_timestamps());
    let extent = Extent::new(8, 8);
    let mut denoiser = Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let refused = denoiser.set_profiling(true).unwrap_err().to_string();
    assert!(refused.contains("timestampValidBits"), "{refused}");
    let pass = denoiser.pass(extent).unwrap();
    assert!(matches!(pass.profiler(1), Err(Error::Unsupported { .. })));
    let rgb = Layout::interleaved(extent, 3);
    let color = vec![0.5; 3 * 64];
    let mut output = vec![0.0; 3 * 64];
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features: Features::default() };
    let report = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
    assert!(report.gpu_ms.is_none() && report.total_ms > 0.0, "{report:?}");
    assert!(denoiser.records().is_empty());

    let graph = Graph::of_convolution(Convolution::Standard, 8).unwrap();
    let weights = Weights::hashed(&graph.arch, PREPROCESSING, 1).unwrap();
    let mut part = PartRunner::new(&device, &graph, &weights, extent, &Target::default(), Precision::Auto).unwrap();
    let run = part.run().unwrap();
    assert!(run.milliseconds > 0.0 && run.records.is_empty());
    assert_eq!(device.validation_messages(), Vec::<String>::new());
}

/// The kernel that measures products of matrices runs where the device has them, and nowhere else.
#[test]
fn the_roof_of_matrices_is_known_where_there_are_any() {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let roof = Roof::measure(device()).unwrap();
    println!("{roof:?}");
    assert_eq!(roof.flops_matrix.is_some(), device().has_matrices());
    assert!(roof.flops_matrix.is_none_or(|rate| rate > 0.0));
    assert_no_validation_messages();
}

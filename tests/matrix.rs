//! Whole networks on cooperative matrices: how far from the f64 reference, the same bits every run, a choice of the
//! caller's. They run where the device has matrices (`tools/lavapipe-matrix` brings a driver that does), and say so
//! where not.

mod common;

use common::case::PREPROCESSING;
use common::compare::{assert_same_bits, nmse};
use common::device::{assert_no_validation_messages, device};
use common::golden::Golden;
use common::network::{crop, plan_of};
use common::planes::TestFrame;
use common::trained::residual_hybrid;
use common::vulkan::Renderer;
use vkdenoise::kernels::{Arithmetic, Storage};
use vkdenoise::metrics::Comparison;
use vkdenoise::net::{Arch, Graph, Weights};
use vkdenoise::plan::plan;
use vkdenoise::reference::Reference;
use vkdenoise::target::Target;
use vkdenoise::testing::denoise_and_read;
use vkdenoise::{
    BufferFrame, BufferPlane, Denoiser, Device, DeviceKind, Error, Extent, Features, Frame, FrameOptions, Layout,
    Options, Plane, PlaneMut, Precision, Region, SampleFormat,
};

/// What rounding factors to halves may cost a whole pass that ends in kernels, which average, and in a residual.
const LEAST_DB: f64 = 90.0;
const LEAST_DB_OF_RESIDUALS: f64 = 60.0;
/// The same of the residual, as NMSE, where the weights are random.
const RANDOM_LIMIT: f64 = 1e-4;

fn on_matrices() -> Options {
    Options { precision: Precision::Matrix, ..Options::default() }
}

fn has_matrices() -> bool {
    let has = device().has_matrices();
    if !has {
        println!("not tested: the device has no cooperative matrices");
    }
    has
}

/// Whether more than one network is worth running: a CPU driver takes minutes to compile each.
fn compiles_fast() -> bool {
    has_matrices() && device().info().kind != DeviceKind::Cpu
}

/// Tone-mapped dB of the output to the reference's, and NMSE of the residual.
fn errors(frame: &TestFrame, weights: &Weights) -> (f64, f64) {
    let plan = plan_of(weights, frame.extent);
    let mut reference = Reference::new(&plan, weights).unwrap();
    reference.set_frame(&frame.frame(), None, 0.0).unwrap();
    reference.run();
    let mut denoiser = Denoiser::new(device(), weights, &on_matrices()).unwrap();
    assert_eq!(denoiser.precision(), Precision::Matrix);
    let mut output = vec![0.0; 3 * frame.extent.pixels() as usize];
    let plane = PlaneMut::f32(&mut output, Layout::interleaved(frame.extent, 3));
    let report = denoiser.denoise(&frame.frame(), plane).unwrap();
    if compiles_fast() {
        let banded = Options { max_chain_bytes: Some(1 << 18), ..on_matrices() };
        let mut in_bands = vec![0.0; output.len()];
        let plane = PlaneMut::f32(&mut in_bands, Layout::interleaved(frame.extent, 3));
        Denoiser::new(device(), weights, &banded).unwrap().denoise(&frame.frame(), plane).unwrap();
        assert_same_bits(&in_bands, &output, "in bands");
    }
    let expected: Vec<f32> = reference.output().iter().map(|&v| v as f32).collect();
    let db = Comparison::new(frame.extent, &output, &expected).unwrap().tone_mapped_db(report.exposure);
    let (residual, _) = denoise_and_read(&mut denoiser, &frame.frame(), |plan| plan.residual.buffer).unwrap();
    let expected = crop(&reference.view(&plan.residual), plan.padded, plan.padded);
    (db, nmse(&crop(&residual, plan.padded, plan.padded), &expected))
}

#[test]
fn trained_networks_are_close_to_the_reference() {
    if !has_matrices() {
        return;
    }
    let golden = Golden::read("golden_trained.safetensors");
    let (ships, residual) = (Weights::hybrid_kernels().unwrap(), residual_hybrid());
    let passes = [
        ("odd.", "the network that ships", &ships, LEAST_DB),
        ("square.", "the network that ships", &ships, LEAST_DB),
        ("square.", "with a residual", &residual, LEAST_DB_OF_RESIDUALS),
        ("odd.", "with a residual", &residual, LEAST_DB_OF_RESIDUALS),
    ];
    // The first has all kernels of the others.
    for (prefix, name, weights, least) in &passes[..if compiles_fast() { passes.len() } else { 1 }] {
        let (db, error) = errors(&golden.frame(prefix), weights);
        println!("trained weights, {name}, {prefix} {db:.1} dB, NMSE of the result {error:.1e}");
        assert!(db >= *least, "{name}, {prefix} {db:.1} dB");
    }
    assert_no_validation_messages();
}

/// Chains band by band, as in frames of 1920x1080 and more, and a rectangle of the frame. On a network that ships, in
/// which kernels of several operations follow each other.
#[test]
fn bands_and_regions_have_the_bits_of_the_whole() {
    if !has_matrices() {
        return;
    }
    let weights = Weights::hybrid_kernels().unwrap();
    let frame = Golden::read("golden_trained.safetensors").frame("square.");
    let denoised = |options: &Options, region: Option<Region>| {
        let mut output = vec![0.0; 3 * frame.extent.pixels() as usize];
        let plane = PlaneMut::f32(&mut output, Layout::interleaved(frame.extent, 3));
        let mut denoiser = Denoiser::new(device(), &weights, options).unwrap();
        denoiser.set_region(region);
        denoiser.denoise(&frame.frame(), plane).unwrap();
        output
    };
    let whole = denoised(&on_matrices(), None);
    for max_chain_bytes in [1 << 18, 1 << 16] {
        let banded = Options { max_chain_bytes: Some(max_chain_bytes), ..on_matrices() };
        assert_same_bits(&denoised(&banded, None), &whole, &format!("in bands of {max_chain_bytes} bytes"));
        let rows = Region { x: 0, y: 43, width: frame.extent.width, height: 30 };
        for (options, region) in [(&banded, rows), (&on_matrices(), Region { x: 21, width: 40, ..rows })] {
            let part = denoised(options, Some(region));
            let of_region = |picture: &[f32]| -> Vec<f32> {
                let rows = picture.chunks_exact(3 * frame.extent.width as usize).skip(region.y as usize);
                let columns = 3 * region.x as usize..3 * (region.x + region.width) as usize;
                rows.take(region.height as usize).flat_map(|row| row[columns.clone()].to_vec()).collect()
            };
            assert_same_bits(&of_region(&part), &of_region(&whole), &format!("{region:?}"));
        }
    }
    assert_no_validation_messages();
}

/// Where chains run in narrow bands and what a head takes of pixels is kept all the same: the plan alone, by its f64
/// twins. A kernel that leaves more than its result must not compute rows that only those after it need.
#[test]
fn what_is_kept_is_right_whatever_the_bands() {
    let weights = Weights::hybrid_kernels().unwrap();
    let frame = Golden::read("golden_trained.safetensors").frame("square.");
    let graph = Graph::new(weights.arch()).unwrap();
    let denoised = |max_chain_bytes| {
        let suitable = Target::for_gpu(Storage::F16, Arithmetic::Matrices);
        let target = Target { max_chain_bytes, max_kept_bytes: u64::MAX, ..suitable };
        let plan = plan(&graph, frame.extent, &target).unwrap();
        let mut reference = Reference::new(&plan, &weights).unwrap();
        reference.set_frame(&frame.frame(), None, 0.0).unwrap();
        reference.run();
        (plan.dispatches.len(), reference.output().to_vec())
    };
    let ((dispatches, whole), (in_bands, banded)) = (denoised(u64::MAX), denoised(1 << 16));
    assert!(in_bands > dispatches, "{in_bands} dispatches in bands, {dispatches} without");
    let far = banded.iter().zip(&whole).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(far <= 1e-9, "in bands off by {far:.1e}");
}

/// Random weights, with joint scores that span +-5 and every branch worth a tenth of its block: attention turns small
/// errors of its scores into large ones of its result, in all of them and not in a few windows as trained weights do.
/// `VKDENOISE_NETWORKS=all` runs all ten, which takes minutes, instead of the most and a little sensitive one.
#[test]
fn every_network_runs_on_matrices() {
    if !compiles_fast() {
        return;
    }
    let golden = Golden::read("golden_random.safetensors");
    let all = std::env::var("VKDENOISE_NETWORKS").is_ok_and(|which| which == "all");
    for name in Arch::NAMES.into_iter().filter(|name| all || ["shsa_050", "hybrid"].contains(name)) {
        let weights = Weights::hashed(&Arch::named(name).unwrap(), PREPROCESSING, 1).unwrap();
        let (db, residual) = errors(&golden.frame(""), &weights);
        println!("{name}: {db:.1} dB, NMSE of the residual {residual:.1e}");
        assert!(residual <= RANDOM_LIMIT, "{name}: NMSE {residual:.1e}");
    }
    assert_no_validation_messages();
}

#[test]
fn matrices_are_asked_for() {
    let weights = Weights::hybrid_kernels().unwrap();
    let denoiser = |precision| Denoiser::new(device(), &weights, &Options { precision, ..Options::default() });
    assert_eq!(denoiser(Precision::F32).unwrap().precision(), Precision::F32);
    let expected = match (device().has_matrices(), device().info().kind) {
        (true, kind) if kind != DeviceKind::Cpu => Precision::Matrix,
        _ => Precision::F32,
    };
    assert_eq!(denoiser(Precision::Auto).unwrap().precision(), expected);
    match denoiser(Precision::Matrix) {
        Ok(denoiser) => assert!(device().has_matrices() && denoiser.precision() == Precision::Matrix),
        Err(Error::Unsupported { missing, .. }) => {
            assert!(!device().has_matrices() && missing.contains("VK_KHR_cooperative_matrix"), "{missing}");
        }
        Err(other) => panic!("{other}"),
    }
    assert_eq!("matrix".parse::<Precision>().unwrap().to_string(), "matrix");
}

#[test]
fn another_run_has_the_same_bits() {
    if !compiles_fast() {
        return;
    }
    let frame = TestFrame::random(Extent::new(150, 70), 3);
    let weights = Weights::hybrid_kernels().unwrap();
    let mut denoiser = Denoiser::new(device(), &weights, &on_matrices()).unwrap();
    let mut run = || denoise_and_read(&mut denoiser, &frame.frame(), |plan| plan.residual.buffer).unwrap().0;
    let first = run();
    assert!(first.iter().zip(run()).all(|(a, b)| a.to_bits() == b.to_bits()));
    assert_no_validation_messages();
}

/// The same kernels in a renderer's command buffer; not on a device on which it enabled none.
#[test]
fn a_renderers_device_has_matrices_where_it_enabled_them() {
    if !compiles_fast() {
        return;
    }
    let renderer = Renderer::new();
    // SAFETY: the handles are the renderer's, which lives to the end of the test; the same below.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let weights = Weights::hybrid_kernels().unwrap();
    let denoiser = Denoiser::new(&device, &weights, &on_matrices()).unwrap();
    let extent = Extent::new(70, 45);
    let buffer = renderer.buffer(12 * extent.pixels());
    let color: Vec<f32> = (0..3 * extent.pixels()).map(|i| (i * 7 % 13) as f32 * 0.1).collect();
    buffer.write(bytemuck::cast_slice(&color));
    let rgb = Layout::interleaved(extent, 3);
    let plane = BufferPlane { buffer: buffer.raw, size: buffer.size, format: SampleFormat::F32, layout: rgb };
    let frame = BufferFrame::new(plane, plane);
    let pass = denoiser.pass(extent).unwrap();
    // SAFETY: the buffer lives to the end of the test.
    let binding = unsafe { pass.bind_buffers(&frame) }.unwrap();
    renderer.wait(renderer.submit(|commands| {
        // SAFETY: everything bound lives until the fence is waited for.
        unsafe { pass.record(commands, &binding, &FrameOptions::default()) }.unwrap();
        renderer.barrier_to_host(commands);
    }));
    let mut expected = vec![0.0; color.len()];
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features: Features::default() };
    let mut on_host = Denoiser::new(common::device::device(), &weights, &on_matrices()).unwrap();
    on_host.denoise(&frame, PlaneMut::f32(&mut expected, rgb)).unwrap();
    assert_same_bits(bytemuck::cast_slice(&buffer.read()), &expected, "the renderer's frame");

    let mut handles = renderer.handles();
    handles.cooperative_matrix = None;
    // SAFETY: as above.
    let without = unsafe { Device::from_renderer(handles) }.unwrap();
    assert!(!without.has_matrices());
    assert!(matches!(Denoiser::new(&without, &weights, &on_matrices()), Err(Error::Unsupported { .. })));
    drop((binding, pass, denoiser, device, without));
    renderer.assert_silent();
}

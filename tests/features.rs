//! Features that did not change since the last frame: what depends on them alone is kept, and the bits are the same.

mod common;

use common::case::PREPROCESSING;
use common::compare::assert_same_bits;
use common::device::{assert_no_validation_messages, device};
use common::random::Random;
use common::vulkan::{Renderer, RendererBuffer};
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::net::graph::Graph;
use vkdenoise::net::{Arch, Block, Bottleneck, Convolution, Decoder, Head, StageSpec, Weights};
use vkdenoise::options::{ConvAlgorithm, SeparableForm};
use vkdenoise::plan::{Buffer, Dispatch, Place, Plan, plan};
use vkdenoise::target::Target;
use vkdenoise::testing::overwrite_memory;
use vkdenoise::{
    BufferFrame, BufferPlane, Denoiser, Device, Error, Extent, Features, Frame, FrameOptions, Layout, Options, Plane,
    PlaneMut, Region, SampleFormat,
};

const EXTENT: Extent = Extent::new(150, 100);

fn keeping() -> Options {
    Options { keep_features: true, ..Options::default() }
}

struct Picture {
    color: Vec<f32>,
    albedo: Vec<f32>,
    normal: Vec<f32>,
    depth: Vec<f32>,
}

impl Picture {
    fn new(seed: u64) -> Self {
        let (mut random, pixels) = (Random::new(seed), EXTENT.pixels() as usize);
        Self {
            color: random.values(3 * pixels, 0.0, 3.0),
            albedo: random.values(3 * pixels, 0.0, 1.0),
            normal: random.values(3 * pixels, -1.0, 1.0),
            depth: random.values(pixels, 1.0, 50.0),
        }
    }

    /// This colour with another's features.
    fn frame<'a>(&'a self, other: &'a Self) -> Frame<'a> {
        let rgb = Layout::interleaved(EXTENT, 3);
        let features = Features {
            albedo: Some(Plane::f32(&other.albedo, rgb)),
            normal: Some(Plane::f32(&other.normal, rgb)),
            depth: Some(Plane::f32(&other.depth, Layout::interleaved(EXTENT, 1))),
            noise: None,
        };
        Frame { extent: EXTENT, color: Plane::f32(&self.color, rgb), features }
    }
}

/// Random weights of the network that ships: every branch matters to the result.
fn weights() -> Weights {
    Weights::hashed(&ships(), PREPROCESSING, 9).unwrap()
}

fn denoise(denoiser: &mut Denoiser, frame: &Frame) -> Result<Vec<f32>, Error> {
    let mut output = vec![-1.0; 3 * EXTENT.pixels() as usize];
    denoiser.denoise(frame, PlaneMut::f32(&mut output, Layout::interleaved(EXTENT, 3))).map(|_| output)
}

/// The network that ships.
fn ships() -> Arch {
    Arch { head: Head::pure(), ..Arch::hybrid() }
}

fn plan_of(arch: &Arch, extent: Extent, keep_features: bool) -> Plan {
    let graph = Graph::new(arch).unwrap();
    plan(&graph, extent, &Target { keep_features, ..Target::default() }).unwrap()
}

/// Where a persistent buffer lies: block, first byte.
fn persistent(buffer: &Buffer) -> Option<(usize, u64)> {
    match buffer.place {
        Place::Persistent { block, offset } => Some((block, offset)),
        _ => None,
    }
}

/// The plan finds by dataflow what the network's definition says.
#[test]
fn what_depends_on_features_alone_is_found() {
    for arch in Arch::NAMES.map(|name| Arch::named(name).unwrap()).into_iter().chain([ships()]) {
        let name = &arch.name;
        let plan = plan_of(&arch, Extent::new(256, 128), true);
        for dispatch in &plan.dispatches {
            let last = dispatch.name.rsplit('.').next().unwrap_or_default();
            let expected = dispatch.name.starts_with("aux_proj")
                || ["patch_embed_f", "input.aux", "stats.depths", "stats.depth_scale", "head.f0"]
                    .contains(&&dispatch.name[..])
                || ["f", "norm1_f", "qkf", "film", "mean"].contains(&last)
                || dispatch.name.contains(".film");
            assert_eq!(dispatch.of_features, expected, "{name}: {}", dispatch.name);
        }
        // Whatever the rest reads of it outlives the recording.
        let rest: Vec<_> = plan.dispatches.iter().filter(|d| !d.of_features).map(|d| d.traffic()).collect();
        let written: Vec<_> = rest.iter().flat_map(|traffic| &traffic.writes).map(|(id, _)| *id).collect();
        for (id, _) in rest.iter().flat_map(|traffic| &traffic.reads) {
            let buffer = plan.buffer(*id);
            let outlives = matches!(buffer.place, Place::Persistent { .. } | Place::Weights { .. });
            assert_ne!(outlives, written.contains(id), "{name}: {}", buffer.name);
        }
        // Nothing else lies there.
        let mut kept: Vec<_> = plan.buffers.iter().filter_map(|buffer| Some((persistent(buffer)?, buffer))).collect();
        kept.sort_by_key(|(at, _)| *at);
        assert!(!kept.is_empty());
        for pair in kept.windows(2) {
            let [((block, start), first), ((next_block, next), second)] = pair else { unreachable!() };
            let apart = block != next_block || start + first.bytes <= *next;
            assert!(apart, "{name}: {} lies on {}", second.name, first.name);
        }
        let forgetful = plan_of(&arch, Extent::new(256, 128), false);
        assert!(forgetful.persistent.is_empty() && forgetful.buffers.iter().all(|b| persistent(b).is_none()), "{name}");
    }
}

#[test]
fn what_it_saves_and_costs() {
    let extent = Extent::new(1920, 1080);
    let (plain, keeping) = (plan_of(&ships(), extent, false), plan_of(&ships(), extent, true));
    let flops = |kept: fn(&Dispatch) -> bool| {
        keeping.dispatches.iter().filter(|d| kept(d)).map(|d| d.flops).sum::<u64>() as f64
    };
    let rest = flops(|dispatch| !dispatch.of_features) / flops(|_| true);
    let mb = |plan: &Plan| plan.blocks.iter().chain(&plan.persistent).sum::<u64>() as f64 * 1e-6;
    println!("{rest:.4} of the work remains, {:.0} MB in place of {:.0}", mb(&keeping), mb(&plain));
    assert!((0.85..0.87).contains(&rest), "{rest}");
    assert!(mb(&keeping) < 1.35 * mb(&plain), "{} MB in place of {}", mb(&keeping), mb(&plain));
}

#[test]
fn the_host_path_keeps_features() {
    let [first, second, third] = [1, 2, 3].map(Picture::new);
    let mut plain = Denoiser::new(device(), &weights(), &Options::default()).unwrap();
    let mut whole = |color: &Picture, features: &Picture| denoise(&mut plain, &color.frame(features)).unwrap();
    let mut keeping = Denoiser::new(device(), &weights(), &keeping()).unwrap();

    keeping.set_features_unchanged(true);
    let refused = denoise(&mut keeping, &first.frame(&first));
    assert!(matches!(refused, Err(Error::InvalidOption { option: "features_unchanged", .. })), "{refused:?}");
    keeping.set_features_unchanged(false);
    assert_same_bits(&denoise(&mut keeping, &first.frame(&first)).unwrap(), &whole(&first, &first), "first");
    // From now on those of the first count, whatever comes with the colour.
    keeping.set_features_unchanged(true);
    assert_same_bits(&denoise(&mut keeping, &second.frame(&second)).unwrap(), &whole(&second, &first), "second");
    let colour_alone = Frame { features: Features::default(), ..third.frame(&third) };
    assert_same_bits(&denoise(&mut keeping, &colour_alone).unwrap(), &whole(&third, &first), "third");

    // Whatever region came before: features are kept of the whole frame.
    let regions = [Region { x: 3, y: 50, width: 20, height: 9 }, Region { x: 120, y: 4, width: 30, height: 70 }];
    keeping.set_features_unchanged(false);
    for region in regions {
        keeping.set_region(Some(region));
        let part = denoise(&mut keeping, &second.frame(&third)).unwrap();
        let expected = whole(&second, &third);
        for (i, (part, expected)) in part.iter().zip(&expected).enumerate() {
            let inside = region.contains(i as u32 / 3 % EXTENT.width, i as u32 / 3 / EXTENT.width);
            assert_eq!(part.to_bits(), if inside { *expected } else { -1.0f32 }.to_bits(), "{region:?}: sample {i}");
        }
        keeping.set_features_unchanged(true);
    }

    keeping.set_features_unchanged(false);
    keeping.set_region(None);
    assert_same_bits(&denoise(&mut keeping, &first.frame(&second)).unwrap(), &whole(&first, &second), "changed");

    let mut forgetful = Denoiser::new(device(), &weights(), &Options::default()).unwrap();
    denoise(&mut forgetful, &first.frame(&first)).unwrap();
    forgetful.set_features_unchanged(true);
    let refused = denoise(&mut forgetful, &first.frame(&first));
    assert!(refused.is_err_and(|error| error.to_string().contains("keep_features")));
    assert_no_validation_messages();
}

#[test]
fn a_renderer_keeps_features() {
    let renderer = Renderer::new();
    // SAFETY: the renderer lives to the end of the test.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let denoiser = Denoiser::new(&device, &weights(), &keeping()).unwrap();
    let pass = denoiser.pass(EXTENT).unwrap();
    let pixels = EXTENT.pixels() as usize;
    let input = renderer.buffer(40 * EXTENT.pixels());
    let output = renderer.buffer(12 * EXTENT.pixels());
    let plane = |buffer: &RendererBuffer, offset, channels| BufferPlane {
        buffer: buffer.raw,
        size: buffer.size,
        format: SampleFormat::F32,
        layout: Layout { offset, ..Layout::interleaved(EXTENT, channels) },
    };
    let mut frame = BufferFrame::new(plane(&input, 0, 3), plane(&output, 0, 3));
    frame.albedo = Some(plane(&input, 3 * pixels, 3));
    frame.normal = Some(plane(&input, 6 * pixels, 3));
    frame.depth = Some(plane(&input, 9 * pixels, 1));
    // SAFETY: the buffers live to the end of the test.
    let binding = unsafe { pass.bind_buffers(&frame) }.unwrap();
    let mut plain = Denoiser::new(common::device::device(), &weights(), &Options::default()).unwrap();
    let pictures = [4, 5, 6].map(Picture::new);
    for (i, picture) in pictures.iter().enumerate() {
        // The features in the buffer change, too, as they must not be looked at.
        let planes = [&picture.color, &picture.albedo, &picture.normal, &picture.depth];
        let all: Vec<f32> = planes.into_iter().flatten().copied().collect();
        input.write(bytemuck::cast_slice(&all));
        let options = FrameOptions { features_unchanged: i > 0, ..FrameOptions::default() };
        let work = pass.work(&binding, &options, None).unwrap();
        assert!(if i > 0 { (0.8..0.9).contains(&work) } else { work == 1.0 }, "{work}");
        let fence = renderer.submit(|commands| {
            // SAFETY: everything bound lives until the fence is waited for.
            unsafe { pass.record(commands, &binding, &options) }.unwrap();
            renderer.barrier_to_host(commands);
        });
        renderer.wait(fence);
        let expected = denoise(&mut plain, &picture.frame(&pictures[0])).unwrap();
        assert_same_bits(bytemuck::cast_slice(&output.read()), &expected, &format!("frame {i}"));
    }
    drop((binding, pass, denoiser, device));
    renderer.assert_silent();
}

/// Denoises without features, and with planes of what stands for a missing one: 0, which as a normal is half of the
/// range.
fn check_missing(weights: &Weights, extent: Extent, options: &Options) {
    let mut random = Random::new(u64::from(extent.width));
    let color = random.values(3 * extent.pixels() as usize, 0.0, 3.0);
    let zeros = vec![0.0; color.len()];
    let (rgb, one) = (Layout::interleaved(extent, 3), Layout::interleaved(extent, 1));
    let zero = Some(Plane::f32(&zeros, rgb));
    let all = Features { albedo: zero, normal: zero, depth: Some(Plane::f32(&zeros, one)), noise: None };
    let mut denoiser = Denoiser::new(device(), weights, options).unwrap();
    let run = |denoiser: &mut Denoiser, features: Features, region: Option<Region>| {
        denoiser.set_region(region);
        let mut output = vec![-1.0; color.len()];
        let frame = Frame { extent, color: Plane::f32(&color, rgb), features };
        let report = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb)).unwrap();
        (output, report.work)
    };
    let (expected, work) = run(&mut denoiser, all, None);
    assert_eq!(work, 1.0);
    let (found, work) = run(&mut denoiser, Features::default(), None);
    println!("{}, {extent:?}: without features {work:.4} of the work", weights.arch().name);
    assert_same_bits(&found, &expected, &format!("{extent:?}"));
    // Where a side is large enough, a part is computed only.
    assert_eq!(work < 1.0, extent.width.max(extent.height) > 256, "{extent:?}: {work}");
    // One feature that is there makes them differ from pixel to pixel.
    for features in [Features { albedo: None, ..all }, Features { depth: None, ..all }] {
        let (found, work) = run(&mut denoiser, features, None);
        assert_same_bits(&found, &expected, &format!("{extent:?}"));
        assert_eq!(work, 1.0);
    }
    for _ in 0..3 {
        let (width, height) = (random.integer(1, extent.width.min(60)), random.integer(1, extent.height.min(60)));
        let (x, y) = (random.integer(0, extent.width - width), random.integer(0, extent.height - height));
        let region = Region { x, y, width, height };
        // What the arena still holds must not stand in for what is not computed.
        overwrite_memory(&mut denoiser, extent).unwrap();
        let (found, _) = run(&mut denoiser, Features::default(), Some(region));
        for (i, (found, whole)) in found.iter().zip(&expected).enumerate() {
            let inside = region.contains(i as u32 / 3 % extent.width, i as u32 / 3 / extent.width);
            assert_eq!(found.to_bits(), if inside { *whole } else { -1.0f32 }.to_bits(), "{region:?}: sample {i}");
        }
    }
    assert_no_validation_messages();
}

#[test]
fn without_features_the_bits_are_those_of_constant_ones() {
    for (width, height) in [(300, 70), (40, 520), (270, 260), (256, 256), (90, 17)] {
        check_missing(&weights(), Extent::new(width, height), &Options::default());
    }
}

/// By Winograd, whose results are no function of the token's surroundings alone; without patches; the wide decoder.
#[test]
fn other_networks_without_features() {
    let stage = |block| StageSpec { encoder_blocks: 1, decoder_blocks: 1, heads: 1, block };
    let film = |conv| Block::FilmCnn { conv };
    for (patch, decoder, tile) in [
        (1, Decoder::Baseline, WinogradTile::F4),
        (2, Decoder::Symmetric, WinogradTile::F2),
        (2, Decoder::Baseline, WinogradTile::F4),
    ] {
        let arch = Arch {
            name: format!("patch{patch}"),
            channels: 8,
            window: 8,
            patch,
            decoder,
            stages: vec![stage(film(Convolution::Separable)), stage(Block::Jsa)],
            bottleneck: Bottleneck { blocks: 1, heads: 1, block: Block::ShJsa { ratio: 0.5 } },
            head: Head::Residual,
        };
        let weights = Weights::hashed(&arch, PREPROCESSING, 5).unwrap();
        let forms =
            Options { conv: Some(ConvAlgorithm::Winograd(tile)), separable: Some(SeparableForm::Fused), ..keeping() };
        check_missing(&weights, Extent::new(290, 300), &Options::default());
        check_missing(&weights, Extent::new(290, 100), &forms);
    }
}

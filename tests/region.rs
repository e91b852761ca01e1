//! Regions: the bits of the whole frame for a part of the work.

mod common;

use common::case::{PREPROCESSING, small_net};
use common::device::{assert_no_validation_messages, device};
use common::random::Random;
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::kernels::{Call, Tiles};
use vkdenoise::net::graph::Graph;
use vkdenoise::net::op::Stage;
use vkdenoise::net::{Arch, Block, Bottleneck, Decoder, Folds, Head, StageSpec};
use vkdenoise::options::{ConvAlgorithm, SeparableForm};
use vkdenoise::plan::{Plan, plan};
use vkdenoise::target::Target;
use vkdenoise::testing::overwrite_memory;
use vkdenoise::{
    Denoiser, Error, Extent, Features, Frame, Layout, Options, Plane, PlaneMut, Precision, Region, Weights,
};

/// The Hybrid in one piece: bands compute their borders twice, whichever part is wanted.
fn hybrid(head: Head, extent: Extent, folds: Folds) -> Plan {
    let options = Target { max_chain_bytes: u64::MAX, folds, ..Target::default() };
    plan(&Graph::new(&Arch { head, ..Arch::hybrid() }).unwrap(), extent, &options).unwrap()
}

fn flops(dispatches: &[vkdenoise::plan::Dispatch]) -> u64 {
    dispatches.iter().map(|dispatch| dispatch.flops).sum()
}

/// The worst share of the whole frame's work over all placements of a square.
///
/// The work at (x, y) is a sum of products of a width that depends on x alone and the same of y, so it is at most that
/// of (x, x) or of (y, y) (Cauchy and Schwarz): the diagonal has the worst.
fn worst_share(head: Head, side: u32, square: u32, folds: Folds) -> f64 {
    let plan = hybrid(head, Extent::new(side, side), folds);
    let whole = flops(&plan.dispatches) as f64;
    let diagonal = (0..=side - square).map(|at| Region { x: at, y: at, width: square, height: square });
    diagonal.map(|region| flops(&plan.of_region(region)) as f64 / whole).fold(0.0, f64::max)
}

#[test]
fn a_small_region_needs_a_part_of_the_work() {
    let shares_with = |head: Head, folds| {
        let shares = [1024, 2048, 4096].map(|side| worst_share(head.clone(), side, 128, folds));
        println!("128 x 128 pixels at worst, {head:?}, {folds:?}: {shares:.4?}");
        shares
    };
    // A whole frame is less work where the last stage is folded, and a region never took much of that.
    // Light is given back by squares of 64 pixels, of which those around count: the work of 96 pixels more on each
    // side.
    for (head, most) in [(Head::pure(), [0.69, 0.45, 0.18]), (Head::Residual, [0.62, 0.43, 0.23])] {
        let shares = shares_with(head, Folds::ALL);
        assert!(shares.into_iter().zip(most).all(|(share, most)| share <= most), "{shares:?}");
    }
    // Token by token, with whole windows where there is attention, the pixels depend on 0.5465, 0.3634 and 0.1629 of
    // the network with a residual as it stands.
    let shares = shares_with(Head::Residual, Folds::NONE);
    for (share, least) in shares.into_iter().zip([0.5465, 0.3634, 0.1629]) {
        assert!((least..least + 0.008).contains(&share), "{shares:?}");
    }
}

#[test]
fn the_whole_frame_is_a_region() {
    let extent = Extent::new(200, 136);
    let plan = hybrid(Head::pure(), extent, Folds::ALL);
    for (part, whole) in plan.of_region(Region::all(extent)).iter().zip(&plan.dispatches) {
        let Some(grid) = part.call.grid() else { continue };
        let Tiles::Rect(rect) = grid.tiles else { panic!("{}: {grid:?}", part.name) };
        // Padding is needed as far as the network looks; of the frame itself, everything.
        let end = rect.tokens();
        let (padded_width, padded_height) = (grid.width.next_multiple_of(8), grid.height.next_multiple_of(8));
        assert!(end.right <= padded_width && end.bottom <= padded_height, "{}: {rect:?}", part.name);
        assert!(part.flops <= whole.flops, "{}", part.name);
        if let Call::Output(_) = part.call {
            assert_eq!(rect.count(), grid.counts()[1]);
        }
    }
}

#[test]
fn a_region_outside_the_frame_is_refused() {
    let mut denoiser = Denoiser::new(device(), &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let extent = Extent::new(16, 8);
    let color = [0.5; 3 * 16 * 8];
    let rgb = Layout::interleaved(extent, 3);
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features: Features::default() };
    for (x, y, width, height) in [(0, 0, 0, 1), (0, 0, 17, 1), (9, 0, 8, 8), (0, 8, 1, 1), (u32::MAX, 0, u32::MAX, 1)] {
        denoiser.set_region(Some(Region { x, y, width, height }));
        let mut output = [-1.0; 3 * 16 * 8];
        let refused = denoiser.denoise(&frame, PlaneMut::f32(&mut output, rgb));
        assert!(matches!(refused, Err(Error::InvalidOption { option: "region", .. })), "{refused:?}");
        assert!(output.iter().all(|&v| v == -1.0));
    }
}

/// Denoises random rectangles of a frame and compares them with the whole; `VKDENOISE_REGIONS` gives their number.
fn check_rectangles(weights: &Weights, options: &Options, extent: Extent, seed: u64, inactive: &[Stage]) {
    let count = std::env::var("VKDENOISE_REGIONS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(if extent.width.max(extent.height) > 1000 { 2 } else { 8 });
    let mut random = Random::new(seed);
    let color = random.values(3 * extent.pixels() as usize, 0.0, 2.0);
    let depth = random.values(extent.pixels() as usize, 1.0, 9.0);
    let rgb = Layout::interleaved(extent, 3);
    let features = Features { depth: Some(Plane::f32(&depth, Layout::interleaved(extent, 1))), ..Features::default() };
    let frame = Frame { extent, color: Plane::f32(&color, rgb), features };
    let mut denoiser = Denoiser::new(device(), weights, options).unwrap();
    let mut whole = vec![f32::NAN; color.len()];
    denoiser.denoise(&frame, PlaneMut::f32(&mut whole, rgb)).unwrap();

    let plan = plan(&Graph::new(weights.arch()).unwrap(), extent, &Target::default()).unwrap();
    for _ in 0..count {
        let (width, height) = (random.integer(1, extent.width.min(90)), random.integer(1, extent.height.min(90)));
        let (x, y) = (random.integer(0, extent.width - width), random.integer(0, extent.height - height));
        let region = Region { x, y, width, height };
        let idle: Vec<Stage> = plan
            .of_region(region)
            .iter()
            .filter(|dispatch| dispatch.call.grid().is_some_and(|grid| grid.counts()[0] < grid.counts()[1]))
            .map(|dispatch| dispatch.stage)
            .collect();
        for stage in inactive {
            assert!(idle.contains(stage), "{region:?}: {stage:?} computes everything");
        }
        // What the arena still holds of the whole must not stand in for what the region fails to compute.
        overwrite_memory(&mut denoiser, extent).unwrap();
        denoiser.set_region(Some(region));
        let mut part = vec![-1.0; color.len()];
        denoiser.denoise(&frame, PlaneMut::f32(&mut part, rgb)).unwrap();
        for (i, (part, whole)) in part.iter().zip(&whole).enumerate() {
            let (px, py) = (i as u32 / 3 % extent.width, i as u32 / 3 / extent.width);
            let expected = if region.contains(px, py) { *whole } else { -1.0 };
            assert_eq!(part.to_bits(), expected.to_bits(), "{region:?}: pixel ({px}, {py}) is {part}, not {expected}");
        }
    }
    assert_no_validation_messages();
}

#[test]
fn rectangles_of_a_small_frame_have_the_bits_of_the_whole() {
    check_rectangles(
        &Weights::hybrid_kernels().unwrap(),
        &Options::default(),
        Extent::new(300, 211),
        1,
        &[Stage::Output],
    );
}

#[test]
fn rectangles_on_matrices_have_the_bits_of_the_whole() {
    if !device().has_matrices() {
        println!("not tested: the device has no cooperative matrices");
        return;
    }
    let options = Options { precision: Precision::Matrix, ..Options::default() };
    check_rectangles(&Weights::hybrid_kernels().unwrap(), &options, Extent::new(300, 211), 5, &[Stage::Output]);
}

/// Winograd's results depend on where its tiles begin.
#[test]
fn rectangles_by_winograd_have_the_bits_of_the_whole() {
    for tile in [WinogradTile::F2, WinogradTile::F4] {
        let options = Options {
            conv: Some(ConvAlgorithm::Winograd(tile)),
            separable: Some(SeparableForm::Fused),
            ..Options::default()
        };
        check_rectangles(&small_net(16, Block::ShJsa { ratio: 0.5 }), &options, Extent::new(200, 70), 4, &[]);
    }
}

/// Without FiLM no mean asks for the features of the whole frame: they too are computed in part.
#[test]
fn rectangles_without_film_have_the_bits_of_the_whole() {
    let attention = StageSpec { encoder_blocks: 1, decoder_blocks: 1, heads: 1, block: Block::Jsa };
    let arch = Arch {
        name: "attention".into(),
        channels: 16,
        window: 8,
        patch: 2,
        decoder: Decoder::Symmetric,
        stages: vec![attention],
        bottleneck: Bottleneck { blocks: 1, heads: 1, block: Block::Jsa },
        head: Head::Residual,
    };
    let weights = Weights::hashed(&arch, PREPROCESSING, 5).unwrap();
    check_rectangles(
        &weights,
        &Options::default(),
        Extent::new(640, 200),
        3,
        &[Stage::Input, Stage::Encoder(0), Stage::Bottleneck],
    );
}

#[test]
fn rectangles_of_a_long_frame_have_the_bits_of_the_whole() {
    let stages = (0..3).flat_map(|i| [Stage::Encoder(i), Stage::Decoder(i)]);
    let stages: Vec<_> = stages.chain([Stage::Input, Stage::Bottleneck, Stage::Output]).collect();
    let (weights, options) = (Weights::hybrid_kernels().unwrap(), Options::default());
    check_rectangles(&weights, &options, Extent::new(2560, 128), 2, &stages);
    check_rectangles(&weights, &options, Extent::new(128, 2560), 3, &stages);
}

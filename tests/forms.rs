//! Whole networks in every form of convolution, against the f64 reference of the plain forms.

mod common;

use common::case::{PREPROCESSING, small_net};
use common::compare::{max_error, nmse};
use common::device::{assert_no_validation_messages, device};
use common::network::{crop, plan_with};
use common::planes::TestFrame;
use vkdenoise::kernels::Call;
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::net::{Arch, Block, Convolution, Folds, Weights};
use vkdenoise::options::{ConvAlgorithm, SeparableForm};
use vkdenoise::plan::Plan;
use vkdenoise::reference::Reference;
use vkdenoise::testing::denoise_and_read;
use vkdenoise::{Denoiser, Extent, Layout, Options, PlaneMut, Region};

/// What the network's residual may be wrong by: NMSE.
const NETWORK_LIMIT: f64 = 1e-9;

/// Whole and in part, whatever the size of the bands.
#[test]
fn bands_have_the_bits_of_the_whole() {
    let extent = Extent::new(120, 517);
    let frame = TestFrame::random(extent, 7);
    let rgb = Layout::interleaved(extent, 3);
    let mut separable = Arch::hybrid();
    separable.stages[0].block = Block::FilmCnn { conv: Convolution::Separable };
    let nets = [Arch::hybrid(), separable].map(|arch| Weights::hashed(&arch, PREPROCESSING, 8).unwrap());
    for weights in nets.into_iter().chain([small_net(32, Block::Jsa)]) {
        let arch = weights.arch();
        let denoised = |frame: &TestFrame, max_chain_bytes, region| {
            let options = Options { max_chain_bytes: Some(max_chain_bytes), ..Options::default() };
            let mut denoiser = Denoiser::new(device(), &weights, &options).unwrap();
            denoiser.set_region(region);
            let mut output = vec![-1.0; 3 * extent.pixels() as usize];
            denoiser.denoise(&frame.frame(), PlaneMut::f32(&mut output, rgb)).unwrap();
            let dispatches = denoiser.pass(extent).unwrap().plan().dispatches.len();
            (output, dispatches)
        };
        let (whole, dispatches) = denoised(&frame, u64::MAX, None);
        let sizes: &[u64] = if arch.name == "hybrid" { &[1 << 19, 1 << 21] } else { &[1 << 20] };
        for bytes in sizes {
            let (banded, more) = denoised(&frame, *bytes, None);
            assert!(more > dispatches, "{} in bands of {bytes}", arch.name);
            assert!(banded == whole, "{} in bands of {bytes}", arch.name);
        }
        if arch.name != "hybrid" {
            continue;
        }
        let bare = TestFrame { albedo: None, normal: None, depth: None, ..frame.clone() };
        assert!(denoised(&bare, 1 << 19, None).0 == denoised(&bare, u64::MAX, None).0, "without features");
        let region = Region { x: 50, y: 200, width: 61, height: 90 };
        let (part, _) = denoised(&frame, 1 << 19, Some(region));
        for (i, (part, whole)) in part.iter().zip(&whole).enumerate() {
            let inside = region.contains(i as u32 / 3 % extent.width, i as u32 / 3 / extent.width);
            assert_eq!(*part, if inside { *whole } else { -1.0 });
        }
    }
    assert_no_validation_messages();
}

/// Against the f64 reference of what is not folded, at sizes that need some padding and none.
#[test]
fn folds_are_exact() {
    let none = Folds::NONE;
    let norm = Folds { norm: true, ..none };
    let one_by_one =
        [none, Folds { unembed: true, ..none }, Folds { skip: true, ..none }, Folds { unread: true, ..none }, norm];
    for (name, extent, folds) in [
        ("hybrid", Extent::new(128, 256), &one_by_one[..]),
        ("hybrid", Extent::new(70, 45), &[Folds::ALL]),
        ("expanded_patch", Extent::new(128, 128), &[Folds::ALL]),
        ("three_stage", Extent::new(64, 100), &[Folds::ALL]),
    ] {
        let frame = TestFrame::random(extent, 5);
        let weights = Weights::hashed(&Arch::named(name).unwrap(), PREPROCESSING, 6).unwrap();
        let plain = plan_with(&weights, extent, none);
        let mut reference = Reference::new(&plain, &weights).unwrap();
        reference.set_frame(&frame.frame(), None, 0.0).unwrap();
        reference.run();
        let expected = crop(&reference.view(&plain.residual), plain.padded, plain.padded);
        for folds in folds {
            let options = Options { folds: Some(*folds), ..Options::default() };
            let mut denoiser = Denoiser::new(device(), &weights, &options).unwrap();
            let (found, plan) = denoise_and_read(&mut denoiser, &frame.frame(), |plan| plan.residual.buffer).unwrap();
            let flops = |plan: &Plan| plan.dispatches.iter().map(|dispatch| dispatch.flops).sum::<u64>();
            assert_eq!(flops(&plan) < flops(&plain), *folds != none && *folds != norm, "{name}: {folds:?}");
            let found = crop(&found, plan.padded, plan.padded);
            let (nmse, largest) = (nmse(&found, &expected), max_error(&found, &expected));
            println!("{name}, {folds:?}: NMSE {nmse:.1e}, largest error {largest:.1e}");
            assert!(nmse <= NETWORK_LIMIT && largest <= 1e-4, "{name}, {folds:?}: {nmse:.1e}, {largest:.1e}");
        }
    }
    assert_no_validation_messages();
}

#[test]
fn every_form_is_the_reference() {
    let frame = TestFrame::random(Extent::new(70, 45), 5);
    let mut arch = Arch::hybrid();
    // With a separable convolution of its own beside those of the FFNs.
    arch.stages[0].block = Block::FilmCnn { conv: Convolution::Separable };
    for arch in [Arch::hybrid(), arch] {
        let weights = Weights::hashed(&arch, PREPROCESSING, 6).unwrap();
        let plain = plan_with(&weights, frame.extent, Folds::NONE);
        let mut reference = Reference::new(&plain, &weights).unwrap();
        reference.set_frame(&frame.frame(), None, 0.0).unwrap();
        reference.run();
        let expected = reference.view(&plain.residual);
        for tile in [WinogradTile::F2, WinogradTile::F4] {
            let options = Options {
                conv: Some(ConvAlgorithm::Winograd(tile)),
                separable: Some(SeparableForm::Fused),
                ..Options::default()
            };
            let mut denoiser = Denoiser::new(device(), &weights, &options).unwrap();
            let (found, plan) = denoise_and_read(&mut denoiser, &frame.frame(), |plan| plan.residual.buffer).unwrap();
            let ran = |form: fn(&Call) -> bool| plan.dispatches.iter().any(|dispatch| form(&dispatch.call));
            assert!(
                ran(|call| matches!(call, Call::Winograd3x3(_))) && ran(|call| matches!(call, Call::Separable3x3(_)))
            );
            let nmse = nmse(&crop(&found, plan.padded, plan.padded), &crop(&expected, plan.padded, plan.padded));
            println!("{:?} {tile:?}: NMSE {nmse:.1e}", arch.stages[0].block);
            assert!(nmse <= NETWORK_LIMIT, "{tile:?}: NMSE {nmse:.1e}");
        }
    }
    assert_no_validation_messages();
}

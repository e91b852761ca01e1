//! Whole networks in every form of convolution, against the f64 reference of the plain forms.

mod common;

use common::case::PREPROCESSING;
use common::compare::nmse;
use common::device::{assert_no_validation_messages, device};
use common::network::{crop, plan_of};
use common::planes::TestFrame;
use vkdenoise::kernels::Call;
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::net::{Arch, Block, Convolution, Weights};
use vkdenoise::plan::{ConvAlgorithm, SeparableForm};
use vkdenoise::reference::Reference;
use vkdenoise::testing::denoise_and_read;
use vkdenoise::{Denoiser, Extent, Options};

/// What the network's residual may be wrong by: NMSE.
const NETWORK_LIMIT: f64 = 1e-9;

#[test]
fn every_form_is_the_reference() {
    let frame = TestFrame::random(Extent::new(70, 45), 5);
    let mut arch = Arch::hybrid();
    // With a separable convolution of its own beside those of the FFNs.
    arch.stages[0].block = Block::FilmCnn { conv: Convolution::Separable };
    for arch in [Arch::hybrid(), arch] {
        let weights = Weights::hashed(&arch, PREPROCESSING, 6).unwrap();
        let plain = plan_of(&weights, frame.extent);
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

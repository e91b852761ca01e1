//! Trained networks that do not ship.

use vkdenoise::Weights;

/// The thesis's Hybrid, which adds a residual to the colour.
pub fn residual_hybrid() -> Weights {
    Weights::from_bytes(include_bytes!("../../weights/hybrid.safetensors")).unwrap()
}

/// The thesis's +Expanded Patch: full joint attention in every block.
pub fn expanded_patch() -> Weights {
    Weights::from_bytes(include_bytes!("../../weights/expanded_patch.safetensors")).unwrap()
}

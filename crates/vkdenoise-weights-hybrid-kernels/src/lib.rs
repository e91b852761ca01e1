//! The network of vkdenoise, a Vulkan compute denoiser: the trained Hybrid that predicts kernels. A crate of its own, as
//! a registry takes no larger ones. NOTICE.md names the authors of the scenes that it was trained on.

#![no_std]

/// A safetensors file, for `vkdenoise::Weights::from_bytes`.
pub static WEIGHTS: &[u8] = include_bytes!("../weights.safetensors");

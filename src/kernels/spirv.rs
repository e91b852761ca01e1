//! The compiled shaders, embedded.

include!(concat!(env!("OUT_DIR"), "/spirv.rs"));

/// The SPIR-V of a variant. Every [`super::contract::Contract`] of [`super::contracts::ALL`] has one; of an unknown
/// name it is empty.
pub fn words(name: &str) -> &'static [u32] {
    MODULES.iter().find(|(module, _)| *module == name).map_or(&[], |(_, words)| words)
}

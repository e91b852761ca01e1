//! The compiled shaders, embedded.

use super::contract::Module;

include!(concat!(env!("OUT_DIR"), "/spirv.rs"));

/// The SPIR-V of a module. Every [`super::contract::Contract::module`] of [`super::contracts::ALL`] has one; of another it is empty.
pub fn words(module: &Module) -> &'static [u32] {
    MODULES.iter().find(|(name, _)| *name == module.name).map_or(&[], |(_, words)| words)
}

//! The compiled shaders, embedded.

use super::contract::Module;

include!(concat!(env!("OUT_DIR"), "/shaders/spirv.rs"));

/// The SPIR-V of a module. Every [`super::contract::Contract::module`] of [`super::contracts::ALL`] has one; of another it is
/// empty.
pub fn words(module: &Module) -> &'static [u32] {
    MODULES.iter().find(|(name, _)| *name == module.name).map_or(&[], |(_, words)| words)
}

#[cfg(test)]
mod tests {
    use super::super::contract::Sharing;
    use super::super::contracts;
    use super::*;

    #[test]
    fn every_variant_has_its_modules() {
        for contract in contracts::ALL {
            let modules = Sharing::ALL.map(|sharing| words(&contract.module(sharing)));
            assert!(modules.iter().all(|words| !words.is_empty()), "{}", contract.name);
            // By shuffle and by broadcast.
            assert_eq!(modules[0] != modules[1], contract.has("LANES_SHARE"), "{}", contract.name);
        }
        assert_eq!(words(&Module { name: "nothing".into(), defines: Vec::new() }), &[] as &[u32]);
    }
}

//! The compiled shaders, embedded, and what they declare.

use super::contract::{Binding, BindingType, Contract, Module};

/// What a variant's shader declares.
struct Interface {
    name: &'static str,
    push_bytes: u32,
    bindings: &'static [Binding],
}

include!(concat!(env!("OUT_DIR"), "/shaders/spirv.rs"));

/// The SPIR-V of a module. Every [`super::contract::Contract::module`] of [`super::contracts::ALL`] has one; of another
/// it is empty.
pub fn words(module: &Module) -> &'static [u32] {
    MODULES.iter().find(|(name, _)| *name == module.name).map_or(&[], |(_, words)| words)
}

impl Contract {
    fn interface(&self) -> Option<&'static Interface> {
        INTERFACES.iter().find(|interface| interface.name == self.name)
    }

    /// The descriptors of set 0, in the order of their binding numbers.
    pub fn bindings(&self) -> &'static [Binding] {
        self.interface().map_or(&[], |interface| interface.bindings)
    }

    /// Size of the push-constant block in bytes.
    pub fn push_size(&self) -> u32 {
        self.interface().map_or(0, |interface| interface.push_bytes)
    }
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

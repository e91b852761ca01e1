//! Any bytes as a weights file: an error, or weights that are whole.
#![no_main]

use vkdenoise::Weights;
use vkdenoise::net::Graph;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let Ok(weights) = Weights::from_bytes(bytes) else { return };
    let graph = Graph::new(weights.arch()).expect("an architecture that was read is possible");
    for spec in graph.tensors() {
        let tensor = weights.tensor(&spec.name).expect("every tensor is there");
        assert_eq!(tensor.data.len() as u64, spec.elements(), "{}", spec.name);
        assert!(tensor.data.iter().all(|v| v.is_finite()), "{}", spec.name);
    }
});

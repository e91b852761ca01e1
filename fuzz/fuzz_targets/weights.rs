//! Any bytes as a weights file.
#![no_main]

use vkdenoise::Weights;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    // An error is as good as weights.
    let _ = Weights::from_bytes(bytes);
});

//! Any bytes as an EXR file: read, and where that goes well, written again.
#![no_main]

use std::sync::OnceLock;
use tempfile::TempDir;
use vkdenoise::exr_io::{ExrFrame, LayerOptions};

// A panic of the decoder that the library catches is an answer, and no end of the process: without libFuzzer's hook
// only those that reach the target are finds.
libfuzzer_sys::fuzz_target!(init: std::panic::set_hook(Box::new(|info| eprintln!("{info}"))), |bytes: &[u8]| {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    let folder = FOLDER.get_or_init(|| TempDir::new().expect("a folder for the files")).path();
    let path = folder.join("any.exr");
    std::fs::write(&path, bytes).expect("room for the file");
    if let Ok(frame) = ExrFrame::read(&path, &LayerOptions::default()) {
        frame.frame().check().expect("a frame that was read is whole");
        let _ = frame.write_with_color(folder.join("again.exr"), frame.color());
    }
});

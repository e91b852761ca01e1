//! Files of any bytes, for the loaders of weights and of EXR: an error or a sound result, never a panic, never much
//! memory on a file's word. `fuzz/` has the same for unbounded runs.
#![cfg(feature = "exr")]

#[path = "common/sound_files.rs"]
mod sound_files;

use exr::image::Blocks;
use exr::prelude::Compression;
use proptest::prelude::*;
use proptest::test_runner::{Config, RngSeed};
use std::alloc::{GlobalAlloc, Layout, System};
use std::fs::File;
use std::path::Path;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};
use tempfile::TempDir;
use vkdenoise::Weights;
use vkdenoise::exr_io::{ExrError, ExrFrame, LayerOptions};
use vkdenoise::net::WeightsError;

/// Remembers the largest single allocation.
struct Watch;
static LARGEST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system allocator unchanged.
unsafe impl GlobalAlloc for Watch {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller's.
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        // SAFETY: as the caller's.
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        LARGEST.fetch_max(size, Ordering::Relaxed);
        // SAFETY: as the caller's.
        unsafe { System.realloc(pointer, layout, size) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as the caller's.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static WATCH: Watch = Watch;

/// No file of these tests may cause a larger allocation.
const MOST: usize = 64 << 20;

fn assert_modest() {
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest <= MOST, "one allocation of {largest} bytes");
}

/// A folder for the files of this process.
fn folder() -> &'static Path {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    FOLDER.get_or_init(|| tempfile::tempdir().unwrap()).path()
}

fn sound_weights() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| sound_files::weights(&sound_files::one_stage()))
}

fn sound_exr() -> &'static [u8] {
    static BYTES: OnceLock<Vec<u8>> = OnceLock::new();
    BYTES.get_or_init(|| sound_files::exr(Compression::ZIP16, Blocks::ScanLines))
}

fn read_exr(bytes: &[u8]) -> Result<ExrFrame, ExrError> {
    // A file of its own: the tests run side by side.
    let file = tempfile::NamedTempFile::new_in(folder()).unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    ExrFrame::read(file.path(), &LayerOptions::default())
}

#[test]
fn the_sound_files_are_read() {
    assert!(Weights::from_bytes(sound_weights()).is_ok());
    let frame = read_exr(sound_exr()).unwrap();
    assert_eq!((frame.extent().width, frame.extent().height), (40, 23));
    assert!(frame.frame().features.normal.is_some());
}

/// 10 GB that are nowhere, and devices that never end.
#[test]
fn files_that_claim_too_much_are_refused_unread() {
    let sparse = folder().join("sparse");
    File::create(&sparse).unwrap().set_len(10 << 30).unwrap();
    assert!(matches!(Weights::from_file(&sparse), Err(WeightsError::Read { .. })));
    assert!(matches!(ExrFrame::read(&sparse, &LayerOptions::default()), Err(ExrError::NotExr { .. })));
    if cfg!(unix) {
        assert!(Weights::from_file("/dev/zero").is_err());
        assert!(matches!(ExrFrame::read("/dev/zero", &LayerOptions::default()), Err(ExrError::NotExr { .. })));
    }
    // A header whose size is 10 GB, and one that says so of a tensor.
    let claimed = [&(10u64 << 30).to_le_bytes(), &sound_weights()[8..]].concat();
    assert!(matches!(Weights::from_bytes(&claimed), Err(WeightsError::Malformed(_))));
    let header = br#"{"a":{"dtype":"F32","shape":[2684354560],"data_offsets":[0,10737418240]}}"#;
    let claimed = [&(header.len() as u64).to_le_bytes(), &header[..], &[0; 64]].concat();
    assert!(matches!(Weights::from_bytes(&claimed), Err(WeightsError::Malformed(_))));
    assert_modest();
}

/// An architecture that no device could hold, in a small file.
#[test]
fn absurd_architectures_are_refused() {
    let text = String::from_utf8(sound_weights()[8..].to_vec()).unwrap();
    let mut tried = 0;
    for (from, to) in [
        (r#"\"channels\":16"#, r#"\"channels\":4294967295"#),
        (r#"\"channels\":16"#, r#"\"channels\":0"#),
        (r#"\"channels\":16"#, r#"\"channels\":-8"#),
        (r#"\"encoder_blocks\":1"#, r#"\"encoder_blocks\":4294967295"#),
        (r#"\"blocks\":2"#, r#"\"blocks\":4000000000"#),
        (r#"\"patch\":2"#, r#"\"patch\":2.5"#),
    ] {
        let end = text.find('\0').unwrap();
        let header = text[..end].replace(from, to);
        assert_ne!(header, text[..end], "{from} is not in the header");
        let bytes = [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &text.as_bytes()[end..]].concat();
        assert!(Weights::from_bytes(&bytes).is_err(), "{to}");
        tried += 1;
    }
    assert_eq!(tried, 6);
    assert_modest();
}

/// What happens to a file on its way.
#[derive(Clone, Debug)]
enum Damage {
    /// A byte is another, at a share of the length.
    Byte(f64, u8),
    /// Eight bytes are a number, little-endian.
    Number(f64, u64),
    /// Bytes are put in.
    Insert(f64, Vec<u8>),
    /// A part is taken out.
    Cut(f64, usize),
    /// The rest is gone.
    Truncate(f64),
}

fn damage() -> impl Strategy<Value = Damage> {
    // Half of it in the header, a small share of the bytes.
    let at = prop_oneof![0.0..1.0f64, (0.0..1.0f64).prop_map(|at| at * 0.05)];
    let numbers =
        prop_oneof![any::<u64>(), prop::sample::select(vec![0, 1, u64::MAX, 1 << 31, 1 << 33, i64::MAX as u64])];
    prop_oneof![
        4 => (at.clone(), any::<u8>()).prop_map(|(at, byte)| Damage::Byte(at, byte)),
        3 => (at.clone(), numbers).prop_map(|(at, number)| Damage::Number(at, number)),
        1 => (at.clone(), prop::collection::vec(any::<u8>(), 1..40)).prop_map(|(at, bytes)| Damage::Insert(at, bytes)),
        1 => (at.clone(), 1..60usize).prop_map(|(at, len)| Damage::Cut(at, len)),
        1 => at.prop_map(Damage::Truncate),
    ]
}

fn damaged(sound: &[u8], damages: &[Damage]) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for damage in damages {
        let place = |at: f64| (at * bytes.len() as f64) as usize;
        match damage {
            Damage::Byte(at, byte) => {
                let at = place(*at);
                bytes.get_mut(at).into_iter().for_each(|b| *b = *byte);
            }
            Damage::Number(at, number) => {
                let at = place(*at);
                bytes[at..].iter_mut().zip(number.to_le_bytes()).for_each(|(to, from)| *to = from);
            }
            Damage::Insert(at, new) => {
                let at = place(*at);
                bytes.splice(at..at, new.iter().copied());
            }
            Damage::Cut(at, len) => {
                let (from, to) = (place(*at), (place(*at) + len).min(bytes.len()));
                bytes.drain(from..to);
            }
            Damage::Truncate(at) => bytes.truncate(place(*at)),
        }
    }
    bytes
}

fn config() -> Config {
    Config { cases: 600, rng_seed: RngSeed::Fixed(1), failure_persistence: None, ..Config::default() }
}

/// `fuzz/corpus` of a checkout, from which the fuzzers begin.
#[test]
#[ignore = "writes the fuzzers' first inputs"]
fn write_the_first_inputs_of_the_fuzzers() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    for (target, files) in [("weights", sound_files::all_weights()), ("exr", sound_files::all_exr())] {
        let folder = corpus.join(target);
        std::fs::create_dir_all(&folder).unwrap();
        for (name, bytes) in files {
            std::fs::write(folder.join(name), bytes).unwrap();
        }
    }
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn weights_of_any_bytes(bytes in prop::collection::vec(any::<u8>(), 0..600), with_size: bool) {
        let sized = [&(bytes.len() as u64).to_le_bytes(), &bytes[..]].concat();
        let read = Weights::from_bytes(if with_size { &sized } else { &bytes });
        prop_assert!(read.is_err());
        assert_modest();
    }

    #[test]
    fn damaged_weights(damages in prop::collection::vec(damage(), 1..4)) {
        // What is still read is of the same network or of another: whole either way.
        if let Ok(weights) = Weights::from_bytes(&damaged(sound_weights(), &damages)) {
            let tensors = vkdenoise::net::Graph::new(weights.arch()).unwrap().tensors();
            let finite = tensors.iter().all(|spec| weights.tensor(&spec.name).unwrap().data.iter().all(|v| v.is_finite()));
            prop_assert!(finite);
        }
        assert_modest();
    }

    #[test]
    fn damaged_exr_files(damages in prop::collection::vec(damage(), 1..4), any in prop::option::of(prop::collection::vec(any::<u8>(), 0..400))) {
        // Some have nothing of the sound file but its first eight bytes.
        let bytes = match any {
            Some(any) if any.len() % 4 == 0 => [&sound_exr()[..8], &any].concat(),
            _ => damaged(sound_exr(), &damages),
        };
        if let Ok(frame) = read_exr(&bytes) {
            frame.frame().check().unwrap();
            // What another tool would make of it does not matter; that this one ends does.
            let _ = frame.write_with_color(folder().join("again.exr"), frame.color());
        }
        assert_modest();
    }
}

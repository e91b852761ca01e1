//! Bad files: of other kinds, truncated, with flipped bits.

use super::*;
use exr::math::RoundingMode;
use std::alloc::{GlobalAlloc, Layout as AllocLayout, System};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Remembers the largest single allocation, to catch memory that is asked for on a bad file's word.
struct Watch;
static LARGEST: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call goes to the system allocator unchanged.
unsafe impl GlobalAlloc for Watch {
    unsafe fn alloc(&self, layout: AllocLayout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: AllocLayout) -> *mut u8 {
        LARGEST.fetch_max(layout.size(), Ordering::Relaxed);
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: AllocLayout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static WATCH: Watch = Watch;

fn patch(bytes: &[u8], after: &[u8], skip: usize, new: &[u8]) -> Vec<u8> {
    let start = bytes.windows(after.len()).position(|w| w == after).unwrap() + after.len() + skip;
    let mut bytes = bytes.to_vec();
    bytes[start..start + new.len()].copy_from_slice(new);
    bytes
}

#[test]
fn files_of_other_kinds_are_refused_by_name() {
    let directory = Directory::new();
    let good = std::fs::read(directory.file("good.exr", &[Part::new("", "R G B")])).unwrap();
    let window = |x: i32, y: i32| [[0; 4], [0; 4], x.to_le_bytes(), y.to_le_bytes()].concat();
    let read_patched = |after: &[u8], skip, new: &[u8]| {
        failure(read(&directory.bytes("patched.exr", &patch(&good, after, skip, new))))
    };

    assert!(matches!(failure(read(Path::new("missing.exr"))), ExrError::Read { .. }));
    for bytes in [&b""[..], b"v/1", b"P6\n1 1\n255\n..."] {
        assert!(matches!(failure(read(&directory.bytes("other.exr", bytes))), ExrError::NotExr { .. }));
    }
    // The deep bit of the version field.
    let error = read_patched(&good[..4], 0, &[2, 8, 0, 0]);
    assert!(matches!(&error, ExrError::Unsupported { .. }) && error.to_string().contains("deep"), "{error}");
    // The x sampling of B, in the channel list.
    let error = read_patched(b"chlist\0", 4 + 2 + 8, &2i32.to_le_bytes());
    assert!(matches!(&error, ExrError::Unsupported { .. }) && error.to_string().contains("subsampled"), "{error}");
    let error = read_patched(b"compression\0compression\0", 4, &[99]);
    assert!(matches!(&error, ExrError::Unsupported { .. }), "{error}");
    // Windows that a file of this size cannot hold, in blocks, in bytes and at all.
    LARGEST.store(0, Ordering::Relaxed);
    let error = read_patched(b"dataWindow\0box2i\0", 4, &window(12, 1_000_000_000));
    assert!(matches!(&error, ExrError::Incomplete { .. }), "{error}");
    let error = read_patched(b"dataWindow\0box2i\0", 4, &window(5_000_000, 36));
    assert!(matches!(&error, ExrError::TooLarge { .. }), "{error}");
    let error = read_patched(b"dataWindow\0box2i\0", 4, &window(1_000_000_000, 36));
    assert!(matches!(&error, ExrError::TooLarge { .. }), "{error}");
    assert!(LARGEST.load(Ordering::Relaxed) < 32 << 20);
}

#[test]
fn mip_maps_are_refused_as_colour_and_read_as_features() {
    let directory = Directory::new();
    let mip = |names: [&str; 3]| {
        let level = |size: usize| FlatSamples::F32(vec![0.25; size * size]);
        let levels = Levels::Mip { rounding_mode: RoundingMode::Down, level_data: [16, 8, 4, 2, 1].map(level).into() };
        let channels = names.map(|name| AnyChannel::new(name, levels.clone()));
        let encoding = Encoding { blocks: Blocks::Tiles(Vec2(8, 8)), ..Encoding::UNCOMPRESSED };
        let channels = AnyChannels::sort(channels.into_iter().collect());
        let layer = Layer::new((16, 16), LayerAttributes::named("texture"), encoding, channels);
        let path = directory.0.path().join("mip.exr");
        Image::from_layer(layer).write().non_parallel().to_file(&path).unwrap();
        path
    };
    let error = failure(read(&mip(["R", "G", "B"])));
    assert!(matches!(&error, ExrError::Unsupported { .. }) && error.to_string().contains("mip map"), "{error}");

    let color = directory.0.path().join("color.exr");
    exr::prelude::write_rgb_file(&color, 16, 16, |_, _| (0.5f32, 0.5f32, 0.5f32)).unwrap();
    let normal = FeatureSource::File(mip(["N.X", "N.Y", "N.Z"]));
    let frame = ExrFrame::read(&color, &LayerOptions { normal, ..LayerOptions::default() }).unwrap();
    frame.frame().check().unwrap();
    assert!(frame.frame().features.normal.is_some());
}

/// Small files of several kinds for the damage tests.
fn samples(directory: &Directory) -> Vec<Vec<u8>> {
    let encode = |compression, blocks| Encoding { compression, blocks, line_order: LineOrder::Increasing };
    let parts = |encoding| {
        [Part { encoding, ..Part::new("rgba", "R G B A id:u") }, Part { encoding, ..Part::new("N", "X:f Y:f Z:f") }]
    };
    use Compression::*;
    let mut files = Vec::new();
    for compression in [Uncompressed, RLE, ZIP16, PIZ, PXR24, B44A, DWAA(None)] {
        files
            .push(std::fs::read(directory.file("sample.exr", &parts(encode(compression, Blocks::ScanLines)))).unwrap());
        let one = Part { encoding: encode(compression, Blocks::Tiles(Vec2(16, 16))), ..Part::new("", "R G B Z:f") };
        files.push(std::fs::read(directory.file("sample.exr", &[one])).unwrap());
    }
    files
}

#[test]
fn truncated_files_are_refused_at_every_length() {
    let directory = Directory::new();
    for bytes in samples(&directory) {
        let lengths = (0..bytes.len()).filter(|length| length % 61 == 0 || *length > bytes.len() - 4);
        for length in lengths {
            let error = failure(read(&directory.bytes("cut.exr", &bytes[..length])));
            let expected =
                matches!(error, ExrError::Incomplete { .. } | ExrError::NotExr { .. } | ExrError::Damaged { .. });
            assert!(expected && error.to_string().contains("cut.exr"), "{length}: {error}");
        }
    }
}

#[test]
fn damaged_files_neither_panic_nor_ask_for_much_memory() {
    let directory = Directory::new();
    let files = samples(&directory);
    LARGEST.store(0, Ordering::Relaxed);
    let mut state = 0x2545_f491_4f6c_dd1du64;
    let mut random = move |below: usize| {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state % below as u64) as usize
    };
    let (mut read_well, mut refused) = (0, 0);
    for round in 0..1400 {
        let mut bytes = files[round % files.len()].clone();
        for _ in 0..1 + random(4) {
            // Half of the flips go into the headers, which are a small share of the bytes.
            let end = if random(2) == 0 { bytes.len().min(900) } else { bytes.len() };
            bytes[random(end)] ^= 1 << random(8);
        }
        match read(&directory.bytes("flipped.exr", &bytes)) {
            Ok(frame) => {
                read_well += 1;
                let _ = frame.write_with_color(directory.0.path().join("rewritten.exr"), frame.color());
            }
            Err(error) => {
                refused += 1;
                assert!(error.to_string().contains("flipped.exr"), "{error}");
            }
        }
    }
    assert!(read_well > 50 && refused > 50, "{read_well} read, {refused} refused");
    let largest = LARGEST.load(Ordering::Relaxed);
    assert!(largest < 64 << 20, "one allocation of {largest} bytes");
}

//! Forms of convolutions that were measured: once for a size class, whatever state the folder is in, and with the same bits for
//! the same forms.

mod common;

use ash::{DeviceFnV1_0, vk};
use common::compare::assert_same_bits;
use common::planes::TestFrame;
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use vkdenoise::plan::{ConvAlgorithm, ConvShape};
use vkdenoise::testing::open_patched;
use vkdenoise::{
    Cache, Denoiser, Device, DeviceOptions, DeviceSelector, Extent, Layout, Options, PlaneMut, Region, Weights,
};

static SUBMITS: AtomicUsize = AtomicUsize::new(0);
static DRIVER: Mutex<Option<DeviceFnV1_0>> = Mutex::new(None);
/// The counter is of one test at a time.
static TURN: Mutex<()> = Mutex::new(());

unsafe extern "system" fn queue_submit(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo<'_>,
    fence: vk::Fence,
) -> vk::Result {
    SUBMITS.fetch_add(1, Ordering::Relaxed);
    let driver = DRIVER.lock().unwrap_or_else(PoisonError::into_inner).clone().unwrap();
    // SAFETY: the arguments are the caller's.
    unsafe { (driver.queue_submit)(queue, count, submits, fence) }
}

fn open(folder: &Path) -> Device {
    let selector = DeviceSelector::from_env().unwrap_or_default();
    let cache = Cache::Folder(folder.into());
    let options = DeviceOptions { selector, validation: true, cache, ..DeviceOptions::default() };
    // SAFETY: the patched function counts and does what the driver's does.
    let device = unsafe {
        open_patched(&options, |own| {
            *DRIVER.lock().unwrap_or_else(PoisonError::into_inner) = Some(own.clone());
            DeviceFnV1_0 { queue_submit, ..own.clone() }
        })
    };
    device.unwrap()
}

const EXTENT: Extent = Extent::new(72, 40);

/// A tuned denoiser, and how many submits that took.
fn tuned(device: &Device, extent: Extent) -> (Denoiser, usize) {
    let options = Options { keep_features: true, ..Options::default() };
    let before = SUBMITS.load(Ordering::Relaxed);
    let denoiser = Denoiser::tuned(device, &Weights::hybrid().unwrap(), &options, extent).unwrap();
    (denoiser, SUBMITS.load(Ordering::Relaxed) - before)
}

fn denoise(denoiser: &mut Denoiser) -> Vec<f32> {
    let frame = TestFrame::random(EXTENT, 1);
    let mut output = vec![-1.0; 3 * EXTENT.pixels() as usize];
    denoiser.denoise(&frame.frame(), PlaneMut::f32(&mut output, Layout::interleaved(EXTENT, 3))).unwrap();
    output
}

fn choices(folder: &Path) -> Vec<std::path::PathBuf> {
    let paths = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    paths.filter(|path| path.file_name().unwrap().to_string_lossy().starts_with("convolutions")).collect()
}

#[test]
fn a_size_class_is_measured_once() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let device = open(folder.path());
    let (first, submits) = tuned(&device, EXTENT);
    assert!(submits >= 3 * 4, "{submits} passes");
    let rows: Vec<(ConvShape, ConvAlgorithm)> = first.conv_table().iter().collect();
    println!("{rows:#?}");
    assert!(rows.len() > 4 && rows.iter().any(|(shape, _)| (shape.inputs, shape.outputs, shape.token) == (32, 32, 2)));
    assert_eq!(choices(folder.path()).len(), 1);

    // Another process, another size of the class: nothing is run.
    let (second, submits) = tuned(&open(folder.path()), Extent::new(64, 33));
    assert_eq!((second.conv_table(), submits), (first.conv_table(), 0));
    // Another class is measured by itself.
    let (_, submits) = tuned(&device, Extent::new(9, 7));
    assert!(submits > 0);
    let files = choices(folder.path());
    assert_eq!(files.len(), 2);
    // Damage is measured again and mended.
    for file in &files {
        fs::write(file, b"vkdenoise cache").unwrap();
    }
    let (third, submits) = tuned(&device, EXTENT);
    assert!(submits > 0 && third.conv_table().iter().count() == rows.len());
    assert_eq!(tuned(&device, EXTENT).1, 0);
    let messages = device.validation_messages();
    assert!(messages.is_empty(), "{messages:#?}");
}

/// One set of forms, one result: for another denoiser, for a region, for unchanged features.
#[test]
fn the_same_forms_give_the_same_bits() {
    let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir().unwrap();
    let device = open(folder.path());
    let (mut first, _) = tuned(&device, EXTENT);
    let whole = denoise(&mut first);
    let (mut second, _) = tuned(&device, EXTENT);
    assert_eq!(second.conv_table(), first.conv_table());
    assert_same_bits(&denoise(&mut second), &whole, "another denoiser");
    second.set_features_unchanged(true);
    assert_same_bits(&denoise(&mut second), &whole, "unchanged features");
    second.set_features_unchanged(false);
    let region = Region { x: 40, y: 11, width: 20, height: 17 };
    second.set_region(Some(region));
    let part = denoise(&mut second);
    for (i, (found, expected)) in part.iter().zip(&whole).enumerate() {
        let (x, y) = (i as u32 / 3 % EXTENT.width, i as u32 / 3 / EXTENT.width);
        let expected = if region.contains(x, y) { *expected } else { -1.0 };
        assert_eq!(found.to_bits(), expected.to_bits(), "at {x},{y}");
    }
}

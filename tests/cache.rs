//! What is not done again: compiled kernels are kept for the next process, whatever state the folder is in, each is
//! made once, and a frame is recorded once.
//!
//! lavapipe keeps nothing in a pipeline cache, so these tests put something there: what the driver is asked for and
//! given is seen, the kernels themselves are its own.

mod common;

use ash::{DeviceFnV1_0, vk};
use common::compare::assert_same_bits;
use common::planes::TestFrame;
use std::ffi::c_void;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use vkdenoise::testing::open_patched;
use vkdenoise::{
    Cache, Denoiser, Device, DeviceOptions, DeviceSelector, Exposure, Extent, Layout, Options, PlaneMut, Weights,
};

/// What has gone to and fro since the test began.
#[derive(Default)]
struct Seen {
    /// What each cache was made with.
    given: Vec<Vec<u8>>,
    /// How often its content was asked for.
    asked: usize,
    /// Pipelines made, in the making now, and most at a time.
    made: usize,
    making: usize,
    most: usize,
    /// Command buffers begun, and submits.
    recorded: usize,
    submitted: usize,
}

static SEEN: Mutex<Option<Seen>> = Mutex::new(None);
static DRIVER: Mutex<Option<DeviceFnV1_0>> = Mutex::new(None);
/// Nothing of the driver's is global: one test after another.
static TURN: Mutex<()> = Mutex::new(());

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn with_seen<T>(f: impl FnOnce(&mut Seen) -> T) -> T {
    f(lock(&SEEN).get_or_insert_default())
}

fn driver() -> DeviceFnV1_0 {
    lock(&DRIVER).clone().unwrap()
}

/// What stands behind the header in every cache.
const KERNELS: [u8; 1000] = [7; 1000];
const HEADER: usize = 32;

unsafe extern "system" fn create_pipeline_cache(
    device: vk::Device,
    info: *const vk::PipelineCacheCreateInfo<'_>,
    callbacks: *const vk::AllocationCallbacks<'_>,
    out: *mut vk::PipelineCache,
) -> vk::Result {
    // SAFETY: the arguments are the caller's.
    unsafe {
        let given = match (*info).initial_data_size {
            0 => Vec::new(),
            size => std::slice::from_raw_parts((*info).p_initial_data.cast::<u8>(), size).to_vec(),
        };
        with_seen(|seen| seen.given.push(given));
        (driver().create_pipeline_cache)(device, &vk::PipelineCacheCreateInfo::default(), callbacks, out)
    }
}

unsafe extern "system" fn get_pipeline_cache_data(
    device: vk::Device,
    cache: vk::PipelineCache,
    size: *mut usize,
    data: *mut c_void,
) -> vk::Result {
    // SAFETY: the arguments are the caller's; it asks for the size first.
    unsafe {
        if data.is_null() {
            with_seen(|seen| seen.asked += 1);
            *size = HEADER + KERNELS.len();
            return vk::Result::SUCCESS;
        }
        assert_eq!(*size, HEADER + KERNELS.len());
        let mut own = 0;
        assert_eq!(
            (driver().get_pipeline_cache_data)(device, cache, &mut own, std::ptr::null_mut()),
            vk::Result::SUCCESS
        );
        let mut bytes = vec![0u8; own];
        let result = (driver().get_pipeline_cache_data)(device, cache, &mut own, bytes.as_mut_ptr().cast());
        bytes.truncate(HEADER);
        bytes.extend(KERNELS);
        std::ptr::copy_nonoverlapping(bytes.as_ptr(), data.cast(), bytes.len());
        result
    }
}

unsafe extern "system" fn create_compute_pipelines(
    device: vk::Device,
    cache: vk::PipelineCache,
    count: u32,
    infos: *const vk::ComputePipelineCreateInfo<'_>,
    callbacks: *const vk::AllocationCallbacks<'_>,
    out: *mut vk::Pipeline,
) -> vk::Result {
    with_seen(|seen| {
        seen.made += 1;
        seen.making += 1;
        seen.most = seen.most.max(seen.making);
    });
    // Long enough for another thread to begin.
    std::thread::sleep(Duration::from_millis(3));
    // SAFETY: the arguments are the caller's.
    let result = unsafe { (driver().create_compute_pipelines)(device, cache, count, infos, callbacks, out) };
    with_seen(|seen| seen.making -= 1);
    result
}

unsafe extern "system" fn begin_command_buffer(
    commands: vk::CommandBuffer,
    info: *const vk::CommandBufferBeginInfo<'_>,
) -> vk::Result {
    with_seen(|seen| seen.recorded += 1);
    // SAFETY: the arguments are the caller's.
    unsafe { (driver().begin_command_buffer)(commands, info) }
}

unsafe extern "system" fn queue_submit(
    queue: vk::Queue,
    count: u32,
    submits: *const vk::SubmitInfo<'_>,
    fence: vk::Fence,
) -> vk::Result {
    with_seen(|seen| seen.submitted += count as usize);
    // SAFETY: the arguments are the caller's.
    unsafe { (driver().queue_submit)(queue, count, submits, fence) }
}

fn open(cache: Cache) -> Device {
    let selector = DeviceSelector::from_env().unwrap_or_default();
    let options = DeviceOptions { selector, validation: true, cache, ..DeviceOptions::default() };
    let patched = |own: &DeviceFnV1_0| {
        *lock(&DRIVER) = Some(own.clone());
        DeviceFnV1_0 {
            create_pipeline_cache,
            get_pipeline_cache_data,
            create_compute_pipelines,
            begin_command_buffer,
            queue_submit,
            ..own.clone()
        }
    };
    // SAFETY: the patched functions do what the driver's do, with other data in the cache.
    unsafe { open_patched(&options, patched) }.unwrap()
}

fn denoise(denoiser: &mut Denoiser) -> Vec<f32> {
    let frame = TestFrame::random(Extent::new(9, 7), 1);
    let mut output = vec![f32::NAN; 3 * 9 * 7];
    denoiser.denoise(&frame.frame(), PlaneMut::f32(&mut output, Layout::interleaved(frame.extent, 3))).unwrap();
    output
}

/// A new device, a denoiser and a frame; what was seen meanwhile.
fn process(cache: &Cache) -> (Vec<f32>, Seen) {
    lock(&SEEN).take();
    let device = open(cache.clone());
    let mut denoiser = Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let output = denoise(&mut denoiser);
    let messages = device.validation_messages();
    assert!(messages.is_empty(), "{messages:#?}");
    (output, lock(&SEEN).take().unwrap())
}

fn only_file(folder: &Path) -> PathBuf {
    let files: Vec<_> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 1, "{files:?}");
    files[0].clone()
}

#[test]
fn the_next_process_begins_with_what_this_one_kept() {
    let _turn = lock(&TURN);
    let folder = tempfile::tempdir().unwrap();
    let cache = Cache::Folder(folder.path().join("kernels"));
    let (expected, first) = process(&cache);
    assert_eq!(first.given, [Vec::<u8>::new()]);
    let written = fs::read(only_file(&folder.path().join("kernels"))).unwrap();
    let (output, second) = process(&cache);
    assert_same_bits(&output, &expected, "the second process");
    assert!(second.given[0].len() == HEADER + KERNELS.len() && second.given[0].ends_with(&KERNELS));
    // There was nothing new to keep.
    assert!(second.asked > 0);
    assert_eq!(fs::read(only_file(&folder.path().join("kernels"))).unwrap(), written);
}

#[test]
fn damage_is_passed_over_and_mended() {
    let _turn = lock(&TURN);
    let folder = tempfile::tempdir().unwrap();
    let cache = Cache::Folder(folder.path().into());
    let (expected, _) = process(&cache);
    let path = only_file(folder.path());
    let whole = fs::read(&path).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    for (name, bytes) in
        [("flipped", &flipped[..]), ("cut", &whole[..whole.len() / 2]), ("empty", b""), ("other", b"text")]
    {
        fs::write(&path, bytes).unwrap();
        let (output, seen) = process(&cache);
        assert_eq!(seen.given, [Vec::<u8>::new()], "{name}: given to the driver");
        assert_same_bits(&output, &expected, name);
        assert_eq!(fs::read(&path).unwrap(), whole, "{name}: mended");
    }
    // A folder in the file's place cannot be mended, and does not matter.
    fs::remove_file(&path).unwrap();
    fs::create_dir(&path).unwrap();
    assert_same_bits(&process(&cache).0, &expected, "a folder");
    only_file(folder.path());
}

#[test]
fn a_folder_that_takes_nothing_is_no_error() {
    let _turn = lock(&TURN);
    let folder = tempfile::tempdir().unwrap();
    let in_the_way = folder.path().join("file");
    fs::write(&in_the_way, "").unwrap();
    let (expected, off) = process(&Cache::Off);
    assert_eq!((off.given, off.asked), (vec![Vec::new()], 0));
    let (output, seen) = process(&Cache::Folder(in_the_way));
    assert_same_bits(&output, &expected, "no folder");
    assert!(seen.asked > 0);
    // Root writes where others may not.
    let read_only = folder.path().join("read only");
    fs::create_dir(&read_only).unwrap();
    let mut permissions = fs::metadata(&read_only).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(&read_only, permissions).unwrap();
    assert_same_bits(&process(&Cache::Folder(read_only)).0, &expected, "read only");
}

#[test]
fn each_pipeline_is_made_once_and_several_at_a_time() {
    let _turn = lock(&TURN);
    lock(&SEEN).take();
    let device = open(Cache::Off);
    let mut denoiser = Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let first = denoise(&mut denoiser);
    let Seen { made, most, .. } = lock(&SEEN).take().unwrap();
    let threads = std::thread::available_parallelism().map_or(1, |threads| threads.get());
    assert!(made > 5 && most >= threads.min(2), "{made} made, {most} at a time on {threads} threads");
    assert_same_bits(&denoise(&mut denoiser), &first, "again");
    assert_eq!(lock(&SEEN).take().map_or(0, |seen| seen.made), 0, "more was made for the second frame");
}

/// A frame costs one submit: the host path records when something changes, not for every frame.
#[test]
fn what_was_recorded_is_submitted_again() {
    let _turn = lock(&TURN);
    let device = open(Cache::Off);
    let mut denoiser = Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &Options::default()).unwrap();
    let first = denoise(&mut denoiser);
    lock(&SEEN).take();
    for _ in 0..3 {
        assert_same_bits(&denoise(&mut denoiser), &first, "again");
    }
    let seen = lock(&SEEN).take().unwrap();
    assert_eq!((seen.recorded, seen.submitted), (0, 3));
    denoiser.set_exposure(Exposure::Fixed(0.5)).unwrap();
    denoise(&mut denoiser);
    let seen = lock(&SEEN).take().unwrap();
    assert_eq!((seen.recorded, seen.submitted), (1, 1), "another exposure");
}

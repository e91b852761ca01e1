//! What recording a frame costs the host: on the plain path nothing is allocated.

mod common;

use common::vulkan::Renderer;
use std::alloc::{GlobalAlloc, Layout as Bytes, System};
use std::cell::Cell;
use vkdenoise::{
    BufferFrame, BufferPlane, Denoiser, Device, Extent, FrameOptions, Layout, Options, Region, SampleFormat, Weights,
};

/// The system's allocator, which counts what this thread asks for.
struct Counting;

thread_local! {
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

// SAFETY: all is done by the system's allocator, with the caller's own arguments.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Bytes) -> *mut u8 {
        COUNT.with(|count| count.set(count.get() + 1));
        // SAFETY: as above.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Bytes) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Bytes, size: usize) -> *mut u8 {
        COUNT.with(|count| count.set(count.get() + 1));
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

fn counted(run: impl FnOnce()) -> u64 {
    let before = COUNT.with(Cell::get);
    run();
    COUNT.with(Cell::get) - before
}

#[test]
fn recording_allocates_nothing() {
    const EXTENT: Extent = Extent::new(200, 150);
    let renderer = Renderer::new();
    // SAFETY: the renderer lives to the end of the test.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let buffer = renderer.buffer(12 * EXTENT.pixels());
    let plane = BufferPlane {
        buffer: buffer.raw,
        size: buffer.size,
        format: SampleFormat::F32,
        layout: Layout::interleaved(EXTENT, 3),
    };
    for label_kernels in [true, false] {
        let options = Options { label_kernels, ..Options::default() };
        let denoiser = Denoiser::new(&device, &Weights::hybrid_kernels().unwrap(), &options).unwrap();
        let pass = denoiser.pass(EXTENT).unwrap();
        for albedo in [None, Some(plane)] {
            let mut frame = BufferFrame::new(plane, plane);
            frame.albedo = albedo;
            // SAFETY: the buffer lives to the end of the test.
            let binding = unsafe { pass.bind_buffers(&frame) }.unwrap();
            let record = |options: FrameOptions| {
                let mut allocated = 0;
                renderer.record_only(|commands| {
                    allocated = counted(|| {
                        // SAFETY: nothing of it is submitted.
                        unsafe { pass.record(commands, &binding, &options) }.unwrap();
                    });
                });
                allocated
            };
            assert_eq!(record(FrameOptions::default()), 0);
            let region = Some(Region { x: 10, y: 20, width: 30, height: 40 });
            // A region's list of dispatches is made anew: this counts.
            assert!(record(FrameOptions { region, ..FrameOptions::default() }) > 0);
        }
    }
    renderer.assert_silent();
}

//! A pass on the queue of a device of the library's own.

use crate::descriptor::{self, descriptor};
use crate::frame_options::{self, FrameOptions};
use crate::handle;
use crate::interop::{SharedBuffer, Timeline};
use crate::pass::{Binding, Pass};
use crate::status::{Failure, Status, guard};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use vkdenoise::{RecordedPass, TimelinePoint as CorePoint};

/// A pass recorded for the queue of a device that the library opened, to be submitted any number of times.
pub struct Recorded(Mutex<RecordedPass>);

/// A value of a timeline semaphore, to wait for or to signal.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct TimelinePoint {
    /// sizeof(vkdenoise_timeline_point).
    pub struct_size: usize,
    /// The semaphore.
    pub timeline: *const Timeline,
    /// The value: what waits goes on when the semaphore's is at least as large.
    pub value: u64,
}
descriptor!(TimelinePoint, "vkdenoise_timeline_point", value: u64);

impl Recorded {
    fn with<T>(&self, run: impl FnOnce(&mut RecordedPass) -> T) -> T {
        run(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Records a pass for the library's own queue, on a device that the library opened (vkdenoise_device_open). On a
/// renderer's device vkdenoise_pass_record is for that. Pass and binding are kept; the buffers of the binding and of
/// the options live as long as this.
///
/// @param options NULL: the defaults.
/// @param shared the shared buffers that planes lie in, which are taken over from the other side when the pass begins
///   and handed back when it ends.
/// @param recorded receives the recording; destroy it with vkdenoise_recorded_destroy.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_recorded_create(
    pass: *const Pass,
    binding: *const Binding,
    options: *const FrameOptions,
    shared: *const *const SharedBuffer,
    shared_count: usize,
    recorded: *mut *mut Recorded,
) -> Status {
    let make = || {
        // SAFETY: the caller's pointers are as the header says; the same below.
        let (pass, binding) = unsafe { (handle::borrow(pass, "pass")?, handle::borrow(binding, "binding")?) };
        // SAFETY: as above.
        let (options, progress) = unsafe { frame_options::read(options)? };
        if progress.is_some() {
            return Err(Failure::argument("progress is for the host path, not for passes"));
        }
        if shared.is_null() && shared_count > 0 {
            return Err(Failure::argument("shared is NULL"));
        }
        // SAFETY: as above.
        let buffer = |at: usize| unsafe { Ok(handle::borrow(*shared.add(at), "shared buffer")?.0.clone()) };
        let shared = (0..shared_count).map(buffer).collect::<Result<Vec<_>, Failure>>()?;
        // SAFETY: the caller promises what the header asks for.
        let made = unsafe { RecordedPass::new(pass.shared(), Arc::clone(&binding.0), &options, &shared)? };
        Ok(Recorded(Mutex::new(made)))
    };
    // SAFETY: as above.
    guard(|| unsafe { handle::give(recorded, make) })
}

/// Submits the pass, which begins when `wait` is reached, and reaches `signal` when it has run. Returns at once.
///
/// @param wait NULL: it begins at once.
/// @param signal NULL: nothing is signalled.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_recorded_submit(
    recorded: *const Recorded,
    wait: *const TimelinePoint,
    signal: *const TimelinePoint,
) -> Status {
    guard(|| {
        // SAFETY: as above.
        let (recorded, wait, signal) =
            unsafe { (handle::borrow(recorded, "recording")?, point(wait)?, point(signal)?) };
        Ok(recorded.with(|recorded| recorded.submit(wait.as_ref(), signal.as_ref()))?)
    })
}

/// Waits on the host until all that was submitted has run.
///
/// @param ended receives 1, or 0 where it did not end within the time.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_recorded_wait(
    recorded: *const Recorded,
    timeout_ns: u64,
    ended: *mut u32,
) -> Status {
    // SAFETY: as above.
    guard(|| unsafe {
        let recorded = handle::borrow(recorded, "recording")?;
        let ended = ended.as_mut().ok_or_else(|| Failure::argument("ended is NULL"))?;
        *ended = recorded.with(|recorded| recorded.wait(Duration::from_nanos(timeout_ns)))?.into();
        Ok(())
    })
}

/// Waits until all that was submitted has run, and destroys the recording. NULL is nothing.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vkdenoise_recorded_destroy(recorded: *mut Recorded) {
    // SAFETY: as above.
    guard(|| {
        unsafe { handle::take(recorded) };
        Ok(())
    });
}

/// # Safety
/// The point is as its header says, or null.
unsafe fn point(point: *const TimelinePoint) -> Result<Option<CorePoint>, Failure> {
    if point.is_null() {
        return Ok(None);
    }
    // SAFETY: as the caller's.
    let (point, semaphore) = unsafe {
        let point = descriptor::read(point)?;
        (point, handle::borrow(point.timeline, "timeline of a vkdenoise_timeline_point")?.0.clone())
    };
    Ok(Some(CorePoint { semaphore, value: point.value }))
}

//! The host path's progress callback.

use std::ffi::c_void;
use std::ops::ControlFlow;

/// Called in the caller's own thread with the share of the work that is done, from 0 to 1, about every 50 ms. It
/// answers 1 to go on, 0 to end the call with VKDENOISE_STATUS_CANCELLED. It must return (no exception, no longjmp) and
/// may not use the denoiser that calls it.
///
/// @param user vkdenoise_frame_options.progress_user.
pub type ProgressFunction = Option<unsafe extern "C" fn(user: *mut c_void, share: f32) -> u32>;

/// A callback, and what it is given.
#[derive(Clone, Copy)]
pub struct Progress {
    function: unsafe extern "C" fn(*mut c_void, f32) -> u32,
    user: *mut c_void,
}

impl Progress {
    /// Of a descriptor's fields; `None` where there is none.
    pub fn new(function: ProgressFunction, user: *mut c_void) -> Option<Self> {
        function.map(|function| Self { function, user })
    }

    /// Calls it.
    pub fn tell(self, share: f32) -> ControlFlow<()> {
        // SAFETY: the caller's function, as the header describes it.
        match unsafe { (self.function)(self.user, share) } {
            0 => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        }
    }
}

//! How calls fail: a status, and a message for each thread.

use std::any::Any;
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use vkdenoise::Error;

/// How a call ended. Later releases may add values; what is not VKDENOISE_STATUS_OK is a failure, and
/// vkdenoise_last_error() says what was wrong.
#[repr(u32)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// It did what it should.
    Ok = 0,
    /// A pointer is NULL, a struct_size is wrong, or a value is outside its range.
    InvalidArgument = 1,
    /// A plane does not fit the frame: too small, or strides that reach beyond its end.
    PlaneMismatch = 2,
    /// The Vulkan loader could not be opened.
    NoLoader = 3,
    /// There is no such Vulkan device, or none that can run the denoiser.
    NoDevice = 4,
    /// The device lacks something that is needed.
    Unsupported = 5,
    /// Device or host memory could not be allocated.
    OutOfMemory = 6,
    /// The frame takes more memory than the device has or the budget allows.
    FrameTooLarge = 7,
    /// A weights file could not be used.
    Weights = 8,
    /// What is bound does not fit the pass, or the call is not for this kind of device.
    Binding = 9,
    /// A Vulkan call failed.
    Vulkan = 10,
    /// The device was lost: destroy what was made on it and begin again.
    DeviceLost = 11,
    /// An error inside the library. Please report its message.
    Internal = 12,
    /// The progress callback ended the call.
    Cancelled = 13,
}

impl Status {
    fn name(self) -> &'static CStr {
        match self {
            Self::Ok => c"ok",
            Self::InvalidArgument => c"invalid argument",
            Self::PlaneMismatch => c"plane mismatch",
            Self::NoLoader => c"no Vulkan loader",
            Self::NoDevice => c"no device",
            Self::Unsupported => c"unsupported",
            Self::OutOfMemory => c"out of memory",
            Self::FrameTooLarge => c"frame too large",
            Self::Weights => c"weights",
            Self::Binding => c"binding",
            Self::Vulkan => c"Vulkan",
            Self::DeviceLost => c"device lost",
            Self::Internal => c"internal error",
            Self::Cancelled => c"cancelled",
        }
    }

    const ALL: [Self; 14] = [
        Self::Ok,
        Self::InvalidArgument,
        Self::PlaneMismatch,
        Self::NoLoader,
        Self::NoDevice,
        Self::Unsupported,
        Self::OutOfMemory,
        Self::FrameTooLarge,
        Self::Weights,
        Self::Binding,
        Self::Vulkan,
        Self::DeviceLost,
        Self::Internal,
        Self::Cancelled,
    ];
}

/// A status and what is said of it.
#[derive(Debug)]
pub struct Failure {
    status: Status,
    message: String,
}

impl Failure {
    /// The caller's mistake.
    pub fn argument(message: impl Into<String>) -> Self {
        Self { status: Status::InvalidArgument, message: message.into() }
    }
}

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        let status = match &error {
            Error::NoLoader(_) => Status::NoLoader,
            Error::NoDevice(_) | Error::UnknownDevice { .. } => Status::NoDevice,
            Error::Unsupported { .. } => Status::Unsupported,
            Error::Vulkan { .. } => Status::Vulkan,
            Error::DeviceLost => Status::DeviceLost,
            Error::OutOfMemory { .. } => Status::OutOfMemory,
            Error::EmptyFrame { .. } | Error::InvalidOption { .. } => Status::InvalidArgument,
            Error::PlaneMismatch { .. } => Status::PlaneMismatch,
            Error::FrameTooLarge { .. } => Status::FrameTooLarge,
            Error::Binding(_) => Status::Binding,
            Error::Weights(_) => Status::Weights,
            Error::Cancelled => Status::Cancelled,
            _ => Status::Internal,
        };
        Self { status, message: error.to_string() }
    }
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

/// Runs the body of a function: keeps its message, and turns a panic into a status.
pub fn guard(body: impl FnOnce() -> Result<(), Failure>) -> Status {
    // A panic leaves the caller's objects as they are; the library's locks are taken again in spite of it.
    let failure = match catch_unwind(AssertUnwindSafe(body)) {
        Ok(Ok(())) => return Status::Ok,
        Ok(Err(failure)) => failure,
        Err(panic) => Failure { status: Status::Internal, message: panic_message(&*panic) },
    };
    let message = CString::new(failure.message.replace('\0', "?")).unwrap_or_default();
    // A thread that is ending keeps no message.
    let _ = LAST.try_with(|last| last.replace(message));
    failure.status
}

fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied().or_else(|| panic.downcast_ref::<String>().map(String::as_str));
    format!("an error inside vkdenoise: {}", text.unwrap_or("it gave no message"))
}

/// What went wrong in this thread's last call that failed, in English, for people; empty if none did. Never NULL. It
/// is valid until this thread's next call that fails.
#[unsafe(no_mangle)]
pub extern "C" fn vkdenoise_last_error() -> *const c_char {
    LAST.try_with(|last| last.borrow().as_ptr()).unwrap_or(c"".as_ptr())
}

/// A status in words, such as "out of memory". Never NULL; it lives as long as the library.
#[unsafe(no_mangle)]
pub extern "C" fn vkdenoise_status_string(status: u32) -> *const c_char {
    let known = Status::ALL.into_iter().find(|known| *known as u32 == status);
    known.map_or(c"unknown status", Status::name).as_ptr()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    fn last_error() -> String {
        // SAFETY: the function gives a string of this thread's.
        unsafe { CStr::from_ptr(vkdenoise_last_error()) }.to_str().unwrap().to_owned()
    }

    #[test]
    fn a_panic_is_a_status_with_its_message() {
        assert_eq!(guard(|| panic!("lost {} things", 3)), Status::Internal);
        assert!(last_error().contains("lost 3 things"), "{}", last_error());
        assert_eq!(guard(|| panic!("constant")), Status::Internal);
        assert!(last_error().contains("constant"), "{}", last_error());
    }

    #[test]
    fn messages_are_of_a_thread_and_stay_until_the_next_failure() {
        assert_eq!(guard(|| Err(Failure::argument("here, with a \0 in it"))), Status::InvalidArgument);
        thread::spawn(|| assert_eq!(last_error(), "")).join().unwrap();
        assert_eq!(guard(|| Ok(())), Status::Ok);
        assert_eq!(last_error(), "here, with a ? in it");
        let lost = guard(|| Err(Error::DeviceLost.into()));
        assert_eq!((lost, last_error()), (Status::DeviceLost, Error::DeviceLost.to_string()));
    }

    #[test]
    fn every_status_has_words_of_its_own() {
        let words: std::collections::BTreeSet<_> = Status::ALL.into_iter().map(Status::name).collect();
        assert_eq!(words.len(), Status::ALL.len());
    }
}

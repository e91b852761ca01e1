//! Objects that the caller holds by pointer, and text that it hands in.

use crate::status::Failure;
use std::ffi::{CStr, c_char};

/// Gives an object to the caller.
///
/// # Errors
/// Where `out` is null.
///
/// # Safety
/// `out` is null or can be written.
pub unsafe fn give<T>(out: *mut *mut T, make: impl FnOnce() -> Result<T, Failure>) -> Result<(), Failure> {
    if out.is_null() {
        return Err(Failure::argument("the place for the new object is NULL"));
    }
    // What the caller finds after a failure can be destroyed.
    // SAFETY: the caller's place can be written.
    unsafe { out.write(std::ptr::null_mut()) };
    let made = Box::into_raw(Box::new(make()?));
    // SAFETY: as above.
    unsafe { out.write(made) };
    Ok(())
}

/// Borrows an object of the caller's.
///
/// # Errors
/// Where it is null.
///
/// # Safety
/// `object` is null or one that [`give`] gave and [`take`] has not taken.
pub unsafe fn borrow<'a, T>(object: *const T, name: &str) -> Result<&'a T, Failure> {
    // SAFETY: as the caller's.
    unsafe { object.as_ref() }.ok_or_else(|| Failure::argument(format!("the {name} is NULL")))
}

/// Takes an object back and drops it; null is nothing.
///
/// # Safety
/// As [`borrow`], and nothing borrows it.
pub unsafe fn take<T>(object: *mut T) {
    if !object.is_null() {
        // SAFETY: it was given by `give`, once.
        drop(unsafe { Box::from_raw(object) });
    }
}

/// A string of the caller's; `None` for null.
///
/// # Errors
/// Where it is not UTF-8.
///
/// # Safety
/// `text` is null or ends with a zero.
pub unsafe fn text<'a>(text: *const c_char, name: &str) -> Result<Option<&'a str>, Failure> {
    if text.is_null() {
        return Ok(None);
    }
    // SAFETY: as the caller's.
    let text = unsafe { CStr::from_ptr(text) };
    text.to_str().map(Some).map_err(|_| Failure::argument(format!("{name} is not UTF-8")))
}

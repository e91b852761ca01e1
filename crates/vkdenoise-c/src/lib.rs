//! The C interface of vkdenoise. `include/vkdenoise.h` is made from this crate; C programs read that.
//!
//! Every function runs behind [`status::guard`]: no panic leaves the library. Descriptors begin with their size
//! ([`descriptor`]), so that they can grow while programs built against older headers go on working.

mod abi_version;
mod arena;
mod choice;
mod denoiser;
mod descriptor;
mod device;
mod frame_options;
mod handle;
mod host;
mod host_output;
mod host_planes;
mod interop;
mod layout;
mod pass;
mod progress;
mod recorded;
mod renderer_planes;
mod signals;
mod status;

use abi_version::VKDENOISE_ABI_VERSION;
use std::ffi::c_char;

/// The interface's version of the library that runs. A program that loads the library itself compares it with the
/// VKDENOISE_ABI_VERSION that it was built with.
#[unsafe(no_mangle)]
pub extern "C" fn vkdenoise_abi_version() -> u32 {
    VKDENOISE_ABI_VERSION
}

/// The library's release, such as "0.1.0". Never NULL; it lives as long as the library.
#[unsafe(no_mangle)]
pub extern "C" fn vkdenoise_version() -> *const c_char {
    concat!(env!("CARGO_PKG_VERSION"), "\0").as_ptr().cast()
}

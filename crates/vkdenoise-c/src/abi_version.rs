//! The number of the interface, for the library and for its build.

/// The version of this interface. It changes when a program that was built against an older header would no longer
/// run: a function that went away, a field that moved. What is added does not change it.
pub const VKDENOISE_ABI_VERSION: u32 = 1;

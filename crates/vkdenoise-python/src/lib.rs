//! vkdenoise for Python: numpy arrays in, a numpy array out, without the interpreter's lock while a frame is denoised.
//!
//! ```text
//! arrays     whatever numpy can view -> planes of the library, in place where their strides allow
//! output     the array that is written: a new one, or the caller's
//! layers     dicts of arrays beside a colour -> the library's signals, and back
//! alpha      a colour's fourth channel
//! progress   the caller's callback, and whose turn it is
//! settings   keywords -> the library's options
//! denoiser   the class that holds a network on a device
//! devices    what there is to run on
//! error      the library's errors -> Python's
//! ```
//! What a user sees of it is `python/vkdenoise`.

mod alpha;
mod arrays;
mod denoiser;
mod devices;
mod error;
mod layers;
mod output;
mod progress;
mod settings;

#[pyo3::pymodule]
mod _vkdenoise {
    #[pymodule_export]
    use crate::denoiser::{Denoiser, Report};
    #[pymodule_export]
    use crate::devices::{DeviceInfo, devices};
    #[pymodule_export]
    use crate::error::{Cancelled, DeviceError, DeviceLostError};

    #[pymodule_export]
    #[expect(non_upper_case_globals, reason = "Python's name for it")]
    const __version__: &str = env!("CARGO_PKG_VERSION");
}

//! The library's errors as Python's.

use pyo3::exceptions::{PyException, PyMemoryError, PyOSError, PyRuntimeError, PyValueError};
use pyo3::{PyErr, create_exception};
use vkdenoise::Error;
use vkdenoise::WeightsError;

create_exception!(vkdenoise, Cancelled, PyException, "A progress callback returned False, and the call ended.");
create_exception!(
    vkdenoise,
    DeviceError,
    PyRuntimeError,
    "No Vulkan device can do it: none is there, it lacks something, or a call of its driver failed."
);
create_exception!(
    vkdenoise,
    DeviceLostError,
    DeviceError,
    "The device was lost, as after a hang or a driver's restart. Make a new Denoiser."
);

/// The exception for an error, with the library's own words.
pub fn raised(error: Error) -> PyErr {
    let message = error.to_string();
    match error {
        Error::Cancelled => Cancelled::new_err("a progress callback returned False"),
        Error::DeviceLost => DeviceLostError::new_err(message),
        Error::NoLoader(_)
        | Error::NoDevice(_)
        | Error::UnknownDevice { .. }
        | Error::Unsupported { .. }
        | Error::Vulkan { .. } => DeviceError::new_err(message),
        Error::OutOfMemory { .. } | Error::FrameTooLarge { .. } => PyMemoryError::new_err(message),
        Error::Weights(WeightsError::Read { .. }) => PyOSError::new_err(message),
        _ => PyValueError::new_err(message),
    }
}

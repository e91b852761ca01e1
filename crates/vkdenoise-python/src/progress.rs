//! The caller's progress callback, and that it keeps off the denoiser that calls it.

use crate::error::raised;
use pyo3::exceptions::{PyRuntimeError, PyTypeError};
use pyo3::prelude::*;
use std::ops::ControlFlow;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::thread::{self, ThreadId};
use vkdenoise::Error;

/// A denoiser whose calls take turns, and the thread that is in a progress callback of one.
pub struct Turns {
    denoiser: Mutex<vkdenoise::Denoiser>,
    calling: Mutex<Option<ThreadId>>,
}

impl Turns {
    pub fn new(denoiser: vkdenoise::Denoiser) -> Self {
        Self { denoiser: Mutex::new(denoiser), calling: Mutex::default() }
    }

    /// Waits for the denoiser.
    ///
    /// # Errors
    /// From within a callback of it, where it would be waited for forever.
    pub fn take(&self) -> PyResult<MutexGuard<'_, vkdenoise::Denoiser>> {
        if *locked(&self.calling) == Some(thread::current().id()) {
            return Err(PyRuntimeError::new_err(
                "a progress callback cannot use the Denoiser that calls it: wait for its call to end, or make another",
            ));
        }
        Ok(locked(&self.denoiser))
    }
}

/// After a panic too: what it left is replaced or refused by the library's own checks.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A callback, and what it raised.
pub struct Watcher {
    callback: Py<PyAny>,
    raised: Option<PyErr>,
}

impl Watcher {
    /// Of a call's keyword.
    ///
    /// # Errors
    /// Where it cannot be called.
    pub fn new(callback: &Bound<'_, PyAny>) -> PyResult<Self> {
        if callback.is_callable() {
            return Ok(Self { callback: callback.clone().unbind(), raised: None });
        }
        let found = callback.get_type().name()?;
        Err(PyTypeError::new_err(format!("progress is a {found}; a function of the share that is done is wanted")))
    }

    /// Calls it, with the interpreter's lock.
    pub fn tell(&mut self, turns: &Turns, share: f32) -> ControlFlow<()> {
        *locked(&turns.calling) = Some(thread::current().id());
        let stops = Python::attach(|py| {
            let answer = self.callback.bind(py).call1((share,))?;
            // Nothing but False stops: many functions return 0 or None.
            Ok(answer.extract::<bool>().is_ok_and(|goes_on| !goes_on))
        });
        *locked(&turns.calling) = None;
        match stops {
            Ok(false) => ControlFlow::Continue(()),
            Ok(true) => ControlFlow::Break(()),
            Err(error) => {
                self.raised = Some(error);
                ControlFlow::Break(())
            }
        }
    }
}

/// The exception for a call's error: what the callback raised, where it did.
pub fn ended(watcher: Option<Watcher>, error: Error) -> PyErr {
    let own = watcher.and_then(|watcher| watcher.raised);
    own.filter(|_| matches!(error, Error::Cancelled)).unwrap_or_else(|| raised(error))
}

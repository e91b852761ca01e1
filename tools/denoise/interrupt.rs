//! Ctrl-C ends the program at once, but never within the writing of a file.

use crate::Failure;
use std::sync::{PoisonError, RwLock, RwLockReadGuard};

/// Read by those who write files, written by the end.
static WRITING: RwLock<()> = RwLock::new(());

/// Hold this while a file is written: an interrupt waits for it, so no half file is left behind.
pub fn hold_off() -> RwLockReadGuard<'static, ()> {
    WRITING.read().unwrap_or_else(PoisonError::into_inner)
}

/// Installs the handler for SIGINT, SIGTERM and SIGHUP.
pub fn install() -> Result<(), Failure> {
    let handler = || {
        let _written = WRITING.write().unwrap_or_else(PoisonError::into_inner);
        std::process::exit(130);
    };
    ctrlc::set_handler(handler).map_err(|error| Failure::Failed(format!("cannot handle interrupts: {error}")))
}

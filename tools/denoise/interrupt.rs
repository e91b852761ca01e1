//! Ctrl-C stops the frame that is being denoised at its next submission; a second one ends the program at once, but
//! never within the writing of a file.

use crate::Failure;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{PoisonError, RwLock, RwLockReadGuard};

/// Read by those who write files, written by the end.
static WRITING: RwLock<()> = RwLock::new(());
/// Whether the program is to stop.
static STOPPED: AtomicBool = AtomicBool::new(false);

/// Whether the program is to stop: nothing new is begun then.
pub fn stopped() -> bool {
    STOPPED.load(Ordering::Relaxed)
}

/// Hold this while a file is written: the end waits for it, so no half file is left behind.
pub fn hold_off() -> RwLockReadGuard<'static, ()> {
    WRITING.read().unwrap_or_else(PoisonError::into_inner)
}

/// Installs the handler for SIGINT, SIGTERM and SIGHUP.
pub fn install() -> Result<(), Failure> {
    let handler = || {
        if !STOPPED.swap(true, Ordering::Relaxed) {
            return;
        }
        let _written = WRITING.write().unwrap_or_else(PoisonError::into_inner);
        std::process::exit(i32::from(crate::INTERRUPTED));
    };
    ctrlc::set_handler(handler).map_err(|error| Failure::Failed(format!("cannot handle interrupts: {error}")))
}

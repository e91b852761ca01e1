//! The networks that ship inside the library.

use crate::error::Result;
use crate::net::weights::Weights;

static HYBRID: &[u8] = include_bytes!("../weights/hybrid.safetensors");

impl Weights {
    /// The trained Hybrid, embedded in the library.
    ///
    /// # Errors
    /// None in a sound build.
    pub fn hybrid() -> Result<Self> {
        Ok(Self::from_bytes(HYBRID)?)
    }
}

//! The push constants of every kernel, read off its shader by `build.rs`.
//!
//! Strides and channel counts named `*_stride` and `*_channels` count vectors of four channels where maps are meant,
//! and samples where the caller's planes are meant.

include!(concat!(env!("OUT_DIR"), "/shaders/pushes.rs"));

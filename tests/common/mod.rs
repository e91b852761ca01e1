//! What the tests share: the device, random numbers, comparisons, kernel cases, golden vectors.

#![allow(dead_code, reason = "each test binary uses a part")]

pub mod case;
pub mod compare;
pub mod dense;
pub mod device;
pub mod golden;
pub mod image;
pub mod network;
pub mod planes;
pub mod random;
pub mod rig;
pub mod trained;
pub mod vulkan;

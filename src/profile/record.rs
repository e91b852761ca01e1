//! What is known of one dispatch once it has run.

use super::shape::Shape;
use crate::kernels::{Accesses, Traffic, Variants};
use crate::net::graph::Stage;
use crate::plan::Dispatch;

/// One dispatch: what it was, what it had to do, how long it took.
#[derive(Clone, Debug, PartialEq)]
pub struct KernelRecord {
    /// The op that it comes from, e.g. `enc.1.0.qkv`.
    pub name: String,
    /// Part of the network.
    pub stage: Stage,
    /// The kernel, e.g. `conv3x3`.
    pub kernel: &'static str,
    /// The variant of it that ran, e.g. `conv3x3_s2_cpu`.
    pub variant: &'static str,
    /// Whether it runs on cooperative matrices, whose rate is its roof then.
    pub matrix: bool,
    /// Size of the result and channels.
    pub shape: Shape,
    /// Whether it was left out, as nothing depended on it or its result was known; it then has no FLOPs, groups or bytes.
    pub skipped: bool,
    /// Workgroups.
    pub groups: [u32; 3],
    /// Multiplications and additions of the network's own channels, as [`crate::net::cost`] counts them: what the op
    /// asks for, however the kernel computes it.
    pub flops: u64,
    /// Bytes that it needs to read once, weights included; planes of the caller's are left out.
    pub bytes_read: u64,
    /// Bytes that it writes.
    pub bytes_written: u64,
    /// Loads and stores of its invocations; `None` for kernels over the caller's planes.
    pub accesses: Option<Accesses>,
    /// Microseconds from the first dispatch's start to this one's.
    pub start: f64,
    /// Microseconds from the end of everything before it to its own end.
    pub microseconds: f64,
}

impl KernelRecord {
    /// A dispatch that started and ended at these microseconds.
    pub(super) fn new(dispatch: &Dispatch, variants: Variants, start: f64, end: f64) -> Self {
        let kernel = dispatch.call.kernel();
        let contract = kernel.contract(variants);
        let traffic = if dispatch.skipped { Traffic::default() } else { dispatch.traffic() };
        let accesses = dispatch.call.accesses(variants);
        let bytes = |touched: &[(_, u64)]| touched.iter().map(|(_, bytes)| bytes).sum();
        Self {
            name: dispatch.name.clone(),
            stage: dispatch.stage,
            kernel: contract.kernel(),
            variant: contract.name,
            matrix: contract.needs_matrix(),
            shape: Shape::of(&dispatch.call),
            skipped: dispatch.skipped,
            groups: if dispatch.skipped { [0; 3] } else { kernel.groups(variants) },
            flops: dispatch.flops,
            bytes_read: bytes(&traffic.reads),
            bytes_written: bytes(&traffic.writes),
            accesses: if dispatch.skipped { accesses.map(|_| Accesses::default()) } else { accesses },
            start,
            microseconds: (end - start).max(0.0),
        }
    }

    /// Bytes read and written.
    pub fn bytes(&self) -> u64 {
        self.bytes_read + self.bytes_written
    }

    /// FLOPs for each byte: its place on a roofline.
    pub fn intensity(&self) -> f64 {
        self.flops as f64 / self.bytes().max(1) as f64
    }
}

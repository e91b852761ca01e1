//! Single kernels beside their twins.

use super::case::make_buffers;
use super::device::device;
use vkdenoise::kernels::{BufferId, Call, KernelTarget, Storage};
use vkdenoise::plan::{Buffer, Place};
use vkdenoise::reference::Reference;
use vkdenoise::testing::{Bench, SENTINEL};
use vkdenoise::{Extent, Weights};

const PORTABLE: KernelTarget = KernelTarget { cpu: false, images: false, output_half: false };

/// Buffers on a device and for the twins.
pub struct Rig<'a> {
    pub bench: Bench,
    pub reference: Reference<'a>,
    buffers: &'a [Buffer],
}

/// Buffers of so many words each.
pub fn words(sizes: &[u64]) -> Vec<Buffer> {
    let place = Place::Arena { block: 0, offset: 0 };
    let buffer = |(i, words): (usize, &u64)| Buffer {
        name: format!("buffer {i}"),
        bytes: 4 * words,
        storage: Storage::F32,
        place: place.clone(),
    };
    sizes.iter().enumerate().map(buffer).collect()
}

impl<'a> Rig<'a> {
    pub fn new(extent: Extent, buffers: &'a [Buffer]) -> Self {
        let weights = Weights::hybrid_kernels().unwrap();
        let mut bench = Bench::new(device(), PORTABLE).unwrap();
        make_buffers(&mut bench, buffers, &weights);
        Self { bench, reference: Reference::for_calls(extent, buffers, &weights).unwrap(), buffers }
    }

    pub fn set_floats(&mut self, id: BufferId, values: &[f32]) {
        self.bench.upload(id, values);
        self.reference.set_buffer(id, &values.iter().map(|&v| f64::from(v)).collect::<Vec<_>>());
    }

    /// Runs a call on both sides.
    pub fn run(&mut self, call: Call) {
        self.bench.run(std::slice::from_ref(&call)).unwrap();
        self.reference.run_call(&call);
    }

    /// Compares integers; where the twin wrote nothing, the device must not have either.
    pub fn assert_integers(&self, id: BufferId, what: &str) {
        let found = self.bench.download(id, self.buffers[id.0].bytes as usize / 4);
        for (i, (found, expected)) in found.iter().zip(self.reference.buffer(id)).enumerate() {
            let expected = if expected.is_nan() { SENTINEL } else { *expected as u32 };
            assert_eq!(found.to_bits(), expected, "{what}: word {i}");
        }
    }
}

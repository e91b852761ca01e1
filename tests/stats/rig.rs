//! A frame on the device and in the reference.

use super::*;

/// One frame on the device and in the reference.
pub struct Rig<'a> {
    pub name: &'a str,
    pub bench: Bench,
    pub reference: Reference<'a>,
    pub buffers: &'a [Buffer],
    pub used: Vec<u64>,
}

impl<'a> Rig<'a> {
    pub fn new(name: &'a str, frame: &TestFrame, buffers: &'a [Buffer], target: KernelTarget) -> Self {
        let weights = any_weights();
        let mut bench = Bench::new(device(), target).unwrap();
        make_buffers(&mut bench, buffers, &weights);
        let mut used = buffers.iter().map(|buffer| buffer.bytes).collect();
        frame.upload(&mut bench, &mut used);
        let mut reference = Reference::for_calls(frame.extent, buffers, &weights).unwrap();
        reference.set_frame(&frame.frame(), None, 0.0).unwrap();
        Self { name, bench, reference, buffers, used }
    }

    pub fn run(&mut self, calls: &[Call]) {
        self.bench.run(calls).unwrap();
        calls.iter().for_each(|call| self.reference.run_call(call));
        self.bench.check_guards(&self.used).unwrap();
    }

    pub fn download(&self, id: BufferId) -> Vec<f32> {
        self.bench.download(id, self.buffers[id.0].bytes as usize / 4)
    }

    /// The same values on both sides.
    pub fn set(&mut self, id: BufferId, values: &[f32]) {
        self.bench.upload(id, values);
        self.reference.set_buffer(id, &values.iter().map(|&v| v.into()).collect::<Vec<_>>());
    }

    /// The reference's values on both sides, rounded to what the device holds.
    pub fn share(&mut self, id: BufferId) {
        let values: Vec<f32> = self.reference.buffer(id).iter().map(|&v| v as f32).collect();
        self.set(id, &values);
    }

    /// What is known of the tiles, as the reference has it, on both sides.
    pub fn set_tile_stats(&mut self, values: &[f64]) {
        let word = |(i, &value): (usize, &f64)| match (i % 4, value.is_nan()) {
            (3, _) => f32::from_bits(value as u32),
            (_, true) => f32::from_bits(u32::MAX),
            (_, false) => value as f32,
        };
        let words: Vec<f32> = values.iter().enumerate().map(word).collect();
        self.bench.upload(TILE_STATS, &words);
        let rounded: Vec<f64> =
            values.iter().enumerate().map(|(i, &v)| if i % 4 == 3 { v } else { (v as f32).into() }).collect();
        self.reference.set_buffer(TILE_STATS, &rounded);
    }

    /// Compares the tiles' means, and how many pixels of all are lit and noisy.
    pub fn compare_tile_stats(&self, limit: f64) {
        let (found, expected) = (self.download(TILE_STATS), self.reference.buffer(TILE_STATS));
        let mut apart = [0, 0];
        let mut pixels = 0;
        for (i, (found, &expected)) in found.iter().zip(expected).enumerate() {
            match i % 4 {
                3 => {
                    let parts = |bits: u32| [bits & 0xffff, bits >> 16];
                    let (a, b) = (parts(found.to_bits()), parts(expected as u32));
                    pixels += b[0];
                    (0..2).for_each(|part| apart[part] += a[part].abs_diff(b[part]));
                }
                _ if expected.is_nan() => assert_eq!(found.to_bits(), u32::MAX, "{}: word {i}", self.name),
                _ => {
                    let error = (f64::from(*found) - expected).abs();
                    assert!(error <= limit * expected, "{}: word {i} is {found}, not {expected}", self.name);
                }
            }
        }
        assert_eq!(apart[0], 0, "{}: lit pixels", self.name);
        // A pixel may lie on the edge.
        assert!(f64::from(apart[1]) <= 0.002 * f64::from(pixels), "{}: {apart:?} of {pixels}", self.name);
    }

    /// Compares a buffer: what is written differs by at most `limit` relative to what `scale` makes of its value, the
    /// rest holds what it held.
    pub fn compare(&self, id: BufferId, limit: f64, scale: impl Fn(f64) -> f64) {
        let what = format!("{}: {}", self.name, self.buffers[id.0].name);
        assert_close(&what, &self.download(id), self.reference.buffer(id), limit, scale);
    }
}

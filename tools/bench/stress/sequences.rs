//! Long sequences of calls on the same denoisers: what one leaves behind must not reach the next.

use super::random::Random;
use super::scene::Scene;
use super::subject::Subject;
use super::{Bound, Cases, Effort, Measured, Result};
use std::collections::HashMap;
use vkdenoise::{Device, DeviceSelector, Exposure, Extent, Layout, Options, PlaneMut};

/// What this module measures.
pub const CASES: Cases = &[("random sizes, options and devices in sequence", sequence)];

/// One of few calls, so that each comes again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Call {
    size: (u32, u32),
    fixed_exposure: bool,
    features: u32,
}

const SIZES: [(u32, u32); 6] = [(1, 1), (17, 5), (33, 64), (96, 31), (128, 128), (130, 20)];

fn sequence(subject: &mut Subject, effort: Effort) -> Result<Vec<Measured>> {
    let Some(engine) = subject.as_engine() else { return Ok(Vec::new()) };
    let (length, sizes) = match effort {
        Effort::Sample => (8, &SIZES[..2]),
        Effort::Everything => (200, &SIZES[..]),
    };
    let mut random = Random::new(10);
    let mut differing = Measured::new("equal calls of other bits", Bound::AtMost(0.0));
    let mut grown = Measured::new("bytes more than after the first equal call", Bound::AtMost(0.0));
    let mut leaked = Measured::new("bytes left at the end", Bound::AtMost(0.0));
    let mut outputs = HashMap::new();
    let mut memory = HashMap::new();
    let selector = DeviceSelector::Index(engine.device.info().index);
    let devices = [Device::open(&selector)?, Device::open(&selector)?];
    {
        let mut denoisers = Vec::new();
        for (device, blend) in [(&devices[0], 0.0), (&devices[0], 0.25), (&devices[1], 0.0)] {
            let options = Options { blend, ..Options::default() };
            denoisers.push((blend, engine.tier.denoiser(device, &engine.weights, &options)?));
        }
        // Which call each denoiser holds the memory of.
        let mut held = [None; 3];
        for step in 0..length {
            let at = random.integer(0, 2) as usize;
            let call = Call { size: random.pick(sizes), fixed_exposure: random.coin(), features: random.integer(0, 2) };
            let scene = call.scene();
            let (blend, denoiser) = &mut denoisers[at];
            denoiser.set_exposure(if call.fixed_exposure { Exposure::Fixed(0.7) } else { Exposure::Auto })?;
            let mut output = vec![f32::NAN; scene.color.len()];
            let rgb = Layout::interleaved(scene.extent, 3);
            denoiser.denoise(&scene.frame(), PlaneMut::f32(&mut output, rgb))?;
            engine.left_out.take(&scene, denoiser)?;
            let bits: Vec<u32> = output.iter().map(|v| v.to_bits()).collect();
            // The same on both devices.
            let first = outputs.entry((call, blend.to_bits())).or_insert_with(|| bits.clone());
            differing.take(f64::from(u32::from(*first != bits)), format!("call {step}"));
            held[at] = Some(call.size);
            let bytes: u64 = devices.iter().map(Device::memory_bytes).sum();
            let first = *memory.entry(held).or_insert(bytes);
            grown.take(bytes as f64 - first as f64, format!("call {step}"));
        }
    }
    leaked.take(devices.iter().map(Device::memory_bytes).sum::<u64>() as f64, format!("{length} calls"));
    Ok(vec![differing, grown, leaked])
}

impl Call {
    fn scene(&self) -> Scene {
        let mut scene = Scene::new(Extent::new(self.size.0, self.size.1), 11);
        if self.features < 2 {
            scene.normal = None;
        }
        if self.features < 1 {
            (scene.albedo, scene.depth) = (None, None);
        }
        scene
    }
}

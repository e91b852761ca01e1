//! What one setting does to one frame: its time, its distance from the rendered reference, its distance from f64.

use super::frames::Pair;
use super::{Clock, Record, Result};
use crate::stress::scene::Scene;
use crate::stress::subject::{Peer, PeerSpec, Tier};
use cpu_time::ProcessTime;
use vkdenoise::kernels::stats::EXPOSURE;
use vkdenoise::metrics::{Comparison, nmse};
use vkdenoise::net::Graph;
use vkdenoise::plan::plan;
use vkdenoise::reference::Reference;
use vkdenoise::target::Target;
use vkdenoise::{Denoiser, Device, DeviceKind, Extent, Layout, Options, PlaneMut, Weights};

/// A network with a name.
pub struct Network {
    /// The name it goes by in the table.
    pub name: String,
    /// Its weights.
    pub weights: Weights,
}

/// A setting to be measured: what a row of the table is about.
#[derive(Clone, Copy)]
pub enum Setting<'a> {
    /// A network on a tier of the engine.
    Engine(&'a Network, Tier),
    /// Another program.
    Peer(&'a PeerSpec),
}

impl Setting<'_> {
    /// Names of the network and of the tier, as they stand in a record.
    pub fn names(&self) -> (&str, &'static str) {
        match self {
            Self::Engine(network, tier) => (&network.name, tier.name),
            Self::Peer(peer) => (&peer.name, ""),
        }
    }

    /// Whether it computes what the f64 reference of its network does, and not an average of two such results.
    fn is_one_result(&self) -> bool {
        !matches!(self, Self::Engine(_, tier) if tier.averaged)
    }
}

/// A setting that can run.
enum Runner {
    Engine { denoiser: Box<Denoiser>, clock: Clock },
    Peer(Peer),
}

impl Runner {
    fn new(device: &Device, setting: &Setting) -> Result<Self> {
        Ok(match setting {
            Setting::Engine(network, tier) => Self::Engine {
                denoiser: Box::new(tier.denoiser(device, &network.weights, &Options::default())?),
                clock: if device.info().kind == DeviceKind::Cpu { Clock::Cpu } else { Clock::Device },
            },
            Setting::Peer(peer) => Self::Peer(Peer::start(&peer.command)?),
        })
    }

    /// The denoised colour and the seconds that it took.
    fn run(&mut self, scene: &Scene) -> Result<(Vec<f32>, f64)> {
        match self {
            Self::Engine { denoiser, clock } => {
                let mut output = vec![0.0; scene.color.len()];
                let started = ProcessTime::now();
                let rgb = Layout::interleaved(scene.extent, 3);
                let report = denoiser.denoise(&scene.frame(), PlaneMut::f32(&mut output, rgb))?;
                let seconds = match clock {
                    Clock::Cpu => started.elapsed().as_secs_f64(),
                    Clock::Device => report.gpu_ms.unwrap_or(report.total_ms) * 1e-3,
                };
                Ok((output, seconds))
            }
            Self::Peer(peer) => peer.denoise(scene),
        }
    }

    fn clock(&self) -> Clock {
        match self {
            Self::Engine { clock, .. } => *clock,
            Self::Peer(_) => Clock::Cpu,
        }
    }
}

/// A network's result in f64 on the upper left part of a frame.
pub struct Exact {
    frame: Scene,
    exposure: f64,
    color: Vec<f64>,
}

impl Exact {
    /// Runs the f64 reference on at most `side` x `side` pixels, taken as a frame of their own.
    ///
    /// # Errors
    /// None that a frame which was checked can cause.
    pub fn of(network: &Network, scene: &Scene, side: u32) -> Result<Self> {
        let part = upper_left(scene, side);
        let graph = Graph::new(network.weights.arch())?;
        let plan = plan(&graph, part.extent, &Target::default())?;
        let mut reference = Reference::new(&plan, &network.weights)?;
        reference.set_frame(&part.frame(), None, 0.0)?;
        reference.run();
        let (exposure, color) = (reference.buffer(plan.stats)[EXPOSURE], reference.output().to_vec());
        Ok(Self { frame: part, exposure, color })
    }

    /// (NMSE, largest difference of a sample) of `log1p(exposure * colour)`.
    fn compare(&self, color: &[f32]) -> Result<(f64, f64)> {
        let log = |v: f64| (v * self.exposure).ln_1p() as f32;
        let found: Vec<f32> = color.iter().map(|&v| log(v.into())).collect();
        let expected: Vec<f32> = self.color.iter().map(|&v| log(v)).collect();
        let differences = found.iter().zip(&expected).map(|(a, b)| f64::from((a - b).abs()));
        Ok((nmse(&found, &expected)?, differences.fold(0.0, f64::max)))
    }
}

fn upper_left(scene: &Scene, side: u32) -> Scene {
    let Extent { width, height } = scene.extent;
    let extent = Extent::new(width.min(side), height.min(side));
    let cut = |plane: &[f32], channels: usize| -> Vec<f32> {
        let rows = plane.chunks_exact(width as usize * channels).take(extent.height as usize);
        rows.flat_map(|row| &row[..extent.width as usize * channels]).copied().collect()
    };
    let part = |plane: &Option<Vec<f32>>, channels| plane.as_ref().map(|plane| cut(plane, channels));
    Scene {
        extent,
        clean: cut(&scene.clean, 3),
        color: cut(&scene.color, 3),
        albedo: part(&scene.albedo, 3),
        normal: part(&scene.normal, 3),
        depth: part(&scene.depth, 1),
        samples: part(&scene.samples, 1),
    }
}

/// Measures settings on one pair. They take turns, so that all meet the same machine; `runs` warm ones of each are
/// timed. `exact` has the f64 result of a setting's network by its name.
///
/// # Errors
/// As [`Denoiser::denoise`]; a peer that ends.
pub fn measure<'a>(
    device: &Device,
    settings: &[Setting],
    exact: impl Fn(&str) -> Option<&'a Exact>,
    (pair, scene): (&Pair, &Scene),
    runs: u32,
) -> Result<Vec<Record>> {
    let mut runners = settings.iter().map(|setting| Runner::new(device, setting)).collect::<Result<Vec<_>>>()?;
    // The first run of a size compiles and allocates: it is not timed, its picture is the one that counts.
    let first = runners.iter_mut().map(|runner| Ok(runner.run(scene)?.0)).collect::<Result<Vec<_>>>()?;
    let mut times = vec![Vec::new(); runners.len()];
    for _ in 0..runs {
        for (runner, times) in runners.iter_mut().zip(&mut times) {
            times.push(runner.run(scene)?.1);
        }
    }
    let mut records = Vec::new();
    for (((setting, mut runner), output), mut times) in settings.iter().zip(runners).zip(first).zip(times) {
        times.sort_by(f64::total_cmp);
        let (network, tier) = setting.names();
        let exact = match exact(network).filter(|_| setting.is_one_result()) {
            Some(exact) => Some(exact.compare(&runner.run(&exact.frame)?.0)?),
            None => None,
        };
        let compared = Comparison::new(scene.extent, &output, &scene.clean)?;
        records.push(Record {
            network: network.into(),
            tier: tier.into(),
            scene: pair.scene.clone(),
            view: pair.view.clone(),
            spp: pair.spp,
            pixels: scene.extent.pixels(),
            clock: runner.clock(),
            seconds: times[times.len() / 2],
            seconds_min: times[0],
            runs,
            psnr: compared.psnr(),
            ssim: compared.ssim(),
            relmse: compared.rel_mse(),
            flip: flip(scene.extent, &output, &scene.clean),
            nmse: exact.map(|(nmse, _)| nmse),
            worst: exact.map(|(_, worst)| worst),
        });
    }
    Ok(records)
}

/// Mean FLIP between the images as an 8-bit screen shows them.
fn flip(extent: Extent, image: &[f32], reference: &[f32]) -> f64 {
    let shown = |samples: &[f32]| -> Vec<u8> {
        samples.iter().map(|c| (255.0 * c.max(0.0).powf(1.0 / 2.2).min(1.0)) as u8).collect()
    };
    let of = |samples| nv_flip::FlipImageRgb8::with_data(extent.width, extent.height, &shown(samples));
    let map = nv_flip::flip(of(reference), of(image), nv_flip::DEFAULT_PIXELS_PER_DEGREE);
    f64::from(nv_flip::FlipPool::from_image(&map).mean())
}

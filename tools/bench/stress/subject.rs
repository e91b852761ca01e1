//! What is put under stress: a tier of the engine, or a peer that another process runs.

use super::left_out::{LeftOut, against_whole};
use super::scene::Scene;
use super::{Measured, Result};
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::str::FromStr;
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::net::{Arch, Folds, Graph};
use vkdenoise::options::{ConvAlgorithm, SeparableForm};
use vkdenoise::testing::{Bench, denoiser_with_kernels};
use vkdenoise::{Converged, ConvergedMode, Denoiser, Device, Layout, Options, PlaneMut, Precision, Weights};

/// How much a tier may differ where the input is only scaled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exactness {
    /// 32-bit floats throughout.
    Single,
    /// Halves somewhere.
    Half,
}

/// A tier of the engine: a column of the matrix.
#[derive(Clone, Copy, Debug)]
pub struct Tier {
    /// Its name.
    pub name: &'static str,
    /// Arithmetic and storage.
    pub precision: Precision,
    /// Which bounds hold for it.
    pub exactness: Exactness,
    /// Whether the kernels shaped for CPU drivers run.
    pub cpu_kernels: bool,
    /// How dense 3x3 convolutions are computed.
    pub conv: ConvAlgorithm,
    /// Whether operations are folded and fused as the engine prefers; else each is a kernel.
    pub fused: bool,
    /// Which converged squares are left out, and how; `None`: none are.
    pub converged: Option<Converged>,
    /// Whether the results of the frame and of the frame turned by half a circle are averaged.
    pub averaged: bool,
}

/// Relative noise up to which tiers that leave converged squares out do so: that of [`super::scene::CONVERGED`]
/// samples, and a little.
const CONVERGED_THRESHOLD: f32 = 0.02;

impl Tier {
    /// 32-bit floats and direct convolutions, with the kernels that the engine prefers on a device. By itself it takes
    /// Winograd's form on some drivers: a tier of its own here.
    pub fn preferred(device: &Device) -> Self {
        Self {
            name: "fp32",
            precision: Precision::F32,
            exactness: Exactness::Single,
            cpu_kernels: Bench::default_target(device).cpu,
            conv: ConvAlgorithm::Direct,
            fused: true,
            converged: None,
            averaged: false,
        }
    }

    /// Every tier that a device can run. A new one is a line here.
    pub fn all(device: &Device) -> Vec<Self> {
        let preferred = Self::preferred(device);
        let winograd = |name, tile| Self { name, conv: ConvAlgorithm::Winograd(tile), ..preferred };
        let mut tiers = vec![
            preferred,
            winograd("fp32, Winograd F(2x2)", WinogradTile::F2),
            winograd("fp32, Winograd F(4x4)", WinogradTile::F4),
        ];
        if preferred.cpu_kernels {
            tiers.push(Self { name: "fp32, portable kernels", cpu_kernels: false, ..preferred });
        }
        let converged = |name, mode| Self {
            name,
            converged: Some(Converged { threshold: CONVERGED_THRESHOLD, mode }),
            ..preferred
        };
        tiers.push(converged("fp32, converged left out exactly", ConvergedMode::Exact));
        tiers.push(converged("fp32, converged left out approximately", ConvergedMode::default()));
        if Bench::can_store_halves(device) {
            let halves = Self { precision: Precision::F16, exactness: Exactness::Half, ..preferred };
            let winograd = |name, tile| Self { name, conv: ConvAlgorithm::Winograd(tile), ..halves };
            tiers.push(Self { name: "fp16 storage", ..halves });
            tiers.push(winograd("fp16 storage, Winograd F(2x2)", WinogradTile::F2));
            tiers.push(winograd("fp16 storage, Winograd F(4x4)", WinogradTile::F4));
            if preferred.cpu_kernels {
                tiers.push(Self { name: "fp16 storage, portable kernels", cpu_kernels: false, ..halves });
            }
        }
        if device.has_matrices() {
            tiers.push(Self { name: "matrix", precision: Precision::Matrix, exactness: Exactness::Half, ..preferred });
        }
        tiers
    }

    /// [`Tier::all`], and what is a matter of time alone or of taste: nothing fused, two results averaged, a higher
    /// threshold of what is converged.
    pub fn swept(device: &Device) -> Vec<Self> {
        let preferred = Self::preferred(device);
        let converged = Converged { threshold: 0.1, mode: ConvergedMode::default() };
        let mut tiers = Self::all(device);
        tiers.push(Self { name: "fp32, nothing fused", fused: false, ..preferred });
        tiers.push(Self { name: "fp32, average of two turns", averaged: true, ..preferred });
        tiers.push(Self {
            name: "fp32, converged below 0.1 left out approximately",
            converged: Some(converged),
            ..preferred
        });
        tiers
    }

    /// A denoiser of this tier, with its precision, its convolutions and what it leaves out in the place of the
    /// options' own.
    ///
    /// # Errors
    /// As [`Denoiser::new`].
    pub fn denoiser(&self, device: &Device, weights: &Weights, options: &Options) -> Result<Denoiser> {
        let mut options = Options {
            precision: self.precision,
            conv: Some(self.conv),
            converged: self.converged,
            self_ensemble: self.averaged,
            ..*options
        };
        if !self.fused {
            options = Options { folds: Some(Folds::NONE), separable: Some(SeparableForm::TwoKernels), ..options };
        }
        Ok(denoiser_with_kernels(device, weights, &options, self.cpu_kernels)?)
    }
}

/// The pre- and post-processing of a network alone, what comes in comes out: a Hybrid with a residual, of which the
/// output layer is zeros.
///
/// # Errors
/// None for weights that were checked.
pub fn in_and_out_alone(weights: &Weights) -> Result<Weights> {
    let (arch, preprocessing) = (Arch::hybrid(), weights.preprocessing());
    let random = Weights::hashed(&arch, preprocessing, 1)?;
    let mut tensors = BTreeMap::new();
    for spec in Graph::new(&arch)?.tensors() {
        let mut tensor = random.tensor(&spec.name)?.clone();
        if spec.name.starts_with("output.") {
            tensor.data.fill(0.0);
        }
        tensors.insert(spec.name, tensor);
    }
    Ok(Weights::from_parts(arch, preprocessing, tensors)?)
}

/// What is put under stress.
pub struct Subject {
    kind: Kind,
    /// The latest undisturbed scene and its result: several cases begin with the same.
    undisturbed: Option<(Scene, Vec<f32>)>,
    /// The latest scene that 32-bit floats denoised for a tier with halves, and their result.
    single: Option<(Scene, Vec<f32>)>,
}

enum Kind {
    Engine(Box<Engine>),
    Peer(Peer),
}

/// A tier of the engine on a device.
pub struct Engine {
    /// The tier.
    pub tier: Tier,
    /// The device.
    pub device: Device,
    /// The weights.
    pub weights: Weights,
    /// The denoiser, with the tier's default options.
    pub denoiser: Denoiser,
    /// What the calls since the last [`Subject::take_left_out`] left out.
    pub left_out: LeftOut,
    /// The same tier that leaves nothing out, once it is asked for.
    whole: Option<Denoiser>,
}

impl Engine {
    /// Denoises a scene.
    fn denoise(&mut self, scene: &Scene) -> Result<Vec<f32>> {
        let mut output = vec![f32::NAN; scene.color.len()];
        let rgb = Layout::interleaved(scene.extent, 3);
        self.denoiser.denoise(&scene.frame(), PlaneMut::f32(&mut output, rgb))?;
        self.left_out.take(scene, &self.denoiser)?;
        Ok(output)
    }

    /// How what it denoises of a scene differs from the whole frame's pass; `None` for a tier that leaves nothing out.
    ///
    /// # Errors
    /// As [`Denoiser::denoise`].
    pub fn against_whole(&mut self, scene: &Scene) -> Result<Option<Measured>> {
        let Some(Converged { mode, .. }) = self.tier.converged else { return Ok(None) };
        let output = self.denoise(scene)?;
        let whole = match &mut self.whole {
            Some(whole) => whole,
            none => {
                let tier = Tier { converged: None, ..self.tier };
                none.insert(tier.denoiser(&self.device, &self.weights, &Options::default())?)
            }
        };
        against_whole(scene, &output, (&self.denoiser, mode), whole).map(Some)
    }
}

impl Subject {
    /// A tier of the engine.
    ///
    /// # Errors
    /// As [`Denoiser::new`].
    pub fn engine(device: &Device, weights: &Weights, tier: Tier) -> Result<Self> {
        let denoiser = tier.denoiser(device, weights, &Options::default())?;
        let (device, weights) = (device.clone(), weights.clone());
        let engine = Engine { tier, device, weights, denoiser, left_out: LeftOut::default(), whole: None };
        Ok(Self { kind: Kind::Engine(Box::new(engine)), undisturbed: None, single: None })
    }

    /// A process that denoises what it is sent.
    pub fn peer(peer: Peer) -> Self {
        Self { kind: Kind::Peer(peer), undisturbed: None, single: None }
    }

    /// Denoises a scene. Samples that were not written are NaN.
    ///
    /// # Errors
    /// As [`Denoiser::denoise`]; a peer's broken pipe.
    pub fn denoise(&mut self, scene: &Scene) -> Result<Vec<f32>> {
        match &mut self.kind {
            Kind::Engine(engine) => engine.denoise(scene),
            Kind::Peer(peer) => Ok(peer.denoise(scene)?.0),
        }
    }

    /// The same, remembered: for a scene that others are then compared with.
    ///
    /// # Errors
    /// As [`Subject::denoise`].
    pub fn denoise_undisturbed(&mut self, scene: &Scene) -> Result<Vec<f32>> {
        if let Some((_, output)) = self.undisturbed.as_ref().filter(|(known, _)| known == scene) {
            return Ok(output.clone());
        }
        let output = self.denoise(scene)?;
        self.undisturbed = Some((scene.clone(), output.clone()));
        Ok(output)
    }

    /// What 32-bit floats make of a scene, for a tier with halves; `None` for every other subject.
    ///
    /// # Errors
    /// As [`Denoiser::new`] and [`Subject::denoise`].
    pub fn in_single(&mut self, scene: &Scene) -> Result<Option<Vec<f32>>> {
        let Kind::Engine(engine) = &self.kind else { return Ok(None) };
        if engine.tier.exactness == Exactness::Single {
            return Ok(None);
        }
        if let Some((_, output)) = self.single.as_ref().filter(|(known, _)| known == scene) {
            return Ok(Some(output.clone()));
        }
        let tier = Tier::preferred(&engine.device);
        let output = Self::engine(&engine.device, &engine.weights, tier)?.denoise(scene)?;
        self.single = Some((scene.clone(), output.clone()));
        Ok(Some(output))
    }

    /// What the calls since the last time left out.
    pub fn take_left_out(&mut self) -> LeftOut {
        self.as_engine().map_or_else(LeftOut::default, |engine| std::mem::take(&mut engine.left_out))
    }

    /// The engine, where it is one.
    pub fn as_engine(&mut self) -> Option<&mut Engine> {
        match &mut self.kind {
            Kind::Engine(engine) => Some(engine),
            Kind::Peer(_) => None,
        }
    }

    /// Which bounds hold for it.
    pub fn exactness(&self) -> Exactness {
        match &self.kind {
            Kind::Engine(engine) => engine.tier.exactness,
            Kind::Peer(_) => Exactness::Single,
        }
    }
}

/// A peer's name and command, written NAME=COMMAND.
#[derive(Clone, Debug)]
pub struct PeerSpec {
    /// Its name.
    pub name: String,
    /// The command line, split at spaces.
    pub command: String,
}

impl FromStr for PeerSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=').ok_or_else(|| format!("'{text}' is not NAME=COMMAND"))?;
        Ok(Self { name: parts.0.into(), command: parts.1.into() })
    }
}

/// A process that denoises. It is sent `width, height, albedo?, normal?, depth?` as 32-bit integers and then the planes
/// that there are, interleaved 32-bit floats. It answers with the denoised colour and, as a 64-bit float, the seconds
/// that took: CPU seconds where it runs on the CPU. Everything is little-endian.
pub struct Peer {
    child: Child,
    // Closed before the process is waited for: its end of input is its end.
    stdin: Option<ChildStdin>,
    stdout: ChildStdout,
}

impl Peer {
    /// Starts `command`, split at spaces.
    ///
    /// # Errors
    /// Where it cannot be started.
    pub fn start(command: &str) -> Result<Self> {
        let mut words = command.split_whitespace();
        let program = words.next().ok_or("an empty command for a peer")?;
        let mut child = Command::new(program).args(words).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let (stdin, stdout) = (child.stdin.take(), child.stdout.take().ok_or("a peer without output")?);
        Ok(Self { child, stdin, stdout })
    }

    /// The denoised scene, and the seconds that took.
    ///
    /// # Errors
    /// Where the process ends or says too little.
    pub fn denoise(&mut self, scene: &Scene) -> Result<(Vec<f32>, f64)> {
        let stdin = self.stdin.as_mut().ok_or("the peer has ended")?;
        let features = [&scene.albedo, &scene.normal, &scene.depth];
        let mut message = vec![scene.extent.width, scene.extent.height];
        message.extend(features.map(|plane| u32::from(plane.is_some())));
        let planes = std::iter::once(&scene.color).chain(features.into_iter().flatten());
        message.extend(planes.flatten().map(|value| value.to_bits()));
        stdin.write_all(bytemuck::cast_slice(&message))?;
        stdin.flush()?;
        let mut output = vec![f32::NAN; scene.color.len()];
        self.stdout.read_exact(bytemuck::cast_slice_mut(&mut output))?;
        let mut seconds = [0; 8];
        self.stdout.read_exact(&mut seconds)?;
        Ok((output, f64::from_le_bytes(seconds)))
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        drop(self.stdin.take());
        // A peer that fails at its end has answered everything before.
        let _ = self.child.wait();
    }
}

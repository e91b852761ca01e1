//! Passes that share an arena: of several sizes, in the library's memory or in the renderer's. What comes out has the
//! bits of passes by themselves.

mod common;

use common::case::PREPROCESSING;
use common::compare::assert_same_bits;
use common::random::Random;
use common::vulkan::{Renderer, RendererBuffer};
use vkdenoise::net::{Arch, Head, Weights};
use vkdenoise::{
    Arena, ArenaBlock, ArenaRequired, Binding, BufferFrame, BufferPlane, Denoiser, Device, Error, Extent, FrameOptions,
    Layout, Options, Pass, SampleFormat,
};

/// As a renderer changes its resolution; the largest neither first nor last.
const SIZES: [Extent; 3] = [Extent::new(90, 60), Extent::new(150, 100), Extent::new(40, 70)];

/// Random weights of the network that ships.
fn weights() -> Weights {
    Weights::hashed(&Arch { head: Head::pure(), ..Arch::hybrid() }, PREPROCESSING, 9).unwrap()
}

/// A frame of some size in the renderer's memory: colour, albedo and depth, then the output.
struct Scene {
    extent: Extent,
    input: RendererBuffer,
    output: RendererBuffer,
}

impl Scene {
    fn new(renderer: &Renderer, extent: Extent, seed: u64) -> Self {
        let (input, output) = (renderer.buffer(28 * extent.pixels()), renderer.buffer(12 * extent.pixels()));
        let scene = Self { extent, input, output };
        scene.render(seed, seed);
        scene
    }

    fn render(&self, color: u64, features: u64) {
        let pixels = self.extent.pixels() as usize;
        let mut random = Random::new(features);
        let features = [random.values(3 * pixels, 0.0, 1.0), random.values(pixels, 1.0, 50.0)].concat();
        let all = [Random::new(color).values(3 * pixels, 0.0, 3.0), features].concat();
        self.input.write(bytemuck::cast_slice(&all));
    }

    fn bind(&self, pass: &Pass) -> Binding {
        let pixels = self.extent.pixels() as usize;
        let plane = |buffer: &RendererBuffer, offset, channels| BufferPlane {
            buffer: buffer.raw,
            size: buffer.size,
            format: SampleFormat::F32,
            layout: Layout { offset, ..Layout::interleaved(self.extent, channels) },
        };
        let mut frame = BufferFrame::new(plane(&self.input, 0, 3), plane(&self.output, 0, 3));
        frame.albedo = Some(plane(&self.input, 3 * pixels, 3));
        frame.depth = Some(plane(&self.input, 6 * pixels, 1));
        // SAFETY: the scenes live to the end of the tests.
        unsafe { pass.bind_buffers(&frame) }.unwrap()
    }

    fn output(&self) -> Vec<f32> {
        bytemuck::cast_slice(&self.output.read()).to_vec()
    }
}

fn run(renderer: &Renderer, pass: &Pass, scene: &Scene, options: &FrameOptions) -> Vec<f32> {
    let binding = scene.bind(pass);
    renderer.wait(renderer.submit(|commands| {
        // SAFETY: everything bound lives until the fence is waited for.
        unsafe { pass.record(commands, &binding, options) }.unwrap();
        renderer.barrier_to_host(commands);
    }));
    scene.output()
}

#[test]
fn sizes_take_turns_in_one_arena() {
    let renderer = Renderer::new();
    // SAFETY: the renderer lives to the end of the test.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let denoiser = Denoiser::new(&device, &weights(), &Options::default()).unwrap();
    let required = denoiser.arena_required(&SIZES).unwrap();
    assert_eq!(required.bytes(), denoiser.memory_required(SIZES[1]).unwrap().arena, "the largest decides");
    let arena = Arena::new(&device, &required).unwrap();
    assert_eq!((arena.bytes(), arena.device_bytes()), (required.bytes(), required.bytes()));
    let passes = SIZES.map(|extent| denoiser.pass_in(&arena, extent).unwrap());
    assert_eq!(passes.iter().map(Pass::device_bytes).sum::<u64>(), 0);
    assert_eq!(device.memory_bytes(), denoiser.device_bytes() + arena.device_bytes());
    let own = SIZES.map(|extent| denoiser.pass(extent).unwrap());
    let of_own: u64 = own.iter().map(Pass::device_bytes).sum();
    assert_eq!(of_own, SIZES.iter().map(|extent| denoiser.memory_required(*extent).unwrap().arena).sum::<u64>());
    assert_eq!(device.memory_bytes(), denoiser.device_bytes() + arena.device_bytes() + of_own);

    let scenes = SIZES.map(|extent| Scene::new(&renderer, extent, u64::from(extent.width)));
    let expected: Vec<_> =
        own.iter().zip(&scenes).map(|(pass, scene)| run(&renderer, pass, scene, &FrameOptions::default())).collect();
    drop(own);
    // The passes keep what they compute in.
    drop(arena);
    let bindings: Vec<_> = scenes.iter().zip(&passes).map(|(scene, pass)| scene.bind(pass)).collect();
    for round in [[0, 1, 2], [2, 1, 0], [1, 0, 1]] {
        scenes.iter().for_each(|scene| scene.output.write(&vec![0xff; scene.output.size as usize]));
        // All in flight at once.
        let fences = round.map(|i| {
            renderer.submit(|commands| {
                // SAFETY: everything bound lives until the fences are waited for.
                unsafe { passes[i].record(commands, &bindings[i], &FrameOptions::default()) }.unwrap();
                renderer.barrier_to_host(commands);
            })
        });
        fences.into_iter().for_each(|fence| renderer.wait(fence));
        for i in round {
            assert_same_bits(&scenes[i].output(), &expected[i], &format!("{round:?}: {:?}", SIZES[i]));
        }
    }
    let weights = denoiser.device_bytes();
    // Bindings have tables of their planes.
    drop(bindings);
    assert_eq!(device.memory_bytes(), weights + required.bytes());
    drop(passes);
    assert_eq!(device.memory_bytes(), weights);
    drop(denoiser);
    renderer.assert_silent();
}

#[test]
fn features_outlive_what_else_runs_in_the_arena() {
    let renderer = Renderer::new();
    // SAFETY: the renderer lives to the end of the test.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let options = Options { keep_features: true, ..Options::default() };
    let denoiser = Denoiser::new(&device, &weights(), &options).unwrap();
    let arena = Arena::new(&device, &denoiser.arena_required(&SIZES).unwrap()).unwrap();
    let passes = SIZES.map(|extent| denoiser.pass_in(&arena, extent).unwrap());
    let persistent = SIZES.map(|extent| denoiser.memory_required(extent).unwrap().persistent);
    assert!(persistent.iter().all(|bytes| *bytes > 0));
    assert_eq!(passes.each_ref().map(Pass::device_bytes), persistent);
    assert_eq!(device.memory_bytes(), denoiser.device_bytes() + arena.bytes() + persistent.iter().sum::<u64>());

    let scenes = SIZES.map(|extent| Scene::new(&renderer, extent, 1));
    let own = SIZES.map(|extent| denoiser.pass(extent).unwrap());
    for i in 0..SIZES.len() {
        run(&renderer, &passes[i], &scenes[i], &FrameOptions::default());
    }
    // Each has run the others' frames since its own.
    let unchanged = FrameOptions { features_unchanged: true, ..FrameOptions::default() };
    for (i, scene) in scenes.iter().enumerate() {
        scene.render(2, 1);
        let expected = run(&renderer, &own[i], scene, &FrameOptions::default());
        // Features that must not be looked at.
        scene.render(2, 3);
        assert_same_bits(&run(&renderer, &passes[i], scene, &unchanged), &expected, &format!("{:?}", SIZES[i]));
    }
    drop((passes, own, arena, denoiser));
    assert_eq!(device.memory_bytes(), 0);
    renderer.assert_silent();
}

#[test]
fn the_renderers_own_memory() {
    let renderer = Renderer::new();
    // SAFETY: the renderer lives to the end of the test.
    let device = unsafe { Device::from_renderer(renderer.handles()) }.unwrap();
    let denoiser = Denoiser::new(&device, &weights(), &Options::default()).unwrap();
    let required = denoiser.arena_required(&SIZES[..1]).unwrap();
    assert_eq!(required.blocks.len(), 1);
    // In the middle of a buffer, between bytes that are not the arena's.
    let (first, bytes) = (3 * ArenaRequired::ALIGNMENT, required.bytes());
    let buffer = renderer.buffer_for(first + bytes + 1000, ArenaRequired::USAGE);
    // NaNs, whatever type they are taken for.
    buffer.write(&vec![0xff; buffer.size as usize]);
    let block = ArenaBlock { buffer: buffer.raw, offset: first, bytes };
    // SAFETY: the buffer is as asked for and lives to the end of the test.
    let arena = unsafe { Arena::from_buffers(&device, &[block]) }.unwrap();
    assert_eq!((arena.bytes(), arena.device_bytes()), (bytes, 0));
    let before = device.memory_bytes();
    let pass = denoiser.pass_in(&arena, SIZES[0]).unwrap();
    assert_eq!(device.memory_bytes(), before);
    let scene = Scene::new(&renderer, SIZES[0], 5);
    let found = run(&renderer, &pass, &scene, &FrameOptions::default());
    let own = denoiser.pass(SIZES[0]).unwrap();
    assert_same_bits(&found, &run(&renderer, &own, &scene, &FrameOptions::default()), "in the renderer's memory");
    let held = buffer.read();
    let end = (first + bytes) as usize;
    assert!(held[..first as usize].iter().chain(&held[end..]).all(|byte| *byte == 0xff), "written beyond the arena");
    assert!(held[first as usize..end].iter().any(|byte| *byte != 0xff), "the arena was not used");

    // In less, narrower bands still fit; in half of it nothing does, and nothing in nothing.
    let smaller = |bytes| [ArenaBlock { bytes, ..block }];
    // SAFETY: as above.
    let arena_of = |blocks: &[ArenaBlock]| unsafe { Arena::from_buffers(&device, blocks) }.unwrap();
    let narrow = denoiser.pass_in(&arena_of(&smaller(bytes - 1)), SIZES[0]).unwrap();
    assert_same_bits(&run(&renderer, &narrow, &scene, &FrameOptions::default()), &found, "in a byte less");
    for blocks in [&smaller(bytes / 2)[..], &[]] {
        let refused = denoiser.pass_in(&arena_of(blocks), SIZES[0]);
        let Err(Error::FrameTooLarge { width: 90, height: 60, reason }) = refused else { panic!("not refused") };
        assert!(reason.contains("arena_required"), "{reason}");
    }
    let refused = denoiser.pass_in(&arena, Extent::new(300, 300));
    assert!(matches!(refused, Err(Error::FrameTooLarge { width: 300, height: 300, .. })));
    // SAFETY: as above.
    let refused = unsafe { Arena::from_buffers(&device, &[ArenaBlock { offset: 4, ..block }]) };
    assert!(matches!(refused, Err(Error::InvalidOption { option: "arena", reason }) if reason.contains("256")));
    let elsewhere = Arena::new(common::device::device(), &required).unwrap();
    let refused = denoiser.pass_in(&elsewhere, SIZES[0]);
    assert!(matches!(refused, Err(Error::InvalidOption { option: "arena", .. })));
    drop((pass, narrow, own, arena, denoiser));
    renderer.assert_silent();
}

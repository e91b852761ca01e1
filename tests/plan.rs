//! Plans as data: barriers where memory asks for them and nowhere else, no two live buffers at one place, limits.
//!
//! Kernels reach memory by address, which the validation layer's synchronisation checks do not follow: these tests are
//! what stands for them.

use vkdenoise::kernels::contract::BindingType;
use vkdenoise::kernels::winograd::WinogradTile;
use vkdenoise::kernels::{Arithmetic, BufferId, Call, KernelTarget, Storage, Tiles};
use vkdenoise::net::{Arch, Folds, Graph, Head};
use vkdenoise::options::{ConvAlgorithm, ConvergedMode, SeparableForm};
use vkdenoise::plan::{Dispatch, Packing, Place, Plan, packing, plan, plan_in};
use vkdenoise::target::{Target, max_chain_bytes};
use vkdenoise::{Error, Extent};

fn plan_of(name: &str, extent: Extent, max_block_bytes: u64) -> Result<Plan, Error> {
    let graph = Graph::new(&Arch::named(name).unwrap()).unwrap();
    plan(&graph, extent, &Target { max_block_bytes, ..Target::default() })
}

/// Bytes of a block, persistent or of the arena.
type Span = ((bool, usize), u64, u64);

fn spans(plan: &Plan, touched: &[(BufferId, u64)]) -> Vec<Span> {
    let span = |(id, _): &(BufferId, u64)| match plan.buffer(*id).place {
        Place::Arena { block, offset } => Some(((false, block), offset, offset + plan.buffer(*id).bytes)),
        Place::Persistent { block, offset } => Some(((true, block), offset, offset + plan.buffer(*id).bytes)),
        Place::Weights { .. } => None,
    };
    touched.iter().filter_map(span).collect()
}

fn conflict(plan: &Plan, a: &Dispatch, b: &Dispatch) -> bool {
    let (a, b) = (a.traffic(), b.traffic());
    let overlap = |x: &[(BufferId, u64)], y: &[(BufferId, u64)]| {
        let (x, y) = (spans(plan, x), spans(plan, y));
        x.iter().any(|p| y.iter().any(|q| p.0 == q.0 && p.1 < q.2 && q.1 < p.2))
    };
    overlap(&a.writes, &b.reads) || overlap(&a.reads, &b.writes) || overlap(&a.writes, &b.writes)
}

/// Every network as it is, and the Hybrid in every form.
fn plans(extent: Extent) -> Vec<(String, Plan)> {
    plans_in(extent, u64::MAX)
}

/// The same in blocks of at most so many bytes.
fn plans_in(extent: Extent, max_block_bytes: u64) -> Vec<(String, Plan)> {
    let named = Arch::NAMES.iter().map(|name| (name.to_string(), plan_of(name, extent, max_block_bytes).unwrap()));
    let graph = Graph::new(&Arch::hybrid()).unwrap();
    let forms = [WinogradTile::F2, WinogradTile::F4].map(|tile| Target {
        conv: ConvAlgorithm::Winograd(tile),
        separable: SeparableForm::Fused,
        max_block_bytes,
        ..Target::default()
    });
    let halves = Target { storage: Storage::F16, max_block_bytes, ..Target::default() };
    let banded = Target { max_chain_bytes: 1 << 17, max_block_bytes, ..Target::default() };
    let keeping = Target { keep_features: true, max_block_bytes, ..Target::default() };
    let headed =
        [Head::pure(), Head::gloss(), Head::gated()].map(|head| Graph::new(&Arch { head, ..Arch::hybrid() }).unwrap());
    let headed = headed.iter().flat_map(|graph| [halves, banded].map(|options| (graph, options)));
    let headed: Vec<_> = headed
        .map(|(graph, options)| {
            let name = format!("{:?}, {options:?}", graph.arch.head);
            (name, plan(graph, extent, &options).unwrap())
        })
        .collect();
    let forms =
        forms.into_iter().chain([halves, banded, keeping, Target { separable: SeparableForm::Fused, ..banded }]);
    let forms = forms.map(|options| (format!("{options:?}"), plan(&graph, extent, &options).unwrap()));
    named.chain(forms).chain(headed).collect()
}

/// What may run of a plan.
fn lists(plan: &Plan) -> Vec<&[Dispatch]> {
    [Some(&plan.dispatches), plan.without_features.as_ref()].into_iter().flatten().map(Vec::as_slice).collect()
}

#[test]
fn every_conflict_has_a_barrier_and_every_barrier_a_conflict() {
    let plans = [plans(Extent::new(200, 120)), plans(Extent::new(600, 120))].concat();
    assert!(plans.iter().any(|(_, plan)| plan.without_features.is_some()));
    for (name, plan, list) in
        plans.iter().flat_map(|(name, plan)| lists(plan).into_iter().map(move |l| (name, plan, l)))
    {
        let mut since_barrier: Vec<&Dispatch> = Vec::new();
        for dispatch in list {
            let conflicts = since_barrier.iter().any(|earlier| conflict(plan, earlier, dispatch));
            assert_eq!(dispatch.barrier, conflicts, "{name}: {}", dispatch.name);
            if dispatch.barrier {
                since_barrier.clear();
            }
            since_barrier.push(dispatch);
        }
    }
}

/// Side by side, dispatches wait as often as the longest chain of dependencies has links: no wait is due to memory that
/// maps share.
#[test]
fn independent_dispatches_share_a_wait() {
    let waits = |list: &[Dispatch]| list.iter().filter(|dispatch| dispatch.barrier).count();
    for head in [Head::Residual, Head::pure()] {
        let graph = Graph::new(&Arch { head, ..Arch::hybrid() }).unwrap();
        for target in [Target::default(), Target::for_gpu(Storage::F16, Arithmetic::Matrices)] {
            let of = |overlap_bytes| plan(&graph, Extent::new(256, 256), &Target { overlap_bytes, ..target }).unwrap();
            let (serial, side_by_side) = (of(0), of(u64::MAX));
            for (before, after) in lists(&serial).into_iter().zip(lists(&side_by_side)) {
                let (fewer, most) = (waits(after), waits(before));
                println!("{:?}, {:?}: {most} waits, {fewer} side by side", graph.arch.head, target.storage);
                assert!(fewer + 8 <= most, "{fewer} of {most}");
                assert_eq!(fewer, longest_chain(after) - 1);
                let names = |list: &[Dispatch]| {
                    let mut names: Vec<_> = list.iter().map(|d| (d.name.clone(), d.call.clone(), d.flops)).collect();
                    names.sort_by(|a, b| a.0.cmp(&b.0).then(format!("{:?}", a.1).cmp(&format!("{:?}", b.1))));
                    names
                };
                assert_eq!(names(before), names(after), "the same work");
            }
        }
    }
}

/// The most dispatches of which each must follow the one before: it reads or overwrites what that writes, or overwrites
/// what that reads. The output follows all.
fn longest_chain(list: &[Dispatch]) -> usize {
    let mut lengths: Vec<usize> = Vec::new();
    for (at, dispatch) in list.iter().enumerate() {
        let own = dispatch.traffic();
        let meets = |a: &[(BufferId, u64)], b: &[(BufferId, u64)]| a.iter().any(|x| b.iter().any(|y| x.0 == y.0));
        let before = list[..at].iter().zip(&lengths).filter(|(earlier, _)| {
            let other = earlier.traffic();
            let last = matches!(dispatch.call, Call::Output(_));
            last || meets(&own.reads, &other.writes)
                || meets(&own.writes, &other.writes)
                || meets(&own.writes, &other.reads)
        });
        lengths.push(1 + before.map(|(_, length)| *length).max().unwrap_or(0));
    }
    lengths.into_iter().max().unwrap_or(0)
}

/// Where maps are large, dispatches side by side would need more memory: they keep their order.
#[test]
fn side_by_side_takes_little_memory() {
    for head in [Head::Residual, Head::pure()] {
        let graph = Graph::new(&Arch { head, ..Arch::hybrid() }).unwrap();
        let target = Target::for_gpu(Storage::F16, Arithmetic::Matrices);
        // One by one, a head's coarse levels take less than what their kernels are made of, and the features' chain is
        // through before the colour's begins.
        for (width, height, most) in [(256, 256, 1.15), (1024, 1024, 1.15), (1920, 1080, 1.13), (3840, 2160, 1.0)] {
            let of = |target: &Target| plan(&graph, Extent::new(width, height), target).unwrap().blocks.iter().sum();
            let [serial, own]: [u64; 2] = [of(&Target { overlap_bytes: 0, ..target }), of(&target)];
            println!("{:?}, {width}x{height}: {own} bytes, {serial} one by one", graph.arch.head);
            assert!(own as f64 <= most * serial as f64, "{width}x{height}: {own} of {serial}");
        }
    }
}

#[test]
fn what_is_read_was_written_and_not_overwritten() {
    // Without features, a frame of the first multiple is as small as can be for some networks.
    let sizes = [Extent::new(130, 257), Extent::new(30, 600)];
    for (name, plan) in sizes.into_iter().flat_map(|extent| plans_in(extent, 1 << 27)) {
        assert!(plan.blocks.iter().all(|bytes| *bytes <= 1 << 27), "{:?}", plan.blocks);
        lists(&plan).into_iter().for_each(|list| check_memory(&name, &plan, list));
    }
}

fn check_memory(name: &str, plan: &Plan, list: &[Dispatch]) {
    // Who wrote last: (block, start, end, buffer).
    let mut memory: Vec<((bool, usize), u64, u64, BufferId)> = Vec::new();
    for dispatch in list {
        let traffic = dispatch.traffic();
        for (id, _) in &traffic.reads {
            for span in spans(plan, &[(*id, 0)]) {
                let owners: Vec<_> =
                    memory.iter().filter(|m| m.0 == span.0 && m.1 < span.2 && span.1 < m.2).map(|m| m.3).collect();
                assert_eq!(owners, [*id], "{name}: {} reads {}", dispatch.name, plan.buffer(*id).name);
            }
        }
        for (id, _) in &traffic.writes {
            for span in spans(plan, &[(*id, 0)]) {
                memory.retain(|m| m.0 != span.0 || m.2 <= span.1 || span.2 <= m.1);
                memory.push((span.0, span.1, span.2, *id));
            }
        }
    }
}

#[test]
fn memory_and_padding() {
    let large = plan_of("hybrid", Extent::new(1920, 1080), u64::MAX).unwrap();
    assert_eq!((large.padded.width, large.padded.height), (1920, 1152));
    assert!(large.bytes() < 1 << 30, "{}", large.bytes());
    let exact = plan_of("hybrid", Extent::new(256, 128), u64::MAX).unwrap();
    assert_eq!(exact.padded, exact.extent);
    // True FLOPs at 128x128, now as dispatches.
    let graph = Graph::new(&Arch::hybrid()).unwrap();
    for (folds, expected) in [(Folds::NONE, 2.902), (Folds::ALL, 2.569)] {
        let small = plan(&graph, Extent::new(128, 128), &Target { folds, ..Target::default() }).unwrap();
        let gflop = small.dispatches.iter().map(|d| d.flops).sum::<u64>() as f64 * 1e-9;
        assert!((gflop - expected).abs() < 1e-3, "{folds:?}: {gflop}");
    }
}

/// What the forms change, and that they leave nothing out.
#[test]
fn forms_change_kernels_not_work() {
    let all = plans(Extent::new(128, 128));
    let flops = |plan: &Plan| plan.dispatches.iter().map(|d| d.flops).sum::<u64>();
    let of = |plan: &Plan, kernel: fn(&Call) -> bool| plan.dispatches.iter().filter(|d| kernel(&d.call)).count();
    let hybrid = &all.iter().find(|(name, _)| name == "hybrid").unwrap().1;
    let direct = of(hybrid, |call| matches!(call, Call::Conv3x3(_)));
    for (name, form) in &all[Arch::NAMES.len()..Arch::NAMES.len() + 2] {
        assert_eq!(flops(form), flops(hybrid), "{name}");
        // By stride 2 (twice) stays direct.
        let winograd = of(form, |call| matches!(call, Call::Winograd3x3(_)));
        assert_eq!((of(form, |call| matches!(call, Call::Conv3x3(_))), winograd), (2, direct - 2), "{name}");
        // An FFN a block; the steps of the auxiliary projection feed two, the last of them one.
        assert_eq!(of(form, |call| matches!(call, Call::Separable3x3(_))), 17, "{name}");
    }
}

/// Of arena and weights, and of the host path's staging. Without bands the wide maps of the input stage alone take
/// more, and where it is not made again, what kernels are predicted from, with all that is made of it.
#[test]
fn a_large_frame_fits_its_memory() {
    const STAGING: u64 = 52 * 3840 * 2160 + 256;
    let extent = Extent::new(3840, 2160);
    let [floats, halves, matrices] =
        [(Storage::F32, Arithmetic::Floats), (Storage::F16, Arithmetic::Floats), (Storage::F16, Arithmetic::Matrices)];
    let limits = [
        (Head::Residual, floats, 1 << 31),
        (Head::Residual, halves, 1 << 30),
        (Head::pure(), floats, 3_900_000_000),
        (Head::pure(), halves, STAGING + (8 << 30) / 10),
        (Head::pure(), matrices, STAGING + (8 << 30) / 10),
    ];
    for (head, (storage, arithmetic), limit) in limits {
        let graph = Graph::new(&Arch { head: head.clone(), ..Arch::hybrid() }).unwrap();
        let target = Target::for_gpu(storage, arithmetic);
        let of = |target: &Target| plan(&graph, extent, target).unwrap().bytes() + STAGING;
        let bytes = of(&target);
        println!("{head:?}, {storage:?}, {arithmetic:?}: {bytes} bytes");
        assert!(bytes <= limit, "{head:?}, {storage:?}: {bytes}");
        let whole = of(&Target { max_chain_bytes: u64::MAX, ..target });
        assert!(whole > bytes + (400 << 20), "{whole} in place of {bytes}");
        let once = of(&Target { max_kept_bytes: u64::MAX, ..target });
        let is_made_again = !head.is_residual() && storage == Storage::F16;
        assert!(if is_made_again { once > bytes + (400 << 20) } else { once == bytes }, "{once} in place of {bytes}");
    }
}

/// Bands compute their borders twice, and nothing else.
#[test]
fn bands_cost_little_work() {
    let graph = Graph::new(&Arch::hybrid()).unwrap();
    let flops = |max_chain_bytes| {
        let options = Target { max_chain_bytes, ..Target::default() };
        let plan = plan(&graph, Extent::new(2048, 2048), &options).unwrap();
        plan.dispatches.iter().map(|d| d.flops).sum::<u64>() as f64
    };
    // Bands of halves are smaller.
    for (storage, most) in [(Storage::F32, 1.03), (Storage::F16, 1.06)] {
        let share = flops(max_chain_bytes(storage, Arithmetic::Floats) * Storage::F32.bytes() / storage.bytes())
            / flops(u64::MAX);
        println!("{storage:?}: {share:.4}");
        assert!((1.001..most).contains(&share), "{storage:?}: {share}");
    }
}

#[test]
fn what_does_not_fit_is_an_error() {
    let refused = plan_of("hybrid", Extent::new(1024, 1024), 1 << 20);
    assert!(matches!(refused, Err(Error::FrameTooLarge { reason, .. }) if reason.contains("1048576")));
    assert!(matches!(plan_of("hybrid", Extent::new(0, 5), u64::MAX), Err(Error::EmptyFrame { .. })));
    assert!(matches!(plan_of("hybrid", Extent::new(u32::MAX, 5), u64::MAX), Err(Error::FrameTooLarge { .. })));
}

/// The order is the contract's; a missing range would leave a descriptor unwritten.
#[test]
fn every_texel_buffer_of_a_contract_has_its_range() {
    let target = KernelTarget { cpu: true, ..KernelTarget::default() };
    for (name, plan) in plans(Extent::new(600, 128)) {
        for dispatch in lists(&plan).concat() {
            let kernel = dispatch.call.kernel();
            let bindings = kernel.choose(target).contract.bindings().iter();
            let buffers = bindings.filter(|binding| binding.ty == BindingType::TexelBuffer).count();
            assert!(buffers == 0 || kernel.texels().len() == buffers, "{name}: {}", dispatch.name);
        }
    }
}

/// All that is dense but what no kernel on matrices takes: 99.9 % of the FLOPs of the Hybrid.
#[test]
fn dense_kernels_have_a_variant_on_matrices() {
    for name in Arch::NAMES {
        let graph = Graph::new(&Arch::named(name).unwrap()).unwrap();
        let plan = plan(&graph, Extent::new(128, 128), &Target::for_gpu(Storage::F16, Arithmetic::Matrices)).unwrap();
        let (mut on_matrices, mut dense) = (0, 0);
        for dispatch in &plan.dispatches {
            let wide = match &dispatch.call {
                Call::Conv3x3(k) => k.channels > 4,
                // A power of two of invocations share a normed token of whole matrices.
                Call::Linear(k) => !k.norm || (k.src.channels.is_power_of_two() && k.src.channels >= 16),
                Call::NormedConv3x3(_) | Call::Separable3x3(_) | Call::AuxProjection(_) => true,
                Call::AttentionBlock(_) | Call::Ffn(_) | Call::Embedding(_) | Call::Unembed(_) => true,
                // Whole vectors of keys and whole matrices of values, and no more than an invocation has registers for.
                Call::WindowAttention(k) => {
                    let whole = k.key_width.is_multiple_of(8) && k.value_width.is_multiple_of(16);
                    whole && k.key_width <= 32 && k.value_width <= 64
                }
                _ => false,
            };
            assert_eq!(dispatch.variant.is_on_matrices(), wide, "{name}: {}", dispatch.name);
            if !wide {
                continue;
            }
            (on_matrices, dense) = (on_matrices + dispatch.flops, dense + 1);
            if !dispatch.call.grid().is_some_and(|grid| grid.tiles == Tiles::All) {
                continue;
            }
            // Nothing is loaded less than once, in vectors of 16 bytes, and everything stored.
            let (accesses, traffic) = (dispatch.call.kernel().accesses(&dispatch.variant).unwrap(), dispatch.traffic());
            let vectors = |touched: &[(BufferId, u64)]| touched.iter().map(|(_, bytes)| bytes).sum::<u64>() / 16;
            assert!(accesses.global_loads >= vectors(&traffic.reads), "{name}: {}", dispatch.name);
            assert!(accesses.global_stores >= vectors(&traffic.writes), "{name}: {}", dispatch.name);
        }
        let all = plan.dispatches.iter().map(|d| d.flops).sum::<u64>();
        println!("{name}: {dense} kernels on matrices, {:.3} of the FLOPs", on_matrices as f64 / all as f64);
        if name == "hybrid" {
            assert!(on_matrices as f64 / all as f64 > 0.999);
        }
    }
}

/// A renderer whose resolution falls has one arena. Frames just below the size from which on chains run in bands take
/// more than larger ones: in narrower bands they fit.
#[test]
fn smaller_frames_fit_the_arena_of_a_larger_one() {
    let graph = Graph::new(&Arch::hybrid()).unwrap();
    let (mut narrower, mut several) = (0, 0);
    for (storage, arithmetic, max_block_bytes) in [
        (Storage::F32, Arithmetic::Floats, u64::MAX),
        (Storage::F32, Arithmetic::Floats, 1 << 28),
        (Storage::F16, Arithmetic::Matrices, u64::MAX),
    ] {
        let target = Target { max_block_bytes, ..Target::for_gpu(storage, arithmetic) };
        for full in [Extent::new(1920, 1080), Extent::new(3840, 2160)] {
            let largest = plan(&graph, full, &target).unwrap();
            several += usize::from(largest.blocks.len() > 1);
            assert_eq!(plan_in(&graph, full, &target, &largest.blocks).unwrap(), largest);
            for percent in (50..100).step_by(3) {
                let extent = Extent::new(full.width * percent / 100, full.height * percent / 100);
                let chains = std::iter::successors(Some(target.max_chain_bytes), |bytes| Some(bytes / 2));
                let planned = chains.take(3).enumerate().find_map(|(i, max_chain_bytes)| {
                    let target = Target { max_chain_bytes, ..target };
                    plan_in(&graph, extent, &target, &largest.blocks).ok().map(|plan| (i, plan))
                });
                let (halved, planned) = planned.unwrap_or_else(|| panic!("{storage:?}, {max_block_bytes}: {extent:?}"));
                narrower += usize::from(halved > 0);
                assert!(planned.blocks.iter().zip(&largest.blocks).all(|(small, large)| small <= large));
                lists(&planned).into_iter().for_each(|list| check_memory(&format!("{extent:?}"), &planned, list));
            }
        }
    }
    println!("{narrower} in narrower bands");
    assert!(narrower > 0 && several > 0);
}

/// Where a plan looks for its weights.
fn packed(plan: &Plan) -> Vec<(String, u64)> {
    let weights = plan.buffers.iter().filter_map(|buffer| match &buffer.place {
        Place::Weights { pack, offset, .. } => {
            assert_eq!(buffer.bytes, pack.bytes(), "{}", buffer.name);
            Some((format!("{pack:?}"), *offset))
        }
        _ => None,
    });
    weights.collect()
}

/// What is packed, and where it lies, follows from network and target: plans of all sizes, of tiles and in bands read
/// the same weights.
#[test]
fn packing_is_of_no_size() {
    let told = |packing: &Packing| -> Vec<(String, u64)> {
        packing.packs().iter().map(|(pack, offset)| (format!("{pack:?}"), *offset)).collect()
    };
    let archs = Arch::NAMES.iter().map(|name| Arch::named(name).unwrap());
    let headed = [Head::pure(), Head::gloss(), Head::gated()].map(|head| Arch { head, ..Arch::hybrid() });
    for arch in archs.chain(headed) {
        let graph = Graph::new(&arch).unwrap();
        for (storage, arithmetic) in [
            (Storage::F32, Arithmetic::Floats),
            (Storage::F16, Arithmetic::Floats),
            (Storage::F16, Arithmetic::Matrices),
        ] {
            let suitable = Target::for_gpu(storage, arithmetic);
            let winograd = ConvAlgorithm::Winograd(WinogradTile::F2);
            let skipping = Target { converged: Some(ConvergedMode::Exact), ..suitable };
            let tiles = Target { of_tile: true, max_chain_bytes: 1 << 17, ..suitable };
            let packing_of = |target: &Target| packing(&graph, target);
            // The tiles of a frame too large read the weights of its denoiser.
            assert_eq!(packing_of(&tiles), packing_of(&skipping), "{}, {storage:?}, {arithmetic:?}", arch.name);
            for target in [suitable, skipping, tiles, Target { conv: winograd, ..suitable }] {
                let packing = packing_of(&target);
                for extent in [Extent::new(1, 1), Extent::new(300, 211)] {
                    let plan = plan(&graph, extent, &target).unwrap();
                    assert!(packed(&plan) == told(&packing), "{}, {extent:?}, {target:?}", arch.name);
                    assert_eq!(plan.weights_bytes, packing.bytes());
                }
            }
        }
    }
}

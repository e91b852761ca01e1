//! The mean that FiLM takes, estimated from a sample where converged squares are left out.

mod common;

use common::case::KERNEL_LIMIT;
use common::compare::{assert_same_bits, nmse};
use common::device::assert_no_validation_messages;
use common::random::Random;
use common::rig::{Rig, words};
use vkdenoise::Extent;
use vkdenoise::kernels::converged::{MapSize, Sample};
use vkdenoise::kernels::film::{Computed, FilmVector, TokenSum};
use vkdenoise::kernels::{BufferId, Call, Storage, View};
use vkdenoise::plan::Place;
use vkdenoise::plan::pack::Pack;

/// Which squares of a map are denoised, by column, row and what is sampled of the rest.
type Marks = fn(u32, u32, bool) -> bool;

/// The FiLM mean of what was computed: denoised squares and a sample of the others. All else is NaN.
#[test]
fn film_means_of_a_sample() {
    let (src, dst, map, counts, weights, film, plain) = (0, 1, 2, 3, 4, 5, 6);
    let mut random = Random::new(11);
    let patterns: [(&str, Marks); 6] = [
        ("all", |_, _, _| true),
        ("none", |_, _, _| false),
        ("all but the sample", |_, _, sampled| sampled),
        ("all but some that are not sampled", |x, y, sampled| sampled || (x + y) % 3 > 0),
        ("all but the first", |x, y, _| x + y > 0),
        ("some", |x, y, _| x * 7 % 5 < 2 && y % 4 < 3),
    ];
    for (i, (name, marks)) in patterns.repeat(4).into_iter().enumerate() {
        let token_pixels = [2, 1, 8, 16, 4, 32][(i + i / 6) % 6];
        let (width, height) = (random.integer(1, 300), random.integer(1, 200));
        let tokens = |pixels: u32| (pixels.div_ceil(token_pixels), pixels.div_ceil(token_pixels).next_multiple_of(8));
        let ((real_width, columns), (real_height, rows)) = (tokens(width), tokens(height));
        let real = MapSize::of(Extent::new(width, height));
        let squares = MapSize { columns: real.columns + 1, rows: real.rows + 1 };
        let sample = Sample::one_in([4, 9, 32][i % 3], real);
        let is_sampled = |x: u32, y: u32| (x + sample.skew * y).is_multiple_of(sample.pitch);
        let marked = |x: u32, y: u32| marks(x, y, is_sampled(x, y));
        let view = View {
            buffer: BufferId(src),
            first: 4,
            channels: 32,
            stride: 40,
            width: columns,
            height: rows,
            top: 0,
            storage: Storage::F32,
        };
        let computed =
            Computed { map: BufferId(map), columns: squares.columns, token_pixels, sample, counts: BufferId(counts) };
        let sum = TokenSum { src: view, real_width, real_height, dst: BufferId(dst), computed: Some(computed) };
        let pack =
            Pack::FilmVector { weight: "enc.0.0.film".into(), norm: "enc.0.0.norm1_f".into(), inputs: 32, outputs: 64 };
        let sizes = [view.tokens() * 40, sum.sums_bytes() / 4, u64::from(squares.tiles()), 2 * sum.sums()];
        let mut buffers = words(&[&sizes[..], &[pack.len() as u64, 64, 64]].concat());
        buffers[weights].place = Place::Weights { pack, offset: 0, turned: false };
        let mut rig = Rig::new(Extent::new(width, height), &buffers);
        let values: Vec<f32> = (0..view.tokens() as u32 * 40)
            .map(|i| {
                let (x, y) = (i / 40 % columns * token_pixels / 16, i / 40 / columns * token_pixels / 16);
                if marked(x, y) || is_sampled(x, y) { random.uniform(-3.0, 4.0) } else { f32::NAN }
            })
            .collect();
        rig.set_floats(BufferId(src), &values);
        let bits: Vec<u32> =
            (0..squares.tiles()).map(|i| u32::from(marked(i % squares.columns, i / squares.columns))).collect();
        rig.bench.upload(BufferId(map), &bits.iter().map(|&bit| f32::from_bits(bit)).collect::<Vec<_>>());
        rig.reference.set_buffer(BufferId(map), &bits.iter().map(|&bit| bit.into()).collect::<Vec<_>>());
        let vector = FilmVector {
            partials: BufferId(dst),
            sums: sum.sums(),
            tokens: sum.real_tokens(),
            counts: Some(BufferId(counts)),
            channels: 32,
            weights: BufferId(weights),
            dst: BufferId(film),
            outputs: 64,
        };
        rig.run(Call::TokenSum(sum.clone()));
        rig.run(Call::FilmVector(vector.clone()));
        rig.assert_integers(BufferId(counts), &format!("{name}: counts"));
        let found = rig.bench.download(BufferId(film), 64);
        let error = nmse(&found, rig.reference.buffer(BufferId(film)));
        assert!(error <= KERNEL_LIMIT, "{name}, {width}x{height}, tokens of {token_pixels}: NMSE {error:.1e}");
        if name == "all" {
            let vector = FilmVector { counts: None, dst: BufferId(plain), ..vector };
            rig.bench.run(&[Call::TokenSum(TokenSum { computed: None, ..sum }), Call::FilmVector(vector)]).unwrap();
            assert_same_bits(&found, &rig.bench.download(BufferId(plain), 64), "nothing converged");
        }
        rig.bench.check_guards(&buffers.iter().map(|buffer| buffer.bytes).collect::<Vec<_>>()).unwrap();
    }
    assert_no_validation_messages();
}

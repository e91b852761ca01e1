//! Twins of the kernels that make the FiLM vectors ([`crate::kernels::film`]).

use super::Reference;
use super::parameters::Parameters;
use crate::kernels::film::{FilmVector, TokenSum};

/// Sums of consecutive real tokens, row by row.
pub fn token_sum(reference: &mut Reference, call: &TokenSum) {
    let src = reference.map(&call.src);
    let (width, height) = (call.real_width as usize, call.real_height as usize);
    let real: Vec<_> = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).collect();
    let mut sums = Vec::new();
    for run in real.chunks(call.tokens_per_sum() as usize) {
        let mut sum = vec![0.0; src.channels];
        for &(x, y) in run {
            for (sum, value) in sum.iter_mut().zip(src.token(x, y)) {
                *sum += value;
            }
        }
        sums.extend(sum);
    }
    reference.set_buffer(call.dst, &sums);
}

/// `W (sum of partials / tokens) + bias`.
pub fn film_vector(reference: &mut Reference, call: &FilmVector) {
    let channels = call.channels as usize;
    let mut mean = vec![0.0; channels];
    for partial in reference.buffer(call.partials).chunks_exact(channels).take(call.sums as usize) {
        for (mean, value) in mean.iter_mut().zip(partial) {
            *mean += value / call.tokens as f64;
        }
    }
    let rows = match reference.parameters(call.weights) {
        Parameters::FilmVector(rows) => rows,
        other => unreachable!("film_vector is given {other:?}"),
    };
    let dot = |row: &[f64]| row.iter().zip(&mean).map(|(a, b)| a * b).sum::<f64>();
    let vector: Vec<f64> = rows.iter().map(|(bias, row)| bias + dot(row)).collect();
    reference.set_buffer(call.dst, &vector);
}

//! Twin of joint window attention ([`crate::kernels::window_attention`]).

use super::map::Map;
use super::parallel::for_each_row;
use super::parameters::Parameters;
use super::{Reference, Twin};
use crate::kernels::window_attention::WindowAttention;
use crate::kernels::{BufferId, TILE};

const SIDE: usize = TILE as usize;

impl Twin for WindowAttention {
    /// Head by head `softmax((Q K^T / sqrt(d) + B) * (Qf Kf^T / sqrt(d) + B)) V`.
    fn compute(&self, reference: &mut Reference) {
        let (x, f) = (reference.map(&self.x), reference.map(&self.f));
        let result = reference.attended(&x, &f, self.bias, (self.key_width as usize, self.value_width as usize));
        let tiles = reference.tiles(&self.tiles, self.dst.width, self.dst.height);
        reference.store(&result, &self.dst, &tiles, |x, y, channel| (x, y, channel));
    }
}

impl Reference<'_> {
    /// The attended values of `[Q | K | V]` and `[Qf | Kf]`, each head-major, of so many channels of keys and of values
    /// a head.
    pub(super) fn attended(&self, x: &Map, f: &Map, bias: BufferId, (keys, values): (usize, usize)) -> Map {
        let tables = match self.parameters(bias) {
            Parameters::BiasTable(tables) => tables,
            other => unreachable!("an attention is given {other:?}"),
        };
        let mut result = Map::zeros(x.width, x.height, tables.len() * values);
        let row_of_windows = result.row_len() * SIDE;
        for_each_row(&mut result.values, row_of_windows, |window_y, out| {
            for window_x in 0..x.width / SIDE {
                for (head, table) in tables.iter().enumerate() {
                    let widths = (tables.len(), keys, values);
                    window(x, f, widths, table, (window_x, window_y, head), out);
                }
            }
        });
        result
    }
}

/// One window and head, of so many heads and channels of keys and of values; `out` is the window's row of the result.
fn window(
    x: &Map,
    f: &Map,
    (heads, keys, values): (usize, usize, usize),
    table: &[f64],
    (window_x, window_y, head): (usize, usize, usize),
    out: &mut [f64],
) {
    let token = |map: &'_ Map, i: usize| {
        let start = (window_y * SIDE + i / SIDE) * map.row_len() + (window_x * SIDE + i % SIDE) * map.channels;
        start..start + map.channels
    };
    let part =
        |map: &Map, i: usize, first: usize, width: usize| map.values[token(map, i)][first..first + width].to_vec();
    let cut = |map: &Map, first: usize, width: usize| -> Vec<Vec<f64>> {
        (0..SIDE * SIDE).map(|i| part(map, i, first + head * width, width)).collect()
    };
    let (q, k, v) = (cut(x, 0, keys), cut(x, heads * keys, keys), cut(x, 2 * heads * keys, values));
    let (qf, kf) = (cut(f, 0, keys), cut(f, heads * keys, keys));
    let scale = 1.0 / (keys as f64).sqrt();
    for i in 0..SIDE * SIDE {
        let score = |j: usize| {
            let bias = table[bias_index(i, j)];
            (dot(&q[i], &k[j]) * scale + bias) * (dot(&qf[i], &kf[j]) * scale + bias)
        };
        let shares = softmax((0..SIDE * SIDE).map(score).collect());
        let (token_x, token_y) = (window_x * SIDE + i % SIDE, i / SIDE);
        let channels = heads * values;
        let to = &mut out[(token_y * x.width + token_x) * channels + head * values..][..values];
        for (share, v) in shares.iter().zip(&v) {
            for (to, v) in to.iter_mut().zip(v) {
                *to += share * v;
            }
        }
    }
}

/// Entry of the bias table for a query and a key token of a window.
fn bias_index(query: usize, key: usize) -> usize {
    let row = query / SIDE + SIDE - 1 - key / SIDE;
    let column = query % SIDE + SIDE - 1 - key % SIDE;
    row * (2 * SIDE - 1) + column
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn softmax(mut scores: Vec<f64>) -> Vec<f64> {
    let highest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    for score in &mut scores {
        *score = (*score - highest).exp();
    }
    let sum: f64 = scores.iter().sum();
    scores.iter().map(|score| score / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bias_is_that_of_query_minus_key() {
        assert_eq!(bias_index(0, 0), 7 * 15 + 7);
        // Query (row 1, column 2), key (row 3, column 7).
        assert_eq!(bias_index(8 + 2, 3 * 8 + 7), (7 - 2) * 15 + 7 - 5);
        assert_eq!((bias_index(0, 63), bias_index(63, 0)), (0, 224));
    }

    #[test]
    fn shares_survive_scores_of_any_size() {
        assert_eq!(softmax(vec![1e6, 1e6, -1e6]), [0.5, 0.5, 0.0]);
        let shares = softmax(vec![0.0, 3f64.ln()]);
        assert!((shares[0] - 0.25).abs() < 1e-15 && (shares[1] - 0.75).abs() < 1e-15);
    }
}

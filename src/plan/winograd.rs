//! The weights of Winograd convolutions: G g G^T, for the points that `glsl/winograd3x3.comp` evaluates at.

use crate::kernels::winograd::WinogradTile;

/// A kernel of three taps at points 0, 1, -1 and infinity, for two outputs.
const G2: [[f64; 3]; 4] = [[1.0, 0.0, 0.0], [0.5, 0.5, 0.5], [0.5, -0.5, 0.5], [0.0, 0.0, 1.0]];

/// At points 0, 1, -1, 2, -2 and infinity, for four outputs.
const G4: [[f64; 3]; 6] = [
    [1.0 / 4.0, 0.0, 0.0],
    [-1.0 / 6.0, -1.0 / 6.0, -1.0 / 6.0],
    [-1.0 / 6.0, 1.0 / 6.0, -1.0 / 6.0],
    [1.0 / 24.0, 1.0 / 12.0, 1.0 / 6.0],
    [1.0 / 24.0, -1.0 / 12.0, 1.0 / 6.0],
    [0.0, 0.0, 1.0],
];

/// The 3x3 taps of one input and output at all points, row by row; in f64, to be rounded once.
pub fn transform(tile: WinogradTile, taps: [f64; 9]) -> Vec<f64> {
    let g: &[[f64; 3]] = match tile {
        WinogradTile::F2 => &G2,
        WinogradTile::F4 => &G4,
    };
    let at = |row: &[f64; 3], column: &[f64; 3]| {
        let products = (0..9).map(|tap| row[tap / 3] * taps[tap] * column[tap % 3]);
        products.sum()
    };
    g.iter().flat_map(|row| g.iter().map(move |column| (row, column))).map(|(row, column)| at(row, column)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One tile of outputs by the transforms, in f64, against the definition.
    #[test]
    fn the_transforms_make_a_convolution() {
        // B^T and A^T of the shader, as matrices.
        let b2: [&[f64]; 4] = [&[1., 0., -1., 0.], &[0., 1., 1., 0.], &[0., -1., 1., 0.], &[0., 1., 0., -1.]];
        let a2: [&[f64]; 2] = [&[1., 1., 1., 0.], &[0., 1., -1., -1.]];
        let b4: [&[f64]; 6] = [
            &[4., 0., -5., 0., 1., 0.],
            &[0., -4., -4., 1., 1., 0.],
            &[0., 4., -4., -1., 1., 0.],
            &[0., -2., -1., 2., 1., 0.],
            &[0., 2., -1., -2., 1., 0.],
            &[0., 4., 0., -5., 0., 1.],
        ];
        let a4: [&[f64]; 4] = [
            &[1., 1., 1., 1., 1., 0.],
            &[0., 1., -1., 2., -2., 0.],
            &[0., 1., 1., 4., 4., 0.],
            &[0., 1., -1., 8., -8., 1.],
        ];
        let taps: [f64; 9] = std::array::from_fn(|i| (i * i % 7) as f64 - 2.5);
        for (tile, b, a) in [(WinogradTile::F2, &b2[..], &a2[..]), (WinogradTile::F4, &b4[..], &a4[..])] {
            let (inputs, outputs) = (tile.inputs() as usize, tile.outputs() as usize);
            let d: Vec<f64> = (0..inputs * inputs).map(|i| (i * 5 % 11) as f64 - 4.0).collect();
            // left * square * left^T
            let both = |left: &[&[f64]], square: &[f64]| -> Vec<f64> {
                let n = left[0].len();
                let half: Vec<f64> =
                    (0..left.len() * n).map(|i| (0..n).map(|k| left[i / n][k] * square[k * n + i % n]).sum()).collect();
                let m = left.len();
                (0..m * m).map(|i| (0..n).map(|k| half[i / m * n + k] * left[i % m][k]).sum()).collect()
            };
            let points: Vec<f64> = both(b, &d).iter().zip(transform(tile, taps)).map(|(x, w)| x * w).collect();
            let found = both(a, &points);
            for (i, found) in found.iter().enumerate() {
                let at = |tap: usize| d[(i / outputs + tap / 3) * inputs + i % outputs + tap % 3];
                let expected: f64 = (0..9).map(|tap| taps[tap] * at(tap)).sum();
                assert!((found - expected).abs() < 1e-12, "{tile:?} output {i}: {found} for {expected}");
            }
        }
    }
}

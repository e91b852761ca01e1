//! Where albedo and normals are noisy, and the mean albedo there: twin of `glsl/shared/noisy_albedo.glsl`.

use super::frame_io::reflect;

/// Pixels around a pixel that it looks at.
const REACH: usize = 3;
const SIDE: usize = 2 * REACH + 1;
/// Variances from which on a feature counts as noise, and from which on fully: of albedo, and of normals in [0, 1].
const ALBEDO: [f64; 2] = [1e-4, 2e-4];
const NORMAL: [f64; 2] = [0.005 / 4.0, 0.015 / 4.0];
/// Ratios of the least mean squared difference between neighbours to that between any pixels, the same.
const WHITE: [f64; 2] = [0.6, 0.8];

type Window = [[[f64; 3]; SIDE]; SIDE];

/// The albedo of a pixel, filtered. `features`: albedo, normal and depth of every pixel of a frame.
pub fn filtered(features: &[[f64; 7]], [width, height]: [usize; 2], x: usize, y: usize) -> [f64; 3] {
    let inside = |at: usize, by: usize, size| reflect((at + by).abs_diff(REACH), size);
    let window = |first: usize| -> Window {
        std::array::from_fn(|dy| {
            std::array::from_fn(|dx| {
                let pixel = &features[inside(y, dy, height) * width + inside(x, dx, width)];
                [0, 1, 2].map(|channel| pixel[first + channel])
            })
        })
    };
    let (albedo, normal) = (window(0), window(3));
    let noise = noise(&albedo, ALBEDO) * self::noise(&normal, NORMAL);
    let (own, mean) = (albedo[REACH][REACH], mean(&albedo));
    [0, 1, 2].map(|channel| own[channel] + (mean[channel] - own[channel]) * noise)
}

fn mean(window: &Window) -> [f64; 3] {
    [0, 1, 2].map(|channel| window.iter().flatten().map(|pixel| pixel[channel]).sum::<f64>() / (SIDE * SIDE) as f64)
}

fn squared_distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
}

fn step(value: f64, [low, high]: [f64; 2]) -> f64 {
    ((value - low) / (high - low)).clamp(0.0, 1.0)
}

/// How noisy a window is, from 0 to 1.
fn noise(window: &Window, variances: [f64; 2]) -> f64 {
    let mean = mean(window);
    let variance = window.iter().flatten().map(|pixel| squared_distance(pixel, &mean)).sum::<f64>() / (SIDE * SIDE) as f64;
    // Between neighbours right, below, below to the right and below to the left.
    let between = |right: usize, below: usize, left: usize| {
        let (rows, columns) = (SIDE - below, SIDE - right - left);
        let pairs = (0..rows).flat_map(|y| (0..columns).map(move |x| (y, x)));
        let squares = pairs.map(|(y, x)| squared_distance(&window[y][x + left], &window[y + below][x + right]));
        squares.sum::<f64>() / (rows * columns) as f64
    };
    let least = [between(1, 0, 0), between(0, 1, 0), between(1, 1, 0), between(0, 1, 1)].into_iter().fold(f64::MAX, f64::min);
    step(variance, variances) * step(least / (2.0 * variance).max(1e-12), WHITE)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: [usize; 2] = [24, 20];

    /// A number in [0, 1) for each place and channel, without pattern (Wellons, "Prospecting for hash functions").
    fn random(x: usize, y: usize, channel: usize) -> f64 {
        let mut hash = (x + 64 * y + 4096 * channel + 1) as u32;
        for (shift, factor) in [(16, 0x7feb_352d_u32), (15, 0x846c_a68b)] {
            hash = (hash ^ hash >> shift).wrapping_mul(factor);
        }
        f64::from(hash ^ hash >> 16) / f64::from(u32::MAX)
    }

    /// The same function for every channel of albedo and of normals.
    fn features(albedo: impl Fn(usize, usize) -> f64, normal: impl Fn(usize, usize, usize) -> f64) -> Vec<[f64; 7]> {
        let at = |i: usize| (i % SIZE[0], i / SIZE[0]);
        let pixel = |(x, y)| {
            let (a, n) = (albedo(x, y), [0, 1, 2].map(|channel| normal(x, y, channel)));
            [a, a, a, n[0], n[1], n[2], 0.5]
        };
        (0..SIZE[0] * SIZE[1]).map(|i| pixel(at(i))).collect()
    }

    /// Pixels that are not as they were, farther than `border` from the frame's end.
    fn changed(features: &[[f64; 7]], border: usize) -> usize {
        let inside = (border..SIZE[1] - border).flat_map(|y| (border..SIZE[0] - border).map(move |x| (x, y)));
        inside.filter(|&(x, y)| filtered(features, SIZE, x, y) != features[y * SIZE[0] + x][..3]).count()
    }

    #[test]
    fn noise_is_filtered() {
        let noisy = features(|x, y| random(x, y, 9), random);
        assert!(changed(&noisy, 0) > noisy.len() * 9 / 10, "{} of {}", changed(&noisy, 0), noisy.len());
        let variance = |values: &[f64]| {
            let mean = values.iter().sum::<f64>() / values.len() as f64;
            values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64
        };
        let before: Vec<f64> = noisy.iter().map(|pixel| pixel[0]).collect();
        let after: Vec<f64> =
            (0..noisy.len()).map(|i| filtered(&noisy, SIZE, i % SIZE[0], i / SIZE[0])[0]).collect();
        assert!(variance(&after) < 0.1 * variance(&before), "{} of {}", variance(&after), variance(&before));
    }

    #[test]
    fn structure_is_not() {
        let smooth = |x: usize, y: usize, channel: usize| [0.5, 0.02 * x as f64, 0.03 * y as f64][channel];
        // Grain under smooth normals is texture.
        assert_eq!(changed(&features(|x, y| random(x, y, 9), smooth), 0), 0);
        // Rough surfaces of one colour have nothing to filter.
        assert_eq!(changed(&features(|_, _| 0.5, random), 0), 0);
        // Edges and bars in any of the four directions, checkers of six pixels; the mirror breaks diagonals.
        for which in 0..5 {
            let pattern = move |x: usize, y: usize| {
                let along = [x, y, x + y, x + 32 - y, x / 6 + y / 6][which];
                f64::from(if which == 4 { along.is_multiple_of(2) } else { along % 7 < 2 })
            };
            assert_eq!(changed(&features(pattern, move |x, y, _| pattern(x, y)), REACH), 0, "{which}");
        }
    }
}

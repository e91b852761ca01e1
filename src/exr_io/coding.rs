//! How the channels of a picture stand for red, green and blue.

use super::container::Container;
use exr::meta::attribute::Chromaticities;
use glam::{DMat3, DVec3};

/// What the channels of a picture are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Coding {
    /// Red, green, blue.
    Rgb,
    /// One channel for all three.
    Gray,
    /// Two of the three, by their places; the third is taken to be their mean.
    Two([usize; 2]),
    /// Y, the luminance with these weights; (R - Y) / Y; (B - Y) / Y. OpenEXR's luminance and chroma.
    LumaChroma([f32; 3]),
}

impl Coding {
    /// How many channels there are.
    pub fn channels(self) -> usize {
        match self {
            Self::Gray => 1,
            Self::Two(_) => 2,
            Self::Rgb | Self::LumaChroma(_) => 3,
        }
    }

    /// The colour of a pixel's samples.
    pub fn color(self, samples: &[f32]) -> [f32; 3] {
        let at = |i: usize| samples.get(i).copied().unwrap_or(0.0);
        match self {
            Self::Rgb => [at(0), at(1), at(2)],
            Self::Gray => [at(0); 3],
            Self::Two(places) => {
                let mut color = [(at(0) + at(1)) / 2.0; 3];
                places.into_iter().enumerate().for_each(|(i, place)| color[place] = at(i));
                color
            }
            Self::LumaChroma([r, g, b]) => {
                let luminance = at(0);
                let (red, blue) = ((at(1) + 1.0) * luminance, (at(2) + 1.0) * luminance);
                [red, (luminance - r * red - b * blue) / g, blue]
            }
        }
    }

    /// The samples of a pixel's colour; only the first [`Coding::channels`] count.
    pub fn samples(self, color: [f32; 3]) -> [f32; 3] {
        let [red, green, blue] = color;
        match self {
            Self::Rgb => color,
            Self::Gray if red == green && green == blue => color,
            Self::Gray => [(red + green + blue) / 3.0; 3],
            Self::Two([first, second]) => [color[first], color[second], 0.0],
            Self::LumaChroma([r, g, b]) => {
                let luminance = r * red + g * green + b * blue;
                // As OpenEXR has it: no chroma where there is no light.
                let share = |c: f32| if luminance == 0.0 { 0.0 } else { (c - luminance) / luminance };
                [luminance, share(red), share(blue)]
            }
        }
    }

    /// All of a picture: its samples, interleaved, as interleaved RGB.
    pub fn colors(self, samples: Vec<f32>) -> Vec<f32> {
        if self == Self::Rgb {
            return samples;
        }
        samples.chunks_exact(self.channels()).flat_map(|pixel| self.color(pixel)).collect()
    }
}

/// The weights of red, green and blue in a file's luminance: those of its chromaticities, else of Rec. 709.
pub(super) fn luminance_weights(container: &Container) -> [f32; 3] {
    const REC_709: [f32; 3] = [0.2126, 0.7152, 0.0722];
    let given = container.header(0).shared_attributes.chromaticities;
    let weights = given.map(weights_of).filter(|weights| weights.iter().all(|w| w.is_finite() && *w > 0.0));
    weights.unwrap_or(REC_709)
}

/// The middle row of the matrix from RGB to XYZ: what of each primary makes white (SMPTE RP 177).
fn weights_of(chromaticities: Chromaticities) -> [f32; 3] {
    let Chromaticities { red, green, blue, white } = chromaticities;
    let xyz = |c: exr::math::Vec2<f32>| {
        let (x, y) = (f64::from(c.0), f64::from(c.1));
        DVec3::new(x, y, 1.0 - x - y)
    };
    let [red, green, blue, white] = [red, green, blue, white].map(xyz);
    // The shares of the primaries whose sum is white, each times its own y.
    let shares = DMat3::from_cols(red, green, blue).inverse() * (white / white.y);
    (shares * DVec3::new(red.y, green.y, blue.y)).as_vec3().to_array()
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::math::Vec2;

    #[test]
    fn every_coding_gives_back_its_samples() {
        let weights = [0.2126, 0.7152, 0.0722];
        for (coding, samples) in [
            (Coding::Rgb, [0.5, 0.25, 2.0]),
            (Coding::Gray, [0.7, 0.0, 0.0]),
            (Coding::Two([0, 1]), [0.5, 0.25, 0.0]),
            (Coding::Two([1, 2]), [0.5, 0.25, 0.0]),
            (Coding::LumaChroma(weights), [0.4, 0.3, -0.5]),
            (Coding::LumaChroma(weights), [0.0, 0.0, 0.0]),
        ] {
            let n = coding.channels();
            let again = coding.samples(coding.color(&samples[..n]));
            for (a, b) in again[..n].iter().zip(&samples[..n]) {
                assert!((a - b).abs() < 1e-6, "{coding:?}: {again:?} for {samples:?}");
            }
        }
        assert_eq!(Coding::Two([0, 2]).color(&[1.0, 3.0]), [1.0, 2.0, 3.0]);
        let [red, green, blue] = Coding::LumaChroma(weights).color(&[0.5, 1.0, -1.0]);
        assert!((red - 1.0).abs() < 1e-6 && blue.abs() < 1e-6 && (green - 0.4018).abs() < 1e-4, "{green}");
    }

    #[test]
    fn luminance_is_that_of_the_primaries() {
        let white = Vec2(0.3127, 0.3290);
        let rec709 = Chromaticities { red: Vec2(0.64, 0.33), green: Vec2(0.3, 0.6), blue: Vec2(0.15, 0.06), white };
        for (weight, wanted) in weights_of(rec709).into_iter().zip([0.2126, 0.7152, 0.0722]) {
            assert!((weight - wanted).abs() < 1e-4, "{weight} for {wanted}");
        }
    }
}

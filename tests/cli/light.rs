//! Files with samples that are hardly light: negative, infinite, a sun; and alpha with noise of its own.

use super::*;

fn case(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases").join(name).with_extension("exr")
}

/// The colour of a file before and after.
fn denoised(input: &Path) -> (Vec<f32>, Vec<f32>) {
    let d = Directory::new();
    let out = d.path("out.exr");
    succeeded(&run(arguments![input, "-o", out]));
    let (before, after) = (color(input), color(&out));
    assert!(after.iter().all(|value| value.is_finite() && *value >= 0.0), "{}", input.display());
    (before, after)
}

/// Indices of the pixels that are so.
fn pixels(color: &[f32], is: impl Fn(&[f32]) -> bool) -> Vec<usize> {
    color.chunks_exact(3).enumerate().filter(|(_, pixel)| is(pixel)).map(|(i, _)| i).collect()
}

fn sum(color: &[f32], pixels: &[usize], channel: usize) -> f64 {
    pixels.iter().map(|i| f64::from(color[3 * i + channel])).sum()
}

/// A colour of a wide gamut in a narrower space has a negative channel: it is 0, and the others are what they were.
/// What a block of 20 pixels without features loses besides is the network's blur.
#[test]
fn a_block_of_negative_red_stays_blue() {
    let file = case("12_negative_block");
    let (before, after) = denoised(&file);
    let block = pixels(&before, |pixel| pixel[0] < 0.0);
    let inner: Vec<usize> = {
        let is_block = |i: usize| block.binary_search(&i).is_ok();
        block.iter().copied().filter(|i| [i - 4, i + 4, i - 4 * 64, i + 4 * 64].into_iter().all(is_block)).collect()
    };
    let of = |color: &[f32], pixels: &[usize], channel| sum(color, pixels, channel) / pixels.len() as f64;
    let [red, green, blue] = [0, 1, 2].map(|channel| of(&after, &inner, channel));
    let share = of(&after, &block, 2) / of(&before, &block, 2);
    let least = block.iter().map(|i| after[3 * i + 2]).fold(f32::MAX, f32::min);
    println!("{} of {} pixels: {red} {green} {blue}; blue {share}, least {least}", inner.len(), block.len());
    assert!(block.len() > 300 && inner.len() > 100, "{} {}", block.len(), inner.len());
    assert!(share > 0.85 && share < 1.05, "{share}");
    assert!(red < 0.05 && (green / 0.05 - 1.0).abs() < 0.3 && blue > 0.85 && blue < 0.95, "{red} {green} {blue}");
    assert!(least > 0.25, "{least}");
}

/// +Inf is as bright as anything finite in the frame.
#[test]
fn an_infinite_disc_is_the_brightest_there_is() {
    let (before, after) = denoised(&case("13_inf_disc"));
    let disc = pixels(&before, |pixel| pixel.iter().any(|value| value.is_infinite()));
    let brightest = before.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::max);
    let least = disc.iter().flat_map(|i| &after[3 * i..3 * i + 3]).copied().fold(f32::MAX, f32::min);
    println!("{} pixels, at least {least} where the brightest is {brightest}", disc.len());
    assert!(disc.len() > 60 && least >= 0.95 * brightest, "{least} {brightest}");
}

/// A sun keeps its energy, where it is.
#[test]
fn a_sun_keeps_its_energy() {
    let (before, after) = denoised(&case("14_sun_float"));
    let sun = pixels(&before, |pixel| pixel[0] > 1e6);
    let around = pixels(&before, |_| true);
    for channel in 0..3 {
        let ratio = sum(&after, &sun, channel) / sum(&before, &sun, channel);
        let all = sum(&after, &around, channel) / sum(&before, &around, channel);
        println!("{} pixels: {ratio}, of all {all}", sun.len());
        assert!((ratio - 1.0).abs() < 0.05 && (all - 1.0).abs() < 0.05, "{ratio} {all}");
    }
}

/// Alpha is left as it is.
#[test]
fn noisy_alpha_stays_as_it_is() {
    let d = Directory::new();
    let (input, out) = (case("20_noisy_alpha"), d.path("out.exr"));
    succeeded(&run(arguments![input, "-o", out]));
    let alpha = |path: &Path| -> Vec<f32> {
        let image = exr::prelude::read_all_flat_layers_from_file(path).unwrap();
        let mut list = image.layer_data[0].channel_data.list.iter();
        list.find(|channel| channel.name.to_string() == "A").unwrap().sample_data.values_as_f32().collect()
    };
    let (before, after) = (alpha(&input), alpha(&out));
    assert!(before.iter().any(|a| *a > 0.0 && *a < 1.0));
    assert_eq!(before, after);
    assert_ne!(color(&input), color(&out));
}

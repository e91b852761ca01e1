//! The ten networks that the thesis measures, from the baseline to the hybrid, in the order of its tables.

use super::arch::{Arch, Block, Bottleneck, Convolution, Decoder, StageSpec, WINDOW};
use super::head::Head;

const FILM: Block = Block::FilmCnn { conv: Convolution::Standard };

impl Arch {
    /// The names [`Arch::named`] knows, in the order of the thesis's tables.
    pub const NAMES: [&'static str; 10] = [
        "jsa_baseline",
        "shsa_100",
        "shsa_075",
        "shsa_050",
        "shsa_025",
        "film_cnn",
        "symmetric_decoder",
        "three_stage",
        "expanded_patch",
        "hybrid",
    ];

    /// The network of this name, `None` when it is none of [`Arch::NAMES`].
    pub fn named(name: &str) -> Option<Arch> {
        Some(match name {
            "jsa_baseline" => Arch::jsa_baseline(),
            "shsa_100" => Arch::shsa_100(),
            "shsa_075" => Arch::shsa_075(),
            "shsa_050" => Arch::shsa_050(),
            "shsa_025" => Arch::shsa_025(),
            "film_cnn" => Arch::film_cnn(),
            "symmetric_decoder" => Arch::symmetric_decoder(),
            "three_stage" => Arch::three_stage(),
            "expanded_patch" => Arch::expanded_patch(),
            "hybrid" => Arch::hybrid(),
            _ => return None,
        })
    }

    /// Four stages of multi-head joint attention.
    pub fn jsa_baseline() -> Arch {
        build("jsa_baseline", &[Block::Jsa; 4], Block::Jsa, Decoder::Baseline, 1)
    }

    /// The baseline with single-head attention on all channels.
    pub fn shsa_100() -> Arch {
        single_head("shsa_100", 1.0)
    }

    /// The baseline with single-head attention on three quarters of the channels.
    pub fn shsa_075() -> Arch {
        single_head("shsa_075", 0.75)
    }

    /// The baseline with single-head attention on half of the channels.
    pub fn shsa_050() -> Arch {
        single_head("shsa_050", 0.5)
    }

    /// The baseline with single-head attention on a quarter of the channels.
    pub fn shsa_025() -> Arch {
        single_head("shsa_025", 0.25)
    }

    /// The baseline with FiLM-CNN blocks at the two finest stages.
    pub fn film_cnn() -> Arch {
        build("film_cnn", &[FILM, FILM, Block::Jsa, Block::Jsa], Block::Jsa, Decoder::Baseline, 1)
    }

    /// The baseline with the symmetric decoder.
    pub fn symmetric_decoder() -> Arch {
        build("symmetric_decoder", &[Block::Jsa; 4], Block::Jsa, Decoder::Symmetric, 1)
    }

    /// Symmetric decoder and one stage less.
    pub fn three_stage() -> Arch {
        build("three_stage", &[Block::Jsa; 3], Block::Jsa, Decoder::Symmetric, 1)
    }

    /// Symmetric decoder, three stages, tokens of 2x2 pixels.
    pub fn expanded_patch() -> Arch {
        build("expanded_patch", &[Block::Jsa; 3], Block::Jsa, Decoder::Symmetric, 2)
    }

    /// All savings at once: FiLM-CNN at stage 0, single-head attention on a quarter of the channels elsewhere.
    pub fn hybrid() -> Arch {
        let attention = Block::ShJsa { ratio: 0.25 };
        build("hybrid", &[FILM, attention, attention], attention, Decoder::Symmetric, 2)
    }
}

fn single_head(name: &str, ratio: f64) -> Arch {
    let block = Block::ShJsa { ratio };
    build(name, &[block; 4], block, Decoder::Baseline, 1)
}

/// One block kind per stage. Depths are 1, 2, 4, 8 | 2 | 8, 4, 2 and, last, 4 (baseline) or 1 (symmetric).
fn build(name: &str, blocks: &[Block], neck: Block, decoder: Decoder, patch: u32) -> Arch {
    let stage = |(i, &block): (usize, &Block)| {
        let deep = 1 << i;
        let decoder_blocks = if i == 0 && decoder == Decoder::Baseline { 4 } else { deep };
        StageSpec { encoder_blocks: deep, decoder_blocks, heads: deep, block }
    };
    Arch {
        name: name.into(),
        channels: 32,
        window: WINDOW,
        patch,
        decoder,
        stages: blocks.iter().enumerate().map(stage).collect(),
        bottleneck: Bottleneck { blocks: 2, heads: 1 << blocks.len(), block: neck },
        head: Head::Residual,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_names_a_valid_network() {
        for name in Arch::NAMES {
            let arch = Arch::named(name).unwrap();
            assert_eq!(arch.name, name);
            arch.validate().unwrap();
        }
        assert!(Arch::named("unet").is_none());
    }
}

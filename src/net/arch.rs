//! The architecture value: everything that tells one network of the family from another.
//!
//! Its JSON form stands in the metadata of a weights file (key `architecture`), so field names and order are a contract
//! with the training kit (`tools/train/vkdn/arch.py`).

use serde::{Deserialize, Serialize};

use super::head::Head;

/// The side of an attention window in tokens. The only one supported.
pub const WINDOW: u32 = 8;

/// An architecture that no network can have, with the reason.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("impossible architecture: {0}")]
pub struct ArchError(String);

/// One network of the family: a U-Net of blocks on a colour map, guided by an auxiliary map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arch {
    /// What the network is called: 1 to 64 letters, digits, `_`, `-` or `.`.
    pub name: String,
    /// Channels at stage 0; stage i has `channels * 2^i`. A multiple of 8, at most 256.
    pub channels: u32,
    /// The side of an attention window in tokens: [`WINDOW`].
    pub window: u32,
    /// The side of a stage 0 token in pixels: 1 or 2.
    pub patch: u32,
    /// How the last decoder stage takes its skip connection.
    pub decoder: Decoder,
    /// The resolutions of the U-Net from the finest down, 1 to 6 of them.
    pub stages: Vec<StageSpec>,
    /// The blocks at the coarsest resolution.
    pub bottleneck: Bottleneck,
    /// How the last maps become the picture; a file of before there were heads says nothing of it.
    #[serde(default, skip_serializing_if = "Head::is_residual")]
    pub head: Head,
}

/// How decoder stage 0 takes its skip connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Decoder {
    /// Side by side: it works on `[up | encoder 0]`, `2 * channels` wide, with `[up of F1 | F0]` as its auxiliary map
    /// and one attention head whatever `heads` says.
    Baseline,
    /// As every other stage: `[up | encoder 0]` mixed down to `channels` by a Linear, auxiliary map F0.
    Symmetric,
}

/// One resolution of the U-Net.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageSpec {
    /// Blocks on the way down, 1 to 64.
    pub encoder_blocks: u32,
    /// Blocks on the way up, 1 to 64.
    pub decoder_blocks: u32,
    /// Attention heads; used by [`Block::Jsa`] only.
    pub heads: u32,
    /// The kind of all blocks of the stage.
    pub block: Block,
}

/// The coarsest resolution, `channels * 2^stages` wide.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bottleneck {
    /// Blocks, 1 to 64.
    pub blocks: u32,
    /// Attention heads; used by [`Block::Jsa`] only.
    pub heads: u32,
    /// The kind of the blocks.
    pub block: Block,
}

/// A kind of block.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Block {
    /// Joint window self-attention on all channels, several heads.
    Jsa,
    /// Joint window self-attention, one head, on the first `ratio * C` channels.
    ShJsa {
        /// Share of the channels that attend, in (0, 1].
        ratio: f64,
    },
    /// A 3x3 convolution modulated by the image-wide mean of the auxiliary map.
    FilmCnn {
        /// The form of the convolution.
        conv: Convolution,
    },
}

/// The form of a FiLM-CNN block's convolution.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Convolution {
    /// One dense 3x3 convolution.
    Standard,
    /// A depthwise 3x3 convolution, then a pointwise one, nothing between.
    Separable,
}

impl Block {
    /// How many of `channels` channels attend: `ratio * channels` in [`Block::ShJsa`], else all.
    pub fn attended(&self, channels: u32) -> u32 {
        match self {
            // Exact after `Arch::validate`.
            Block::ShJsa { ratio } => (f64::from(channels) * ratio) as u32,
            Block::Jsa | Block::FilmCnn { .. } => channels,
        }
    }
}

impl Arch {
    /// Width and height of the network's input are multiples of this many pixels.
    pub fn pad_multiple(&self) -> u32 {
        self.token_stride(self.stages.len() as u32) * WINDOW
    }

    /// The side in pixels of a token at `level`: stage 0, 1, ..., the bottleneck being level `stages.len()`.
    pub fn token_stride(&self, level: u32) -> u32 {
        self.patch << level
    }

    /// The channels at `level`, counted as in [`Arch::token_stride`].
    pub fn width(&self, level: u32) -> u32 {
        self.channels << level
    }

    /// Refuses what the engine cannot build: an architecture may come from a hostile file.
    ///
    /// # Errors
    /// The first rule that is broken, in words.
    pub fn validate(&self) -> Result<(), ArchError> {
        let name = &self.name;
        let legal = |c: char| c.is_ascii_alphanumeric() || "_-.".contains(c);
        check((1..=64).contains(&name.len()) && name.chars().all(legal), || {
            "a name is 1 to 64 letters, digits, '_', '-' or '.'".into()
        })?;
        check(self.window == WINDOW, || format!("window is {}, only {WINDOW} is supported", self.window))?;
        check((1..=2).contains(&self.patch), || format!("patch is {}, not 1 or 2", self.patch))?;
        check((1..=6).contains(&self.stages.len()), || format!("{} stages, not 1 to 6", self.stages.len()))?;
        // Down halves the channels, and kernels take four at a time.
        check((8..=256).contains(&self.channels) && self.channels.is_multiple_of(8), || {
            format!("channels is {}, not a multiple of 8 from 8 to 256", self.channels)
        })?;
        for (i, stage) in (0u32..).zip(&self.stages) {
            let place = format!("stage {i}");
            check_count(stage.encoder_blocks, &place)?;
            check_count(stage.decoder_blocks, &place)?;
            check_block(stage.block, self.width(i), stage.heads, &place)?;
        }
        let place = "bottleneck";
        check_count(self.bottleneck.blocks, place)?;
        check_block(self.bottleneck.block, self.width(self.stages.len() as u32), self.bottleneck.heads, place)?;
        self.head.validate(self)
    }
}

/// What the kernel of the FiLM vectors holds in shared memory.
const MAX_FILM_CHANNELS: u32 = 512;

pub(super) fn check(holds: bool, why: impl FnOnce() -> String) -> Result<(), ArchError> {
    if holds { Ok(()) } else { Err(ArchError(why())) }
}

fn check_count(blocks: u32, place: &str) -> Result<(), ArchError> {
    check((1..=64).contains(&blocks), || format!("{place}: {blocks} blocks, not 1 to 64"))
}

fn check_block(block: Block, channels: u32, heads: u32, place: &str) -> Result<(), ArchError> {
    // Everything works on groups of four channels, of which a head must hold whole ones.
    check(heads > 0 && channels.is_multiple_of(heads), || {
        format!("{place}: {heads} heads do not divide {channels} channels")
    })?;
    match block {
        Block::Jsa => check((channels / heads).is_multiple_of(4), || {
            format!("{place}: heads are {} wide, not a multiple of 4", channels / heads)
        }),
        Block::ShJsa { ratio } => {
            check(ratio > 0.0 && ratio <= 1.0, || format!("{place}: ratio {ratio} is not in (0, 1]"))?;
            let part = f64::from(channels) * ratio;
            // Keys are half as wide as values, so half of the part is a multiple of 4 as well.
            check(part % 8.0 == 0.0, || {
                format!("{place}: ratio {ratio} of {channels} channels is {part}, not a multiple of 8")
            })
        }
        Block::FilmCnn { .. } => check(channels <= MAX_FILM_CHANNELS, || {
            format!("{place}: FiLM blocks take at most {MAX_FILM_CHANNELS} channels, not {channels}")
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HYBRID: &str = concat!(
        r#"{"name":"hybrid","channels":32,"window":8,"patch":2,"decoder":"symmetric","stages":["#,
        r#"{"encoder_blocks":1,"decoder_blocks":1,"heads":1,"block":{"kind":"film_cnn","conv":"standard"}},"#,
        r#"{"encoder_blocks":2,"decoder_blocks":2,"heads":2,"block":{"kind":"sh_jsa","ratio":0.25}},"#,
        r#"{"encoder_blocks":4,"decoder_blocks":4,"heads":4,"block":{"kind":"sh_jsa","ratio":0.25}}],"#,
        r#""bottleneck":{"blocks":2,"heads":8,"block":{"kind":"sh_jsa","ratio":0.25}}}"#
    );

    #[test]
    fn json_is_the_contract() {
        assert_eq!(serde_json::to_string(&Arch::hybrid()).unwrap(), HYBRID);
        assert_eq!(serde_json::from_str::<Arch>(HYBRID).unwrap(), Arch::hybrid());
        assert!(serde_json::from_str::<Arch>(&HYBRID.replace("patch", "patches")).is_err());
    }

    #[test]
    fn multiples_of_the_three_grids() {
        let multiples = [Arch::jsa_baseline(), Arch::three_stage(), Arch::hybrid()].map(|a| a.pad_multiple());
        assert_eq!(multiples, [128, 64, 128]);
    }

    #[test]
    fn nonsense_is_refused_with_its_reason() {
        type Spoil = fn(&mut Arch);
        let cases: [(&str, Spoil); 17] = [
            ("name", |a| a.name = String::new()),
            ("name", |a| a.name = "\u{1b}[2J".into()),
            ("window", |a| a.window = 16),
            ("patch", |a| a.patch = 3),
            ("stages", |a| a.stages.clear()),
            ("stages", |a| a.stages = vec![a.stages[0].clone(); 7]),
            ("channels", |a| a.channels = 0),
            ("channels", |a| a.channels = 30),
            ("channels", |a| a.channels = 4),
            ("FiLM", |a| {
                a.channels = 256;
                a.stages[2].block = Block::FilmCnn { conv: Convolution::Standard };
            }),
            ("channels", |a| a.channels = u32::MAX - 3),
            ("stage 0", |a| a.stages[0].encoder_blocks = 0),
            ("stage 1", |a| a.stages[1].decoder_blocks = 65),
            ("heads", |a| a.stages[2].heads = 0),
            ("heads", |a| a.bottleneck.heads = 7),
            ("ratio", |a| a.stages[1].block = Block::ShJsa { ratio: f64::NAN }),
            ("ratio", |a| a.stages[1].block = Block::ShJsa { ratio: 0.3 }),
        ];
        for (word, spoil) in cases {
            let mut arch = Arch::hybrid();
            spoil(&mut arch);
            let message = arch.validate().unwrap_err().to_string();
            assert!(message.contains(word), "{message} does not speak of {word}");
        }
    }
}

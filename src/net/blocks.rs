//! The three kinds of U-Net block, written down as ops. Each ends with the same FFN.

use super::arch::{Block, Convolution};
use super::builder::{Builder, Conv, Linear};
use super::op::{Activation, LinearPart, OpKind, Slice};

/// Where a block stands: `prefix` its name and that of its tensors, `x` the colour map it changes, `f` the auxiliary
/// map of the same shape, `into` where the result goes (a new value if `None`).
pub(super) struct Place<'a> {
    pub prefix: &'a str,
    pub x: Slice,
    pub f: Slice,
    pub into: Option<Slice>,
}

/// Appends a block, `heads` being those of a multi-head one. Returns its result.
pub(super) fn block(b: &mut Builder, block: Block, heads: u32, place: Place) -> Slice {
    let channels = place.x.channels;
    let mixed = match block {
        Block::Jsa => attention(b, &place, channels, channels, heads),
        Block::ShJsa { .. } => {
            let part = block.attended(channels);
            attention(b, &place, part, part / 2, 1)
        }
        Block::FilmCnn { conv } => film_cnn(b, &place, conv),
    };
    ffn(b, place.prefix, mixed, place.into)
}

/// X + proj([attended | raw rest of X]). The first `part` channels attend; `keys` is the width of Q, all heads
/// together.
fn attention(b: &mut Builder, place: &Place, part: u32, keys: u32, heads: u32) -> Slice {
    let Place { prefix, x, f, .. } = *place;
    let tensor = |name: &str, outputs| LinearPart { prefix: format!("{prefix}.{name}"), outputs };

    let normed = b.layer_norm(&format!("{prefix}.norm1"), x.part(0, part));
    let parts = vec![tensor("q", keys), tensor("k", keys), tensor("v", part)];
    let qkv = b.linear(Linear::stacked(&format!("{prefix}.qkv"), vec![normed], parts));

    let normed = b.layer_norm(&format!("{prefix}.norm1_f"), f.part(0, part));
    let parts = vec![tensor("qf", keys), tensor("kf", keys)];
    let qkf = b.linear(Linear::stacked(&format!("{prefix}.qkf"), vec![normed], parts));

    let name = format!("{prefix}.attention");
    let attended = b.map(&name, b.stride(x), part);
    let kind = OpKind::WindowAttention {
        x: qkv.value,
        f: qkf.value,
        bias_table: format!("{prefix}.bias_table"),
        heads,
        key_width: keys / heads,
        value_width: part / heads,
        output: attended.value,
    };
    b.push(name, kind);

    let mut inputs = vec![attended];
    if part < x.channels {
        inputs.push(x.part(part, x.channels - part));
    }
    b.linear(Linear { residual: Some(x), ..Linear::new(&format!("{prefix}.proj"), inputs, x.channels) })
}

/// X + gamma * conv(LN1(X)) + beta.
fn film_cnn(b: &mut Builder, place: &Place, conv: Convolution) -> Slice {
    let Place { prefix, x, f, .. } = *place;
    let film = Some(b.film(prefix, f));
    let normed = b.layer_norm(&format!("{prefix}.norm1"), x);
    let name = format!("{prefix}.conv");
    match conv {
        Convolution::Standard => b.conv(Conv { film, residual: Some(x), ..Conv::new(&name, normed, x.channels) }),
        Convolution::Separable => {
            let spread = b.depthwise(&format!("{name}.depthwise"), normed, Activation::None);
            let pointwise = Linear::new(&format!("{name}.pointwise"), vec![spread], x.channels);
            b.linear(Linear { film, residual: Some(x), ..pointwise })
        }
    }
}

/// X + contract(relu(depthwise(expand(LN2(X))))), four times as wide inside.
fn ffn(b: &mut Builder, prefix: &str, x: Slice, into: Option<Slice>) -> Slice {
    let normed = b.layer_norm(&format!("{prefix}.norm2"), x);
    let wide = b.linear(Linear::new(&format!("{prefix}.ffn.expand"), vec![normed], 4 * x.channels));
    let wide = b.depthwise(&format!("{prefix}.ffn.depthwise"), wide, Activation::Relu);
    let contract = Linear::new(&format!("{prefix}.ffn.contract"), vec![wide], x.channels);
    b.linear(Linear { residual: Some(x), into, ..contract })
}

//! Layers beside the colour that are denoised with its kernels: light groups, other layers, alpha ([`crate::signals`]).

use super::ExrFrame;
use super::UsedLayer;
use super::coding::Coding;
use super::container::Container;
use super::error::ExrError;
use super::layers::{Layer, Place, describe, part_name, same, simplify};
use super::names::{is_feature, says_denoised};
use super::read::used_layer;
use super::select::Pick;
use crate::signals::SignalKind;
use std::str::FromStr;

/// What comes before `_NAME` in the names of light groups: Cycles (Combined), Arnold (RGBA), Redshift (Beauty), Karma
/// (C), V-Ray's light selects and what people name after them, in small letters.
const GROUP_PREFIXES: [&str; 8] =
    ["combined", "rgba", "beauty", "c", "lightgroup", "lightselect", "vraylightselect", "light"];

/// Layers of three colours that are no light, or light over the surface's colour, by their simplified names:
/// positions, vectors, Cycles' passes. Features' names count too.
const NO_LIGHT: [&str; 20] = [
    "position",
    "p",
    "pworld",
    "worldposition",
    "pointposition",
    "uv",
    "st",
    "vector",
    "motion",
    "motionvector",
    "velocity",
    "diffdir",
    "diffind",
    "glossdir",
    "glossind",
    "glosscol",
    "transdir",
    "transind",
    "transcol",
    "ao",
];

/// Which layers beside the colour are denoised with it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SignalLayers {
    /// Layers by name.
    pub aovs: Vec<AovLayer>,
    /// Whether those are that are light groups by their names.
    pub light_groups: bool,
    /// Whether the colour's alpha is.
    pub alpha: bool,
}

impl SignalLayers {
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }
}

/// A layer by its name, as [`LayerOptions::layer`](super::LayerOptions::layer) has names, and what it is.
#[derive(Clone, Debug, PartialEq)]
pub struct AovLayer {
    /// The name.
    pub name: String,
    /// What it is; `None`: a layer of red, green and blue is a part of the light, but for features, positions and
    /// what Cycles divides by the surface's colour; any other is not.
    pub kind: Option<SignalKind>,
}

impl FromStr for AovLayer {
    type Err = std::convert::Infallible;

    /// `NAME`, `NAME:light` or `NAME:value`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let kinds = [(":light", SignalKind::Light), (":value", SignalKind::Value)];
        let told = kinds.iter().find_map(|(end, kind)| Some((text.strip_suffix(end)?, *kind)));
        let (name, kind) = told.map_or((text, None), |(name, kind)| (name, Some(kind)));
        Ok(Self { name: name.to_owned(), kind })
    }
}

/// A layer beside the colour, or a channel of one, that was read to be denoised with it.
pub struct ExrSignal {
    kind: SignalKind,
    pub(super) channels: Vec<Place>,
    samples: Vec<f32>,
    layer: UsedLayer,
}

impl ExrSignal {
    /// What it is.
    pub fn kind(&self) -> SignalKind {
        self.kind
    }

    /// Its channels, 1 or 3.
    pub fn channels(&self) -> usize {
        self.channels.len()
    }

    /// Its samples, interleaved, as they stand in the file.
    pub fn samples(&self) -> &[f32] {
        &self.samples
    }

    /// Where it stands in the file.
    pub fn layer(&self) -> &UsedLayer {
        &self.layer
    }

    pub(super) fn coding(&self) -> Coding {
        if self.channels.len() == 1 { Coding::Gray } else { Coding::Rgb }
    }

    /// Result samples as a picture's red, green and blue.
    pub(super) fn colors(&self, values: &[f32]) -> Vec<f32> {
        self.coding().colors(values.to_vec())
    }
}

impl ExrFrame {
    /// The layers beside the colour that the options asked for, or channels of them.
    pub fn signals(&self) -> &[ExrSignal] {
        &self.signals
    }

    /// Gives a denoised signal back what the file has where [`ExrFrame::keep_empty`] keeps the colour: it has no
    /// noise there.
    pub fn keep_empty_signal(&self, signal: &ExrSignal, values: &mut [f32]) {
        let Some(empty) = &self.empty else { return };
        let channels = signal.channels();
        let pixels = values.chunks_exact_mut(channels).zip(signal.samples.chunks_exact(channels)).zip(empty);
        pixels.filter(|(_, empty)| **empty).for_each(|((value, own), _)| value.copy_from_slice(own));
    }

    /// Takes the signals' samples, and says of light groups what they are of the colour, where that is not all.
    pub(super) fn take_signals(&mut self, container: &Container, picked: Vec<Picked>, samples: Vec<Vec<f32>>) {
        let signals = picked.into_iter().zip(samples);
        self.signals = signals
            .map(|(Picked { kind, channels, .. }, samples)| {
                let layer = used_layer(container, &channels, None);
                ExrSignal { kind, channels, samples, layer }
            })
            .collect();
    }

    /// What the light groups are off the colour by, of it; `None` where there is no light.
    pub(super) fn off_color(&self, groups: &[usize]) -> Option<f64> {
        let (mut off, mut all) = (0.0, 0.0);
        for (i, color) in self.color().iter().enumerate() {
            let sum: f64 = groups.iter().map(|group| f64::from(self.signals[*group].samples[i])).sum();
            if color.is_finite() && sum.is_finite() {
                off += (sum - f64::from(*color)).abs();
                all += f64::from(color.abs());
            }
        }
        (all > 0.0).then(|| off / all)
    }
}

/// Channels that were chosen for a signal.
pub(super) struct Picked {
    pub kind: SignalKind,
    pub channels: Vec<Place>,
    /// Whether it is a light group.
    pub group: bool,
}

/// The layers of a file, looked through for signals of a picture.
pub(super) struct Signals<'a> {
    pub container: &'a Container,
    pub layers: &'a [Layer],
    pub picture: &'a Pick,
    /// What the picture's result is written into.
    pub target: &'a Pick,
}

impl Signals<'_> {
    /// Finds what is asked for.
    ///
    /// # Errors
    /// [`ExrError::NoLayer`]; [`ExrError::Unsupported`] for what covers other pixels than the colour, is the colour,
    /// or would be written twice.
    pub fn pick(&self, wanted: &SignalLayers) -> Result<Vec<Picked>, ExrError> {
        let mut found: Vec<Picked> = Vec::new();
        for aov in &wanted.aovs {
            found.extend(self.aov(aov)?);
        }
        if wanted.light_groups {
            let groups: Vec<&Layer> = self.layers.iter().filter(|layer| self.is_group(layer)).collect();
            if groups.is_empty() {
                return Err(self.missing("light group (such as Combined_NAME, RGBA_NAME, Beauty_NAME, C_NAME)".into()));
            }
            let channels = groups.into_iter().filter_map(Layer::rgb);
            found.extend(channels.map(|channels| Picked { kind: SignalKind::Light, channels, group: true }));
        }
        if wanted.alpha {
            let own = self.layers[self.target.layer].channel("A");
            let alpha = own.ok_or_else(|| self.missing("alpha channel in the colour's".into()))?;
            found.push(Picked { kind: SignalKind::Alpha, channels: vec![alpha], group: false });
        }
        let mut once: Vec<Picked> = Vec::new();
        for signal in found {
            match once.iter_mut().find(|other| other.channels == signal.channels) {
                Some(other) => other.group |= signal.group,
                None => once.push(signal),
            }
        }
        self.check(&once)?;
        Ok(once)
    }

    fn check(&self, signals: &[Picked]) -> Result<(), ExrError> {
        let window = |place: &Place| self.container.header(place.part).data_window();
        let of_color = window(&self.picture.channels[0]);
        let mut written: Vec<Place> = self.target.channels.clone();
        for signal in signals {
            let name = || used_layer(self.container, &signal.channels, None).to_string();
            let refuse =
                |what: &str| Err(ExrError::unsupported(&self.container.path, format!("layer {} {what}", name())));
            if signal.channels.iter().any(|place| window(place) != of_color) {
                return refuse("covers other pixels than the colour and cannot be denoised with it");
            }
            if signal.channels.iter().any(|place| self.picture.channels.contains(place)) {
                return refuse("is the colour: it is denoised anyway");
            }
            if signal.channels.iter().any(|place| written.contains(place)) {
                return refuse("would be written twice: it takes the colour's result too, or is asked for in two ways");
            }
            written.extend(&signal.channels);
        }
        Ok(())
    }

    /// Layers of the picture's view.
    fn of_view(&self) -> impl Iterator<Item = &Layer> {
        let own = &self.layers[self.picture.layer];
        self.layers.iter().filter(move |layer| layer.view == own.view)
    }

    fn aov(&self, aov: &AovLayer) -> Result<Vec<Picked>, ExrError> {
        let (name, simple) = (aov.name.as_str(), simplify(&aov.name));
        let group = self.layers[self.picture.layer].group();
        let steps: [&dyn Fn(&Layer) -> bool; 4] = [
            &|l| same(&l.path, name) || same(&l.written, name),
            &|l| part_name(self.container, l.part).is_some_and(|part| same(&part, name)),
            &|l| !simple.is_empty() && l.kind() == simple && l.group() == group,
            &|l| !simple.is_empty() && l.kind() == simple,
        ];
        let fits = steps.into_iter().map(|test| self.of_view().filter(|layer| test(layer)).collect::<Vec<_>>());
        let fits = fits.into_iter().find(|fits| !fits.is_empty()).unwrap_or_default();
        let layer = match fits[..] {
            [] => return self.lone_channel(name).ok_or_else(|| self.missing(format!("'{name}'"))),
            [layer] => layer,
            _ => {
                let (path, wanted) = (self.container.path.clone(), format!("'{name}'"));
                return Err(ExrError::Ambiguous { path, wanted, found: describe(fits.into_iter()) });
            }
        };
        let is_light = || {
            let kind = layer.kind();
            !is_feature(&kind) && !NO_LIGHT.contains(&kind.as_str())
        };
        let told = |usual: SignalKind| aov.kind.unwrap_or(usual);
        if let Some(channels) = layer.rgb() {
            let kind = told(if is_light() { SignalKind::Light } else { SignalKind::Value });
            return Ok(vec![Picked { kind, channels, group: false }]);
        }
        if let Some(channels) = layer.xyz() {
            return Ok(vec![Picked { kind: told(SignalKind::Value), channels, group: false }]);
        }
        if aov.kind == Some(SignalKind::Light) {
            let reason = format!("layer '{name}' has no red, green and blue, and so is no part of the light");
            return Err(ExrError::unsupported(&self.container.path, reason));
        }
        let single =
            |(_, place): &(String, Place)| Picked { kind: SignalKind::Value, channels: vec![*place], group: false };
        Ok(layer.channels.iter().map(single).collect())
    }

    /// A channel that stands among the colour's own, such as Z.
    fn lone_channel(&self, name: &str) -> Option<Vec<Picked>> {
        let bare = self.of_view().filter(|layer| layer.bare);
        let place = bare.filter_map(|layer| layer.channel(name)).next()?;
        Some(vec![Picked { kind: SignalKind::Value, channels: vec![place], group: false }])
    }

    /// Whether a layer is a light group of the picture's own view and view layer.
    fn is_group(&self, layer: &Layer) -> bool {
        let own = &self.layers[self.picture.layer];
        let last = layer.path.rsplit_once('.').map_or(layer.path.as_str(), |(_, last)| last);
        let Some((prefix, name)) = last.split_once('_') else { return false };
        let simple = simplify(name);
        layer.view == own.view
            && layer.group() == own.group()
            && layer.rgb().is_some()
            && GROUP_PREFIXES.contains(&prefix.to_lowercase().as_str())
            && !simple.is_empty()
            && !is_feature(&simple)
            && !says_denoised(&layer.kind())
    }

    fn missing(&self, wanted: String) -> ExrError {
        ExrError::NoLayer { path: self.container.path.clone(), wanted, found: describe(self.layers.iter()) }
    }
}

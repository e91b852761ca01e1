//! Which picture to denoise in each view.

use super::coding::{Coding, luminance_weights};
use super::container::Container;
use super::error::ExrError;
use super::layers::{Layer, Place, describe, part_name, same, simplify};
use super::names::{COLOR, is_feature, place, says_denoised};
use super::views::{Views, unnamed};

/// A picture: the channels of one layer.
#[derive(Clone)]
pub(super) struct Pick {
    /// Its view, by the name that it has in messages; `None` where the file has but one, without a name.
    pub view: Option<String>,
    /// Which of the layers it is.
    pub layer: usize,
    /// Its channels: as many as `coding` has.
    pub channels: Vec<Place>,
    pub coding: Coding,
}

/// The layers of a file, looked through for pictures.
pub(super) struct Chooser<'a> {
    container: &'a Container,
    layers: &'a [Layer],
    luminance: [f32; 3],
}

/// Layers with their numbers.
type Fits<'a> = Vec<(usize, &'a Layer)>;

impl<'a> Chooser<'a> {
    pub fn new(container: &'a Container, layers: &'a [Layer]) -> Self {
        Self { container, layers, luminance: luminance_weights(container) }
    }

    /// Finds the picture of each view, or of the one that is asked for: the layer of the given name, or else by the
    /// usual names.
    ///
    /// A name is, in this order: a layer's full name (`ViewLayer.Combined`, with or without its view), a part's name, a
    /// view layer's name (`ViewLayer`), a view (`right`), or the last section of a layer's name (`Combined`).
    pub fn pictures(&self, layer: Option<&str>, view: Option<&str>) -> Result<Vec<Pick>, ExrError> {
        let fits = match layer {
            Some(name) => self.named(name),
            None => self.usual()?,
        };
        let wanted = layer.map_or("colour".into(), |name| format!("colour '{name}'"));
        if fits.is_empty() {
            return Err(self.missing(layer.map_or("colour (R, G, B or Y)".into(), |_| wanted)));
        }
        let views = self.views(&fits);
        let shown = |view: &Option<String>| view.clone().unwrap_or_else(|| unnamed(&views).into());
        let chosen: Vec<&Option<String>> =
            views.iter().filter(|v| view.is_none_or(|wanted| same(&shown(v), wanted))).collect();
        if chosen.is_empty() {
            let found = views.iter().map(shown).collect::<Vec<_>>().join(", ");
            let wanted = view.unwrap_or_default().into();
            return Err(ExrError::NoView { path: self.container.path.clone(), wanted, found });
        }
        let only = self.layers.iter().all(|layer| layer.view.is_none());
        let of_view = |v: &Option<String>| {
            let fits = fits.iter().filter(|(_, layer)| layer.view == *v).copied().collect();
            let pick = self.best(fits, &wanted)?;
            Ok(Pick { view: (!only).then(|| shown(v)), ..pick })
        };
        chosen.into_iter().map(of_view).collect()
    }

    /// Finds the layer of a picture's view to write a result into; for names as [`Chooser::pictures`] has them.
    pub fn target(&self, picture: &Pick, name: &str) -> Result<Pick, ExrError> {
        let window = |layer: &Layer| self.container.header(layer.part).data_window();
        let source = &self.layers[picture.layer];
        let mut fits = self.named(name);
        fits.retain(|(_, layer)| layer.view == source.view);
        if fits.is_empty() {
            return Err(self.missing(format!("colour '{name}'")));
        }
        let pick = self.best(fits, &format!("'{name}'"))?;
        if window(&self.layers[pick.layer]) != window(source) {
            let reason = format!("layer '{name}' to write into covers other pixels than the colour");
            return Err(ExrError::unsupported(&self.container.path, reason));
        }
        Ok(Pick { view: picture.view.clone(), ..pick })
    }

    /// Layers of the picture's view that have the same picture, raw or denoised already, and whether that is raw.
    pub fn beside(&self, picture: &Pick) -> Vec<(&'a Layer, bool)> {
        let own = &self.layers[picture.layer];
        let (kind, same_place) = (own.kind(), |l: &Layer| l.view == own.view && l.group() == own.group());
        let other = |(at, layer): (usize, &'a Layer)| {
            if at == picture.layer || !same_place(layer) || self.picture(layer).is_none() {
                return None;
            }
            match (kind.as_str(), layer.kind().as_str()) {
                ("noisyimage", "combined") => Some((layer, false)),
                ("combined", "noisyimage") => Some((layer, true)),
                (mine, its) if says_denoised(its) && !says_denoised(mine) => Some((layer, false)),
                _ => None,
            }
        };
        self.layers.iter().enumerate().filter_map(other).collect()
    }

    fn missing(&self, wanted: String) -> ExrError {
        ExrError::NoLayer { path: self.container.path.clone(), wanted, found: describe(self.layers.iter()) }
    }

    /// Refuses a file whose picture is stored in channels of less than full resolution.
    fn check_sampling(&self) -> Result<(), ExrError> {
        let named = |layer: &&Layer| layer.path.is_empty() || place(COLOR, &layer.kind()).is_some();
        let Some(layer) = self.layers.iter().filter(|layer| layer.subsampled).find(named) else { return Ok(()) };
        let of = if layer.written.is_empty() { String::new() } else { format!(" of {}", layer.written) };
        let reason = format!("the colour channels{of} are subsampled (luminance and chroma); write it as R, G, B");
        Err(ExrError::unsupported(&self.container.path, reason))
    }

    /// The views of layers: first those that the file names, in its order.
    fn views(&self, fits: &Fits) -> Vec<Option<String>> {
        let mut views: Vec<Option<String>> =
            Views::of(&self.container.meta).names().iter().cloned().map(Some).collect();
        for (_, layer) in fits {
            if !views.contains(&layer.view) {
                views.push(layer.view.clone());
            }
        }
        views.retain(|view| fits.iter().any(|(_, layer)| layer.view == *view));
        views
    }

    fn picture(&self, layer: &Layer) -> Option<(Vec<Place>, Coding)> {
        layer.picture(self.luminance).or_else(|| layer.some_of_rgb())
    }

    fn filter(&self, test: impl Fn(&Layer) -> bool) -> Fits<'a> {
        let fits = self.layers.iter().enumerate();
        fits.filter(|(_, layer)| self.picture(layer).is_some() && test(layer)).collect()
    }

    /// How good a colour layer is; less is better. None for layers that are something else.
    fn rank(&self, layer: &Layer) -> Option<usize> {
        // A channel or two count only where there is no whole picture.
        let whole = layer.picture(self.luminance).is_some();
        self.picture(layer)?;
        let kind = layer.kind();
        // The first part of a file of parts is its main image, whatever its name.
        let main_part = || (layer.part == 0 && layer.bare && !is_feature(&kind)).then_some(COLOR.len() + 1);
        let named = if layer.path.is_empty() { Some(0) } else { place(COLOR, &kind).map(|at| at + 1) };
        named.or_else(main_part).map(|rank| if whole { rank } else { rank + COLOR.len() + 2 })
    }

    /// Layers that are the colour by their names; without any, what else may be it.
    fn usual(&self) -> Result<Fits<'a>, ExrError> {
        let ranked = self.filter(|layer| self.rank(layer).is_some());
        if !ranked.is_empty() {
            return Ok(ranked);
        }
        self.check_sampling()?;
        let mut others = self.filter(|l| l.rgb().is_some() && !is_feature(&l.kind()) && !says_denoised(&l.kind()));
        // Of layers with any name a picture is the one that has an alpha.
        let alphas = others.iter().filter(|(_, layer)| layer.channel("A").is_some()).count();
        if alphas > 0 {
            others.retain(|(_, layer)| layer.channel("A").is_some());
        }
        Ok(others)
    }

    fn named(&self, name: &str) -> Fits<'a> {
        let simple = simplify(name);
        let steps: [&dyn Fn(&Layer) -> bool; 5] = [
            &|l| same(&l.path, name) || same(&l.written, name),
            &|l| part_name(self.container, l.part).is_some_and(|part| same(&part, name)),
            &|l| same(l.group(), name) && self.rank(l).is_some(),
            &|l| l.view.as_ref().is_some_and(|view| same(view, name)) && self.rank(l).is_some(),
            &|l| !simple.is_empty() && l.kind() == simple,
        ];
        steps.into_iter().map(|test| self.filter(test)).find(|fits| !fits.is_empty()).unwrap_or_default()
    }

    /// The best of several colour layers of a view, or an error that lists those which are equally good, and says why.
    fn best(&self, mut fits: Fits<'a>, wanted: &str) -> Result<Pick, ExrError> {
        let rank = |layer: &Layer| self.rank(layer).unwrap_or(usize::MAX);
        let best = fits.iter().map(|(_, l)| rank(l)).min();
        fits.retain(|(_, l)| Some(rank(l)) == best);
        // Blender's Composite has been through the compositor; the view layers are what the renderer made.
        let composite = |layer: &Layer| simplify(layer.group()) == "composite";
        if fits.iter().any(|(_, l)| !composite(l)) {
            fits.retain(|(_, l)| !composite(l));
        }
        if let [(_, first), _, ..] = fits[..] {
            let names: Vec<String> = fits.iter().map(|(_, l)| self.full_name(l)).collect();
            let kind = first.path.rsplit('.').next().unwrap_or_default();
            let why = match best {
                Some(usize::MAX) | None => "each has a colour's channels, and none a colour's name".into(),
                _ if kind.is_empty() => "each has no other name".into(),
                _ => format!("each is named {kind}"),
            };
            let (path, found) = (self.container.path.clone(), format!("{}; {why}", names.join(", ")));
            return Err(ExrError::Ambiguous { path, wanted: wanted.into(), found });
        }
        let picture = fits.first().and_then(|&(layer, l)| Some((layer, self.picture(l)?)));
        let (layer, (channels, coding)) = picture.ok_or_else(|| self.missing(wanted.into()))?;
        Ok(Pick { view: None, layer, channels, coding })
    }

    fn full_name(&self, layer: &Layer) -> String {
        match part_name(self.container, layer.part) {
            Some(part) if part != layer.written => format!("{} in part {part}", layer.written),
            _ => layer.written.clone(),
        }
    }
}

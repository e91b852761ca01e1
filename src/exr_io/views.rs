//! Views (the eyes of a stereo pair, cameras): whose picture a channel belongs to.
//!
//! A part's `view` attribute says it of all its channels. Else a section of the channel's layer or of the part's name
//! does that is a view: one that the file names in `view` or `multiView`, or `left`, `right` and, after another
//! section, `main`. What is left of a part with `multiView` is the first of these, the default view (OpenEXR's rule,
//! where layers without a view belong to none: a renderer that writes them means the default).

use super::layers::{same, text};
use exr::meta::MetaData;
use exr::meta::header::Header;

/// The views that a file names.
pub(super) struct Views {
    names: Vec<String>,
}

impl Views {
    pub fn of(meta: &MetaData) -> Self {
        let mut names: Vec<String> = Vec::new();
        for header in &meta.headers {
            let attributes = &header.own_attributes;
            let several = attributes.multi_view_names.iter().flatten();
            for name in several.chain(&attributes.view_name).map(text).filter(|name| !name.is_empty()) {
                if !names.iter().any(|known| same(known, &name)) {
                    names.push(name);
                }
            }
        }
        Self { names }
    }

    /// The views that the file names, in its order.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// A name without its view, and that view.
    pub fn split(&self, name: &str) -> (String, Option<String>) {
        let mut sections: Vec<&str> = name.split('.').collect();
        let found = sections.iter().enumerate().rev().find_map(|(at, section)| Some((at, self.view(at, section)?)));
        let Some((at, view)) = found else { return (name.to_owned(), None) };
        sections.remove(at);
        (sections.join("."), Some(view))
    }

    /// The view of a part's channels whose names and whose part's name say none.
    pub fn usual(&self, header: &Header) -> Option<String> {
        let first = header.own_attributes.multi_view_names.as_ref()?.first()?;
        Some(text(first)).filter(|name| !name.is_empty())
    }

    /// The view of all of a part's channels, where it has the attribute.
    pub fn of_part(&self, header: &Header) -> Option<String> {
        let name = text(header.own_attributes.view_name.as_ref()?);
        self.names.iter().find(|known| same(known, &name)).cloned()
    }

    fn view(&self, at: usize, section: &str) -> Option<String> {
        let declared = self.names.iter().find(|name| same(name, section)).cloned();
        let usual = ["left", "right", "main"].into_iter().find(|name| section.eq_ignore_ascii_case(name));
        declared.or_else(|| usual.filter(|name| at > 0 || *name != "main").map(Into::into))
    }
}

/// How a view is called that has no name: as the other eye, where there is one.
pub(super) fn unnamed(others: &[Option<String>]) -> &'static str {
    let has = |eye: &str| others.iter().flatten().any(|name| same(name, eye));
    match (has("left"), has("right")) {
        (false, true) => "left",
        (true, false) => "right",
        _ => "main",
    }
}

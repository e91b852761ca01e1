//! What a lossy compression does to channels that nobody asked to change.

use super::container::Container;
use super::layers::{Place, text};
use exr::meta::attribute::{ChannelDescription, Compression, SampleType};

/// Channels that share their blocks with the given ones and are rounded again when these are written, a note for each
/// part. Parts without any of the given channels are copied as they are.
pub(super) fn rounded_again(container: &Container, written: &[Place]) -> Vec<String> {
    const SHOWN: usize = 8;
    let mut parts: Vec<usize> = written.iter().map(|place| place.part).collect();
    parts.sort_unstable();
    parts.dedup();
    let note = |part: usize| {
        let header = container.header(part);
        let kept = header.channels.list.iter().enumerate();
        let kept = kept.filter(|&(channel, _)| !written.contains(&Place { part, channel }));
        let mut names: Vec<String> =
            kept.filter(|(_, c)| rounds(header.compression, c)).map(|(_, c)| text(&c.name)).collect();
        let more = names.len().saturating_sub(SHOWN);
        names.truncate(SHOWN);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        let codec = header.compression;
        (!names.is_empty()).then(|| {
            format!("{codec} is lossy: {}{more}, in blocks with the colour, are rounded once more", names.join(", "))
        })
    };
    parts.into_iter().filter_map(note).collect()
}

/// Whether a compression rounds a channel. DWA knows by the end of its name what is a picture, and keeps the rest.
fn rounds(compression: Compression, channel: &ChannelDescription) -> bool {
    match compression {
        Compression::DWAA(_) | Compression::DWAB(_) => {
            let name = text(&channel.name);
            let end = name.rsplit('.').next().unwrap_or_default();
            channel.sample_type != SampleType::U32 && ["R", "G", "B", "Y", "RY", "BY"].contains(&end)
        }
        compression => !compression.is_lossless_for(channel.sample_type),
    }
}

//! A small map made large.

use super::accesses::{self, Accesses};
use super::contracts::{self, halves};
use super::pushes::ExpandPush;
use super::{
    Access, Addresses, Footprint, Grid, HALF_TILE, Kernel, KernelTarget, PushBytes, Scale, TexelRange, Tiles, Variant,
    View, by_storage, groups,
};

/// Repeats the middle of a map whose middle is all alike, half tile by half tile; its borders stay at the borders.
#[derive(Clone, Debug, PartialEq)]
pub struct Expand {
    /// The small map.
    pub src: View,
    /// The large one, of as many channels and no smaller on either side.
    pub dst: View,
    /// Tiles of the large map.
    pub tiles: Tiles,
}

impl Expand {
    /// Where position `i` of `size` comes from among `small`. What repeats are the [`HALF_TILE`] positions from `small
    /// / 2` on.
    pub fn source_of(i: u32, size: u32, small: u32) -> u32 {
        let middle = small / 2;
        if i < middle || size == small {
            i
        } else if size - i <= small - middle - HALF_TILE {
            small - (size - i)
        } else {
            middle + (i - middle) % HALF_TILE
        }
    }
}

impl Kernel for Expand {
    fn choose(&self, target: KernelTarget) -> Variant {
        Variant::plain(match target.cpu_with(&self.texels()) {
            true => by_storage(self.dst.storage, &contracts::EXPAND_CPU, &halves::EXPAND_CPU),
            false => by_storage(self.dst.storage, &contracts::EXPAND, &halves::EXPAND),
        })
    }

    fn groups(&self, _: &Variant) -> [u32; 3] {
        groups(self.tiles.count(self.dst.width, self.dst.height), 1)
    }

    fn grid(&self) -> Option<Grid> {
        Some(Grid::of(self.tiles, &self.dst))
    }

    fn tiles_mut(&mut self) -> Option<&mut Tiles> {
        Some(&mut self.tiles)
    }

    fn push(&self, at: &Addresses) -> PushBytes {
        PushBytes::new(&ExpandPush {
            src: at.view(&self.src),
            dst: at.view(&self.dst),
            tiles: at.tiles(&self.tiles),
            src_width: self.src.width,
            src_height: self.src.height,
            width: self.dst.width,
            height: self.dst.height,
            src_stride: self.src.stride / 4,
            dst_stride: self.dst.stride / 4,
            channels: self.dst.channels / 4,
            first_tile: self.tiles.first(),
            tile_count: self.tiles.count(self.dst.width, self.dst.height),
            flags: self.tiles.flags(self.dst.width),
        })
    }

    fn maps(&mut self, visit: &mut dyn FnMut(&mut View, Access)) {
        visit(&mut self.src, Access::Read(Footprint::Whole));
        visit(&mut self.dst, Access::Write(Scale::Same));
    }

    fn texels(&self) -> Vec<TexelRange> {
        vec![(&self.src).into()]
    }

    fn accesses(&self, _: &Variant) -> Option<Accesses> {
        let vectors = u64::from(self.dst.channels / 4);
        Some(Accesses::each(accesses::tokens(&self.tiles, &self.dst), vectors, vectors))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_stay_and_the_middle_repeats() {
        let sources: Vec<_> = (0..32).map(|i| Expand::source_of(i, 32, 16)).collect();
        assert_eq!(sources[..8], [0, 1, 2, 3, 4, 5, 6, 7]);
        assert_eq!(sources[8..28], [8, 9, 10, 11].repeat(5));
        assert_eq!(sources[28..], [12, 13, 14, 15]);
        assert!((0..16).all(|i| Expand::source_of(i, 16, 16) == i));
        assert!((0..8).all(|i| Expand::source_of(i, 8, 8) == i));
    }
}

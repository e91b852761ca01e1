//! How a frame that is too large is cut into tiles that overlap.

use crate::frame::{Extent, Region};

/// The most pixels that tiles may have together, over the frame's, for the sake of wider margins.
const MOST_WORK: f64 = 2.0;
/// Margins that leave a seam nobody sees (`docs/tiles.md`), and what tiles may have for the sake of these.
const ENOUGH: u32 = 256;
const MOST_WORK_FOR_ENOUGH: f64 = 4.0;

/// Tiles of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Tiling {
    /// Size of the frame.
    frame: Extent,
    /// Size of a tile with its margins, multiples of the grain; larger than the frame where one tile is all of it.
    tile: [u32; 2],
    /// What of a tile is another one's, beside each other: pixels, a multiple of the grain.
    pub margin: u32,
    /// Whether the margins leave no seam.
    pub exact: bool,
    grain: u32,
}

/// A tile of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tile {
    /// Its pixels, with the margins.
    pub area: Region,
    /// Those that it gives to the result.
    pub core: Region,
}

impl Tile {
    /// Size with the margins.
    pub fn extent(&self) -> Extent {
        Extent::new(self.area.width, self.area.height)
    }

    /// A rectangle of the frame's that lies in the tile, counted from the tile's first pixel.
    pub fn local(&self, region: Region) -> Region {
        Region { x: region.x - self.area.x, y: region.y - self.area.y, ..region }
    }
}

/// A tile along one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Span {
    first: u32,
    end: u32,
    core: u32,
    core_end: u32,
}

/// Cuts `size` pixels into spans of `tile`.
fn spans(size: u32, tile: u32, margin: u32, grain: u32) -> Vec<Span> {
    let padded = size.next_multiple_of(grain);
    let (mut spans, mut core) = (Vec::new(), 0);
    loop {
        let first = u32::saturating_sub(core, margin);
        if first + tile >= padded {
            // The last one is as large as the others, for their plan.
            let first = padded.saturating_sub(tile).min(first);
            spans.push(Span { first, end: size, core, core_end: size });
            return spans;
        }
        let end = first + tile;
        spans.push(Span { first, end, core, core_end: end - margin });
        core = end - margin;
    }
}

impl Tiling {
    /// Tiles of a size with margins; `exact`: those that leave no seam.
    pub fn new(frame: Extent, tile: [u32; 2], margin: u32, exact: u32, grain: u32) -> Self {
        Self { frame, tile, margin, exact: margin >= exact, grain }
    }

    /// The tiling of least work whose tiles `fits` says yes to; `None` where not even the smallest fits. `exact`: the
    /// margin that leaves no seam; `grain`: what windows are aligned to.
    pub fn choose(frame: Extent, exact: u32, grain: u32, fits: &dyn Fn(Extent) -> bool) -> Option<Self> {
        let [width, height] = [frame.width, frame.height].map(|side| side.next_multiple_of(grain));
        let pixels = most_pixels(width.max(height), grain, fits)?;
        let mut best: Option<(f64, Self)> = None;
        for margin in (1..=exact / grain).rev().map(|grains| grains * grain) {
            for columns in 1..=width / grain {
                let tile_width = columns * grain;
                let rows = (pixels / u64::from(tile_width) / u64::from(grain)).min(u64::from(height / grain)) as u32;
                let tiling = Self::new(frame, [tile_width, rows * grain], margin, exact, grain);
                let Some(work) = tiling.work() else { continue };
                if best.is_none_or(|(least, _)| work < least) {
                    best = Some((work, tiling));
                }
            }
            // A narrower margin than the widest that is not too much work only widens the seam.
            let most = if margin > ENOUGH { MOST_WORK } else { MOST_WORK_FOR_ENOUGH };
            if best.is_some_and(|(work, _)| work <= most * frame.pixels() as f64) {
                break;
            }
        }
        let (_, mut tiling) = best?;
        // Memory is not quite a matter of pixels.
        while !fits(tiling.largest()) {
            let side = usize::from(tiling.tile[1] >= tiling.tile[0]);
            tiling.tile[side] -= grain;
            tiling.work()?;
        }
        Some(tiling)
    }

    /// Pixels of all tiles; `None` where a tile has nothing but margins, or would cut windows elsewhere than the frame
    /// does.
    pub fn work(&self) -> Option<f64> {
        let of = |size: u32, tile: u32| {
            let whole = tile >= size.next_multiple_of(self.grain);
            let aligned = tile >= self.grain && tile.is_multiple_of(self.grain);
            let can = aligned && (whole || tile >= 2 * self.margin + self.grain);
            can.then(|| spans(size, tile, self.margin, self.grain).len() as f64 * f64::from(tile))
        };
        Some(of(self.frame.width, self.tile[0])? * of(self.frame.height, self.tile[1])?)
    }

    /// Size of the largest tile.
    fn largest(&self) -> Extent {
        Extent::new(self.tile[0].min(self.frame.width), self.tile[1].min(self.frame.height))
    }

    /// The tiles, those of a size one after another.
    pub fn tiles(&self) -> Vec<Tile> {
        let columns = spans(self.frame.width, self.tile[0], self.margin, self.grain);
        let rows = spans(self.frame.height, self.tile[1], self.margin, self.grain);
        let tile = |y: &Span, x: &Span| Tile {
            area: Region { x: x.first, y: y.first, width: x.end - x.first, height: y.end - y.first },
            core: Region { x: x.core, y: y.core, width: x.core_end - x.core, height: y.core_end - y.core },
        };
        let mut tiles: Vec<Tile> = rows.iter().flat_map(|y| columns.iter().map(move |x| tile(y, x))).collect();
        tiles.sort_by_key(|tile| (tile.area.width, tile.area.height));
        tiles
    }
}

/// Pixels of the largest tile that fits, whose shape hardly matters.
fn most_pixels(side: u32, grain: u32, fits: &dyn Fn(Extent) -> bool) -> Option<u64> {
    let of = |columns: u32, rows: u32| Extent::new(columns * grain, rows * grain);
    let (mut good, mut bad) = (0, side / grain + 1);
    while bad - good > 1 {
        let middle = good + (bad - good) / 2;
        if fits(of(middle, middle)) { good = middle } else { bad = middle }
    }
    // Squares are coarse where tiles are small.
    let larger: Vec<Extent> = match good < 8 {
        true => (good * good + 1..(good + 1) * (good + 1)).rev().map(|blocks| of(blocks, 1)).collect(),
        false => vec![of(good + 1, good)],
    };
    let larger = larger.into_iter().find(|tile| fits(*tile));
    larger.or((good > 0).then(|| of(good, good))).map(Extent::pixels)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tiles of at most so many pixels.
    fn of(frame: Extent, exact: u32, most: u64) -> Option<Tiling> {
        Tiling::choose(frame, exact, 128, &|extent| extent.pixels() <= most)
    }

    fn check(frame: Extent, tiling: &Tiling, most: u64) {
        let mut covered = 0;
        for Tile { area, core } in tiling.tiles() {
            assert!(u64::from(area.width) * u64::from(area.height) <= most, "{area:?}");
            assert_eq!((area.x % 128, area.y % 128, core.x % 128, core.y % 128), (0, 0, 0, 0));
            let reaches = |first: u32, core: u32| first == 0 || core - first >= tiling.margin;
            let ends = |end: u32, core: u32, size: u32| end == size || end - core >= tiling.margin;
            assert!(reaches(area.x, core.x) && reaches(area.y, core.y), "{area:?} {core:?}");
            assert!(ends(area.right(), core.right(), frame.width), "{area:?} {core:?}");
            assert!(ends(area.bottom(), core.bottom(), frame.height), "{area:?} {core:?}");
            covered += u64::from(core.width) * u64::from(core.height);
        }
        // No two cores meet: each begins where the one before it ends.
        assert_eq!(covered, frame.pixels());
    }

    #[test]
    fn tiles_cover_the_frame_once_with_their_margins() {
        for (width, height) in [(16384, 8192), (5000, 300), (300, 5000), (4097, 4095), (1153, 129), (130, 130)] {
            for most in [1 << 18, 1 << 20, 5_000_000] {
                let frame = Extent::new(width, height);
                let tiling = of(frame, 896, most).unwrap();
                check(frame, &tiling, most);
            }
        }
    }

    #[test]
    fn margins_are_exact_where_that_is_not_too_much_work() {
        let frame = Extent::new(16384, 8192);
        assert!(of(frame, 896, 40_000_000).unwrap().exact);
        for (most, margin) in [(5_000_000, 256), (1 << 21, 256), (1 << 18, 128)] {
            let small = of(frame, 896, most).unwrap();
            assert_eq!((small.exact, small.margin), (false, margin), "{small:?}");
        }
        assert_eq!(of(Extent::new(16384, 8192), 896, 128 * 128 - 1), None);
        // One axis is whole: nothing is lost there.
        let strip = of(Extent::new(65536, 128), 896, 8192 * 128).unwrap();
        assert!(strip.exact && strip.tile == [8192, 128], "{strip:?}");
    }
}

//! `--frames`: which frames of a sequence.

use std::str::FromStr;

/// Frames, by ranges with steps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frames(Vec<Range>);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Range {
    first: u64,
    last: u64,
    step: u64,
}

/// More frames than any shot has: a range of more is a slip.
const MOST: u64 = 1_000_000;

impl Frames {
    /// All of them, in the order in which they were given, each once.
    pub fn numbers(&self) -> impl Iterator<Item = u64> {
        let mut seen = std::collections::HashSet::new();
        let ranges = self.0.clone().into_iter();
        let all = ranges.flat_map(|range| (range.first..=range.last).step_by(range.step as usize));
        all.filter(move |number| seen.insert(*number))
    }

    /// Whether a frame is among them.
    pub fn contains(&self, number: u64) -> bool {
        let within = |range: &Range| range.first <= number && number <= range.last;
        self.0.iter().any(|range| within(range) && (number - range.first).is_multiple_of(range.step))
    }
}

impl FromStr for Frames {
    type Err = String;

    /// `7`, `1-100`, `1-100x2`, `1-10,20,30-40`.
    fn from_str(text: &str) -> Result<Self, String> {
        let range = |part: &str| {
            let (range, step) = part.split_once('x').unwrap_or((part, "1"));
            let (first, last) = range.split_once('-').unwrap_or((range, range));
            let number = |text: &str| text.trim().parse::<u64>().ok();
            let range = Range { first: number(first)?, last: number(last)?, step: number(step)? };
            (range.first <= range.last && (1..=MOST).contains(&range.step)).then_some(range)
        };
        let ranges: Option<Vec<Range>> = text.split(',').map(range).collect();
        let ranges = ranges.ok_or_else(|| "give frames as 7, 1-100, 1-100x2 or 1-10,20-30".to_owned())?;
        let count = |range: &Range| (range.last - range.first) / range.step + 1;
        if ranges.iter().map(count).fold(0, u64::saturating_add) > MOST {
            return Err(format!("these are more than {MOST} frames"));
        }
        Ok(Self(ranges))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_have_steps() {
        let numbers = |text: &str| text.parse::<Frames>().unwrap().numbers().collect::<Vec<_>>();
        assert_eq!(numbers("7"), [7]);
        assert_eq!(numbers("1-9x4"), [1, 5, 9]);
        assert_eq!(numbers("1-10x4"), [1, 5, 9]);
        assert_eq!(numbers("20,1-3,2-4"), [20, 1, 2, 3, 4]);
        let frames: Frames = "1-9x4,20".parse().unwrap();
        assert_eq!((0..30).filter(|n| frames.contains(*n)).collect::<Vec<_>>(), [1, 5, 9, 20]);
        for wrong in ["", "a", "5-1", "1-5x0", "-3", "1-", "1,,2", "1-99999999999", "1-5x99999999999"] {
            assert!(wrong.parse::<Frames>().is_err(), "{wrong}");
        }
    }
}

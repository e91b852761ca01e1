//! Puts buffers whose times do not overlap at the same place.

/// The first and the last group of dispatches that touch a buffer, in each of two lists of which one runs or the other;
/// `None`: none of that list.
pub type Times = [Option<(usize, usize)>; 2];

/// A buffer to place: its size, and when it is touched.
#[derive(Clone, Copy, Debug)]
pub struct Request {
    /// Bytes, at least 1.
    pub bytes: u64,
    /// When.
    pub times: Times,
}

impl Request {
    /// Whether both are there at some time.
    fn meets(&self, other: &Self) -> bool {
        let both = self.times.iter().zip(&other.times).filter_map(|(own, other)| own.zip(*other));
        both.into_iter().any(|(own, other)| own.0 <= other.1 && other.0 <= own.1)
    }
}

/// Where a request went: (block, bytes from its start).
pub type Placement = (usize, u64);

/// Every placement is a multiple of this, enough for any vector load, for a GPU's cache lines and for views of texels.
pub const ALIGNMENT: u64 = 256;

/// How large blocks may be.
#[derive(Clone, Copy, Debug)]
pub enum Limits<'a> {
    /// Any number of them, each of so many bytes at most.
    Each(u64),
    /// These, each of its bytes and of no more than the second.
    Given(&'a [u64], u64),
}

impl Limits<'_> {
    fn of(&self, block: usize) -> Option<u64> {
        match self {
            Self::Each(most) => Some(*most),
            Self::Given(blocks, most) => blocks.get(block).map(|bytes| *bytes.min(most)),
        }
    }

    fn most(&self) -> u64 {
        match self {
            Self::Each(most) => *most,
            Self::Given(blocks, most) => blocks.iter().copied().max().unwrap_or(0).min(*most),
        }
    }
}

/// Places every request in blocks. Largest first, each at the lowest place that is free for its whole time (the
/// greedy-by-size of Pisarchyk and Lee, "Efficient Memory Management for Deep Neural Net Inference", 2020). Returns the
/// placements and the sizes of the blocks.
///
/// In given blocks that are no smaller than those of [`Limits::Each`] with the same most bytes, the placements are
/// those: what did not fit a block then does not fit now, and what did does.
///
/// # Errors
/// The size of a request that fits no block.
pub fn place(requests: &[Request], limits: Limits) -> Result<(Vec<Placement>, Vec<u64>), u64> {
    let mut order: Vec<usize> = (0..requests.len()).collect();
    let first = |i: usize| requests[i].times.iter().flatten().map(|time| time.0).min();
    order.sort_by_key(|&i| (std::cmp::Reverse(requests[i].bytes), first(i), i));
    let mut placements = vec![(0, 0); requests.len()];
    let mut blocks: Vec<u64> = Vec::new();
    let mut placed: Vec<usize> = Vec::new();
    for i in order {
        let request = requests[i];
        if request.bytes > limits.most() {
            return Err(request.bytes);
        }
        let mut block = 0;
        let offset = loop {
            let limit = limits.of(block).ok_or(request.bytes)?;
            let overlapping =
                placed.iter().filter(|&&other| placements[other].0 == block && request.meets(&requests[other]));
            let mut taken: Vec<(u64, u64)> =
                overlapping.map(|&other| (placements[other].1, placements[other].1 + requests[other].bytes)).collect();
            taken.sort_unstable();
            let mut offset = 0u64;
            for (start, end) in taken {
                if offset + request.bytes <= start {
                    break;
                }
                offset = offset.max(end.next_multiple_of(ALIGNMENT));
            }
            if offset + request.bytes <= limit {
                break offset;
            }
            block += 1;
        };
        blocks.resize(blocks.len().max(block + 1), 0);
        blocks[block] = blocks[block].max((offset + request.bytes).next_multiple_of(ALIGNMENT));
        placements[i] = (block, offset);
        placed.push(i);
    }
    Ok((placements, blocks))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(bytes: u64, first: usize, last: usize) -> Request {
        Request { bytes, times: [Some((first, last)), None] }
    }

    fn assert_apart(requests: &[Request], placements: &[Placement]) {
        for (i, a) in requests.iter().enumerate() {
            for (j, b) in requests.iter().enumerate().skip(i + 1) {
                let same_time = a.meets(b);
                let (pa, pb) = (placements[i], placements[j]);
                let same_place = pa.0 == pb.0 && pa.1 < pb.1 + b.bytes && pb.1 < pa.1 + a.bytes;
                assert!(!(same_time && same_place), "{i} at {pa:?} and {j} at {pb:?} overlap");
            }
        }
    }

    #[test]
    fn buffers_of_other_times_share_memory() {
        let requests = [request(1000, 0, 1), request(1000, 2, 3), request(500, 1, 2)];
        let (placements, blocks) = place(&requests, Limits::Each(1 << 20)).unwrap();
        assert_apart(&requests, &placements);
        assert_eq!(placements[0], placements[1]);
        assert_eq!(blocks, [1536]);
    }

    #[test]
    fn what_is_of_one_list_shares_memory_with_what_is_of_the_other() {
        let of_list = |first: Option<(usize, usize)>, second| Request { bytes: 1000, times: [first, second] };
        let requests = [of_list(Some((0, 5)), None), of_list(None, Some((0, 5))), of_list(Some((6, 7)), Some((4, 4)))];
        let (placements, blocks) = place(&requests, Limits::Each(1 << 20)).unwrap();
        assert_apart(&requests, &placements);
        assert_eq!(placements[0], placements[1]);
        assert_ne!(placements[1], placements[2]);
        assert_eq!(blocks, [2048]);
    }

    #[test]
    fn what_does_not_fit_a_block_goes_to_another() {
        let requests = [request(1000, 0, 5), request(1000, 0, 5), request(900, 0, 5)];
        let (placements, blocks) = place(&requests, Limits::Each(2048)).unwrap();
        assert_apart(&requests, &placements);
        assert_eq!(blocks.len(), 2);
        assert!(blocks.iter().all(|b| *b <= 2048));
        assert_eq!(place(&requests, Limits::Each(999)), Err(1000));
    }

    #[test]
    fn random_requests_never_overlap() {
        let mut state = 1u64;
        let mut random = |n: u64| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) % n
        };
        let requests: Vec<_> = (0..200)
            .map(|_| {
                let first = random(50) as usize;
                request(1 + random(5000), first, first + random(8) as usize)
            })
            .collect();
        let (placements, blocks) = place(&requests, Limits::Each(10_000)).unwrap();
        assert_apart(&requests, &placements);
        assert!(blocks.len() > 1);
        // In what it takes it fits again, and so in more, in the same places.
        let more: Vec<u64> = blocks.iter().map(|bytes| bytes + 512).chain([3]).collect();
        for given in [&blocks, &more] {
            assert_eq!(place(&requests, Limits::Given(given, 10_000)), Ok((placements.clone(), blocks.clone())));
        }
        let less = [&blocks[..1], &[0], &blocks[1..]].concat();
        let (apart, _) = place(&requests, Limits::Given(&less, 10_000)).unwrap();
        assert_apart(&requests, &apart);
        assert!(apart.iter().all(|(block, _)| *block != 1));
        assert!(place(&requests, Limits::Given(&blocks[1..], 10_000)).is_err());
        assert!(place(&requests, Limits::Given(&[], 10_000)).is_err());
    }
}

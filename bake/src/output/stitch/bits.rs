//! A set of numbers below a limit that knows how many of its members come before each.

/// A set of texels.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Bits {
    words: Vec<u64>,
    /// Members before each word; empty until [`Bits::count`].
    before: Vec<u32>,
}

impl Bits {
    /// The empty set of numbers below `n`.
    #[must_use]
    pub fn new(n: usize) -> Self {
        Self { words: vec![0; n.div_ceil(64)], before: Vec::new() }
    }

    /// The numbers for which `f` is true.
    #[must_use]
    pub fn of(n: usize, f: impl Fn(usize) -> bool) -> Self {
        let mut bits = Self::new(n);
        for i in (0..n).filter(|&i| f(i)) {
            bits.insert(i);
        }
        bits
    }

    /// Adds a number.
    pub fn insert(&mut self, i: usize) {
        self.words[i / 64] |= 1 << (i % 64);
    }

    /// Whether it holds a number.
    #[must_use]
    pub fn contains(&self, i: usize) -> bool {
        self.words[i / 64] >> (i % 64) & 1 != 0
    }

    /// Counts the members, for [`Bits::rank`]; gives their number.
    pub fn count(&mut self) -> usize {
        self.before.clear();
        let mut sum = 0;
        for word in &self.words {
            self.before.push(sum);
            sum += word.count_ones();
        }
        sum as usize
    }

    /// Members below `i`, as [`Bits::count`] found them.
    #[must_use]
    pub fn rank(&self, i: usize) -> u32 {
        let below = self.words[i / 64] & ((1 << (i % 64)) - 1);
        self.before[i / 64] + below.count_ones()
    }

    /// All members, ascending.
    pub fn members(&self) -> impl Iterator<Item = usize> {
        self.words.iter().enumerate().flat_map(|(i, &word)| {
            let mut rest = word;
            std::iter::from_fn(move || {
                let bit = rest.trailing_zeros() as usize;
                (rest != 0).then(|| {
                    rest &= rest - 1;
                    64 * i + bit
                })
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_count_members() {
        let mut bits = Bits::of(300, |i| i % 7 == 3 || i == 64 || i == 299);
        let members: Vec<usize> = bits.members().collect();
        assert_eq!(bits.count(), members.len());
        for (rank, &m) in (0..).zip(&members) {
            assert!(bits.contains(m));
            assert_eq!(bits.rank(m), rank);
        }
        assert!(!bits.contains(0) && !bits.contains(65));
        assert!(members.is_sorted() && members.contains(&64) && members.contains(&299));
    }
}

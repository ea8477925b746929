//! Owen-scrambled Sobol points, padded in sets of four dimensions.
//!
//! \[Bur20\] Burley, "Practical Hash-based Owen Scrambling", JCGT 9(4), 2020; the points themselves
//! come from the crate `sobol_burley`.

/// Sets of four dimensions that are drawn from the Sobol sequence. Deeper ones are plain hashes:
/// a path's far end gains nothing from stratification that its near end has not already lost.
const SOBOL_SETS: u32 = 16;

/// Longest run of `sobol_burley`; beyond it a new scramble starts.
const RUN: u32 = 1 << 16;

/// 64-bit finaliser: the output function of `SplitMix64` (\[SLF14\] Steele, Lea & Flood, "Fast
/// Splittable Pseudorandom Number Generators", 2014, with Stafford's constants, variant 13).
#[must_use]
pub const fn mix64(mut x: u64) -> u64 {
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Key of one texel or point within a domain (a page, or a set of points). Sequences drawn with
/// different keys have different scrambles, but for one pair in 2^32.
#[must_use]
pub const fn key(seed: u64, domain: u64, index: u64) -> u64 {
    mix64(mix64(mix64(seed ^ 0x9e37_79b9_7f4a_7c15).wrapping_add(domain)).wrapping_add(index))
}

/// The numbers of one sample: call [`Sequence::next4`] once for each set of four dimensions.
#[derive(Clone, Debug)]
pub struct Sequence {
    seed: u32,
    index: u32,
    set: u32,
}

impl Sequence {
    /// Sample number `index` of the sequence that belongs to `key` (see [`key`]).
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "hash bits are cut to 32 on purpose")]
    pub const fn new(key: u64, index: u32) -> Self {
        let run = (index / RUN) as u64;
        let key = if run == 0 { key } else { mix64(key.wrapping_add(run)) };
        Self { seed: (key ^ (key >> 32)) as u32, index: index % RUN, set: 0 }
    }

    /// Number of the sample, within a run of 65,536.
    #[must_use]
    pub const fn index(&self) -> u32 {
        self.index
    }

    /// Numbers for something else that belongs to the same sample: independent of these, and stratified over
    /// samples as they are.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "hash bits are cut to 32 on purpose")]
    pub const fn fork(&self) -> Self {
        Self { seed: mix64(self.seed as u64 ^ 0x666f_726b) as u32, index: self.index, set: 0 }
    }

    /// A number in [0, 1) that is cheap and not stratified: for decisions that few samples take. It belongs to the dimensions
    /// that [`Sequence::next4`] gives next.
    #[must_use]
    pub fn coin(&self) -> f32 {
        let place = u64::from(self.seed) << 32 | u64::from(self.index);
        unit(mix64(place ^ (u64::from(self.set) + 1).wrapping_mul(0xa076_1d64_78bd_642f)) >> 40)
    }

    /// Four numbers as cheap as [`Sequence::coin`], others for each `purpose` (which [`Sequence::coin`] counts as 0).
    #[must_use]
    pub fn coins(&self, purpose: u32) -> [f32; 4] {
        let place = u64::from(self.seed) << 32 | u64::from(self.index);
        let set = (u64::from(self.set) + 1).wrapping_mul(0xa076_1d64_78bd_642f);
        let h = mix64(place ^ set ^ u64::from(purpose).wrapping_mul(0xe703_7ed1_a0b4_28db));
        let g = mix64(h ^ 0xd1b5_4a32_d192_ed03);
        [unit(h >> 40), unit((h >> 8) & 0xff_ffff), unit(g >> 40), unit((g >> 8) & 0xff_ffff)]
    }

    /// The sample without stratification from its first number on: cheaper, for paths that others stand in for.
    #[must_use]
    pub const fn hashed(key: u64, index: u32) -> Self {
        Self { set: SOBOL_SETS, ..Self::new(key, index) }
    }

    /// The next four dimensions, each uniform in [0, 1).
    pub fn next4(&mut self) -> [f32; 4] {
        let set = self.set;
        self.set += 1;
        if set < SOBOL_SETS {
            return sobol_burley::sample_4d(self.index, set, self.seed);
        }
        let h = key(u64::from(self.seed), u64::from(self.index), u64::from(set));
        let g = mix64(h ^ 0xd1b5_4a32_d192_ed03);
        [unit(h >> 40), unit((h >> 8) & 0xff_ffff), unit(g >> 40), unit((g >> 8) & 0xff_ffff)]
    }
}

/// Maps 24 bits to [0, 1); they are exact in f32.
fn unit(bits: u64) -> f32 {
    bits as f32 * (1.0 / 16_777_216.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_arguments_give_the_same_numbers() {
        let draw = |k, i| {
            let mut s = Sequence::new(k, i);
            (0..20).map(|_| s.next4()).collect::<Vec<_>>()
        };
        assert_eq!(draw(key(1, 2, 3), 7), draw(key(1, 2, 3), 7));
        assert_ne!(draw(key(1, 2, 3), 7), draw(key(1, 2, 4), 7));
        assert_ne!(draw(key(1, 2, 3), 7), draw(key(1, 2, 3), 7 + RUN));
    }

    /// The first values are a promise: a change of these changes every bake.
    #[test]
    fn first_values_are_pinned() {
        let mut s = Sequence::new(key(0, 0, 0), 0);
        let first = s.next4();
        let mut s = Sequence::new(key(0, 0, 0), 1);
        for _ in 0..SOBOL_SETS {
            s.next4();
        }
        let hashed = s.next4();
        assert_eq!(format!("{first:?}"), "[0.6200899, 0.79239047, 0.97297704, 0.40852046]");
        assert_eq!(format!("{hashed:?}"), "[0.32282686, 0.5191215, 0.9601553, 0.97212684]");
    }

    /// Kolmogorov-Smirnov at alpha = 0.001 over 4096 samples, every dimension of 20 sets.
    #[test]
    fn every_dimension_is_uniform() {
        let n = 4096;
        for set in 0..20 {
            for dim in 0..4 {
                let mut xs: Vec<f64> = (0..n)
                    .map(|i| {
                        let mut s = Sequence::new(key(5, 6, 7), i);
                        for _ in 0..set {
                            s.next4();
                        }
                        f64::from(s.next4()[dim])
                    })
                    .collect();
                xs.sort_by(f64::total_cmp);
                let n = f64::from(n);
                let worst = xs.iter().enumerate().fold(0.0f64, |w, (i, &x)| {
                    w.max((x - i as f64 / n).abs()).max(((i + 1) as f64 / n - x).abs())
                });
                assert!(worst < 1.95 / n.sqrt(), "set {set} dimension {dim}: {worst}");
            }
        }
    }
}

//! Blocks of BC6H, unsigned: 4 x 4 colours from 0 to 65504 in 16 bytes (Khronos Data Format Specification 1.3, section 20.1).
//!
//! Colours are the bits of half floats, which are about logarithms: a block keeps differences in proportion to its light. The encoder is that of the
//! crate `block_compression`, Intel's in Rust, whose bytes are the same on every machine; `bcdec_rs` decodes and shares nothing with it. Its presets: `very_fast` looks
//! for one line through the colours of a block, `fast` for one in each of two groups as well. That takes ten times as long, so it is done where one line is off by more than
//! 16 steps of half floats, 1 to 1.6 % of the light: most blocks of a noisy map, a sixth of those of a smooth one.
//!
//! Measured on a page of the hall, 1868 x 1708 texels with 16 paths each, as it is and smoothed: root mean squared difference of logarithms of luminance over covered texels,
//! and seconds of processor time. `very_fast` alone 0.0463 and 0.0139 in 0.3 s; `fast` for all 0.0396 and 0.0088 in 2.5 s; `fast` where it helps the same within 1 %, in 2.5 and 0.8 s. Leaving
//! out texels that nothing reads brings 0.0380 and 0.0069. Intel's own library (`intel_tex_2`) with more effort, `basic`: 0.0386 and 0.0078, but it does not link everywhere and depends
//! on the processor. `basisu`, faster than all: 0.0337 and 0.0128, but most texels of smooth walls are off by 4 to 16 steps in place of less than 4. `rusty_dds`: 0.0451 and 0.0122.

use block_compression::encode::compress_rgba16;
use block_compression::{BC6HSettings, CompressionVariant};
use half::f16;

/// Bits of 65504, the greatest half float.
pub const GREATEST: u16 = 0x7bff;

/// Texels along both sides of a block.
pub const SIDE: usize = 4;

/// Bytes of a block.
pub const BYTES: usize = 16;

/// Root mean squared difference that is good enough, in steps of half floats: 1 to 1.6 % of the light.
const FINE: f64 = 16.0;

/// By how much colours of a block of one colour may be off, in steps of half floats.
const SOLID_STEPS: f64 = 2.0;

/// Texels of a block, row by row, and which of them matter.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Bits of half floats, at most [`GREATEST`].
    pub texels: [[u16; 3]; SIDE * SIDE],
    /// Texels that nothing reads are whatever makes the others better.
    pub needed: [bool; SIDE * SIDE],
}

impl Block {
    /// The block's bytes. Their error is never greater than that of the colours' mean.
    #[must_use]
    pub fn encode(&self) -> [u8; BYTES] {
        let Some(mean) = self.mean() else {
            return encode(&[[0; 3]; SIDE * SIDE], BC6HSettings::very_fast());
        };
        let texels = std::array::from_fn(|i| if self.needed[i] { self.texels[i] } else { mean });
        let mut best = self.judged(encode(&texels, BC6HSettings::very_fast()));
        let fine = FINE * FINE * 3.0 * self.count() as f64;
        if fine < best.0 {
            let other = self.judged(encode(&texels, BC6HSettings::fast()));
            best = if other.0 < best.0 { other } else { best };
        }
        // Encoders look for lines through colours; where there is no good one, as in pure red beside green and blue, it can be worse than none.
        if best.0 <= self.squares(&[mean; SIDE * SIDE]) {
            best.1
        } else {
            encode(&[mean; SIDE * SIDE], BC6HSettings::very_fast())
        }
    }

    /// Whether decoded colours are as good as those of a correct encoder: no worse than the mean colour, apart from its rounding.
    #[must_use]
    pub fn is_met_by(&self, decoded: &[[u16; 3]; SIDE * SIDE]) -> bool {
        let Some(mean) = self.mean() else { return true };
        let n = 3.0 * self.count() as f64;
        self.squares(decoded).sqrt() <= self.squares(&[mean; SIDE * SIDE]).sqrt() + SOLID_STEPS * n.sqrt()
    }

    fn count(&self) -> usize {
        self.needed.iter().filter(|n| **n).count()
    }

    fn judged(&self, bytes: [u8; BYTES]) -> (f64, [u8; BYTES]) {
        (self.squares(&decode(&bytes)), bytes)
    }

    /// Mean of the colours that matter, if any does.
    fn mean(&self) -> Option<[u16; 3]> {
        let n = u32::try_from(self.count()).ok().filter(|n| 0 < *n)?;
        let sum = |c: usize| {
            self.texels.iter().zip(self.needed).filter(|(_, n)| *n).map(|(t, _)| u32::from(t[c])).sum::<u32>()
        };
        // A mean of numbers of 16 bits has no more.
        Some([0, 1, 2].map(|c| u16::try_from((sum(c) + n / 2) / n).unwrap_or(GREATEST)))
    }

    /// Sum of squared differences of the texels that matter, in steps of half floats.
    fn squares(&self, other: &[[u16; 3]; SIDE * SIDE]) -> f64 {
        let square = |(a, b): (&u16, &u16)| {
            let d = f64::from(*a) - f64::from(*b);
            d * d
        };
        let texels = self.texels.iter().zip(other).zip(self.needed).filter(|(_, needed)| *needed);
        texels.flat_map(|((a, b), _)| a.iter().zip(b).map(square)).sum()
    }
}

fn encode(texels: &[[u16; 3]; SIDE * SIDE], settings: BC6HSettings) -> [u8; BYTES] {
    let side = u32::try_from(SIDE).unwrap_or(0);
    let mut pixels = [f16::ZERO; 4 * SIDE * SIDE];
    for (to, texel) in pixels.chunks_exact_mut(4).zip(texels) {
        to[..3].copy_from_slice(&texel.map(f16::from_bits));
    }
    let mut bytes = [0; BYTES];
    compress_rgba16(CompressionVariant::BC6H(settings), &pixels, &mut bytes, side, side, 4 * side);
    bytes
}

/// Colours of a block, row by row.
#[must_use]
pub fn decode(bytes: &[u8; BYTES]) -> [[u16; 3]; SIDE * SIDE] {
    let mut out = [[0; 3]; SIDE * SIDE];
    bcdec_rs::bc6h_half(bytes, out.as_flattened_mut(), 3 * SIDE, false);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers that look like chance.
    struct Chance(u64);

    impl Chance {
        fn below(&mut self, n: u16) -> u16 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            u16::try_from((self.0 >> 33) % u64::from(n)).expect("below a number of 16 bits")
        }
    }

    const ALL: [bool; 16] = [true; 16];

    #[test]
    fn one_colour_is_kept() {
        let mut chance = Chance(1);
        let colours = [0, 1, 0x3c00, GREATEST].map(|c| [c, 0, GREATEST]).into_iter();
        let random = (0..2000).map(|_| [0; 3].map(|_: u16| chance.below(GREATEST + 1)));
        for colour in colours.chain(random.collect::<Vec<_>>()) {
            let block = Block { texels: [colour; 16], needed: ALL };
            for back in decode(&block.encode()) {
                for (a, b) in colour.iter().zip(back) {
                    assert!(f64::from(a.abs_diff(b)) <= SOLID_STEPS, "{colour:?} {back:?}");
                }
            }
        }
    }

    /// A block has 16 steps along its line.
    #[test]
    fn gradients_are_kept() {
        for (low, high) in [(0.01f32, 0.0101), (0.01, 0.011), (1.0, 1.3), (20.0, 40.0), (3e4, 6e4)] {
            let value = |i: usize| low + (high - low) * i as f32 / 15.0;
            let texels =
                std::array::from_fn(|i| [1.0, 0.8, 0.5].map(|c| f16::from_f32(c * value(i)).to_bits()));
            let back = decode(&Block { texels, needed: ALL }.encode());
            let mut worst = 0.0f32;
            for (i, t) in back.iter().enumerate() {
                for (c, b) in [1.0, 0.8, 0.5].iter().zip(t) {
                    let wanted = c * value(i);
                    worst = worst.max((f16::from_bits(*b).to_f32() - wanted).abs() / wanted);
                }
            }
            // Half of a step of the ramp, twice that where channels pass powers of 2 at different places, and rounding.
            assert!(worst < 0.003 + 0.06 * (high / low - 1.0), "{low} to {high}: {worst}");
        }
    }

    /// Blocks of every kind that hurts: noise, two and three pure colours, single bright texels, with texels that do not matter.
    #[test]
    fn no_block_is_worse_than_its_mean() {
        let mut chance = Chance(7);
        for round in 0..20_000u16 {
            let base = [0; 3].map(|_: u16| chance.below(GREATEST + 1));
            let spread = 1 << chance.below(15);
            let mut texel = |i: usize| match round % 5 {
                0 => [0; 3].map(|_: u16| chance.below(GREATEST + 1)),
                1 => base.map(|b| (b + chance.below(spread)).min(GREATEST)),
                2 => std::array::from_fn(|c| if i % 3 == c { base[c] } else { 0 }),
                3 => base.map(|b| if chance.below(16) == 0 { GREATEST } else { b / 2 }),
                _ => base.map(|b| if i % 4 < 2 { b } else { b / 3 + chance.below(40) }),
            };
            let texels = std::array::from_fn(&mut texel);
            let needed = std::array::from_fn(|_| round % 2 == 0 || chance.below(2) == 0);
            let block = Block { texels, needed };
            let decoded = decode(&block.encode());
            assert!(block.is_met_by(&decoded), "{round}: {block:?} {decoded:?}");
            assert!(decoded.iter().flatten().all(|v| *v <= GREATEST), "{round}: no infinity, no NaN");
        }
    }

    #[test]
    fn wrong_colours_are_noticed() {
        let texels = std::array::from_fn(|i| [0x3c00 + u16::try_from(i).expect("small") * 8; 3]);
        let block = Block { texels, needed: ALL };
        let bytes = block.encode();
        assert!(block.is_met_by(&decode(&bytes)));
        let other = Block { texels: block.texels.map(|t| t.map(|v| v + 200)), needed: ALL };
        assert!(!block.is_met_by(&decode(&other.encode())));
        // Most single bits matter.
        let noticed = |bit: usize| {
            let mut bad = bytes;
            bad[bit / 8] ^= 1 << (bit % 8);
            !block.is_met_by(&decode(&bad))
        };
        assert!(16 < (0..128).filter(|bit| noticed(*bit)).count());
    }

    #[test]
    fn texels_that_do_not_matter_take_nothing_from_the_others() {
        let texels = std::array::from_fn(|i| {
            if i % 4 < 2 { [0x4000 + u16::try_from(i).expect("small"); 3] } else { [0; 3] }
        });
        let edge = Block { texels, needed: std::array::from_fn(|i| i % 4 < 2) };
        let of = |block: &Block| edge.squares(&decode(&block.encode())).sqrt();
        let (cut, whole) = (of(&edge), of(&Block { needed: ALL, ..edge.clone() }));
        assert!(cut <= 12.0 && cut < whole, "{cut} {whole}");
        assert_eq!(decode(&Block { needed: [false; 16], ..edge }.encode()), [[0; 3]; 16]);
    }
}

//! RGB9E5: three mantissas of 9 bits and an exponent in 32 bits, which graphics cards filter.
//!
//! The format is that of `EXT_texture_shared_exponent` (Khronos): value = mantissa * 2^(exponent - 24).

/// Largest value, (511/512) * 2^16.
const MAX: f32 = 65408.0;
/// Bits of a mantissa.
const BITS: u32 = 9;
/// What is added to an exponent.
const BIAS: i32 = 15;

/// Packs a colour: red in the low bits. Negative values and NaN become 0, too large ones the largest.
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "mantissas and exponents are small"
)]
pub(super) fn pack(color: [f32; 3]) -> u32 {
    let color = color.map(|c| c.clamp(0.0, MAX)).map(|c| if c.is_nan() { 0.0 } else { c });
    let most = color[0].max(color[1]).max(color[2]);
    // Of numbers below the smallest normal one nothing is left in this format.
    let power = (most.to_bits() >> 23) as i32 - 127;
    let mut exponent = power.max(-BIAS - 1) + 1 + BIAS;
    let step = |exponent: i32| 2.0_f32.powi(exponent - BIAS - BITS as i32);
    if ((most / step(exponent)).round() as u32) == 1 << BITS {
        exponent += 1;
    }
    let [r, g, b] = color.map(|c| (c / step(exponent)).round() as u32);
    r | g << BITS | b << (2 * BITS) | (exponent as u32) << (3 * BITS)
}

/// Words as planes of bytes that deflate well: differences, from texel to texel, of green, of red less green, of
/// blue less green, modulo 512, and a last plane with their ninth bits and the difference of the exponent.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "each value is masked to its bits")]
pub(super) fn planes(words: &[u32]) -> Vec<u8> {
    let n = words.len();
    let mut out = vec![0; 4 * n];
    let mut last = [0_u32; 4];
    for (i, word) in words.iter().enumerate() {
        let part = |k: u32| word >> (BITS * k) & 511;
        let values = [part(1), part(0).wrapping_sub(part(1)), part(2).wrapping_sub(part(1)), part(3)];
        let [g, r, b, e] = [0, 1, 2, 3].map(|k| values[k].wrapping_sub(last[k]) & 511);
        [out[i], out[n + i], out[2 * n + i]] = [g, r, b].map(|v| v as u8);
        out[3 * n + i] = (g >> 8 | r >> 8 << 1 | b >> 8 << 2 | (e & 31) << 3) as u8;
        last = values;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unpack(word: u32) -> [f32; 3] {
        let step = 2.0_f32.powi((word >> 27).cast_signed() - 24);
        [0, 9, 18].map(|k| (word >> k & 511) as f32 * step)
    }

    #[test]
    fn colours_are_within_a_thousandth_of_the_greatest_channel() {
        for k in 0..4000_u16 {
            let x = 1e-3 * 1.0043_f32.powi(i32::from(k));
            let color = [x, 0.37 * x, 0.011 * x];
            let got = unpack(pack(color));
            for (g, w) in got.into_iter().zip(color) {
                let w = w.min(MAX);
                assert!((g - w).abs() <= x.min(MAX) / 511.0 / 2.0 * 1.001 + 1e-12, "{got:?} of {color:?}");
            }
        }
        assert_eq!(unpack(pack([f32::NAN, -1.0, f32::INFINITY])), [0.0, 0.0, MAX]);
        assert_eq!(unpack(pack([0.0; 3])), [0.0; 3]);
        assert_eq!(unpack(pack([1.0, 0.5, 0.25])), [1.0, 0.5, 0.25]);
        // All but the next power of two is that.
        assert_eq!(unpack(pack([0.999_99; 3])), [1.0; 3]);
    }

    #[test]
    fn planes_hold_every_bit() {
        let words: Vec<u32> = (0..999_u32).map(|i| i.wrapping_mul(2_654_435_761)).collect();
        let planes = planes(&words);
        let n = words.len();
        let mut last = [0_u32; 4];
        for (i, &want) in words.iter().enumerate() {
            let byte = |k: usize| u32::from(planes[k * n + i]);
            let top = byte(3);
            let step = [
                byte(0) + ((top & 1) << 8),
                byte(1) + ((top & 2) << 7),
                byte(2) + ((top & 4) << 6),
                top >> 3,
            ];
            last = [0, 1, 2, 3].map(|k| (last[k] + step[k]) & if k == 3 { 31 } else { 511 });
            let [g, r, b, e] = last;
            assert_eq!(((r + g) & 511) | g << 9 | ((b + g) & 511) << 18 | e << 27, want);
        }
    }
}

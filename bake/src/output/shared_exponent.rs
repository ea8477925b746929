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
    let power = (most.to_bits() >> 23).cast_signed() - 127;
    let mut exponent = power.max(-BIAS - 1) + 1 + BIAS;
    let step = |exponent: i32| 2.0_f32.powi(exponent - BIAS - BITS as i32);
    if ((most / step(exponent)).round() as u32) == 1 << BITS {
        exponent += 1;
    }
    let [r, g, b] = color.map(|c| (c / step(exponent)).round() as u32);
    r | g << BITS | b << (2 * BITS) | (exponent as u32) << (3 * BITS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unpack(word: u32) -> [f32; 3] {
        let step = 2.0_f32.powi((word >> 27).cast_signed() - 24);
        [0, 9, 18].map(|k| (word >> k & 511) as f32 * step)
    }

    #[test]
    fn colours_are_within_a_512th_of_the_greatest_channel() {
        for k in 0..4000_u16 {
            let x = 1e-3 * 1.0043_f32.powi(i32::from(k));
            let color = [x, 0.37 * x, 0.011 * x];
            let got = unpack(pack(color));
            for (g, w) in got.into_iter().zip(color) {
                let w = w.min(MAX);
                assert!((g - w).abs() <= x.min(MAX) / 512.0 * 1.001, "{got:?} of {color:?}");
            }
        }
        assert_eq!(unpack(pack([f32::NAN, -1.0, f32::INFINITY])), [0.0, 0.0, MAX]);
        assert_eq!(unpack(pack([0.0; 3])), [0.0; 3]);
        assert_eq!(unpack(pack([1.0, 0.5, 0.25])), [1.0, 0.5, 0.25]);
        // All but the next power of two is that.
        assert_eq!(unpack(pack([0.999_99; 3])), [1.0; 3]);
    }
}

//! Looking up textures.

use crate::scene::model::{Image, Scene, TextureRef, Wrap};
use glam::{Vec2, Vec4};
use std::sync::LazyLock;

/// sRGB byte to linear, IEC 61966-2-1.
static SRGB_TO_LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let c = i as f64 / 255.0;
        let linear = if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the result")]
        let linear = linear as f32;
        linear
    })
});

impl Image {
    /// A texel with linear colour (decoded from sRGB) and alpha.
    #[must_use]
    pub fn linear(&self, x: u32, y: u32) -> Vec4 {
        let [r, g, b, a] = self.pixels[y as usize * self.width as usize + x as usize];
        let t = &*SRGB_TO_LINEAR;
        Vec4::new(t[r as usize], t[g as usize], t[b as usize], f32::from(a) / 255.0)
    }

    /// A texel as it is stored, 0..=1.
    #[must_use]
    pub fn raw(&self, x: u32, y: u32) -> Vec4 {
        Vec4::from(self.pixels[y as usize * self.width as usize + x as usize].map(f32::from)) / 255.0
    }
}

impl TextureRef {
    /// Colour decoded from sRGB, with alpha, at the texture coordinates of the mesh.
    #[must_use]
    pub fn color(&self, scene: &Scene, uv: Vec2) -> Vec4 {
        self.filter(&scene.images[self.image], uv, Image::linear)
    }

    /// Data channels, not decoded.
    #[must_use]
    pub fn data(&self, scene: &Scene, uv: Vec2) -> Vec4 {
        self.filter(&scene.images[self.image], uv, Image::raw)
    }

    #[expect(clippy::cast_possible_truncation, reason = "floored coordinates are bounded by the wrap")]
    fn filter(&self, image: &Image, uv: Vec2, texel: fn(&Image, u32, u32) -> Vec4) -> Vec4 {
        let h = uv.extend(1.0);
        let p = Vec2::new(self.transform[0].dot(h), self.transform[1].dot(h));
        let (w, h) = (image.width, image.height);
        if !(p * Vec2::new(w as f32, h as f32)).is_finite() || image.pixels.is_empty() {
            return Vec4::ONE;
        }
        if self.nearest {
            let x = wrap((p.x * w as f32).floor() as i64, w, self.wrap[0]);
            let y = wrap((p.y * h as f32).floor() as i64, h, self.wrap[1]);
            return texel(image, x, y);
        }
        let (fx, fy) = (p.x * w as f32 - 0.5, p.y * h as f32 - 0.5);
        let (x0, y0) = (fx.floor(), fy.floor());
        let (ax, ay) = (fx - x0, fy - y0);
        let xs = [0, 1].map(|k| wrap((x0 as i64).saturating_add(k), w, self.wrap[0]));
        let ys = [0, 1].map(|k| wrap((y0 as i64).saturating_add(k), h, self.wrap[1]));
        let row = |y| texel(image, xs[0], y) * (1.0 - ax) + texel(image, xs[1], y) * ax;
        row(ys[0]) * (1.0 - ay) + row(ys[1]) * ay
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the result lies in 0..n")]
fn wrap(i: i64, n: u32, mode: Wrap) -> u32 {
    let m = i64::from(n);
    (match mode {
        Wrap::Repeat => i.rem_euclid(m),
        Wrap::Clamp => i.clamp(0, m - 1),
        Wrap::Mirror => {
            let k = i.rem_euclid(2 * m);
            if k < m { k } else { 2 * m - 1 - k }
        }
    }) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn scene() -> Scene {
        let pixels = vec![[0, 0, 0, 255], [255, 0, 0, 255], [0, 255, 0, 0], [188, 188, 188, 255]];
        let image = Image { name: String::new(), width: 2, height: 2, pixels, source: None };
        Scene { images: vec![image], ..Scene::default() }
    }

    fn texture(wrap: Wrap, nearest: bool) -> TextureRef {
        TextureRef { image: 0, uv_set: 0, transform: [Vec3::X, Vec3::Y], wrap: [wrap; 2], nearest }
    }

    /// Coordinates beyond any sense still name a colour of the image or none.
    #[test]
    fn far_coordinates_give_a_colour() {
        let s = scene();
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            for nearest in [false, true] {
                for x in [1e19, -1e19, f32::MAX, f32::MIN, 1e10, f32::INFINITY, f32::NAN] {
                    let c = texture(wrap, nearest).color(&s, Vec2::new(x, 0.25));
                    assert!(c.cmpge(Vec4::ZERO).all() && c.cmple(Vec4::ONE).all(), "{x}: {c}");
                }
            }
        }
    }

    #[test]
    fn texel_centres_are_exact_and_between_them_is_linear() {
        let s = scene();
        let t = texture(Wrap::Repeat, false);
        assert_eq!(t.color(&s, Vec2::new(0.75, 0.25)), Vec4::new(1.0, 0.0, 0.0, 1.0));
        assert_eq!(t.color(&s, Vec2::new(0.5, 0.25)), Vec4::new(0.5, 0.0, 0.0, 1.0));
        // sRGB 188 is half of linear white to a byte's precision.
        assert!((t.color(&s, Vec2::new(0.75, 0.75)).x - 0.5).abs() < 0.003);
        // Repeat blends the last column with the first one.
        assert_eq!(t.color(&s, Vec2::new(0.0, 0.25)).x, 0.5);
        assert_eq!(texture(Wrap::Clamp, false).color(&s, Vec2::new(0.0, 0.25)).x, 0.0);
    }

    #[test]
    fn wraps_far_outside() {
        let s = scene();
        for k in [-7.0, 3.0, 1e6] {
            assert_eq!(texture(Wrap::Repeat, true).color(&s, Vec2::new(0.75 + k, 0.25)).x, 1.0);
        }
        assert_eq!(texture(Wrap::Mirror, true).color(&s, Vec2::new(1.25, 0.25)).x, 1.0);
        assert_eq!(texture(Wrap::Mirror, true).color(&s, Vec2::new(-0.25, 0.25)).x, 0.0);
        assert!(texture(Wrap::Clamp, true).color(&s, Vec2::new(9e9, 0.25)).x == 1.0);
        assert!(texture(Wrap::Repeat, false).color(&s, Vec2::new(f32::NAN, 0.25)).is_finite());
    }
}

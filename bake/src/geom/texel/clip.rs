//! Convex polygons of few corners, clipped in f64.

use glam::DVec2;

/// Most corners a triangle has after clipping by four half-planes.
pub(crate) const CORNERS: usize = 7;

/// A convex polygon; fewer than three corners is the empty one.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Polygon {
    corners: [DVec2; CORNERS],
    len: usize,
}

impl Polygon {
    const EMPTY: Self = Self { corners: [DVec2::ZERO; CORNERS], len: 0 };

    /// The triangle itself.
    pub(crate) fn triangle(t: &[DVec2; 3]) -> Self {
        let mut p = Self::EMPTY;
        t.iter().for_each(|&c| p.push(c));
        p
    }

    fn push(&mut self, p: DVec2) {
        // Rounding can make a clipped polygon very slightly concave; a corner beyond the seventh
        // then lies on an edge already there.
        if self.len < CORNERS {
            self.corners[self.len] = p;
            self.len += 1;
        }
    }

    /// The corners, in the winding of the triangle.
    pub(crate) fn corners(&self) -> &[DVec2] {
        &self.corners[..self.len]
    }

    /// Signed area.
    pub(crate) fn area(&self) -> f64 {
        let c = self.corners();
        if c.len() < 3 {
            return 0.0;
        }
        c[1..].windows(2).map(|w| (w[0] - c[0]).perp_dot(w[1] - c[0])).sum::<f64>() * 0.5
    }
}

/// The part where `side`, which is linear, is not negative.
pub(crate) fn half_plane(p: &Polygon, side: impl Fn(DVec2) -> f64) -> Polygon {
    let mut out = Polygon::EMPTY;
    let corners = p.corners();
    let Some(&last) = corners.last() else {
        return out;
    };
    let (mut from, mut s_from) = (last, side(last));
    for &to in corners {
        let s_to = side(to);
        if (s_from < 0.0 && 0.0 < s_to) || (0.0 < s_from && s_to < 0.0) {
            // From the smaller end, so that both triangles at an edge get the same point.
            let cut = if s_from < s_to {
                from + (to - from) * (s_from / (s_from - s_to))
            } else {
                to + (from - to) * (s_to / (s_to - s_from))
            };
            out.push(cut);
        }
        if 0.0 <= s_to {
            out.push(to);
        }
        (from, s_from) = (to, s_to);
    }
    out
}

/// The part of `t` inside the unit square.
pub(crate) fn unit_square(t: &[DVec2; 3]) -> Polygon {
    let mut p = Polygon::triangle(t);
    let inside = t.iter().all(|c| c.cmpge(DVec2::ZERO).all() && c.cmple(DVec2::ONE).all());
    if inside {
        return p;
    }
    p = half_plane(&p, |c| c.x);
    p = half_plane(&p, |c| 1.0 - c.x);
    p = half_plane(&p, |c| c.y);
    p = half_plane(&p, |c| 1.0 - c.y);
    // A cut may land a rounding error outside.
    for c in &mut p.corners {
        *c = c.clamp(DVec2::ZERO, DVec2::ONE);
    }
    p
}

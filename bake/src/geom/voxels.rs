//! Which cells of a lattice triangles pass through.

use glam::{UVec3, Vec3A};

/// What lies in the side of a cell belongs to both; a part of a cell.
const SLACK: f32 = 1e-3;

/// Calls `f` for the cells of a lattice of `size` unit cubes that a triangle may touch, whose corners are in units of cells from the lattice's first corner: those in its
/// bounds that its plane cuts. A few that it only passes by are among them, none that it touches is left out.
pub fn touched(corners: [Vec3A; 3], size: UVec3, mut f: impl FnMut(UVec3)) {
    let min = corners[0].min(corners[1]).min(corners[2]);
    let max = corners[0].max(corners[1]).max(corners[2]);
    let last = (size - 1).as_vec3a();
    if (max + SLACK).cmplt(Vec3A::ZERO).any() || (min - SLACK).cmpgt(last + 1.0).any() {
        return;
    }
    let from = (min - SLACK).floor().clamp(Vec3A::ZERO, last).as_uvec3();
    let to = (max + SLACK).floor().clamp(Vec3A::ZERO, last).as_uvec3();
    // In f64: triangles may be thousands of cells long.
    let [a, b, c] = corners.map(|c| c.as_dvec3());
    let normal = (b - a).cross(c - a).normalize_or_zero();
    let slack = f64::from(SLACK);
    let reach = (0.5 + slack) * normal.abs().element_sum() + slack;
    for z in from.z..=to.z {
        for y in from.y..=to.y {
            for x in from.x..=to.x {
                let cell = UVec3::new(x, y, z);
                if (cell.as_dvec3() + 0.5 - a).dot(normal).abs() <= reach {
                    f(cell);
                }
            }
        }
    }
}

/// The part of a triangle within the cube from `min` to `min + side`: a convex polygon, empty if there is none.
#[must_use]
pub fn clip_to_cube(corners: [Vec3A; 3], min: Vec3A, side: f32) -> Vec<Vec3A> {
    let mut polygon = corners.to_vec();
    for axis in 0..3 {
        for (sign, end) in [(1.0, min[axis]), (-1.0, min[axis] + side)] {
            let inside = |p: &Vec3A| (p[axis] - end) * sign;
            let mut part = Vec::with_capacity(polygon.len() + 1);
            for (i, p) in polygon.iter().enumerate() {
                let q = &polygon[(i + 1) % polygon.len()];
                let (a, b) = (inside(p), inside(q));
                if 0.0 <= a {
                    part.push(*p);
                }
                if (a < 0.0) != (b < 0.0) {
                    part.push(*p + (*q - *p) * (a / (a - b)));
                }
            }
            polygon = part;
        }
    }
    polygon
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_floor_touches_the_cells_on_both_sides() {
        let corners = [[0.0, 1.0, 0.0], [2.0, 1.0, 0.0], [0.0, 1.0, 2.0]].map(Vec3A::from);
        let mut cells = Vec::new();
        touched(corners, UVec3::splat(3), |c| cells.push(c.to_array()));
        assert!(cells.contains(&[0, 0, 0]) && cells.contains(&[1, 1, 0]), "{cells:?}");
        assert!(cells.iter().all(|c| c[1] < 2), "{cells:?}");
        touched(corners.map(|c| c + 50.0), UVec3::splat(3), |c| panic!("{c}"));
    }

    #[test]
    fn clipped_areas_add_up() {
        let corners = [[0.1, 0.3, 0.2], [2.7, 1.1, 0.4], [0.5, 2.2, 2.9]].map(Vec3A::from);
        let area = |p: &[Vec3A]| -> f32 {
            (1..p.len().max(2) - 1).map(|i| 0.5 * (p[i] - p[0]).cross(p[i + 1] - p[0]).length()).sum()
        };
        let mut sum = 0.0;
        for i in 0..27u32 {
            let min = UVec3::new(i % 3, i / 3 % 3, i / 9).as_vec3a();
            sum += area(&clip_to_cube(corners, min, 1.0));
        }
        assert!((sum / area(&corners) - 1.0).abs() < 1e-5, "{sum}");
        assert!(clip_to_cube(corners, Vec3A::splat(5.0), 1.0).is_empty());
    }
}

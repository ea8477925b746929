//! Reads a bake's folder, and knows which piece of the world each texel covers.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use exr::prelude as exr;
use glam::{DVec2, DVec3, Mat4, Vec2, Vec3};
use tables::format::manifest::Manifest;

/// Channels of a page that are no light.
pub const NO_LIGHT: [&str; 2] = ["A", "filled"];

/// A lightmap page.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Texels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major values by channel name, such as `R` or `stderr.G`.
    pub channels: BTreeMap<String, Vec<f32>>,
}

impl Page {
    /// Reads any EXR with channels of one size.
    ///
    /// # Errors
    /// The decoder's words with the path.
    pub fn read(path: &Path) -> Result<Self, String> {
        let image =
            exr::read_first_flat_layer_from_file(path).map_err(|e| format!("{}: {e}", path.display()))?;
        let size = image.layer_data.size;
        let channels = image.layer_data.channel_data.list;
        let channels =
            channels.into_iter().map(|c| (c.name.to_string(), c.sample_data.values_as_f32().collect()));
        Ok(Self { width: size.x(), height: size.y(), channels: channels.collect() })
    }

    /// One value; `None` where the channel does not exist.
    #[must_use]
    pub fn get(&self, channel: &str, x: usize, y: usize) -> Option<f32> {
        self.channels.get(channel).and_then(|c| c.get(y * self.width + x)).copied()
    }

    /// Red, green, blue of the channels `prefix` + `R`, `G`, `B`; NaN where they do not exist.
    #[must_use]
    pub fn rgb(&self, prefix: &str, x: usize, y: usize) -> Vec3 {
        let of = |c: &str| self.get(&format!("{prefix}{c}"), x, y).unwrap_or(f32::NAN);
        Vec3::new(of("R"), of("G"), of("B"))
    }

    /// The value at texture coordinates, interpolated between texel centres as a GPU does.
    #[must_use]
    pub fn bilinear(&self, uv: Vec2) -> Vec3 {
        self.bilinear_of("", uv)
    }

    /// The same of the channels `prefix` + `R`, `G`, `B`.
    #[must_use]
    pub fn bilinear_of(&self, prefix: &str, uv: Vec2) -> Vec3 {
        let size = Vec2::new(self.width as f32, self.height as f32);
        let at = (uv * size - 0.5).clamp(Vec2::ZERO, size - 1.0);
        let (low, part) = (at.floor(), at.fract());
        let index = |v: f32, n: usize| (0..n).rfind(|&i| i as f32 <= v).unwrap_or(0);
        let (x, y) = (index(low.x, self.width), index(low.y, self.height));
        let (x1, y1) = ((x + 1).min(self.width - 1), (y + 1).min(self.height - 1));
        let row = |y| self.rgb(prefix, x, y).lerp(self.rgb(prefix, x1, y), part.x);
        row(y).lerp(row(y1), part.y)
    }
}

/// A triangle of `scene.glb` with texels.
#[derive(Clone, Debug)]
pub struct Triangle {
    /// Name of its node.
    pub node: String,
    /// Corners in the world, metres.
    pub positions: [Vec3; 3],
    /// `TEXCOORD_1`.
    pub uvs: [Vec2; 3],
}

/// A bake read from its folder.
#[derive(Clone, Debug)]
pub struct Baked {
    /// Contents of `manifest.json`.
    pub manifest: Manifest,
    /// Its pages.
    pub pages: Vec<Page>,
    /// Triangles of `scene.glb` that have `TEXCOORD_1`.
    pub triangles: Vec<Triangle>,
    /// Bytes of every file by name, without `timings.json`.
    pub files: BTreeMap<String, Vec<u8>>,
}

/// The part of a texel that one triangle covers: points with weights, texels being the unit of area.
#[derive(Clone, Debug)]
pub struct Piece {
    /// Name of the triangle's node.
    pub node: String,
    /// World position, face normal, weight.
    pub points: Vec<(DVec3, DVec3, f64)>,
}

impl Baked {
    /// Reads manifest, pages and `scene.glb`.
    ///
    /// # Errors
    /// What is missing or broken.
    pub fn read(dir: &Path) -> Result<Self, String> {
        let files = files(dir)?;
        let text = files.get("manifest.json").ok_or("there is no manifest.json")?;
        let manifest = Manifest::from_json(&String::from_utf8_lossy(text)).map_err(|e| e.to_string())?;
        let pages = manifest.pages.iter().map(|p| Page::read(&dir.join(&p.file)));
        let pages = pages.collect::<Result<_, _>>()?;
        let glb = files.get("scene.glb").ok_or("there is no scene.glb")?;
        Ok(Self { manifest, pages, triangles: triangles(glb)?, files })
    }

    /// Every covered texel (page 0) with the pieces of the world it covers. Only for bakes of one page.
    ///
    /// # Panics
    /// Where the bake has several pages.
    #[must_use]
    pub fn texels(&self) -> BTreeMap<(usize, usize), Vec<Piece>> {
        assert_eq!(self.pages.len(), 1, "the density of a test scene is chosen so that one page holds it");
        let page = &self.pages[0];
        let mut out: BTreeMap<(usize, usize), Vec<Piece>> = BTreeMap::new();
        for t in &self.triangles {
            let size = DVec2::new(page.width as f64, page.height as f64);
            let uv = t.uvs.map(|p| p.as_dvec2() * size);
            let (lo, hi) = (uv[0].min(uv[1]).min(uv[2]), uv[0].max(uv[1]).max(uv[2]));
            for y in cells(lo.y, hi.y, page.height) {
                for x in cells(lo.x, hi.x, page.width) {
                    let points = cover(t, uv, DVec2::new(x as f64, y as f64));
                    if !points.is_empty() {
                        out.entry((x, y)).or_default().push(Piece { node: t.node.clone(), points });
                    }
                }
            }
        }
        out
    }

    /// Compares every texel and channel whose pieces satisfy `of` with the average of `exact` (in the texel's unit, `E / pi`).
    #[must_use]
    pub fn cases(
        &self,
        of: impl Fn(&Piece) -> bool,
        exact: impl Fn(DVec3, DVec3) -> DVec3,
    ) -> Vec<crate::stats::Case> {
        let page = &self.pages[0];
        let mut cases = Vec::new();
        for (group, ((x, y), pieces)) in self.texels().into_iter().enumerate() {
            let points: Vec<_> = pieces.iter().filter(|p| of(p)).flat_map(|p| &p.points).collect();
            let weight: f64 = points.iter().map(|p| p.2).sum();
            // Below a thousandth of a texel, rounding of the coordinates decides whether it is covered.
            if weight < 1e-3 {
                continue;
            }
            let want = points.iter().map(|p| exact(p.0, p.1) * p.2).sum::<DVec3>() / weight;
            let (got, err) = (page.rgb("", x, y), page.rgb("stderr.", x, y));
            for c in 0..3 {
                cases.push(crate::stats::Case {
                    what: format!("texel {x},{y} channel {c} coverage {weight:.3}"),
                    group,
                    got: f64::from(got[c]),
                    std_err: f64::from(err[c]),
                    want: want[c],
                });
            }
        }
        cases
    }

    /// Mean of every node's texels, weighted by what the node covers of them, with its standard error, both by channel.
    #[must_use]
    pub fn node_means(&self) -> BTreeMap<String, [DVec3; 2]> {
        let page = &self.pages[0];
        let mut sums: BTreeMap<String, (f64, DVec3, DVec3)> = BTreeMap::new();
        for ((x, y), pieces) in self.texels() {
            let mut weights: BTreeMap<&str, f64> = BTreeMap::new();
            for piece in &pieces {
                *weights.entry(&piece.node).or_default() += piece.points.iter().map(|p| p.2).sum::<f64>();
            }
            for (node, w) in weights {
                let sum = sums.entry(node.into()).or_default();
                let err = page.rgb("stderr.", x, y).as_dvec3();
                sum.0 += w;
                sum.1 += w * page.rgb("", x, y).as_dvec3();
                sum.2 += w * w * err * err;
            }
        }
        let mean = |(w, v, e): (f64, DVec3, DVec3)| [v / w, e.map(f64::sqrt) / w];
        sums.into_iter().map(|(node, sum)| (node, mean(sum))).collect()
    }

    /// The largest channel of any texel that a node covers more than a thousandth of.
    #[must_use]
    pub fn node_max(&self, node: &str) -> f32 {
        let weight = |pieces: &[Piece]| {
            pieces.iter().filter(|p| p.node == node).flat_map(|p| &p.points).map(|p| p.2).sum::<f64>()
        };
        let texels = self.texels().into_iter().filter(|(_, p)| 1e-3 < weight(p));
        texels.map(|((x, y), _)| self.pages[0].rgb("", x, y).max_element()).fold(0.0, f32::max)
    }

    /// The first page's value at texture coordinates, interpolated between texel centres as a GPU does.
    #[must_use]
    pub fn bilinear(&self, uv: Vec2) -> Vec3 {
        self.pages[0].bilinear(uv)
    }
}

/// Whole texels that the interval from `lo` to `hi` touches.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the page")]
fn cells(lo: f64, hi: f64, n: usize) -> std::ops::Range<usize> {
    let end = n as f64;
    (lo.floor().clamp(0.0, end) as usize)..(hi.ceil().clamp(0.0, end) as usize)
}

/// Quadrature points of the part of the texel at `corner` that lies in triangle `t`, whose corners in texels are `uv`.
fn cover(t: &Triangle, uv: [DVec2; 3], corner: DVec2) -> Vec<(DVec3, DVec3, f64)> {
    let area = (uv[1] - uv[0]).perp_dot(uv[2] - uv[0]);
    let mut polygon: Vec<DVec2> = uv.into();
    let sides = [
        (DVec2::X, corner.x),
        (DVec2::NEG_X, -corner.x - 1.0),
        (DVec2::Y, corner.y),
        (DVec2::NEG_Y, -corner.y - 1.0),
    ];
    for (axis, least) in sides {
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (i, &b) in polygon.iter().enumerate() {
            let a = polygon[(i + polygon.len() - 1) % polygon.len()];
            let (da, db) = (a.dot(axis) - least, b.dot(axis) - least);
            if (da < 0.0) != (db < 0.0) {
                kept.push(a + (b - a) * (da / (da - db)));
            }
            if 0.0 <= db {
                kept.push(b);
            }
        }
        polygon = kept;
    }
    let p = t.positions.map(|p| p.as_dvec3());
    let normal = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
    let mut points = Vec::new();
    for i in 1..polygon.len().saturating_sub(1) {
        for [a, b, c] in quarters([polygon[0], polygon[i], polygon[i + 1]], 2) {
            let weight = 0.5 * (b - a).perp_dot(c - a).abs();
            // Exact for quadratics: three points half-way between corners and centre.
            let centre = (a + b + c) / 3.0;
            for q in [a, b, c].map(|q| 0.5 * (q + centre)) {
                let v = (q - uv[0]).perp_dot(uv[2] - uv[0]) / area;
                let w = (uv[1] - uv[0]).perp_dot(q - uv[0]) / area;
                let at = p[0] + (p[1] - p[0]) * v + (p[2] - p[0]) * w;
                points.push((at, normal, weight / 3.0));
            }
        }
    }
    points.retain(|p| 0.0 < p.2);
    points
}

fn quarters(t: [DVec2; 3], level: u32) -> Vec<[DVec2; 3]> {
    if level == 0 {
        return vec![t];
    }
    let [a, b, c] = t;
    let (ab, bc, ca) = (0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a));
    let parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]];
    parts.into_iter().flat_map(|t| quarters(t, level - 1)).collect()
}

/// Bytes of every file of a folder by name, without `timings.json`, which differs from run to run.
///
/// # Errors
/// What cannot be read.
pub fn files(dir: &Path) -> Result<BTreeMap<String, Vec<u8>>, String> {
    let fault = |e: std::io::Error| format!("{}: {e}", dir.display());
    let paths: Vec<PathBuf> = fs::read_dir(dir)
        .map_err(fault)?
        .map(|e| e.map(|e| e.path()))
        .collect::<Result<_, _>>()
        .map_err(fault)?;
    let mut out = BTreeMap::new();
    for path in paths.iter().filter(|p| p.is_file()) {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        if name != "timings.json" {
            out.insert(name, fs::read(path).map_err(fault)?);
        }
    }
    Ok(out)
}

/// The triangles of a `.glb` that have `TEXCOORD_1`, in world space.
///
/// # Errors
/// What is missing.
pub fn triangles(glb: &[u8]) -> Result<Vec<Triangle>, String> {
    let file = ::gltf::Gltf::from_slice_without_validation(glb).map_err(|e| e.to_string())?;
    let blob = file.blob.as_deref().unwrap_or_default();
    let scene = file.default_scene().or_else(|| file.scenes().next()).ok_or("there is no scene")?;
    let mut stack: Vec<_> = scene.nodes().map(|n| (n, Mat4::IDENTITY)).collect();
    let mut out = Vec::new();
    while let Some((node, parent)) = stack.pop() {
        let world = parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        stack.extend(node.children().map(|n| (n, world)));
        for primitive in node.mesh().iter().flat_map(::gltf::Mesh::primitives) {
            let reader = primitive.reader(|_| Some(blob));
            let Some(uvs) = reader.read_tex_coords(1) else { continue };
            let uvs: Vec<Vec2> = uvs.into_f32().map(Vec2::from).collect();
            let positions = reader.read_positions().ok_or("a primitive has no positions")?;
            let positions: Vec<Vec3> = positions.map(|p| world.transform_point3(p.into())).collect();
            let indices: Vec<usize> = match reader.read_indices() {
                Some(i) => i.into_u32().map(|i| i as usize).collect(),
                None => (0..positions.len()).collect(),
            };
            for t in indices.chunks_exact(3) {
                let t = [t[0], t[1], t[2]];
                if t.iter().any(|&i| positions.len() <= i || uvs.len() <= i) {
                    return Err(format!("an index of {t:?} is out of range"));
                }
                out.push(Triangle {
                    node: node.name().unwrap_or_default().into(),
                    positions: t.map(|i| positions[i]),
                    uvs: t.map(|i| uvs[i]),
                });
            }
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_a_quad_fill_its_texels() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::new(1.0, 0.0, -1.0), Vec3::NEG_Z];
        let uv = |p: Vec3| Vec2::new(0.1 + 0.5 * p.x, 0.9 + 0.5 * p.z);
        let triangle = |i: [usize; 3]| Triangle {
            node: "q".into(),
            positions: i.map(|i| corners[i]),
            uvs: i.map(|i| uv(corners[i])),
        };
        let page = Page { width: 10, height: 10, channels: BTreeMap::new() };
        let baked = Baked {
            manifest: Manifest::new("test", "0"),
            pages: vec![page],
            triangles: vec![triangle([0, 1, 2]), triangle([0, 2, 3])],
            files: BTreeMap::new(),
        };
        let texels = baked.texels();
        let weight = |p: &Vec<Piece>| p.iter().flat_map(|p| &p.points).map(|p| p.2).sum::<f64>();
        let full: Vec<_> = texels.iter().filter(|(_, p)| 0.01 < weight(p)).map(|(at, _)| *at).collect();
        assert_eq!(full.len(), 25);
        let mut sum = DVec3::ZERO;
        for (at, p) in texels.iter().filter(|(at, _)| full.contains(at)) {
            assert!((weight(p) - 1.0).abs() < 1e-5, "{at:?}");
            for (q, n, w) in p.iter().flat_map(|p| &p.points) {
                assert!((*n - DVec3::Y).length() < 1e-6);
                sum += *q * *w;
            }
        }
        assert!((sum / 25.0 - DVec3::new(0.5, 0.0, -0.5)).length() < 1e-5);
    }
}

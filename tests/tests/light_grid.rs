//! `light-grid.ktx2` as a fog shader reads it: furnaces, a lamp, walls and solid things.

#![expect(clippy::print_stdout, reason = "figures that are reported")]

use glam::{UVec3, Vec3};
use half::f16;
use serde_json::json;
use std::f32::consts::PI;
use suite::baked::Baked;
use suite::scenes::{closed, open};
use suite::tool;
use tables::harmonics::real::basis;

/// What bakes take whose lightmaps nobody looks at.
const COARSE: [&str; 4] = ["--samples", "4", "--texels-per-metre", "4"];

/// The texture with what the manifest says of it.
struct Grid {
    size: UVec3,
    slices: u32,
    first: Vec3,
    cell: Vec3,
    texels: Vec<[f32; 4]>,
}

impl Grid {
    fn of(baked: &Baked) -> Self {
        let m = baked.manifest.light_grid.as_ref().expect("a light grid in the manifest");
        Self::read(baked, &m.file)
    }

    /// The light without what lamps bring straight away.
    fn indirect(baked: &Baked) -> Option<Self> {
        let m = baked.manifest.light_grid.as_ref().expect("a light grid in the manifest");
        assert_eq!(m.indirect.is_some(), baked.files.contains_key("light-grid.indirect.ktx2"));
        m.indirect.as_ref().map(|file| Self::read(baked, file))
    }

    fn read(baked: &Baked, file: &str) -> Self {
        let m = baked.manifest.light_grid.as_ref().expect("a light grid in the manifest");
        let reader = ktx2::Reader::new(&baked.files[file][..]).expect("a KTX2 file");
        let h = reader.header();
        assert_eq!(h.format, Some(ktx2::Format::R16G16B16A16_SFLOAT));
        assert_eq!([h.pixel_width, h.pixel_height, h.pixel_depth], [m.size[0], m.size[1], 7 * m.slices]);
        let data = reader.levels().next().expect("a level").data;
        let half = |b: &[u8]| f16::from_le_bytes([b[0], b[1]]).to_f32();
        let texel = |t: &[u8]| [half(t), half(&t[2..]), half(&t[4..]), half(&t[6..])];
        Self {
            size: m.size.into(),
            slices: m.slices,
            first: m.first.into(),
            cell: m.cell.into(),
            texels: data.chunks_exact(8).map(texel).collect(),
        }
    }

    fn nodes(&self) -> impl Iterator<Item = UVec3> {
        let s = self.size;
        (0..s.element_product()).map(move |i| UVec3::new(i % s.x, i / s.x % s.y, i / (s.x * s.y)))
    }

    fn place(&self, node: UVec3) -> Vec3 {
        self.first + node.as_vec3() * self.cell
    }

    /// Texel of block `k`, as the shader finds it.
    fn texel(&self, k: usize, node: UVec3) -> [f32; 4] {
        let n = [node.x, node.y, node.z + 1].map(|i| i as usize);
        let slice = n[2] + k * self.slices as usize;
        self.texels[(slice * self.size.y as usize + n[1]) * self.size.x as usize + n[0]]
    }

    /// Coefficients in one channel; `None` inside of solid things.
    fn light(&self, node: UVec3, channel: usize) -> Option<[f32; 9]> {
        let fourth = |k: usize| self.texel(k, node)[3];
        (fourth(6) == 1.0).then(|| {
            std::array::from_fn(|k| match k {
                7 => fourth(channel),
                8 => fourth(3 + channel),
                _ => self.texel(k, node)[channel],
            })
        })
    }
}

/// In a furnace light comes evenly from everywhere: coefficient 0 is sqrt(4 pi) times 2 nits, the others are 0. Single nodes are as noisy as few paths make them,
/// up to 16 % of coefficient 0; their mean is not.
#[test]
fn a_furnace_is_even() {
    let scene = closed::furnace(0.5, 1.0);
    let grid = Grid::of(&tool::baked_in(&scene, "{ sigma_s = 1, g = 0.5 }", &COARSE));
    let want = 2.0 * (4.0 * PI).sqrt();
    let (mut mean, mut n) = (0.0, 0.0);
    for node in grid.nodes() {
        let light = grid.light(node, 1).expect("air");
        mean += light[0];
        n += 1.0;
        assert!((light[0] / want - 1.0).abs() < 0.2, "{node}: {light:?}");
        assert!(light[1..].iter().all(|l| l.abs() < 0.2 * want), "{node}: {light:?}");
    }
    println!("{n} nodes, mean {:+.3} %", 100.0 * (mean / n / want - 1.0));
    assert!((mean / n / want - 1.0).abs() < 5e-3);
}

/// A lamp alone in a medium that takes nearly everything: I e^(-sigma d) / d^2 from one direction, apart from what a mean over a cell makes of it.
#[test]
fn a_lamp_shines_from_its_place() {
    let fog = json!({ "sigma_s": 1e-6, "sigma_a": 0.3, "box": { "min": [-3, -1, -2], "max": [3, 3, 2] } });
    let scene = open::lamp_in_fog(1.0, 100.0, &fog);
    let baked = tool::baked(&scene, &["--samples", "1", "--texels-per-metre", "1"]);
    let (grid, rest) = (Grid::of(&baked), Grid::indirect(&baked).expect("a second texture"));
    let lamp = Vec3::new(0.0, 1.0, 0.0);
    let (mut worst, mut n) = (0.0f32, 0);
    for node in grid.nodes() {
        let to = lamp - grid.place(node);
        let d = to.length();
        if d < 6.0 * grid.cell.max_element() {
            continue;
        }
        let light = grid.light(node, 1).expect("air");
        assert!(rest.light(node, 1).expect("air").iter().all(|l| l.abs() < 1e-4 * light[0]), "{node}");
        let lux = 100.0 * (-0.3 * d).exp() / (d * d);
        let y = basis((to / d).to_array());
        for (l, y) in light.iter().zip(y) {
            worst = worst.max((l / lux - y).abs());
        }
        n += 1;
    }
    println!("{n} nodes, worst {worst} of the lamp's illuminance");
    assert!(100 < n && worst < 0.06, "{n} {worst}");
}

/// Nodes of a dark room know nothing of the bright one beside it, and nodes between the walls of both say so.
#[test]
fn dark_rooms_stay_dark() {
    let grid = Grid::of(&tool::baked_in(&closed::two_rooms(0.3), "{ sigma_s = 0.5 }", &COARSE));
    let (mut lit, mut dark, mut solid) = (Vec::new(), 0.0f32, 0);
    for node in grid.nodes() {
        let p = grid.place(node);
        // Between the lamp, which has only a front, and the ceiling nodes see its back.
        let inside = |x0: f32, x1: f32| {
            p.cmpgt(Vec3::new(x0, 0.0, -1.0)).all() && p.cmplt(Vec3::new(x1, 1.9, 1.0)).all()
        };
        let light = grid.light(node, 1);
        if inside(-2.15, -0.15) {
            lit.push(light.expect("air")[0]);
        } else if inside(0.15, 2.15) {
            dark = dark.max(light.expect("air").iter().fold(0.0, |a, l| a.max(l.abs())));
        } else if light.is_none() {
            solid += 1;
        }
    }
    let mean = lit.iter().sum::<f32>() / lit.len() as f32;
    println!("{mean} in the light, {dark} in the dark, {solid} nodes in walls");
    assert!(100 < lit.len() && 1.0 < mean && dark < 1e-3 * mean && 0 < solid);
}

/// Lamps and suns add to the light that is there without them, and to nothing where nothing is; emissive surfaces count in both textures, so that without others there is one.
#[test]
fn what_lamps_bring_straight_away_is_left_out() {
    let few = [&COARSE[..], &["--grid-nodes", "1024", "--probes", "off"]].concat();
    let bake = |scene: &[u8]| tool::baked_in(scene, "{ sigma_s = 0.5, g = 0.3 }", &few);
    let baked = bake(&closed::room(closed::Room::default()));
    let (all, rest) = (Grid::of(&baked), Grid::indirect(&baked).expect("a second texture"));
    let (mut sums, mut more, mut n) = ([0.0f64; 2], 0, 0);
    for node in all.nodes() {
        for channel in 0..3 {
            let lights = [all.light(node, channel), rest.light(node, channel)];
            let [Some(all), Some(rest)] = lights else {
                assert!(lights[0].is_none() && lights[1].is_none(), "{node}");
                continue;
            };
            assert!(0.0 <= rest[0] && rest[0] <= all[0], "{node}: {} of {}", rest[0], all[0]);
            more += u32::from(rest[0] < all[0]);
            n += 1;
            sums[0] += f64::from(all[0]);
            sums[1] += f64::from(rest[0]);
        }
    }
    println!("lamps add to {more} of {n}, {} in all", sums[0] / sums[1] - 1.0);
    assert!(n / 2 < more && sums[1] < 0.9 * sums[0] && 0.1 * sums[0] < sums[1], "{sums:?} {more} {n}");
    // Without lamp and sun the panel and the sky are left, which both textures would have.
    assert!(Grid::indirect(&bake(&closed::two_rooms(0.3))).is_none());
    assert!(Grid::indirect(&bake(&closed::furnace(0.5, 1.0))).is_none());
}

/// Without media that scatter, or in another mode, there is no grid.
#[test]
fn grids_are_written_where_there_is_fog() {
    let scene = closed::furnace(0.5, 1.0);
    let has = |medium: &str, media: &str| {
        let baked = tool::baked_in(&scene, medium, &[&COARSE[..], &["--media", media]].concat());
        assert_eq!(baked.manifest.light_grid.is_some(), baked.files.contains_key("light-grid.ktx2"));
        baked.manifest.light_grid.is_some()
    };
    assert!(has("{ sigma_s = 1 }", "bounded"));
    assert!(!has("{ sigma_a = 1 }", "bounded"));
    assert!(!has("{ sigma_s = 1 }", "attenuate"));
}

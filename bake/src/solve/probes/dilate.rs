//! Gives probes in walls the light of their neighbours, so that who does not look at validity sees no black.

use tables::probes::{Brick, Light, NODES};

/// Fills the missing ones ring by ring, each with the mean of its neighbours along the axes; what nothing reaches stays.
pub(super) fn dilate(bricks: &[Brick], light: &mut [Option<Light>]) {
    let mut pairs: Vec<(u32, u32)> = Vec::new();
    for b in bricks {
        for i in 0..b.probes.len() {
            for (axis, stride) in [1, NODES, NODES * NODES].into_iter().enumerate() {
                if i / NODES.pow(u32::try_from(axis).unwrap_or(0)) % NODES + 1 < NODES {
                    let (p, q) = (b.probes[i], b.probes[i + stride]);
                    if light[p as usize].is_none() || light[q as usize].is_none() {
                        pairs.extend([(p, q), (q, p)]);
                    }
                }
            }
        }
    }
    // Bricks that touch share pairs.
    pairs.sort_unstable();
    pairs.dedup();
    loop {
        let mut ring = Vec::new();
        for list in pairs.chunk_by(|a, b| a.0 == b.0).filter(|l| light[l[0].0 as usize].is_none()) {
            let near: Vec<&Light> = list.iter().filter_map(|(_, q)| light[*q as usize].as_ref()).collect();
            if let Some(first) = near.first() {
                let mut mean = Light::black(first.basis());
                near.iter().for_each(|l| mean.add(l, 1.0 / near.len() as f32));
                ring.push((list[0].0, mean));
            }
        }
        if ring.is_empty() {
            return;
        }
        for (p, mean) in ring {
            light[p as usize] = Some(mean);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tables::probes::{Basis, NONE};

    #[test]
    fn light_spreads_ring_by_ring() {
        let brick = Brick {
            corner: [0; 3],
            level: 0,
            probes: std::array::from_fn(|i| u32::try_from(i).expect("small")),
            cells: [NONE; 64],
        };
        let of = |v: f32| Some(Light::new(Basis::L1, &[[v; 3]]));
        // The first plane along x is lit, brighter upwards; the rest is in a wall.
        let mut light: Vec<Option<Light>> =
            (0..125).map(|i| if i % 5 == 0 { of((i / 5 % 5) as f32) } else { None }).collect();
        dilate(&[brick], &mut light);
        for (i, l) in light.iter().enumerate() {
            let want = (i / 5 % 5) as f32;
            let got = l.expect("reached").coefficients()[0][0];
            assert!((got - want).abs() < 1e-6, "{i}: {got} {want}");
        }
        let mut dark = vec![None; 125];
        dilate(&[], &mut dark);
        assert!(dark.iter().all(Option::is_none));
    }
}

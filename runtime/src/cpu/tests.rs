//! Bricks in the pool against bricks as they are stored; beams against rays.

use brickfell_formats::chunk::Chunk;
use brickfell_formats::layout::SampleLayout;
use brickfell_pager::{Bricks, ChunkPage};
use glam::{DVec3, dvec3};
use proptest::prelude::*;

use super::beam::Beam;
use super::pool::Packed;
use crate::march::Brick as _;
use crate::reference::sampling::{Brick, Samples};

/// Few samples with an alpha, or many.
fn chunk(layout: SampleLayout, axes: bool) -> impl Strategy<Value = Chunk> {
    let samples = layout.samples();
    let bytes = proptest::collection::vec(any::<[u8; 12]>(), samples);
    (bytes, 1u8..=255).prop_map(move |(bytes, one_in)| {
        let part = |k: usize| bytes.iter().map(move |b| [b[k], b[k + 1], b[k + 2], b[k + 3]]);
        let clear = |[r, g, b, a]: [u8; 4]| if r % one_in > 4 { [0; 4] } else { [r, g, b, a] };
        let opacity = if axes { part(8).collect() } else { Vec::new() };
        Chunk {
            mask: 1,
            layout,
            color: part(0).map(clear).collect(),
            normal: part(4).map(|n| n.map(u8::cast_signed)).collect(),
            opacity,
        }
    })
}

fn layouts() -> impl Strategy<Value = SampleLayout> {
    prop_oneof![Just(SampleLayout::Corner), Just(SampleLayout::Centre)]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn packed_bricks_show_what_is_stored(
        (chunk, layout) in (layouts(), any::<bool>()).prop_flat_map(|(l, axes)| (chunk(l, axes), Just(l))),
        places in proptest::collection::vec(proptest::array::uniform3(-0.1f64..8.1), 200),
    ) {
        let stored = Brick {
            samples: Samples::Stored {
                color: chunk.brick_color(0),
                normal: chunk.brick_normal(0),
                opacity: chunk.brick_opacity(0),
            },
            layout,
        };
        let packed = &Packed::new(&ChunkPage::new(Bricks::Samples(chunk.clone())), 0);
        for place in places {
            // Of what f32 holds, so that both round to the same 256th.
            let local = place.map(|x| (x * 64.0).round() / 64.0);
            let (mut reads, mut expected_reads) = (0, 0);
            let value = packed.value(local.map(|x| x as f32), &mut reads);
            let expected = stored.value(local, &mut expected_reads);
            let numbers = |rgb: [f64; 3], n: [f64; 3], axes: Option<[f64; 3]>, alpha: f64| {
                [rgb, n, axes.unwrap_or_default(), [alpha, 0.0, 0.0]].concat()
            };
            let wide = |v: [f32; 3]| v.map(f64::from);
            let got = numbers(wide(value.rgb), wide(value.normal), value.axes.map(wide), value.alpha.into());
            let want = numbers(expected.rgb, expected.normal, expected.axes, expected.alpha);
            if want[9] == 0.0 {
                prop_assert!(got[9] == 0.0);
                continue;
            }
            for (got, want) in got.iter().zip(&want) {
                prop_assert!((got - want).abs() < 3e-5, "{local:?}: {value:?} {expected:?}");
            }
            prop_assert_eq!(reads, expected_reads);
            // Where there is something the masks and the box say so.
            let at = local.map(|x| (x.floor() as usize).min(7));
            prop_assert!(packed.occupied()[at[2]] >> (at[1] * 8 + at[0]) & 1 == 1);
            let at = dvec3(at[0] as f64, at[1] as f64, at[2] as f64);
            for step in 0..=3 {
                let [low, high] = packed.filled(step);
                prop_assert!(low.cmple(at).all() && at.cmplt(high).all());
                prop_assert!([low, high].iter().all(|p| *p % f64::from(1 << step) == DVec3::ZERO));
            }
        }
    }

    #[test]
    fn a_beam_touches_what_its_rays_touch(
        slopes in proptest::array::uniform2(proptest::array::uniform3(-1.0f64..1.0)),
        part in proptest::array::uniform3(0.0f64..=1.0),
        inside in proptest::array::uniform3(0.0f64..=1.0),
        side in 0.1f64..4.0,
        z in 0.0f64..20.0,
    ) {
        let [a, b] = slopes.map(DVec3::from);
        let beam = Beam::new([a, b, a, b]);
        // A point of a ray between the two, and a box around it.
        let p = (a + (b - a) * DVec3::from(part)) * z;
        let low = p - DVec3::from(inside) * side;
        let (enter, leave) = beam.touches(low, low + side);
        prop_assert!(enter <= z * (1.0 + 1e-9) + 1e-9 && z <= leave * (1.0 + 1e-9) + 1e-9, "{enter} {z} {leave}");
    }
}

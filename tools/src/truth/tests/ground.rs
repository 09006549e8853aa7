//! Rays and the solid below height maps.

use super::*;
use crate::input::Imagery;

/// Lays a picture of one colour over a layer.
fn painted(mut layer: Layer, color: [u8; 3]) -> Layer {
    let [r, g, b] = color;
    let raster = Raster {
        width: 2,
        height: 2,
        pixels: vec![[r, g, b, 255]; 4],
    };
    let imagery = Imagery::place(Path::new("test"), raster, Default::default(), &layer.map);
    layer.imagery = Some(imagery.unwrap());
    layer
}

#[test]
fn a_ramp_is_met_where_it_is() {
    let layers = [layer(40, DVec2::ZERO, |x, y| 0.5 * x - 0.25 * y)];
    let truth = Truth::new(&[], &layers, &Bottom::Level(-20.0)).unwrap();
    let mut random = Random::new(3);
    for _ in 0..2000 {
        let target = dvec3(random.between(1.0, 39.0), random.between(1.0, 39.0), 0.0);
        let target = target.with_z(0.5 * target.x - 0.25 * target.y);
        let away = random_point(&mut random, 1.0) + DVec3::Z * 1.8;
        let hit = truth.hit(target + 30.0 * away, -away, None).unwrap();
        assert!(
            (hit.depth - 30.0).abs() < 1e-5,
            "{target} from {away}: {}",
            hit.depth
        );
        let normal = dvec3(-0.5, 0.25, 1.0).normalize();
        assert!((hit.look.normal.as_dvec3() - normal).length() < 1e-5);
    }
}

#[test]
fn bumpy_ground_is_met_first_where_a_fine_walk_meets_it() {
    let height = |x: f64, y: f64| 3.0 * (x * 1.3).sin() * (y * 0.9).cos() + (x * 5.1 + y * 7.7).sin();
    let layers = [layer(37, DVec2::new(-18.0, -18.5), height)];
    let truth = Truth::new(&[], &layers, &Bottom::Level(-6.0)).unwrap();
    let inside = |p: DVec3| {
        let height = layers[0].map.height_at(p.x, p.y).unwrap();
        height.is_some_and(|h| p.z <= h && p.z >= -6.0)
    };
    let mut random = Random::new(4);
    let (mut hits, mut misses) = (0, 0);
    for k in 0..3000 {
        let eye = random_point(&mut random, 30.0).with_z(random.between(-12.0, 9.0));
        // All signs, some components zero, and grazing rays.
        let mut d = random_point(&mut random, 1.0).normalize() * dvec3(1.0, 1.0, [1.0, 0.1, 0.01][k % 3]);
        (0..3)
            .filter(|c| k >> (c + 3) & 7 == 0)
            .for_each(|c| d[c] = if k % 2 == 0 { 0.0 } else { -0.0 });
        if d == DVec3::ZERO {
            continue;
        }
        let hit = truth.hit(eye, d, None);
        let end = hit.map_or(100.0, |h| h.depth);
        let steps = 4000;
        for s in 0..steps {
            let t = end * f64::from(s) / f64::from(steps);
            // Points within rounding of the surface are on either side of it.
            assert!(
                !inside(eye + d * (t - 1e-9).max(0.0)) || t > end - 1e-6,
                "{eye} {d}: solid at {t} before {end}"
            );
        }
        match hit {
            Some(hit) => {
                let on = eye + d * hit.depth;
                let near = (0..27).any(|k| {
                    inside(
                        on + (dvec3(f64::from(k % 3), f64::from(k / 3 % 3), f64::from(k / 9)) - 1.0) * 1e-6,
                    )
                });
                assert!(near, "{eye} {d}: nothing at {on}");
                hits += 1;
            }
            None => misses += 1,
        }
    }
    assert!(hits > 500 && misses > 500, "{hits} {misses}");
}

#[test]
fn ground_is_solid_to_its_bottom_and_closed_at_its_sides() {
    // 20 m of level ground at z = 5 m with a hole of one sample at (10.5, 10.5): 2 m wide.
    let height = |x: f64, y: f64| if (x, y) == (10.5, 10.5) { f64::NAN } else { 5.0 };
    let layers = [painted(layer(20, DVec2::ZERO, height), [255, 0, 0])];
    let truth = Truth::new(&[], &layers, &Bottom::Level(-3.0)).unwrap();
    let depth = |eye: DVec3, d: DVec3| {
        let hit = truth.hit(eye, d, None)?;
        assert!(
            (hit.look.rgb[0] - 1.0).abs() < 1e-6 && hit.look.rgb[1] == 0.0,
            "{eye} {d}: {:?}",
            hit.look
        );
        assert!((hit.look.normal - Vec3::Z).length() < 1e-6);
        Some(hit.depth)
    };
    let at = |x: f64, y: f64, z: f64| dvec3(x, y, z);
    for z in [4.99, 0.0, -2.99] {
        assert_eq!(depth(at(-7.0, 3.0, z), DVec3::X), Some(7.0));
        assert_eq!(depth(at(27.0, 3.0, z), -DVec3::X), Some(7.0));
        assert_eq!(depth(at(3.0, -7.0, z), DVec3::Y), Some(7.0));
        assert_eq!(depth(at(3.0, 27.0, z), -DVec3::Y), Some(7.0));
        // From within the solid, and from within the hole to its walls.
        assert_eq!(depth(at(3.0, 3.0, z), DVec3::X), Some(0.0));
        assert_eq!(depth(at(10.5, 10.5, z), DVec3::X), Some(1.0));
        assert_eq!(depth(at(10.5, 10.25, z), -DVec3::Y), Some(0.75));
    }
    assert_eq!(depth(at(-7.0, 3.0, 5.01), DVec3::X), None);
    assert_eq!(depth(at(-7.0, 3.0, -3.01), DVec3::X), None);
    assert_eq!(depth(at(3.0, 3.0, -9.0), DVec3::Z), Some(6.0));
    assert_eq!(depth(at(3.0, 3.0, 9.0), -DVec3::Z), Some(4.0));
    assert_eq!(depth(at(10.5, 10.5, 9.0), -DVec3::Z), None);
    assert_eq!(depth(at(20.01, 3.0, 9.0), -DVec3::Z), None);
}

#[test]
fn the_bottom_is_that_of_the_boxes() {
    let layers = [layer(40, DVec2::ZERO, |_, _| 5.0)];
    let boxed = |x: f64, z: f64| [dvec3(x, 0.0, z), dvec3(x + 10.0, 40.0, 9.0)];
    // Over the third of four columns there is none: the lowest of all.
    let boxes = vec![
        boxed(0.0, -2.0),
        boxed(10.0, -4.0),
        boxed(10.0, 0.0),
        boxed(30.0, -1.0),
    ];
    let truth = Truth::new(&[], &layers, &Bottom::Boxes(boxes)).unwrap();
    for (x, bottom) in [
        (1.0, -2.0),
        (8.9, -2.0),
        (11.1, -4.0),
        (25.0, -4.0),
        (31.1, -1.0),
        (39.9, -1.0),
    ] {
        let hit = truth.hit(dvec3(x, 20.2, -50.0), DVec3::Z, None).unwrap();
        assert_eq!(hit.depth, 50.0 + bottom, "{x}");
    }
}

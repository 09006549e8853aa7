//! Rasters from file to ground: every format places the same terrain alike, whatever is kept in memory, and rasters in
//! different systems lie on each other.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec2, DVec3};
use proptest::prelude::*;

use super::block_cache::RasterCache;
use super::error::InputError;
use super::files::HeightInput;
use super::geodesy::{EastNorthUp, geocentric, geodetic};
use super::heights::{HeightOptions, TerrainRgb};
use super::layer::{Layer, load_layer, load_layers};
use super::mapping::Columns;
use super::test_data::{TagValue, float_tiff, tiled_float_tiff};

const LOW: f64 = 1200.0;

/// A terrain of whole metres.
fn height(column: u32, row: u32) -> f64 {
    LOW + (f64::from(column) * 0.7)
        .sin()
        .mul_add(40.0, f64::from(row) * 3.0)
        .round()
}

fn write(dir: &Path, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
    let path = dir.join(name);
    fs::write(&path, bytes).unwrap();
    path
}

fn ascii(w: u32, h: u32, header: &str, height: impl Fn(u32, u32) -> f64) -> String {
    let mut text = format!("NCOLS {w}\r\nnrows {h}\n{header}");
    for row in 0..h {
        let line: Vec<String> = (0..w).map(|c| height(c, row).to_string()).collect();
        text += &(line.join(" ") + "\n");
    }
    text
}

fn hgt(side: u32, height: impl Fn(u32, u32) -> f64) -> Vec<u8> {
    let places = (0..side).flat_map(|r| (0..side).map(move |c| (c, r)));
    places
        .flat_map(|(c, r)| (height(c, r) as i16).to_be_bytes())
        .collect()
}

/// System, zone, unit, unit of heights, steps; then each profile's first sample and heights from the south.
fn usgs(numbers: [i64; 4], step: [f64; 3], profiles: &[(DVec2, Vec<i64>)]) -> Vec<u8> {
    let mut header = vec![b' '; 1024];
    let mut put =
        |from: usize, text: String| header[from..from + text.len()].copy_from_slice(text.as_bytes());
    put(156, format!("{:6}{:6}", numbers[0], numbers[1]));
    put(528, format!("{:6}{:6}", numbers[2], numbers[3]));
    put(
        816,
        step.map(|s| format!("{:>12}", format!("{s:.5}E+00"))).concat(),
    );
    put(852, format!("{:6}{:6}", 1, profiles.len()));
    put(890, " 4".into());
    let mut file = header;
    for (number, (start, heights)) in profiles.iter().enumerate() {
        let number_text = |v: f64| format!("{:>24}", format!("{v:.9}D+00"));
        let mut record = format!("{:6}{:6}{:6}{:6}", 1, number + 1, heights.len(), 1).into_bytes();
        record.extend(
            [start.x, start.y, 0.0, 0.0, 0.0]
                .map(number_text)
                .concat()
                .bytes(),
        );
        assert_eq!(record.len(), 144);
        let mut room = 146;
        for height in heights {
            if room == 0 {
                file.append(&mut record);
                file.resize(file.len().next_multiple_of(1024), b' ');
                room = 170;
            }
            record.extend(format!("{height:6}").bytes());
            room -= 1;
        }
        file.append(&mut record);
        file.resize(file.len().next_multiple_of(1024), b' ');
    }
    file
}

fn load(path: &Path) -> Layer {
    load_layer(path, None, HeightOptions::default()).unwrap()
}

fn fault(path: &Path) -> String {
    load_layer(path, None, HeightOptions::default())
        .unwrap_err()
        .to_string()
}

fn geo_tags(corner: DVec2, pixel: f64, keys: &[u16]) -> Vec<(u16, TagValue)> {
    let mut directory = vec![1, 1, 0, (keys.len() / 4) as u16];
    directory.extend(keys);
    vec![
        (33550, TagValue::Double(vec![pixel, pixel, 0.0])),
        (
            33922,
            TagValue::Double(vec![0.0, 0.0, 0.0, corner.x, corner.y, 0.0]),
        ),
        (34735, TagValue::Short(directory)),
    ]
}

fn samples(w: u32, h: u32) -> Vec<f32> {
    (0..h)
        .flat_map(|r| (0..w).map(move |c| height(c, r) as f32))
        .collect()
}

#[test]
fn projected_formats_agree() {
    let dir = tempfile::tempdir().unwrap();
    let (w, h, pixel) = (40, 200, 30.0);
    let corner = DVec2::new(557_805.0, 5_107_965.0);
    let top = corner + DVec2::new(0.0, pixel * f64::from(h));
    let header = "xllcorner 557805\nYLLCORNER 5107965\ncellsize 30\n";
    let centred = "xllcenter 557820\nyllcenter 5107980.0\ndx 30\ndy 3e1\nNODATA_value 32000\n";
    let profiles: Vec<_> = (0..w)
        .map(|c| {
            let start = corner + DVec2::new(15.0 + pixel * f64::from(c), 15.0);
            (start, (0..h).rev().map(|r| height(c, r) as i64).collect())
        })
        .collect();
    let rgb =
        |code: &dyn Fn(f64) -> [u8; 3]| image::RgbImage::from_fn(w, h, |c, r| image::Rgb(code(height(c, r))));
    let tags = || geo_tags(top, pixel, &[3072, 0, 1, 26910]);
    let files = [
        write(dir.path(), "a.tif", float_tiff(w, h, &samples(w, h), tags())),
        write(
            dir.path(),
            "tiled.tif",
            tiled_float_tiff(w, h, 16, |c, r| height(c, r) as f32, tags()),
        ),
        write(dir.path(), "a.asc", ascii(w, h, header, height)),
        write(dir.path(), "centred.asc", ascii(w, h, centred, height)),
        write(
            dir.path(),
            "a.dem",
            usgs([1, 10, 2, 2], [30.0, 30.0, 1.0], &profiles),
        ),
        dir.path().join("mapbox.png"),
        dir.path().join("terrarium.png"),
    ];
    let mapbox = |h: f64| {
        let code = ((h + 10_000.0) * 10.0).round() as u32;
        [(code >> 16) as u8, (code >> 8) as u8, code as u8]
    };
    let terrarium = |h: f64| [((h + 32_768.0) as u32 >> 8) as u8, (h + 32_768.0) as u32 as u8, 0];
    rgb(&mapbox).save(&files[5]).unwrap();
    rgb(&terrarium).save(&files[6]).unwrap();
    for name in ["mapbox.pgw", "terrarium.pgw"] {
        write(
            dir.path(),
            name,
            format!("30\n0\n0\n-30\n{}\n{}\n", top.x + 15.0, top.y - 15.0),
        );
    }
    for path in &files {
        let code = if path.ends_with("terrarium.png") {
            TerrainRgb::Terrarium
        } else {
            TerrainRgb::Mapbox
        };
        let options = HeightOptions {
            terrain_rgb: Some(code),
            ..HeightOptions::default()
        };
        let map = load_layer(path, None, options).unwrap().map;
        assert_eq!(
            map.bounds(),
            (corner, corner + DVec2::new(40.0, 200.0) * pixel),
            "{path:?}"
        );
        for (c, r) in [(0, 0), (39, 0), (7, 150), (39, 199), (20, 100)] {
            let at = top + DVec2::new(f64::from(c) + 0.5, -(f64::from(r) + 0.5)) * pixel;
            let z = map.height_at(at.x, at.y).unwrap().unwrap();
            assert!((z - height(c, r)).abs() < 1e-3, "{path:?} {c} {r}: {z}");
        }
    }
    assert!(fault(&files[5]).contains("--terrain-rgb"));
}

#[test]
fn degrees_agree_and_lie_where_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let side = 61;
    let step = 1.0 / 60.0;
    let tags = geo_tags(
        DVec2::new(-122.0, 47.0) - step * DVec2::new(0.5, -0.5),
        step,
        &[1024, 0, 1, 2],
    );
    let arc = 60.0;
    let profiles: Vec<_> = (0..side)
        .map(|c| {
            let start = DVec2::new(-122.0 * 3600.0 + arc * f64::from(c), 46.0 * 3600.0);
            (start, (0..side).rev().map(|r| height(c, r) as i64).collect())
        })
        .collect();
    let header = format!("xllcenter -122\nyllcenter 46\ncellsize {step:.17}\n");
    let files = [
        write(dir.path(), "N46W122.hgt", hgt(side, height)),
        write(
            dir.path(),
            "a.tif",
            float_tiff(side, side, &samples(side, side), tags),
        ),
        write(
            dir.path(),
            "a.dem",
            usgs([0, 0, 3, 2], [arc, arc, 1.0], &profiles),
        ),
        write(dir.path(), "a.asc", ascii(side, side, &header, height)),
    ];
    write(
        dir.path(),
        "a.prj",
        "GEOGCS[\"WGS 84\",UNIT[\"degree\",0.0174532925199433]]",
    );
    let frame = EastNorthUp::new(DVec2::new(-121.5, 46.5));
    for path in &files {
        let map = load(path).map;
        let name = map.world_system().unwrap();
        assert!(name.contains("+lon_0=-121.5 +lat_0=46.5"), "{path:?}: {name}");
        for (c, r) in [(0, 0), (60, 0), (7, 50), (30, 30), (60, 60)] {
            let place = DVec2::new(-122.0 + f64::from(c) * step, 47.0 - f64::from(r) * step);
            let p = frame.to_local(geocentric(place, height(c, r)));
            let z = map.height_at(p.x, p.y).unwrap().unwrap();
            // Slopes of 40 m in 1.3 km, and positions that are rounded to 2^-20 pixels.
            assert!((z - p.z).abs() < 2e-3, "{path:?} {c} {r}: {z} is not {}", p.z);
        }
        // 60 km from the middle the ground is 70 m lower than its height; the pixels are those of the ellipsoid.
        let size = map.pixel_size();
        assert!(
            (size.y - 1852.69).abs() < 0.05 && (size.x - 1279.38).abs() < 0.05,
            "{size}"
        );
    }
}

#[test]
fn points_between_nodes_are_where_geodesy_says() {
    let dir = tempfile::tempdir().unwrap();
    let path = write(dir.path(), "N46W122.hgt", hgt(61, height));
    let map = load(&path).map;
    let frame = EastNorthUp::new(DVec2::new(-121.5, 46.5));
    let columns = Columns {
        step: 90.0,
        zero: 0.25,
    };
    let (first, width) = ([-310.0, -290.0], 97);
    let mut z = vec![0.0; width * 91];
    map.heights(columns, first, width, &mut z).unwrap();
    let mut part = [0.0; 7 * 3];
    map.heights(columns, [first[0] + 17.0, first[1] + 40.0], 7, &mut part)
        .unwrap();
    for (k, z_part) in part.iter().enumerate() {
        assert_eq!(
            *z_part,
            z[(40 + k / 7) * width + 17 + k % 7],
            "a part gives the same bits"
        );
    }
    for (k, z) in z.iter().enumerate().step_by(13) {
        let [x, y] = [first[0] + (k % width) as f64, first[1] + (k / width) as f64].map(|c| columns.world(c));
        let (place, h) = geodetic(frame.to_geocentric(DVec3::new(x, y, *z)));
        let (c, r) = ((place.x + 122.0) * 60.0, (47.0 - place.y) * 60.0);
        let (i, j) = (c as u32, r as u32);
        let (s, t) = (c.fract(), r.fract());
        let row = |j| height(i, j) + s * (height(i + 1, j) - height(i, j));
        let expected = row(j) + t * (row(j + 1) - row(j));
        assert!((h - expected).abs() < 0.1, "{h} is not {expected}");
    }
}

#[test]
fn voids_and_faults() {
    let dir = tempfile::tempdir().unwrap();
    let void = |c, r| if (c, r) == (1, 1) { -32768.0 } else { height(c, r) };
    let map = load(&write(dir.path(), "S01E180.hgt", hgt(3, void))).map;
    assert_eq!(map.height_at(0.0, 0.0).unwrap(), None);
    assert!(map.height_at(0.0, 60_000.0).unwrap().is_some());
    let name = dir.path().join("tile.hgt");
    fs::write(&name, [0; 8]).unwrap();
    assert!(fault(&name).contains("tile.hgt") && fault(&name).contains("name"));
    assert!(fault(&write(dir.path(), "N00E000.hgt", [0; 10])).contains("square"));

    let header = "xllcorner 0\nyllcorner 0\ncellsize 1\n";
    let map = load(&write(
        dir.path(),
        "v.asc",
        ascii(2, 2, header, |c, r| if c + r == 0 { -9999.0 } else { 1.0 }),
    ))
    .map;
    assert_eq!(map.height_at(0.5, 1.5).unwrap(), None);
    assert_eq!(map.height_at(1.5, 1.5).unwrap(), Some(1.0));
    for (text, part) in [
        (
            "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2\n3 x\n",
            "line 7: 'x' is not a number",
        ),
        (
            "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n10 20\n30\n",
            "cut short",
        ),
        (
            "ncols 2\nnrows 99999\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2\n",
            "cut short",
        ),
        (
            "ncols 2\nnrows -2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2\n",
            "not a size",
        ),
        ("ncols 2\nnrows 2\ncellsize 1\n1 2 3 4\n", "header needs"),
        (
            "ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 0\n1 2 3 4\n",
            "not positive",
        ),
        ("ncols 2\nrows 2\n", "line 2: 'rows' is no key"),
    ] {
        let message = fault(&write(dir.path(), "a.asc", text));
        assert!(message.contains("a.asc") && message.contains(part), "{message}");
    }

    let profile = |x: f64| (DVec2::new(x, 0.0), vec![1, -32767, 3]);
    let good = usgs([1, 10, 2, 1], [30.0, 30.0, 2.0], &[profile(0.0), profile(30.0)]);
    let map = load(&write(dir.path(), "a.dem", &good)).map;
    assert_eq!(
        map.min_max(),
        (2.0 * 0.3048, 6.0 * 0.3048),
        "feet, in steps of two"
    );
    assert_eq!(map.height_at(0.0, 30.0).unwrap(), None);
    let message = fault(&write(dir.path(), "a.dem", &good[..2048 + 100]));
    assert!(
        message.contains("byte 2048") && message.contains("cut short"),
        "{message}"
    );
    let mut bad = good.clone();
    bad[1024 + 144 + 3] = b'x';
    let message = fault(&write(dir.path(), "a.dem", &bad));
    assert!(message.contains("byte 1168"), "{message}");
}

/// A tall map of a picture, two pixels for every height, in another projection.
#[test]
fn a_picture_in_another_projection_lies_on_the_heights() {
    let dir = tempfile::tempdir().unwrap();
    // Heights in UTM 10 north, around 44° north, 122.3° west; the picture in web Mercator with finer pixels.
    let (n, pixel) = (64, 30.0);
    let corner = DVec2::new(556_000.0, 4_872_000.0 + pixel * f64::from(n));
    let tags = geo_tags(corner, pixel, &[3072, 0, 1, 26910]);
    let heights = write(
        dir.path(),
        "h.tif",
        float_tiff(n, n, &vec![5.0; (n * n) as usize], tags),
    );
    let image = dir.path().join("i.png");
    let (size, step) = (256, 15.0);
    let origin = DVec2::new(-13_615_000.0, 5_467_500.0);
    image::RgbImage::from_fn(size, size, |c, r| image::Rgb([c as u8, r as u8, 0]))
        .save(&image)
        .unwrap();
    write(
        dir.path(),
        "i.png.aux.xml",
        format!(
            "<PAMDataset><SRS>PROJCS[\"m\",GEOGCS[\"g\"],UNIT[\"metre\",1],AUTHORITY[\"EPSG\",\"3857\"]]</SRS>\
             <GeoTransform>{},{step},0,{},0,-{step}</GeoTransform></PAMDataset>",
            origin.x, origin.y
        ),
    );
    let layer = load_layer(&heights, Some(&image), HeightOptions::default()).unwrap();
    let columns = Columns {
        step: 10.0,
        zero: 0.0,
    };
    let first = [55_620, 487_220];
    let width = 150;
    let ground = vec![(5.0, 1.0f32); width * 140];
    let colors = layer.colors(columns, first, width, &ground).unwrap();
    let wgs = proj4rs::Proj::from_proj_string("+proj=longlat +datum=WGS84").unwrap();
    let [utm, mercator] = [26910, 3857].map(|code| proj4rs::Proj::from_epsg_code(code).unwrap());
    let mut inside = 0;
    for (k, color) in colors.iter().enumerate().step_by(37) {
        let middle = [first[0] + (k % width) as i64, first[1] + (k / width) as i64]
            .map(|c| columns.world(c as f64 + 0.5));
        let mut p = (middle[0], middle[1], 0.0);
        proj4rs::transform::transform(&utm, &wgs, &mut p).unwrap();
        proj4rs::transform::transform(&wgs, &mercator, &mut p).unwrap();
        let at = DVec2::new((p.0 - origin.x) / step, (origin.y - p.1) / step);
        if at.min_element() < 2.0 || at.max_element() > 254.0 {
            continue;
        }
        inside += 1;
        let code = |linear: f32| f64::from(brickfell_formats::value::linear_to_srgb(linear));
        let found = DVec2::new(code(color[0]), code(color[1])) + 0.5;
        // Colours are means in linear light of a box of 14 m, which lies askew in the picture.
        assert!(
            (found - at).abs().max_element() < 0.55 + 8.0 / at.min_element(),
            "{found} is not {at}"
        );
    }
    assert!(inside > 100, "{inside}");
    // What cannot be related is refused, by both names.
    let side = dir.path().join("i.png.aux.xml");
    let text = fs::read_to_string(&side).unwrap().replace("3857", "26710");
    fs::write(side, text).unwrap();
    let message = load_layer(&heights, Some(&image), HeightOptions::default())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("EPSG:26710") && message.contains("EPSG:26910"),
        "{message}"
    );
}

#[test]
fn geocentric_rasters_lie_on_their_plane() {
    let dir = tempfile::tempdir().unwrap();
    // A plane that touches the ellipsoid: its columns go east, its rows south, its heights up, 10 m apart.
    let origin = DVec2::new(7.5, 47.0);
    let frame = EastNorthUp::new(origin);
    let o = frame.to_geocentric(DVec3::new(-160.0, 160.0, 0.0));
    let axis = |v: DVec3| frame.to_geocentric(v) - frame.to_geocentric(DVec3::ZERO);
    let (c, r, h) = (axis(DVec3::X * 10.0), axis(DVec3::Y * -10.0), axis(DVec3::Z));
    let matrix = (0..3)
        .flat_map(|k| [c[k], r[k], h[k], o[k]])
        .chain([0.0, 0.0, 0.0, 1.0]);
    let tags = vec![
        (34264, TagValue::Double(matrix.collect())),
        (34735, TagValue::Short(vec![1, 1, 0, 1, 1024, 0, 1, 3])),
    ];
    let path = write(dir.path(), "g.tif", float_tiff(32, 32, &samples(32, 32), tags));
    let map = load(&path).map;
    assert!(map.world_system().unwrap().contains("topocentric"));
    for (c, r) in [(0u32, 0u32), (31, 3), (16, 20)] {
        let at = DVec2::new(-155.0 + 10.0 * f64::from(c), 155.0 - 10.0 * f64::from(r));
        let z = map.height_at(at.x, at.y).unwrap().unwrap();
        // The frame's origin is rounded to a millionth of a degree.
        assert!((z - height(c, r)).abs() < 2.5, "{z} is not {}", height(c, r));
    }
}

#[test]
fn maps_in_degrees_lie_beside_each_other() {
    let dir = tempfile::tempdir().unwrap();
    let level = |_, _| 100.0;
    let inputs = ["N10E179.hgt", "N10W180.hgt"].map(|name| HeightInput {
        path: write(dir.path(), name, hgt(31, level)),
        imagery: None,
    });
    let cache = RasterCache::new(1 << 20, dir.path());
    let layers = load_layers(&inputs, HeightOptions::default(), &cache).unwrap();
    let name = layers[1].map.world_system().unwrap();
    assert!(name.contains("+lon_0=180 +lat_0=10.5"), "{name}");
    let (west, east) = (layers[0].map.bounds(), layers[1].map.bounds());
    assert!(
        (west.0.x + east.1.x).abs() < 1.0 && west.0.x < -100_000.0,
        "{west:?} {east:?}"
    );
}

/// Reads everything in windows of trees' size, in an order that comes back.
fn survey(layer: &Layer) -> Result<Vec<u64>, InputError> {
    let (min, _) = layer.map.bounds();
    let columns = Columns { step: 1.0, zero: 0.0 };
    let mut all = Vec::new();
    for (x, y) in (0..4).flat_map(|y| (0..4).map(move |x| (x, y))) {
        let first = [min.x as i64 + x * 200, min.y as i64 + y * 200];
        let mut z = vec![0.0; 216 * 216];
        layer
            .map
            .heights(columns, first.map(|v| v as f64 + 0.5), 216, &mut z)?;
        let ground: Vec<(f64, f32)> = z.iter().map(|z| (*z, 1.0)).collect();
        let colors = layer.colors(columns, first, 216, &ground)?;
        all.extend(z.iter().map(|z| z.to_bits()));
        all.extend(colors.iter().flatten().map(|c| u64::from(c.to_bits())));
    }
    Ok(all)
}

#[test]
fn what_is_larger_than_its_memory_gives_the_same_bits() {
    let dir = tempfile::tempdir().unwrap();
    let n = 800;
    let sample = |c: u32, r: u32| {
        if (c / 7 + r).is_multiple_of(31) {
            f32::NAN
        } else {
            (c * 3 + r) as f32 * 0.01
        }
    };
    let tags = || geo_tags(DVec2::new(0.0, f64::from(n)), 1.0, &[3072, 0, 1, 2056]);
    let data: Vec<f32> = (0..n).flat_map(|r| (0..n).map(move |c| sample(c, r))).collect();
    let picture = image::RgbaImage::from_fn(2 * n, 2 * n, |c, r| {
        image::Rgba([c as u8, r as u8, (c * r) as u8, 255])
    });
    let image = dir.path().join("i.png");
    picture.save(&image).unwrap();
    let text = ascii(
        n,
        n,
        "xllcorner 0\nyllcorner 0\ncellsize 1\nnodata_value -1\n",
        |c, r| {
            let h = f64::from(sample(c, r));
            if h.is_nan() { -1.0 } else { h }
        },
    );
    let heights = [
        write(
            dir.path(),
            "tiled.tif",
            tiled_float_tiff(n, n, 64, sample, tags()),
        ),
        write(dir.path(), "one_strip.tif", float_tiff(n, n, &data, tags())),
        write(dir.path(), "text.asc", text),
    ];
    let mut first: Option<Vec<u64>> = None;
    for path in heights {
        let input = HeightInput {
            path,
            imagery: Some(image.clone()),
        };
        let load = |budget: u64| -> (Arc<RasterCache>, Result<Vec<Layer>, InputError>) {
            let cache = RasterCache::new(budget, dir.path());
            let layers = load_layers(std::slice::from_ref(&input), HeightOptions::default(), &cache);
            (cache, layers)
        };
        let (_, whole) = load(64 << 20);
        let expected = survey(&whole.unwrap()[0]).unwrap();
        // 2.4 MiB of heights and 10 MiB of colours.
        let budget = 3 << 20;
        let (cache, parts) = load(budget);
        if input.path.ends_with("one_strip.tif") {
            assert!(
                matches!(parts, Err(InputError::Memory { .. })),
                "one strip is more than it may read at once"
            );
            continue;
        }
        let found = survey(&parts.unwrap()[0]).unwrap();
        assert!(found == expected, "{:?}", input.path);
        assert!(cache.peak_bytes() <= budget, "{}", cache.peak_bytes());
        assert!(cache.peak_bytes() > budget / 2, "{}", cache.peak_bytes());
        if let Some(first) = &first {
            assert!(*first == expected, "{:?} has other heights", input.path);
        }
        first = Some(expected);
    }
}

#[test]
fn ranges_hold_all_heights_and_end_with_the_map() {
    let dir = tempfile::tempdir().unwrap();
    let tags = geo_tags(DVec2::new(100.0, 250.0), 1.0, &[3072, 0, 1, 2056]);
    let plane = load(&write(
        dir.path(),
        "a.tif",
        float_tiff(64, 50, &samples(64, 50), tags),
    ))
    .map;
    let columns = Columns { step: 1.0, zero: 0.0 };
    assert!(plane.range_over(columns, [164, 200], [200, 250]).is_none());
    assert!(plane.range_over(columns, [100, 150], [164, 200]).is_none());
    let degrees = load(&write(dir.path(), "N46W122.hgt", hgt(61, height))).map;
    for (map, step, first, size) in [
        (&plane, 1.0, [110, 210], 20),
        (&degrees, 200.0, [-180, -260], 150),
    ] {
        let columns = Columns { step, zero: 0.0 };
        let mut z = vec![0.0; size * size];
        map.heights(columns, first.map(|v| v as f64 + 0.5), size, &mut z)
            .unwrap();
        let (low, high) = z.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), z| {
            (l.min(*z), h.max(*z))
        });
        let range = map
            .range_over(columns, first, first.map(|v| v + size as i64))
            .unwrap();
        assert!(
            range.0 <= low && high <= range.1,
            "{range:?} does not hold {low} to {high}"
        );
        assert!(
            range.1 - range.0 < high - low + 250.0,
            "{range:?} is far from {low} to {high}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn damaged_files_are_errors_that_name_them(
        kind in 0usize..3, cut in 0usize..9000, changes in prop::collection::vec((0usize..9000, any::<u8>()), 0..6),
    ) {
        let dir = tempfile::tempdir().unwrap();
        let profile = |x: f64| (DVec2::new(x, 0.0), (0..200).collect::<Vec<i64>>());
        let (name, mut bytes) = match kind {
            0 => ("N10E010.hgt", hgt(9, height)),
            1 => ("a.asc", ascii(9, 9, "xllcorner 0\nyllcorner 0\ncellsize 1\n", height).into_bytes()),
            _ => ("a.dem", usgs([1, 10, 2, 1], [30.0, 30.0, 1.0], &[profile(0.0), profile(30.0)])),
        };
        bytes.truncate(cut.max(20));
        for (at, value) in changes {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        let path = write(dir.path(), name, &bytes);
        if let Err(e) = load_layer(&path, None, HeightOptions::default()) {
            let message = e.to_string();
            prop_assert!(message.contains(name) && !message.contains('\n'), "{message}");
        }
    }
}

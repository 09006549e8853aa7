//! `compare`, and `render --truth`, which needs no Vulkan adapter.

use std::fs;
use std::path::Path;

use image::{Rgb, RgbImage};

use crate::common::{Run, brickfell, shared};
use crate::inputs::png_claiming;

fn compare(a: &Path, b: &Path, more: &[&str]) -> Run {
    let (a, b) = (a.display().to_string(), b.display().to_string());
    let mut args = vec!["compare", &a, &b];
    args.extend(more);
    brickfell(args)
}

#[test]
fn figures_and_a_heat_map_of_two_pictures() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    let mut picture = RgbImage::from_pixel(20, 10, Rgb([188; 3]));
    picture.save(path("a.png")).unwrap();
    picture.put_pixel(7, 3, Rgb([188, 255, 187]));
    picture.save(path("b.png")).unwrap();
    let diff = path("diff.png").display().to_string();
    let run = compare(&path("a.png"), &path("b.png"), &["--out", &diff]);
    let out = run.success();
    for part in [
        "67 of 255 sRGB steps at (7, 3)",
        "0.500 % of the pixels",
        "FLIP",
        "RMSE",
    ] {
        assert!(out.contains(part), "{part} is not in {out}");
    }
    let heat = image::open(&diff).unwrap().to_rgb8();
    assert_eq!((heat.dimensions(), heat.get_pixel(19, 9).0), ((20, 10), [0; 3]));
    assert!(heat.get_pixel(7, 3).0[2] > 50);
    let same = compare(&path("a.png"), &path("a.png"), &[]);
    for part in [
        "99.00 dB linear light, 99.00 dB sRGB",
        "FLIP         0.00000",
        "0.000 %",
    ] {
        assert!(same.success().contains(part), "{part} is not in {}", same.out);
    }
}

#[test]
fn what_cannot_be_compared_is_one_line_and_leaves_no_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name);
    RgbImage::new(20, 10).save(path("a.png")).unwrap();
    RgbImage::new(10, 20).save(path("turned.png")).unwrap();
    fs::write(path("text.png"), "not a picture").unwrap();
    fs::write(path("huge.png"), png_claiming(1 << 30, 1 << 30)).unwrap();
    let diff = path("diff.png").display().to_string();
    for (other, part) in [
        ("turned.png", "20x10"),
        ("text.png", "text.png"),
        ("huge.png", "huge.png"),
        ("none.png", "none.png"),
    ] {
        let run = compare(&path("a.png"), &path(other), &["--out", &diff]);
        assert!(run.error(1).contains(part), "{}", run.err);
        assert!(run.err.contains("hint: "), "{}", run.err);
    }
    assert!(!Path::new(&diff).exists());
    let nowhere = path("none/diff.png").display().to_string();
    let run = compare(&path("a.png"), &path("a.png"), &["--out", &nowhere]);
    assert!(run.error(1).contains("none"), "{}", run.err);
}

#[test]
fn the_truth_is_near_the_reference_and_shows_the_input() {
    let dir = tempfile::tempdir().unwrap();
    let (db, inputs) = (shared().join("db"), shared().join("inputs"));
    let text = |p: &Path| p.display().to_string();
    let out = |name: &str| dir.path().join(name);
    let render = |name: &str, more: &[String]| {
        let fixed = [
            "--eye",
            "16,-14,26",
            "--target",
            "16,16,10",
            "--size",
            "64x48",
            "--out",
        ];
        let mut args = vec!["render".to_string(), text(&db)];
        args.extend(more.iter().cloned());
        args.extend(fixed.map(String::from));
        args.push(text(&out(name)));
        brickfell(args)
    };
    let heights = ["--heights".to_string(), text(&inputs.join("heights.png"))];
    let imagery = ["--imagery".to_string(), text(&inputs.join("imagery.png"))];
    let whole = [
        &["--truth".to_string(), text(&inputs.join("box.obj"))][..],
        &heights,
        &imagery,
    ]
    .concat();
    render("reference.png", &["--reference".into()]).success();
    render(
        "truth.png",
        &[whole.clone(), vec!["--rays".into(), "9".into()]].concat(),
    )
    .success();
    render("bare.png", &[&["--truth".to_string()][..], &heights].concat()).success();
    let psnr = |name: &str| -> f64 {
        let run = compare(&out("reference.png"), &out(name), &[]);
        let line = run
            .success()
            .lines()
            .find(|l| l.starts_with("PSNR"))
            .unwrap()
            .to_string();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    };
    let (near, far) = (psnr("truth.png"), psnr("bare.png"));
    assert!(near > 25.0 && near > far + 5.0, "{near} {far}");

    for (args, part) in [
        (vec!["--truth".to_string()], "none is named"),
        (heights.to_vec(), "--truth only"),
        (vec!["--truth".into(), text(&inputs.join("none.obj"))], "none.obj"),
    ] {
        let run = render("none.png", &args);
        assert!(run.error(1).contains(part), "{}", run.err);
    }
    assert_ne!(
        render("none.png", &[whole, vec!["--reference".into()]].concat()).code,
        0
    );
    assert!(!out("none.png").exists());
}

//! What a build takes does not show in what it makes.

use super::*;

#[test]
fn textures_larger_than_their_memory_make_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    // Read by rows, and in one piece.
    for (k, name) in ["0.png", "1.jpg", "2.png", "3.jpg"].into_iter().enumerate() {
        let picture = image::RgbImage::from_fn(500, 400 + k as u32, |x, y| {
            image::Rgb([(x * y) as u8, (x ^ y) as u8, (x / 2) as u8])
        });
        picture.save(file(name)).unwrap();
    }
    fs::write(
        file("a.mtl"),
        "newmtl 0\nmap_Kd 0.png\nmap_d 2.png\nnewmtl 1\nmap_Kd 1.jpg\nnewmtl 2\nmap_Kd 2.png\nnewmtl 3\nmap_Kd 3.jpg\n",
    )
    .unwrap();
    // From several texels a voxel to several voxels a texel.
    let mut text = String::from("mtllib a.mtl\nvt 0 0\nvt 2 0\nvt 2 2\nvt 0 2\n");
    for (k, size) in [20, 40, 80, 10].into_iter().enumerate() {
        for (x, y) in [(0, 0), (size, 0), (size, size), (0, size)] {
            text += &format!("v {x} {y} {}\n", 3 * k);
        }
        text += &format!("usemtl {k}\nf -4/1 -3/2 -2/3 -1/4\n");
    }
    fs::write(file("a.obj"), text).unwrap();
    let run = |memory: u64, out: &str| {
        let args = BuildArgs {
            inputs: vec![file("a.obj")],
            voxel: Some(0.2),
            tree_voxels: 128,
            memory,
            ..BuildArgs::new(file(out))
        };
        let depth = check(&args).unwrap();
        let mut ground = Ground::load(&args).unwrap();
        ground.build(&args, depth, &Silent).unwrap();
        (files(&args.out), ground.textures.cache().peak_bytes())
    };
    let (whole, held) = run(DEFAULT_MEMORY, "whole");
    let budget = 2_000_000;
    assert!(held > 5 * budget / 2, "{held}");
    let (parts, peak) = run(budget * RASTERS_SHARE, "parts");
    assert!(peak <= budget && peak > budget / 2, "{peak}");
    assert!(whole == parts && whole.len() > 10);
}

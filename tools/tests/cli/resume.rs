//! Builds that are ended from outside, at any moment, go on to the same bytes.

use std::collections::BTreeMap;
use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::common::{brickfell, build_args, files};
use crate::inputs;

/// Everything in a database that the same input always gives.
fn database(out: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = files(out);
    files.remove("build.json");
    files
}

fn finer(mut args: Vec<String>) -> Vec<String> {
    let voxel = args.iter().position(|a| a == "--voxel").expect("the option") + 1;
    args[voxel] = "0.125".into();
    args
}

#[test]
fn a_build_that_is_killed_again_and_again_ends_with_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("inputs");
    inputs::write(&input);
    let (whole, killed) = (dir.path().join("whole"), dir.path().join("killed"));
    brickfell(finer(build_args(&input, &whole))).success();
    let args = finer(build_args(&input, &killed));
    let (mut kills, mut wait) = (0, Duration::from_millis(15));
    loop {
        let mut child = Command::new(env!("CARGO_BIN_EXE_brickfell"))
            .args(&args)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // Longer each time, so that some build gets to its end.
        std::thread::sleep(wait);
        wait += wait / 4;
        match child.try_wait().unwrap() {
            Some(status) => {
                let mut said = String::new();
                child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
                assert!(status.success(), "after {kills} kills: {said}");
                break;
            }
            None => {
                kills += 1;
                child.kill().unwrap();
                child.wait().unwrap();
            }
        }
    }
    assert!(kills > 0, "it was never killed");
    assert!(database(&whole) == database(&killed), "after {kills} kills");
}

/// Needs the right to mount; where there is none it says so and tests nothing.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_said_and_the_build_goes_on_when_there_is_room() {
    let dir = tempfile::tempdir().unwrap();
    let input = dir.path().join("inputs");
    inputs::write(&input);
    let (whole, disk) = (dir.path().join("whole"), dir.path().join("disk"));
    brickfell(finer(build_args(&input, &whole))).success();
    fs::create_dir(&disk).unwrap();
    let mount = |options: &str| {
        let status = Command::new("mount")
            .args(["-t", "tmpfs", "-o", options, "tmpfs"])
            .arg(&disk)
            .stderr(Stdio::null())
            .status();
        status.is_ok_and(|s| s.success())
    };
    if !mount("size=256k") {
        eprintln!("skipped: no right to mount a small disk");
        return;
    }
    let unmount = Unmount(&disk);
    let out = disk.join("db");
    let run = brickfell(finer(build_args(&input, &out)));
    let line = run.error(1).to_string();
    assert!(
        line.contains("No space left") && line.contains("disk/db"),
        "{line}"
    );
    assert!(mount("remount,size=64m"), "no more room");
    brickfell(finer(build_args(&input, &out))).success();
    assert!(database(&whole) == database(&out));
    drop(unmount);
}

#[cfg(target_os = "linux")]
struct Unmount<'a>(&'a Path);

#[cfg(target_os = "linux")]
impl Drop for Unmount<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0).status();
    }
}

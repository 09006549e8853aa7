//! A flight's frames as a video, made by `ffmpeg` where that is installed.

use std::path::Path;
use std::process::Command;

use crate::commands::{CommandError, say};

/// Name of the video.
pub(super) const NAME: &str = "flight.mp4";

/// Makes a video of the frames in a folder, so many a second, if there is a program for it; else says so.
pub(super) fn make(folder: &Path, rate: f64) -> Result<(), CommandError> {
    let frames = folder.join("frame_%04d.png");
    let run = Command::new("ffmpeg")
        .args([
            "-loglevel",
            "error",
            "-y",
            "-framerate",
            &format!("{rate:.3}"),
            "-i",
        ])
        .arg(&frames)
        // Players want pairs of rows and columns, and colours at half the resolution.
        .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])
        .arg(folder.join(NAME))
        .output();
    match run {
        Ok(run) if run.status.success() => {
            println!("see {}", folder.join(NAME).display());
            Ok(())
        }
        Ok(run) => Err(CommandError::new(
            format!(
                "ffmpeg makes no video: {}",
                String::from_utf8_lossy(&run.stderr).trim()
            ),
            "the frames are there, numbered from frame_0000.png on",
        )),
        Err(e) => {
            say::note(format_args!(
                "no video, ffmpeg cannot be started ({e}); the frames are {}",
                frames.display()
            ));
            Ok(())
        }
    }
}

//! The window, driven under Xvfb by key and mouse events of the X server. Skipped, with a message, where Xvfb, xdotool or xwd are not
//! installed (`scripts/display` does that).

use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use brickfell::flight::Flight;
use tempfile::TempDir;

use crate::common::copy_of_database;

/// The longest that anything in the window may take: frames of software devices take long.
const PATIENCE: Duration = Duration::from_secs(90);

/// A process that ends with the test.
struct Ends(Child);

impl Drop for Ends {
    fn drop(&mut self) {
        // Not killed: a server takes its lock with it when it is asked to end.
        if let Ok(None) = self.0.try_wait() {
            let _ = Command::new("kill").arg(self.0.id().to_string()).status();
        }
        let _ = self.0.wait();
    }
}

/// One at a time: servers that start together may choose the same display.
static ONE: Mutex<()> = Mutex::new(());

/// A display of its own with the program's window on it.
struct Stage {
    _server: Ends,
    program: Ends,
    display: String,
    window: String,
    db: TempDir,
    folder: TempDir,
    _only: MutexGuard<'static, ()>,
}

/// What a window shows, RGB.
#[derive(Clone, PartialEq)]
struct Shot {
    width: usize,
    height: usize,
    rgb: Vec<[u8; 3]>,
}

impl Shot {
    /// Part of the pixels of a rectangle that are not alike.
    fn differs(&self, other: &Shot, [x0, y0, x1, y1]: [usize; 4]) -> f64 {
        let different = (y0..y1)
            .flat_map(|y| (x0..x1).map(move |x| y * self.width + x))
            .filter(|k| self.rgb[*k] != other.rgb[*k]);
        different.count() as f64 / ((x1 - x0) * (y1 - y0)) as f64
    }

    /// Colours in it.
    fn colors(&self) -> usize {
        let mut all = self.rgb.clone();
        all.sort_unstable();
        all.dedup();
        all.len()
    }
}

fn installed(tools: &[&str]) -> bool {
    let missing: Vec<_> = (tools.iter())
        .filter(|tool| {
            let path = std::env::var_os("PATH").unwrap_or_default();
            !std::env::split_paths(&path).any(|folder| folder.join(tool).exists())
        })
        .collect();
    if !missing.is_empty() {
        eprintln!("skipped: {missing:?} are not installed; scripts/display installs them");
    }
    missing.is_empty()
}

fn until<T>(what: &str, mut found: impl FnMut() -> Option<T>) -> T {
    let start = Instant::now();
    loop {
        if let Some(found) = found() {
            return found;
        }
        assert!(start.elapsed() < PATIENCE, "waited in vain for {what}");
        std::thread::sleep(Duration::from_millis(50));
    }
}

impl Stage {
    /// A window over a copy of the small database, on a monitor of so many pixels to a point.
    fn open(args: &[&str], monitor_scale: &str) -> Self {
        let only = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        let (db, folder) = (copy_of_database(), tempfile::tempdir().unwrap());
        let mut server = Command::new("Xvfb")
            .args([
                "-displayfd",
                "1",
                "-screen",
                "0",
                "1024x768x24",
                "-nolisten",
                "tcp",
            ])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(server.stdout.as_mut().unwrap())
            .read_line(&mut line)
            .unwrap();
        let display = format!(":{}", line.trim());
        let program = Command::new(env!("CARGO_BIN_EXE_brickfell"))
            .args(["view", "--size", "480x360", "--shots"])
            .arg(folder.path())
            .arg(db.path())
            .args(args)
            .env("DISPLAY", &display)
            .env("WINIT_X11_SCALE_FACTOR", monitor_scale)
            .env_remove("WAYLAND_DISPLAY")
            .env("XDG_CONFIG_HOME", folder.path().join("config"))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stage = Self {
            _server: Ends(server),
            program: Ends(program),
            display,
            window: String::new(),
            db,
            folder,
            _only: only,
        };
        stage.window = until("a window", || {
            if stage.program.0.try_wait().unwrap().is_some() {
                panic!("the program has ended: {}", stage.said());
            }
            let found = stage.xdotool(&["search", "--name", "^brickfell"]);
            Some(found.lines().next()?.to_string())
        });
        // Xvfb has no window manager that would do it.
        until("the focus", || {
            stage.xdotool(&["windowfocus", &stage.window]);
            (stage.xdotool(&["getwindowfocus"]).trim() == stage.window).then_some(())
        });
        until("a picture", || (stage.shot().colors() > 200).then_some(()));
        stage
    }

    fn xdotool(&self, args: &[&str]) -> String {
        let run = Command::new("xdotool")
            .args(args)
            .env("DISPLAY", &self.display)
            .output()
            .unwrap();
        String::from_utf8(run.stdout).unwrap()
    }

    /// What the program has said, once it has ended.
    fn said(&mut self) -> String {
        let mut said = String::new();
        let stderr = self.program.0.stderr.as_mut();
        stderr.unwrap().read_to_string(&mut said).unwrap();
        said
    }

    fn key(&self, key: &str) {
        self.xdotool(&["key", key]);
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// What the window shows.
    fn shot(&self) -> Shot {
        // A window that is not on the screen yet has nothing to be read.
        let bytes = until("what the window shows", || {
            let run = Command::new("xwd")
                .args(["-silent", "-id", &self.window])
                .env("DISPLAY", &self.display)
                .output()
                .unwrap();
            (run.stdout.len() > 100).then_some(run.stdout)
        });
        let word = |k: usize| u32::from_be_bytes(bytes[k * 4..][..4].try_into().unwrap()) as usize;
        let (width, height, line) = (word(4), word(5), word(12));
        let start = word(0) + word(19) * 12;
        let pixel = |k: usize| {
            let at = start + k / width * line + k % width * 4;
            [bytes[at + 2], bytes[at + 1], bytes[at]]
        };
        Shot {
            width,
            height,
            rgb: (0..width * height).map(pixel).collect(),
        }
    }

    /// Waits until a rectangle of the window shows something else than before.
    fn changes(&self, what: &str, before: &Shot, rectangle: [usize; 4]) -> Shot {
        until(what, || {
            let now = self.shot();
            (now.differs(before, rectangle) > 0.02).then_some(now)
        })
    }

    /// Quits by key; the folder with what the program left.
    fn quit(mut self) -> TempDir {
        self.key("Escape");
        let code = until("the end", || self.program.0.try_wait().unwrap());
        let said = self.said();
        assert!(code.success() && !said.contains("panicked"), "{code}: {said}");
        self.folder
    }
}

const TOOLS: [&str; 3] = ["Xvfb", "xdotool", "xwd"];
/// Where the figures are, and a part of the picture that nothing lies over.
const FIGURES: [usize; 4] = [20, 60, 250, 300];
const PICTURE: [usize; 4] = [300, 20, 470, 300];

#[test]
fn the_window_flies_by_keys_and_mouse_and_keeps_what_it_is_told() {
    if !installed(&TOOLS) {
        return;
    }
    let stage = Stage::open(&["--cpu"], "1");

    // Figures go and come back.
    let with = stage.shot();
    stage.key("Tab");
    let without = stage.changes("no figures", &with, FIGURES);
    stage.key("h");
    let help = stage.changes("the table of keys", &without, PICTURE);
    stage.key("h");
    let plain = stage.changes("no table of keys", &help, PICTURE);

    // Keys, mouse and wheel move the camera, a recording keeps it.
    stage.key("r");
    stage.xdotool(&["keydown", "w"]);
    let closer = stage.changes("a flight forward", &plain, PICTURE);
    stage.xdotool(&["keyup", "w"]);
    stage.xdotool(&["mousemove", "--window", &stage.window, "400", "250"]);
    stage.xdotool(&["mousedown", "1"]);
    stage.xdotool(&["mousemove", "--window", &stage.window, "340", "230"]);
    stage.xdotool(&["mouseup", "1"]);
    let turned = stage.changes("a turn", &closer, PICTURE);
    std::thread::sleep(Duration::from_millis(600));
    stage.key("r");
    let path = stage.path("path-0001.json");
    until("a camera path", || Flight::load(&path).ok());
    stage.key("p");
    stage.changes("the path", &turned, PICTURE);

    // Coordinates, on foot, home.
    stage.key("g");
    // The field takes what is typed from the frame on that shows it.
    std::thread::sleep(Duration::from_millis(1500));
    stage.xdotool(&["type", "16,16,60"]);
    let asked = stage.shot();
    stage.key("Return");
    let there = stage.changes("the place", &asked, PICTURE);
    stage.xdotool(&["mousemove", "--window", &stage.window, "380", "200"]);
    stage.xdotool(&["click", "--repeat", "2", "--delay", "120", "1"]);
    let near = stage.changes("the point of a double-click", &there, PICTURE);
    stage.key("v");
    let walk = stage.changes("the ground", &near, PICTURE);
    stage.key("Home");
    stage.changes("home", &walk, PICTURE);

    // A picture of what is loaded in full.
    stage.key("F12");
    let file = stage.path("brickfell-0001.png");
    until("a screenshot", || {
        let image = image::open(&file).ok()?;
        (image.width() == 480).then_some(())
    });

    // Another size, hidden, shown again.
    stage.xdotool(&["windowsize", &stage.window, "300", "200"]);
    until("another size", || {
        let shot = stage.shot();
        (shot.width == 300 && shot.colors() > 200).then_some(())
    });
    stage.xdotool(&["windowunmap", &stage.window]);
    std::thread::sleep(Duration::from_millis(500));
    stage.xdotool(&["windowmap", &stage.window]);
    stage.xdotool(&["windowsize", &stage.window, "480", "360"]);
    until("the old size", || {
        let shot = stage.shot();
        (shot.width == 480 && shot.colors() > 200).then_some(())
    });

    stage.xdotool(&["windowfocus", &stage.window]);
    let folder = stage.quit();
    let settings = fs::read_to_string(folder.path().join("config/brickfell/view.json")).unwrap();
    assert!(settings.contains("\"hud\": false"), "{settings}");
}

#[test]
fn a_scene_that_changes_is_opened_again_and_a_broken_one_is_not() {
    if !installed(&TOOLS) {
        return;
    }
    let stage = Stage::open(&["--gpu"], "1.5");
    stage.key("Tab");
    std::thread::sleep(Duration::from_millis(500));

    // What else than the terrain can be shown.
    let mut before = stage.shot();
    for key in ["2", "4", "7", "1"] {
        stage.key(key);
        before = stage.changes(key, &before, PICTURE);
    }
    let scene = stage.db.path().join("scene.xml");
    let sound = fs::read_to_string(&scene).unwrap();
    fs::write(&scene, "<PagedScene").unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    assert!(stage.shot().colors() > 200, "the old scene is gone");
    // A single tree of it.
    let tree = sound.find("<PagedOctTree").unwrap();
    let end = sound.rfind("</").unwrap();
    let first = &sound[tree..][..sound[tree..].find('>').unwrap() + 1];
    assert!(first.ends_with("/>"), "{first}");
    fs::write(&scene, format!("{}{first}{}", &sound[..tree], &sound[end..])).unwrap();
    stage.changes("a smaller scene", &before, [0, 0, 480, 360]);
    stage.quit();
}

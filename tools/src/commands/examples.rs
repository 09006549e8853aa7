//! The examples at the end of each command's help. A test of the program holds that all of them are understood.

/// Of `build`.
pub const BUILD: &str = "\
Examples:
  A height map in feet with an aerial picture, and a model that stands on it
    brickfell build house.obj --heights ground.tif --imagery ortho.tif --height-unit ft --voxel 0.5 --out db
  Models at the places of a list, with 4 GiB of memory
    brickfell build --heights ground.tif --place trees.csv --memory 4GiB --out db";

/// Of `fly`.
pub const FLY: &str = "\
Examples:
  An orbit, each frame settled: pictures, an overview and a report
    brickfell fly db --settle --frames 24 --size 640x360 --out flight
  A path in real time, 30 ms a frame, over a hundred kilometres that nobody built
    brickfell fly 'procedural:1?extent=100km' --path path.json --target-ms 30 --out flight --trace trace.json
  For scripts: the summary alone
    brickfell fly db --settle --out flight --quiet --json";

/// Of `view`.
pub const VIEW: &str = "\
Examples:
  A window, and a path to fly with P
    brickfell view db --path path.json --shots pictures";

/// Of `render`.
pub const RENDER: &str = "\
Examples:
  One picture
    brickfell render db --eye 0,-200,150 --target 100,100,0 --out picture.png
  The same of what the database was built from
    brickfell render db --truth house.obj --heights ground.tif --eye 0,-200,150 --target 100,100,0 --out truth.png";

/// Of `compare`.
pub const COMPARE: &str = "\
Examples:
  How far a picture is from the truth, and where
    brickfell compare picture.png truth.png --out difference.png
  For scripts
    brickfell compare picture.png truth.png --json";

/// Of `convert`.
pub const CONVERT: &str = "\
Examples:
  The octrees to be read and edited
    brickfell convert db --octrees xml --out readable
  A level for other programs
    brickfell convert db --level 4 --out surface.obj";

/// Of `info`.
pub const INFO: &str = "\
Examples:
  For people, and for scripts
    brickfell info db
    brickfell info db --json";

/// Of `inspect`.
pub const INSPECT: &str = "\
Examples:
  All of it, or the outermost groups alone
    brickfell inspect db
    brickfell inspect db --depth 1
  For scripts
    brickfell inspect db --json";

/// Of `slice`.
pub const SLICE: &str = "\
Examples:
  A cut across the y axis at 50 m
    brickfell slice db --axis y --at 50 --out cut.png
  A map, a pixel a metre
    brickfell slice db --top --voxel 1 --checker --out map.png
  Level 4 of one tree
    brickfell slice db --axis z --at 12.5 --tree trees/a.oct --level 4 --out cut.png";

/// Of `check`.
pub const CHECK: &str = "\
Examples:
  For people, and for scripts
    brickfell check db
    brickfell check db --quiet --json";

/// Of `stats`.
pub const STATS: &str = "\
Examples:
  What paging did on a flight
    brickfell fly db --out flight --trace trace.json
    brickfell stats trace.json";

/// Of `bench`.
pub const BENCH: &str = "\
Examples:
  One suite
    brickfell bench caster --quick --out results
  Time against error on a scene of your own
    brickfell bench truth --scene db --input house.obj --heights ground.tif --out results";

/// Of `demo`.
pub const DEMO: &str = "\
Examples:
  A terrain, and its database
    brickfell demo --out demo
    brickfell build demo/trees.obj demo/buildings.obj --heights demo/heights.png --imagery demo/imagery.png --voxel 0.25 --out db";

/// Of `new`.
pub const NEW: &str = "\
Examples:
  A scene to begin with, and a flight around it
    brickfell new scene
    brickfell fly scene --settle --out flight";

/// Of `completions`.
pub const COMPLETIONS: &str = "\
Examples:
  For bash, zsh and fish
    brickfell completions bash > ~/.local/share/bash-completion/completions/brickfell
    brickfell completions zsh > ~/.zfunc/_brickfell
    brickfell completions fish > ~/.config/fish/completions/brickfell.fish";

/// Of `man`.
pub const MAN: &str = "\
Examples:
  For your own account
    brickfell man --out ~/.local/share/man/man1
    man brickfell-build";

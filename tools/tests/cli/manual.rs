//! The manual's list of commands and options is what the program says of itself.

use std::fs;
use std::path::Path;

use crate::common::brickfell;

const HEAD: &str = "# Commands and options

What `brickfell COMMAND --help` says, of all commands. Written by
`BRICKFELL_WRITE=1 cargo test -p brickfell --test cli manual`, which fails where this is out of date.
";

#[test]
fn the_manual_has_every_option() {
    let help = brickfell(["--help"]);
    let commands = help.success().split("Commands:\n").nth(1).unwrap();
    let names = (commands.lines().take_while(|line| !line.is_empty()))
        .filter_map(|line| line.strip_prefix("  ")?.split(' ').next())
        .filter(|name| !name.is_empty() && *name != "help");
    let mut text = HEAD.to_string();
    for name in names {
        let help = brickfell([name, "--help"]);
        let lines = help.success().lines().map(str::trim_end);
        let help = lines.collect::<Vec<_>>().join("\n");
        text += &format!("\n## brickfell {name}\n\n```text\n{help}\n```\n");
    }
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/commands.md");
    if std::env::var_os("BRICKFELL_WRITE").is_some() {
        fs::write(&file, &text).unwrap();
    }
    let written = fs::read_to_string(&file).unwrap_or_default();
    assert!(
        written == text,
        "docs/commands.md is out of date; BRICKFELL_WRITE=1 writes it anew"
    );
}

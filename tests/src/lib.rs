//! Tests that cross crates are in `tests/tests/`: builder, formats, pager, both renderers together.
//!
//! Cargo wants a library in every package; this one has nothing in it. What a user sees of the program is tested in
//! `tools/tests/cli`, where cargo gives tests the program's path.

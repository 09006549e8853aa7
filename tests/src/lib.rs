//! Tests that cross crates are in `tests/tests/`: builder, formats, pager, both renderers together. What they share is here.
//! What a user sees of the program is tested in `tools/tests/cli`, where cargo gives tests the program's path.
//!
//! | module | what |
//! |---|---|
//! | [`exact`] | a test binary run once more with exact texture filtering |
//! | [`pictures`] | how far two pictures are apart |
//! | [`world`] | a terrain with both its renderers |
//! | [`demo`] | the generated demo terrain, built once for each set of arguments |
//! | [`trees`] | small trees made in memory from closures |
//!
//! Helpers panic with what went wrong: they are called by tests only, from any thread.
#![allow(
    clippy::unwrap_used,
    reason = "a helper that fails ends the test that called it"
)]

pub mod demo;
pub mod exact;
pub mod pictures;
pub mod trees;
pub mod world;

//! The program from outside: what it prints, its exit codes, the files it leaves, and what it does about bad input.
//!
//! Every fault ends in one line that names file and place, an exit code other than 0, and nothing overwritten. Tests that
//! draw need a Vulkan adapter and fail without one.

#![allow(
    clippy::unwrap_used,
    reason = "helpers are parts of tests: a panic is their way to fail"
)]

mod build;
mod check;
mod common;
mod compare;
mod compress;
mod convert;
mod fly;
mod info;
mod inputs;
mod inspect;
mod manual;
mod new;
mod paging;
mod rasters;
mod resume;
mod schema;
mod scripts;
mod slice;
mod view;

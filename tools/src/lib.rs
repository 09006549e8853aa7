//! brickfell's tools: the builder and the program's commands.

pub mod bench;
pub mod build;
pub mod commands;
pub mod flight;
pub mod holes;
pub mod input;
pub mod metrics;
mod noise;
pub mod picture_file;
pub mod report;
pub(crate) mod trace;
pub mod truth;
pub mod view;

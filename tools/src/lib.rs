//! brickfell's tools: the builder and the program's commands.

pub mod build;
pub mod commands;
pub mod input;
pub mod flight;
pub mod holes;
pub mod picture_file;
pub mod report;
pub mod bench;
mod noise;

//! Placeholder.
pub mod input;

//! Tests of the formats through their public interface, one program: what they share is compiled once.

mod blocks;
mod bricks;
mod common;
mod damage;
mod examples;
mod layout;
mod octree;
mod scene;

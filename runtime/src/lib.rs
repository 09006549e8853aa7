//! GPU runtime of brickfell: pools, uploads, ray caster, feedback and frame loop, and the CPU reference.

pub mod picture;
pub mod reference;
pub mod settings;

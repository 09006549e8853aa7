//! Trees in memory as references, and single rays through them.

use std::sync::Arc;

use glam::DVec3;

use super::{Reference, ReferenceError, Scene};
use crate::march::Lens;
use crate::picture::RayCounters;
use crate::settings::RenderSettings;
pub(super) use crate::testing::*;

impl Store {
    /// A reference of the named trees.
    pub(super) fn open(self, names: &[&str]) -> Reference {
        self.try_open(names).unwrap()
    }

    /// A reference of the named trees, or why not.
    pub(super) fn try_open(self, names: &[&str]) -> Result<Reference, ReferenceError> {
        Reference::new(
            Arc::new(self.0),
            &names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>(),
        )
    }
}

/// One ray: colour and counters. `footprint` is a pixel's size in metres per metre of depth, bias included.
pub(super) fn shoot(
    reference: &Reference,
    eye: DVec3,
    direction: DVec3,
    footprint: f64,
    fade: f64,
) -> ([f64; 4], RayCounters) {
    let settings = RenderSettings::default();
    let lens = Lens {
        eye,
        footprint,
        fade,
        segment: settings.segment(),
    };
    let scene = Scene::through(reference, DVec3::Y, lens, &settings);
    let mut counters = RayCounters::default();
    let rgba = scene
        .cast(direction, f64::INFINITY, &mut Vec::new(), &mut counters)
        .unwrap();
    assert!(
        rgba.iter().all(|c| c.is_finite()) && (0.0..=1.0).contains(&rgba[3]),
        "{eye} {direction}: {rgba:?}"
    );
    assert_eq!(
        (counters.capped, counters.not_finite),
        (0, 0),
        "{eye} {direction}"
    );
    (rgba, counters)
}

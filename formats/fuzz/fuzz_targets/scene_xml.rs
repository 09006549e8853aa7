//! Any bytes as a scene: no panic, and what is read round-trips.
#![no_main]

use brickfell_formats::scene::Scene;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    match Scene::parse(data) {
        Ok(scene) => assert_eq!(Scene::parse(scene.to_xml().as_bytes()), Ok(scene)),
        Err(e) => assert!(!e.to_string().contains('\n')),
    }
});

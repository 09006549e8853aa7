//! The counters that every picture of these tests finds at 0 can count; what no ray comes to is in use nevertheless.

use std::sync::Arc;

use brickfell_formats::chunk::Layers;
use brickfell_runtime::caster::{Caster, Feedback, Kernel, REQUEST_CAPACITY};
use brickfell_runtime::memory::{PoolMemory, PoolSizes};
use brickfell_runtime::reference::Reference;
use brickfell_shaders::layout;

use super::*;

#[test]
fn pixels_that_are_not_finite_are_counted() {
    exactly("counters::pixels_that_are_not_finite_are_counted", || {
        let Stage {
            world, mut renderer, ..
        } = Stage::new(neighbours());
        let camera = look(DVec3::new(-30.0, -20.0, 20.0), DVec3::new(1.0, 1.0, -0.6), 40, 30);
        let plain = RenderSettings::default();
        renderer.settle(&camera, &plain).unwrap();
        let hits = renderer.feedback().counters.rays_hit;
        let reference = Reference::new(Arc::clone(&world.store), &world.trees).unwrap();
        // Light that is finite in f64 but not in f32, and light that is finite but for the sum of its two kinds.
        for light in [1e39, f64::MAX] {
            let settings = RenderSettings {
                ambient: light,
                diffuse: light,
                ..plain
            };
            renderer.settle(&camera, &settings).unwrap();
            let gpu = (renderer.read_picture().unwrap(), renderer.feedback().counters);
            for (picture, counters) in [gpu, reference.render(&camera, &settings).unwrap()] {
                let counted = counters.not_finite;
                assert!(counted > hits / 2 && counted <= hits, "{counted} of {hits}");
                let mut components = picture.pixels.as_flattened().iter();
                assert!(components.all(|c| c.abs() < 1e6), "none reaches the picture");
            }
        }
    });
}

/// Casts 8×8 rays through one tree of a single empty brick, with a cap on their steps. Segments of up to two voxels pass over
/// what is empty, longer ones are sampled.
fn cast(segment_shift: u32, max_steps: u32) -> Feedback {
    let gpu = world::gpu();
    let sizes = PoolSizes::fit(1 << 20, Centre, Layers::Plain, false, &gpu.device.limits()).unwrap();
    let mut memory = PoolMemory::new(&gpu, sizes).unwrap();
    let mut caster = Caster::new(&gpu, &memory).unwrap();
    (caster.prepare(&gpu, &memory, [8, 8], Kernel::default(), None)).unwrap();
    let frame = layout::Frame {
        size: [8, 8],
        tree_count: 1,
        frame: 1,
        screen_origin: [-0.0875; 2],
        screen_step: [0.025; 2],
        forward: [1.0, 0.0, 0.0, 0.0],
        right: [0.0, -1.0, 0.0, 0.0],
        up: [0.0, 0.0, 1.0, 0.0],
        footprint: 1e-3,
        fade: 1.0,
        slots: [sizes.slots[0], sizes.slots[1], sizes.slots[2], 0],
        texel: [0.0; 4],
        brick_slots: sizes.bricks(),
        node_tiles: sizes.tiles,
        request_capacity: REQUEST_CAPACITY,
        request_share: 1,
        segment_shift,
        segment_samples: 1,
        slot: [10, 10, 10, 0],
        ..Default::default()
    };
    // Eight voxels of a metre, from 1 m before the eye.
    let tree = layout::Tree {
        base: [0.0, 0.5, 0.5],
        cell: [-1, 4, 4],
        inv_voxel: 1.0,
        root: 8,
        gain: 1.0,
        texel_offset: 1.0,
        rim: 1,
        max_steps,
        high: [8; 3],
        ..Default::default()
    };
    let mut encoder = gpu.device.create_command_encoder(&Default::default());
    let root = [8, layout::TERMINAL | layout::BRICK, 1, 0];
    memory.upload(&gpu, &mut encoder, &[root], &[], None);
    let entry = caster.encode(&gpu, &mut encoder, &frame, &[tree]).unwrap();
    gpu.queue.submit([encoder.finish()]);
    caster.submitted(entry);
    gpu.wait().unwrap();
    loop {
        if let Some(feedback) = caster.collect(&gpu, &memory).pop() {
            return feedback;
        }
        std::thread::yield_now();
    }
}

#[test]
fn rays_that_need_more_steps_than_their_cap_are_counted() {
    exactly(
        "counters::rays_that_need_more_steps_than_their_cap_are_counted",
        || {
            assert_eq!(cast(2, 96).counters.capped, 0);
            assert_eq!(cast(2, 1).counters.capped, 64);
        },
    );
}

#[test]
fn what_rays_begin_behind_is_in_use() {
    exactly("counters::what_rays_begin_behind_is_in_use", || {
        let feedback = cast(0, 1);
        assert_eq!(feedback.counters.capped, 0, "a ray came to the brick");
        assert_eq!((feedback.used_bricks[0], feedback.used_tiles[0]), (1, 1 << 1));
    });
}

//! Counts the allocations of frames: none, once the culler's vectors have grown.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use brickfell_culler::{Aabb, Camera, Culler, Cut, Expiry, GroupId, Readiness, SceneGraph, TreeId};
use glam::{DVec3, dvec3};

/// The system's allocator, with a count per thread.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

fn count() {
    // A thread that is going away has nothing to count for.
    let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
}

#[allow(
    unsafe_code,
    reason = "an allocator cannot be counted otherwise; it passes everything on"
)]
// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: as above.
        unsafe { System.realloc(pointer, layout, size) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// A quadtree of groups over 64 × 64 trees, with coarse trees in all groups but the root.
fn scene() -> Result<SceneGraph, Box<dyn std::error::Error>> {
    let mut builder = SceneGraph::builder();
    let mut open = vec![(GroupId::ROOT, DVec3::ZERO, 64.0)];
    let mut next = 0;
    while let Some((group, low, size)) = open.pop() {
        for k in 0..4 {
            let half = size / 2.0;
            let low = low + dvec3(f64::from(k % 2), f64::from(k / 2), 0.0) * half;
            let bounds = Aabb::new(low, low + dvec3(half, half, 1.0))?;
            if half == 1.0 {
                builder.add_tree(Some(group), TreeId(next), bounds)?;
            } else {
                let inner = builder.add_group(Some(group))?;
                builder.add_coarse(inner, TreeId(next), bounds, half / 16.0)?;
                open.push((inner, low, half));
            }
            next += 1;
        }
    }
    Ok(builder.finish())
}

#[test]
fn frames_allocate_nothing_once_they_have_been_flown() {
    let scene = scene().unwrap();
    let mut culler = Culler::new();
    let mut expiry = Expiry::default();
    culler.set_prefetch_margin(5.0);
    let mut fly = |frames: u64| {
        let before = ALLOCATIONS.get();
        for frame in frames..frames + 200 {
            let angle = (frame % 200) as f64 * 0.05;
            let eye = dvec3(32.0 + 20.0 * angle.cos(), 32.0 + 20.0 * angle.sin(), 3.0);
            let camera = Camera::look_at(eye, dvec3(32.0, 32.0, 0.0), 60.0, 640, 360).unwrap();
            let cut = Cut {
                footprint: camera.pixel_size() * 4.0,
                readiness: &|tree| match tree.0 % 5 {
                    0 => Readiness::Awaited,
                    _ => Readiness::Ready,
                },
            };
            let result = culler.cull_cut(&scene, &camera, &cut, frame);
            for tree in result.visible.iter().chain(&result.wanted) {
                expiry.touch(tree.tree, frame);
            }
            expiry.expire(frame, 30, |_| ());
        }
        ALLOCATIONS.get() - before
    };
    assert!(fly(0) > 0, "the first frames make the vectors grow");
    assert_eq!(fly(200), 0);
}

//! Asks for what the camera is about to see: the trees in view from where it will be if it goes on as it does.
//!
//! From the camera's last three places follows whether it goes on steadily; if it rests, jumps or turns back nothing is asked
//! for. What is in view from the place ahead is cut as the picture is, so a group that will still be far is asked for by
//! its coarse trees. Roots and levels by footprint are asked for, not chunks: which of those are seen only rays know, and they
//! come soon once it is known where they are. Owned by the render thread; once a frame, between the requests and
//! [`Pager::submit`].

use brickfell_culler::{Camera, Culler, Cut, Readiness, SceneGraph};
use glam::DVec3;

use crate::page::PageKey;
use crate::pager::Pager;

/// Frames to look ahead: about what a page takes that waits behind others.
const FRAMES: f64 = 30.0;
/// How much of a step may be new for the motion to be steady.
const STEADY: f64 = 0.5;

/// Where the camera was, and what it will see.
#[derive(Debug, Default)]
pub struct Lookahead {
    culler: Culler,
    last: Option<DVec3>,
    step: DVec3,
}

impl Lookahead {
    /// Asks the pager for what is in view from where the camera will be; `footprint` is as in [`Cut`]. Gives the trees
    /// asked for.
    pub fn ask(&mut self, pager: &mut Pager, scene: &SceneGraph, camera: &Camera, footprint: f64) -> usize {
        let step = self.last.map_or(DVec3::ZERO, |last| camera.eye - last);
        self.last = Some(camera.eye);
        let before = std::mem::replace(&mut self.step, step);
        if step == DVec3::ZERO || step.distance(before) > step.length() * STEADY {
            return 0;
        }
        let ahead = Camera {
            eye: camera.eye + step * FRAMES,
            ..*camera
        };
        let seen = {
            let pager: &Pager = pager;
            let cut = Cut {
                footprint,
                // What will be there: whatever is given up will not.
                readiness: &|tree| match pager.is_failed(PageKey::Root(tree)) {
                    true => Readiness::Failed,
                    false => Readiness::Ready,
                },
            };
            self.culler.cull_cut(scene, &ahead, &cut, 0)
        };
        for tree in &seen.visible {
            pager.prefetch_levels(tree.tree, tree.distance * footprint, tree.distance);
        }
        seen.visible.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{config, pager, root, store};
    use brickfell_culler::{Aabb, TreeId};
    use glam::dvec3;

    #[test]
    fn trees_ahead_are_asked_for_while_the_camera_goes_steadily() {
        let store = store(&[2; 40]);
        let mut pager = pager(&store, 40, config(1 << 30, 2));
        let mut builder = SceneGraph::builder();
        for id in 0..40 {
            let low = dvec3(f64::from(id) * 16.0, 0.0, 0.0);
            builder
                .add_tree(None, TreeId(id), Aabb::new(low, low + 16.0).unwrap())
                .unwrap();
        }
        let scene = builder.finish();
        let mut lookahead = Lookahead::default();
        let mut frame = 0;
        let mut go = |x: f64| {
            // Looks down, so that it sees what is below it and nothing else.
            let eye = dvec3(x, 8.0, 40.0);
            let camera = Camera::look_at(eye, eye - DVec3::Z, 40.0, 64, 64).unwrap();
            frame += 1;
            pager.merge(frame);
            let asked = lookahead.ask(&mut pager, &scene, &camera, 0.01);
            pager.submit();
            while !pager.is_idle() {
                pager.wait_for_progress(std::time::Duration::from_secs(20));
                frame += 1;
                pager.merge(frame);
            }
            let there: Vec<u32> = (0..40).filter(|k| pager.tree(TreeId(*k)).is_some()).collect();
            assert!(there.iter().all(|k| !pager.is_failed(root(*k))));
            (asked, there)
        };
        assert_eq!(go(100.0), (0, vec![]), "no motion yet");
        assert_eq!(go(101.0), (0, vec![]), "a first step may be a jump");
        let (asked, there) = go(102.0);
        // 30 m ahead of 102 m.
        assert!(
            asked > 0 && there.contains(&8) && !there.contains(&4),
            "{there:?}"
        );
        assert_eq!(go(102.0).0, 0, "at rest");
        assert_eq!(go(400.0).0, 0, "a jump");
        assert_eq!(go(399.0).0, 0, "back again");
        let (asked, there) = go(398.0);
        assert!(asked > 0 && there.contains(&23), "{there:?}");
    }
}

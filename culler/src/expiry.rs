//! Which trees were not used for a while, at the cost of those in use.
//!
//! The culler stamps what it sees; this keeps what somebody holds on to because it was seen: a list of the trees in use and
//! the frame of each one's last use. Going through the list costs as much as there are trees in use, however large the
//! terrain. Owned by the render thread.
//!
//! Invariant: a tree is in the list exactly if its stamp is not `UNUSED`.

use crate::scene::TreeId;

const UNUSED: u64 = u64::MAX;

/// The trees in use and their last-access stamps.
#[derive(Clone, Debug, Default)]
pub struct Expiry {
    /// By tree id, the frame of the last use, or `UNUSED`.
    stamps: Vec<u64>,
    in_use: Vec<TreeId>,
}

impl Expiry {
    /// Notes that a tree is used in this frame.
    pub fn touch(&mut self, tree: TreeId, frame: u64) {
        let at = tree.0 as usize;
        if self.stamps.len() <= at {
            self.stamps.resize(at + 1, UNUSED);
        }
        if std::mem::replace(&mut self.stamps[at], frame.min(UNUSED - 1)) == UNUSED {
            self.in_use.push(tree);
        }
    }

    /// Takes out the trees that were last used more than `keep` frames before `frame`, and calls with each of them.
    pub fn expire(&mut self, frame: u64, keep: u64, mut expired: impl FnMut(TreeId)) {
        let Self { stamps, in_use } = self;
        in_use.retain(|tree| {
            let stamp = &mut stamps[tree.0 as usize];
            let keeps = frame.saturating_sub(*stamp) <= keep;
            if !keeps {
                *stamp = UNUSED;
                expired(*tree);
            }
            keeps
        });
    }

    /// Number of trees in use.
    pub fn len(&self) -> usize {
        self.in_use.len()
    }

    /// Whether no tree is in use.
    pub fn is_empty(&self) -> bool {
        self.in_use.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn behaves_like_a_map_of_stamps(steps in proptest::collection::vec((0u32..20, 0u64..3, any::<bool>()), 0..200)) {
            let (mut expiry, mut model) = (Expiry::default(), BTreeMap::new());
            let mut frame = 0;
            for (tree, pause, expires) in steps {
                frame += pause;
                if expires {
                    let mut gone = Vec::new();
                    expiry.expire(frame, 4, |tree| gone.push(tree.0));
                    let expected: Vec<u32> = model.iter().filter(|(_, at)| frame - **at > 4).map(|(t, _)| *t).collect();
                    model.retain(|_, at| frame - *at <= 4);
                    gone.sort_unstable();
                    prop_assert_eq!(gone, expected);
                } else {
                    expiry.touch(TreeId(tree), frame);
                    model.insert(tree, frame);
                }
                prop_assert_eq!(expiry.len(), model.len());
            }
        }
    }
}

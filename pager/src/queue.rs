//! The waiting jobs in order of urgency, with a limit on the loaders that read one file at a time.
//!
//! One heap per file and one heap over the files' most urgent jobs: taking a job is O(log n), building the queue O(n),
//! and a file whose limit is reached is stepped over without looking at its other jobs. A plain value; the pager keeps its own
//! behind the lock it shares with the loaders.

use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap};

/// How urgent a job is; the smallest is taken first.
#[derive(Clone, Copy, Debug)]
pub struct Urgency {
    /// Roots before everything else.
    pub class: u8,
    /// The caller's priority, for instance a distance. NaN is last.
    pub priority: f64,
    /// Ties: coarse before fine, levels before chunks.
    pub order: u16,
    /// Ties of those: any stable number.
    pub slot: u32,
}

impl Ord for Urgency {
    fn cmp(&self, other: &Self) -> Ordering {
        let last = |p: f64| if p.is_nan() { f64::INFINITY } else { p };
        (self.class.cmp(&other.class))
            .then(last(self.priority).total_cmp(&last(other.priority)))
            .then(self.order.cmp(&other.order))
            .then(self.slot.cmp(&other.slot))
    }
}

impl PartialOrd for Urgency {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Urgency {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Urgency {}

/// A value in a heap from which the most urgent is taken first.
#[derive(Debug)]
struct Ranked<T>(Urgency, T);

impl<T> Ord for Ranked<T> {
    fn cmp(&self, other: &Self) -> Ordering {
        other.0.cmp(&self.0)
    }
}

impl<T> PartialOrd for Ranked<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> PartialEq for Ranked<T> {
    fn eq(&self, other: &Self) -> bool {
        self.0 == other.0
    }
}

impl<T> Eq for Ranked<T> {}

/// Whether a job may be taken now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Take it.
    Take,
    /// Look at the jobs of other files.
    SkipFile,
    /// Take nothing: what comes later must not overtake this job.
    Wait,
}

/// Jobs of type `J`, each of a file.
#[derive(Debug)]
pub struct Queue<J> {
    files: HashMap<u64, BinaryHeap<Ranked<J>>>,
    heads: BinaryHeap<Ranked<u64>>,
    len: usize,
}

impl<J> Default for Queue<J> {
    fn default() -> Self {
        Self {
            files: HashMap::new(),
            heads: BinaryHeap::new(),
            len: 0,
        }
    }
}

impl<J> Queue<J> {
    /// A queue of jobs, each with its urgency and its file.
    pub fn new(jobs: impl IntoIterator<Item = (Urgency, u64, J)>) -> Self {
        let mut lists: HashMap<u64, Vec<Ranked<J>>> = HashMap::new();
        let mut len = 0;
        for (urgency, file, job) in jobs {
            lists.entry(file).or_default().push(Ranked(urgency, job));
            len += 1;
        }
        let files: HashMap<u64, BinaryHeap<Ranked<J>>> = lists
            .into_iter()
            .map(|(file, list)| (file, list.into()))
            .collect();
        Self {
            heads: heads(&files),
            files,
            len,
        }
    }

    /// Keeps the jobs that the test lets through.
    pub fn retain(&mut self, mut keep: impl FnMut(&J) -> bool) {
        self.files.retain(|_, jobs| {
            jobs.retain(|job| keep(&job.1));
            !jobs.is_empty()
        });
        self.heads = heads(&self.files);
        self.len = self.files.values().map(BinaryHeap::len).sum();
    }

    /// The most urgent job.
    pub fn peek(&self) -> Option<&J> {
        let head = self.heads.peek()?;
        self.files.get(&head.1)?.peek().map(|job| &job.1)
    }

    /// Number of jobs.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no job.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Takes the most urgent job that the verdict lets through.
    pub fn take(&mut self, mut verdict: impl FnMut(u64, &J) -> Verdict) -> Option<(u64, J)> {
        let mut aside = Vec::new();
        let mut taken = None;
        while let Some(head) = self.heads.pop() {
            let file = head.1;
            let Some(jobs) = self.files.get_mut(&file) else {
                continue;
            };
            let decision = jobs.peek().map_or(Verdict::SkipFile, |job| verdict(file, &job.1));
            if decision != Verdict::Take {
                aside.push(head);
                if decision == Verdict::Wait {
                    break;
                }
                continue;
            }
            taken = jobs.pop().map(|job| (file, job.1));
            match jobs.peek() {
                Some(next) => self.heads.push(Ranked(next.0, file)),
                None => drop(self.files.remove(&file)),
            }
            break;
        }
        self.heads.extend(aside);
        self.len -= usize::from(taken.is_some());
        taken
    }
}

fn heads<J>(files: &HashMap<u64, BinaryHeap<Ranked<J>>>) -> BinaryHeap<Ranked<u64>> {
    files
        .iter()
        .filter_map(|(file, jobs)| Some(Ranked(jobs.peek()?.0, *file)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn urgency(priority: f64, slot: u32) -> Urgency {
        Urgency {
            class: 1,
            priority,
            order: 0,
            slot,
        }
    }

    #[test]
    fn nan_is_last_and_roots_are_first() {
        let mut all = [
            urgency(f64::NAN, 0),
            urgency(f64::INFINITY, 1),
            urgency(-0.0, 2),
            urgency(5.0, 3),
        ];
        all[3].class = 0;
        all.sort();
        assert_eq!(all.map(|u| u.slot), [3, 2, 0, 1]);
    }

    #[test]
    fn a_blocked_file_is_looked_at_once_and_not_job_by_job() {
        let jobs = (0..10_000u32).map(|k| {
            (
                urgency(f64::from(k.wrapping_mul(2654435761)), k),
                u64::from(k % 100),
                k,
            )
        });
        let mut queue = Queue::new(jobs);
        let (mut looks, mut most) = (0, 0);
        while queue
            .take(|file, _| {
                looks += 1;
                match file {
                    7 => Verdict::SkipFile,
                    _ => Verdict::Take,
                }
            })
            .is_some()
        {
            most = most.max(std::mem::take(&mut looks));
        }
        assert_eq!(queue.len(), 100);
        assert!(most <= 2, "{most} jobs looked at for one");
    }

    #[test]
    fn what_is_not_kept_is_not_taken() {
        let mut queue = Queue::new((0..20u32).map(|k| (urgency(f64::from(k), k), u64::from(k % 3), k)));
        queue.retain(|k| k % 2 == 1 && k % 3 != 0);
        assert_eq!((queue.len(), queue.peek()), (7, Some(&1)));
        let taken: Vec<u32> = std::iter::from_fn(|| queue.take(|_, _| Verdict::Take))
            .map(|(_, k)| k)
            .collect();
        assert_eq!(taken, [1, 5, 7, 11, 13, 17, 19]);
    }

    proptest! {
        #[test]
        fn takes_in_order_like_a_sorted_list(
            jobs in proptest::collection::vec((0u8..5, 0u64..4), 0..60),
            blocked in 0u64..5,
            wait_at in 0usize..60,
        ) {
            let jobs: Vec<(Urgency, u64, usize)> = jobs
                .iter()
                .enumerate()
                .map(|(k, (p, file))| (urgency(f64::from(*p), k as u32), *file, k))
                .collect();
            let mut model = jobs.clone();
            model.sort_by_key(|job| job.0);
            model.retain(|(_, file, _)| *file != blocked);
            let mut queue = Queue::new(jobs.clone());
            let mut taken = Vec::new();
            while let Some((_, k)) = queue.take(|file, k| match () {
                () if file == blocked => Verdict::SkipFile,
                () if *k == wait_at => Verdict::Wait,
                () => Verdict::Take,
            }) {
                taken.push(k);
            }
            let expected: Vec<usize> = model.iter().map(|(_, _, k)| *k).take_while(|k| *k != wait_at).collect();
            prop_assert_eq!(&taken, &expected);
            prop_assert_eq!(queue.len(), jobs.len() - taken.len());
        }
    }
}

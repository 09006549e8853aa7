//! Where the ground is: a thread that casts single rays through the database's files, so that the window never waits for them.
//!
//! It answers the newest question of each kind; older ones that nobody asks any more are not answered. What its rays have read is let go from
//! time to time, since the reference keeps all of it.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::thread;

use brickfell_formats::scene::Scene;
use brickfell_pager::Store;
use brickfell_runtime::reference::Reference;
use glam::DVec3;

/// Answers after which what was read is let go.
const ANSWERS: usize = 4096;
/// How far above a place a ray starts that looks for its ground: steps up to that height are taken.
const STEP: f64 = 2.5;
/// A ray's footprint per metre.
const FOOTPRINT: f64 = 0.002;

/// Something to find out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Question {
    /// Height of the ground below a place.
    Ground(DVec3),
    /// What a ray from a point meets.
    Point(DVec3, DVec3),
}

/// A question with its answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Answer {
    /// Height of the ground below a place, if there is any.
    Ground(DVec3, Option<f64>),
    /// What a ray meets, if anything.
    Point(Option<DVec3>),
}

/// The thread's ends.
#[derive(Debug)]
pub(super) struct Probe {
    questions: Sender<Question>,
    answers: Receiver<Answer>,
}

impl Probe {
    /// Starts the thread; it ends with this value. `wake` is called after each answer.
    pub(super) fn new(
        store: Arc<dyn Store>,
        scene: Scene,
        top: f64,
        wake: impl Fn() + Send + 'static,
    ) -> Self {
        let (questions, asked) = channel();
        let (answer, answers) = channel();
        thread::spawn(
            move || {
                while let Ok(()) = answer_some(&store, &scene, top, &asked, &answer, &wake) {}
            },
        );
        Self { questions, answers }
    }

    /// Asks; an answer comes later.
    pub(super) fn ask(&self, question: Question) {
        // A thread that has ended answers nothing.
        let _ = self.questions.send(question);
    }

    /// The answers since the last call.
    pub(super) fn answers(&self) -> impl Iterator<Item = Answer> + '_ {
        self.answers.try_iter()
    }
}

/// Opens the database and answers, until there is nobody to answer or much was read.
fn answer_some(
    store: &Arc<dyn Store>,
    scene: &Scene,
    top: f64,
    asked: &Receiver<Question>,
    answers: &Sender<Answer>,
    wake: &impl Fn(),
) -> Result<(), ()> {
    let first = asked.recv().map_err(|_| ())?;
    let reference = Reference::open(Arc::clone(store), scene).ok();
    let mut newest = [Some(first), None];
    if matches!(first, Question::Point(..)) {
        newest.swap(0, 1);
    }
    for _ in 0..ANSWERS {
        loop {
            match asked.try_recv() {
                Ok(question @ Question::Ground(_)) => newest[0] = Some(question),
                Ok(question @ Question::Point(..)) => newest[1] = Some(question),
                Err(TryRecvError::Empty) if newest.iter().any(Option::is_some) => break,
                Err(TryRecvError::Empty) => match asked.recv() {
                    Ok(question @ Question::Ground(_)) => newest[0] = Some(question),
                    Ok(question @ Question::Point(..)) => newest[1] = Some(question),
                    Err(_) => return Err(()),
                },
                Err(TryRecvError::Disconnected) => return Err(()),
            }
        }
        // What cannot be read is not there.
        let meet = |eye: DVec3, direction: DVec3| {
            let reference = reference.as_ref()?;
            reference.depth(eye, direction, FOOTPRINT).ok().flatten()
        };
        for question in newest.iter_mut().filter_map(Option::take) {
            let answer = match question {
                Question::Ground(place) => {
                    // From a little above; if nothing is below that, the place is itself below the ground.
                    let fall = |z: f64| {
                        let depth = meet(place.with_z(z), DVec3::NEG_Z)?;
                        Some(z - depth)
                    };
                    let ground = fall(place.z + STEP).or_else(|| fall(top.max(place.z) + 1.0));
                    Answer::Ground(place, ground)
                }
                Question::Point(eye, direction) => {
                    let depth = meet(eye, direction);
                    Answer::Point(depth.map(|depth| eye + direction * depth))
                }
            };
            answers.send(answer).map_err(|_| ())?;
            wake();
        }
    }
    Ok(())
}

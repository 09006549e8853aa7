//! Camera paths in the window: recorded while one flies, written as `fly --path` reads them, and flown.

use std::path::{Path, PathBuf};

use glam::DVec3;

use crate::flight::{Flight, FlightError, TimedView};

/// Seconds between two keys of a recorded path.
const INTERVAL: f64 = 0.25;

/// What is recorded, and what is played.
#[derive(Debug, Default)]
pub(super) struct Tape {
    /// The path to be flown.
    path: Option<Flight>,
    /// Seconds since its begin, while it is flown.
    playing: Option<f64>,
    /// Seconds since the begin of a recording, and views with their times.
    recording: Option<(f64, Vec<TimedView>)>,
}

impl Tape {
    /// With a path from a file.
    pub(super) fn new(path: Option<Flight>) -> Self {
        Self {
            path,
            ..Self::default()
        }
    }

    pub(super) fn is_recording(&self) -> bool {
        self.recording.is_some()
    }

    pub(super) fn is_playing(&self) -> bool {
        self.playing.is_some()
    }

    /// Begins or ends to fly the path; false if there is none.
    pub(super) fn play(&mut self) -> bool {
        let start = self.path.is_some().then_some(0.0);
        self.playing = if self.playing.is_some() { None } else { start };
        self.path.is_some()
    }

    /// Stops flying the path.
    pub(super) fn stop(&mut self) {
        self.playing = None;
    }

    /// Begins to record.
    pub(super) fn record(&mut self) {
        self.recording = Some((0.0, Vec::new()));
    }

    /// Ends a recording and writes it to a file that is not there yet; it is the path to be flown from now on.
    ///
    /// # Errors
    /// If there are fewer than two views, or the file cannot be written.
    pub(super) fn finish(&mut self, folder: &Path) -> Result<PathBuf, FlightError> {
        let (_, views) = self.recording.take().unwrap_or_default();
        let file = super::free_file(folder, "path", "json");
        let flight = Flight::from_views(&views, &file)?;
        flight.save(&file)?;
        self.path = Some(flight);
        Ok(file)
    }

    /// Goes on by `dt` seconds from a view; the view of the path that is flown, if one is.
    pub(super) fn advance(&mut self, dt: f64, (eye, target): (DVec3, DVec3)) -> Option<(DVec3, DVec3)> {
        if let Some((seconds, views)) = &mut self.recording {
            if views.last().is_none_or(|(last, ..)| *seconds - last >= INTERVAL) {
                views.push((*seconds, eye, target));
            }
            *seconds += dt;
        }
        let (path, seconds) = (self.path.as_ref()?, self.playing.as_mut()?);
        let view = path.at(*seconds);
        *seconds += dt;
        if *seconds > path.duration() + dt {
            self.playing = None;
        }
        Some(view)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recorded_path_is_flown_as_it_was() {
        let folder = tempfile::tempdir().unwrap();
        let mut tape = Tape::default();
        assert!(!tape.play());
        tape.record();
        let view = |k: f64| (DVec3::new(k, 2.0 * k, 10.0), DVec3::new(k, 100.0, 0.0));
        for k in 0..40 {
            assert_eq!(tape.advance(0.1, view(f64::from(k))), None);
        }
        let file = tape.finish(folder.path()).unwrap();
        assert!(!tape.is_recording() && Flight::load(&file).is_ok());
        assert!(tape.play());
        for k in 0..30 {
            let (eye, _) = tape.advance(0.1, view(0.0)).unwrap();
            // Up to where the recording saw the eye between two keys.
            assert!(eye.distance(view(f64::from(k)).0) < 0.5, "{k}: {eye}");
        }
        for _ in 0..30 {
            tape.advance(0.1, view(0.0));
        }
        assert!(!tape.is_playing());
        // Nothing recorded is no path, and the old one stays.
        tape.record();
        assert!(tape.finish(folder.path()).is_err() && tape.play());
    }
}

//! What keys do in the window: one table, from which the help is made, too. Keys are places on the keyboard, so that WASD is
//! where it is whatever the layout.

use winit::keyboard::KeyCode;

use super::rig::Mode;
use brickfell_runtime::settings::Shows;

/// Something a key does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Action {
    /// While it is down: right, forward, up.
    Go([i8; 3]),
    /// While it is down: faster.
    Fast,
    /// Another kind of movement.
    NextMode,
    /// A kind of movement.
    Mode(Mode),
    /// To where it began.
    Home,
    /// Asks for coordinates.
    GoTo,
    /// Shows or hides the table of keys.
    Help,
    /// Shows or hides figures and sliders.
    Hud,
    /// What is shown instead of the picture; the picture if that is shown already.
    Show(Shows),
    /// Lines around the trees that are drawn.
    Boxes,
    /// Keeps the camera that decides what is drawn.
    Freeze,
    /// Surfaces hide the sun.
    Shadows,
    /// Surfaces hide the sky.
    Occlusion,
    /// A picture, once nothing is loading.
    Screenshot,
    /// Begins or ends a camera path.
    Record,
    /// Flies the path.
    Play,
    /// All of the screen.
    Fullscreen,
    /// Ends.
    Quit,
}

impl Action {
    /// Whether the camera goes elsewhere than along a path that is flown.
    pub(super) fn moves(self) -> bool {
        matches!(
            self,
            Self::Go(_) | Self::NextMode | Self::Mode(_) | Self::Home | Self::GoTo
        )
    }
}

/// A key and what it does.
#[derive(Clone, Copy, Debug)]
pub(super) struct Binding {
    /// The key.
    pub(super) key: KeyCode,
    /// What is written on it.
    pub(super) label: &'static str,
    /// What it does.
    pub(super) action: Action,
    /// The same for the user.
    pub(super) about: &'static str,
}

const fn bind(key: KeyCode, label: &'static str, action: Action, about: &'static str) -> Binding {
    Binding {
        key,
        label,
        action,
        about,
    }
}

/// All keys.
pub(super) const BINDINGS: &[Binding] = &[
    bind(
        KeyCode::KeyW,
        "W",
        Action::Go([0, 1, 0]),
        "forward; closer to the pivot",
    ),
    bind(
        KeyCode::KeyS,
        "S",
        Action::Go([0, -1, 0]),
        "back; away from the pivot",
    ),
    bind(KeyCode::KeyA, "A", Action::Go([-1, 0, 0]), "left"),
    bind(KeyCode::KeyD, "D", Action::Go([1, 0, 0]), "right"),
    bind(KeyCode::KeyE, "E", Action::Go([0, 0, 1]), "up"),
    bind(KeyCode::KeyQ, "Q", Action::Go([0, 0, -1]), "down"),
    bind(
        KeyCode::ShiftLeft,
        "Shift",
        Action::Fast,
        "faster, while it is down",
    ),
    bind(
        KeyCode::KeyC,
        "C",
        Action::NextMode,
        "next kind of movement: fly, orbit, walk",
    ),
    bind(KeyCode::KeyZ, "Z", Action::Mode(Mode::Fly), "fly"),
    bind(
        KeyCode::KeyX,
        "X",
        Action::Mode(Mode::Orbit),
        "orbit what is in the middle",
    ),
    bind(KeyCode::KeyV, "V", Action::Mode(Mode::Walk), "walk on the ground"),
    bind(KeyCode::Home, "Home", Action::Home, "back to where it began"),
    bind(KeyCode::KeyG, "G", Action::GoTo, "go to coordinates"),
    bind(KeyCode::KeyH, "H", Action::Help, "this table"),
    bind(KeyCode::Tab, "Tab", Action::Hud, "figures and sliders"),
    bind(KeyCode::Digit1, "1", Action::Show(Shows::Picture), "the picture"),
    bind(
        KeyCode::Digit2,
        "2",
        Action::Show(Shows::Levels),
        "colours by level",
    ),
    bind(KeyCode::Digit3, "3", Action::Show(Shows::Nodes), "boxes of nodes"),
    bind(
        KeyCode::Digit4,
        "4",
        Action::Show(Shows::Steps),
        "steps of each ray",
    ),
    bind(
        KeyCode::Digit5,
        "5",
        Action::Show(Shows::Residency),
        "what is missing, in red",
    ),
    bind(
        KeyCode::Digit6,
        "6",
        Action::Show(Shows::Trees),
        "colours by the order of trees",
    ),
    bind(KeyCode::Digit7, "7", Action::Show(Shows::Normals), "normals"),
    bind(KeyCode::KeyB, "B", Action::Boxes, "boxes and numbers of trees"),
    bind(
        KeyCode::KeyF,
        "F",
        Action::Freeze,
        "freeze what is drawn, and look at it from outside",
    ),
    bind(KeyCode::KeyL, "L", Action::Shadows, "shadows"),
    bind(KeyCode::KeyO, "O", Action::Occlusion, "ambient occlusion"),
    bind(
        KeyCode::F12,
        "F12",
        Action::Screenshot,
        "screenshot, once nothing is loading",
    ),
    bind(
        KeyCode::KeyR,
        "R",
        Action::Record,
        "begin or end recording a camera path",
    ),
    bind(KeyCode::KeyP, "P", Action::Play, "fly the path"),
    bind(KeyCode::F11, "F11", Action::Fullscreen, "all of the screen"),
    bind(KeyCode::Escape, "Esc", Action::Quit, "quit"),
];

/// What the mouse does, for the table.
pub(super) const MOUSE: &[(&str, &str)] = &[
    ("drag", "look around; turn around the pivot"),
    ("wheel", "speed; in an orbit, distance"),
    ("double-click", "fly to that point"),
];

/// What a key does.
pub(super) fn action(key: KeyCode) -> Option<Action> {
    BINDINGS.iter().find(|b| b.key == key).map(|b| b.action)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_does_two_things() {
        for (k, a) in BINDINGS.iter().enumerate() {
            for b in &BINDINGS[k + 1..] {
                assert!(a.key != b.key && a.label != b.label, "{a:?} {b:?}");
                assert!(a.action != b.action, "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn the_manual_has_all_keys() {
        let manual = include_str!("../../../docs/manual.md");
        let keys = BINDINGS.iter().map(|b| (b.label, b.about));
        for (label, about) in keys.chain(MOUSE.iter().copied()) {
            assert!(manual.contains(&format!("| {label} | {about} |")), "{label}");
        }
    }
}

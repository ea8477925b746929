//! Keys and what they do.

use glam::Vec3;
use winit::keyboard::KeyCode;

use super::look::Mode;

/// What a key does when it is pressed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Action {
    /// Changes what surfaces show.
    Show(Mode),
    /// Turns fog on or off.
    Fog,
    /// Turns normal maps on or off.
    Normals,
    /// Turns moving spheres on or off.
    Balls,
    /// Turns probes as spheres on or off.
    Probes,
    /// Changes the exposure by stops.
    Expose(f32),
    /// Goes to the next bake of the folder.
    NextBake,
    /// Goes to the one before.
    PreviousBake,
    /// Turns the wiper between a bake and the next on or off.
    Wiper,
    /// Moves the wiper by a part of the picture.
    Wipe(f32),
    /// Goes to the next camera.
    Camera,
    /// Goes to the first camera.
    Home,
    /// Shows or hides the panel.
    Panel,
    /// Shows or hides the keys.
    Help,
    /// Shows or hides what stages take.
    Times,
    /// Writes a picture.
    Screenshot,
    /// Closes the window.
    Quit,
}

/// What the key does; nothing for most.
pub(crate) fn action(key: KeyCode) -> Option<Action> {
    let digits = [
        KeyCode::Digit1,
        KeyCode::Digit2,
        KeyCode::Digit3,
        KeyCode::Digit4,
        KeyCode::Digit5,
        KeyCode::Digit6,
    ];
    if let Some((_, mode)) = digits.iter().zip(Mode::ALL).find(|(d, _)| **d == key) {
        return Some(Action::Show(mode));
    }
    Some(match key {
        KeyCode::KeyF => Action::Fog,
        KeyCode::KeyN => Action::Normals,
        KeyCode::KeyB => Action::Balls,
        KeyCode::KeyP => Action::Probes,
        KeyCode::Equal | KeyCode::NumpadAdd => Action::Expose(0.5),
        KeyCode::Minus | KeyCode::NumpadSubtract => Action::Expose(-0.5),
        KeyCode::PageDown => Action::NextBake,
        KeyCode::PageUp => Action::PreviousBake,
        KeyCode::KeyX => Action::Wiper,
        KeyCode::Comma => Action::Wipe(-0.02),
        KeyCode::Period => Action::Wipe(0.02),
        KeyCode::KeyC => Action::Camera,
        KeyCode::Home => Action::Home,
        KeyCode::KeyG => Action::Panel,
        KeyCode::KeyH | KeyCode::F1 => Action::Help,
        KeyCode::KeyT => Action::Times,
        KeyCode::F12 => Action::Screenshot,
        KeyCode::Escape => Action::Quit,
        _ => return None,
    })
}

/// All keys, for people.
pub(crate) const HELP: [(&str, &str); 17] = [
    ("W A S D Q E", "fly; Shift faster, wheel changes the speed"),
    ("arrows, drag", "look around"),
    ("C, Home", "next camera, first camera"),
    ("1", "the scene as a game shows it"),
    ("2", "lightmap only"),
    ("3", "texels in squares"),
    ("4", "standard error"),
    ("5", "filled texels and gutter"),
    ("6", "light of probes"),
    ("F, N", "fog, normal maps on or off"),
    ("B, P", "moving spheres, probes on or off"),
    ("+ -", "exposure"),
    ("Page Up, Down", "another bake of the folder"),
    ("X  , .", "wiper to the next bake, move it"),
    ("G, H, T", "panel, keys, times of stages"),
    ("F12", "write a picture"),
    ("Esc", "quit"),
];

/// Keys that are held down.
#[derive(Clone, Debug, Default)]
pub(crate) struct Held {
    keys: Vec<KeyCode>,
    /// Powers of two of the speed.
    pub(crate) speed: f32,
}

impl Held {
    /// A key was pressed or let go.
    pub(crate) fn set(&mut self, key: KeyCode, down: bool) {
        self.keys.retain(|k| *k != key);
        if down {
            self.keys.push(key);
        }
    }

    /// Nothing is held any more.
    pub(crate) fn clear(&mut self) {
        self.keys.clear();
    }

    /// Whether a key is held that moves.
    pub(crate) fn moves(&self) -> bool {
        self.way() != Vec3::ZERO || self.turn() != [0.0; 2]
    }

    /// To the right, up and ahead, in units of what is in focus a second.
    pub(crate) fn way(&self) -> Vec3 {
        let fast = self.axis(KeyCode::ShiftLeft, KeyCode::ShiftLeft)
            + self.axis(KeyCode::ShiftRight, KeyCode::ShiftRight);
        let way = Vec3::new(
            self.axis(KeyCode::KeyA, KeyCode::KeyD),
            self.axis(KeyCode::KeyQ, KeyCode::KeyE),
            self.axis(KeyCode::KeyS, KeyCode::KeyW),
        );
        way * (0.4 * self.speed.exp2() * if 0.0 < fast.abs() { 4.0 } else { 1.0 })
    }

    /// To the left and up, radians a second.
    pub(crate) fn turn(&self) -> [f32; 2] {
        [
            1.2 * self.axis(KeyCode::ArrowRight, KeyCode::ArrowLeft),
            1.2 * self.axis(KeyCode::ArrowDown, KeyCode::ArrowUp),
        ]
    }

    fn axis(&self, back: KeyCode, forth: KeyCode) -> f32 {
        let held = |k: KeyCode| if self.keys.contains(&k) { 1.0 } else { 0.0 };
        if back == forth { held(forth) } else { held(forth) - held(back) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_show_modes_in_their_order() {
        assert_eq!(action(KeyCode::Digit1), Some(Action::Show(Mode::Lit)));
        assert_eq!(action(KeyCode::Digit6), Some(Action::Show(Mode::Probes)));
        assert_eq!(action(KeyCode::Digit7), None);
    }

    #[test]
    fn held_keys_move_until_they_are_let_go() {
        let mut held = Held::default();
        held.set(KeyCode::KeyW, true);
        held.set(KeyCode::KeyW, true);
        assert_eq!(held.way(), Vec3::new(0.0, 0.0, 0.4));
        held.set(KeyCode::ShiftLeft, true);
        assert_eq!(held.way(), Vec3::new(0.0, 0.0, 1.6));
        held.set(KeyCode::KeyW, false);
        assert!(!held.moves());
        held.set(KeyCode::ArrowLeft, true);
        assert_eq!(held.turn(), [1.2, 0.0]);
        held.clear();
        assert!(!held.moves());
    }
}

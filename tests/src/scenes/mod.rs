//! Generated scenes, each as the bytes of a `.glb`.

pub mod closed;
pub mod hall;
pub mod hard;
pub mod lamps;
pub mod open;
pub mod seams;

//! Generated scenes, each as the bytes of a `.glb`.

pub mod closed;
pub mod fire;
pub mod hall;
pub mod hard;
pub mod lamps;
pub mod open;
pub mod seams;

/// Configuration for Sponza as it is shared (metres): a sun through haze that ends at its walls.
pub const SPONZA_IN_HAZE: &str = r#"
sky = 0.4
[[lamps]]
name = "sun"
type = "directional"
direction = [-0.35, -1, -0.25]
illuminance = 10
[[media]]
sigma_s = 0.02
box = { min = [-26.9, 2.2, -16.5], max = [24.3, 23.7, 15] }
"#;

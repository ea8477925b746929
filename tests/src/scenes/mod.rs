//! Generated scenes, each as the bytes of a `.glb`.

pub mod hall;

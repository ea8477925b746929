//! Bakes a glTF scene into lightmaps.
//!
//! Data flows one way, and each module uses only those before it:
//!
//! ```text
//! tables -> error -> sample -> scene -> geom -> media -> light -> plan -> transport -> solve -> output -> files
//! files -> compare, files -> runtime-sample;  study bakes and reads files as a user does;  cli stands above all
//! ```
//!
//! | stage | takes | gives |
//! |---|---|---|
//! | [`scene`] | glTF, configuration | a [`Scene`](scene::model::Scene) in world units, and findings |
//! | [`plan`] | scene, settings | a [`Plan`](plan::Plan): atlas, tree, lights; refuses findings that are errors |
//! | [`solve`] | plan, sample by sample through [`transport`] | `E / pi` in nits and its standard error, by texel |
//! | [`output`] | solved texels | a folder: pages, `scene.glb`, manifest |
//! | [`compare`] | two folders or EXRs | error figures and a verdict |
//! | [`study`] | a scene | error over seconds for every knob: CSV, plots, one page |
//!
//! [`geom`], [`media`], [`light`] and [`sample`] are what these stand on. Units and words are explained in
//! [`tables`]; what is approximated is listed in the README under "Where it is wrong".
//!
//! Nothing but [`cli`] prints. Nothing after [`plan`] reports errors of the input. No result depends
//! on threads, time or the order of a hash map, and no length is absolute.

pub mod cli;
pub mod compare;
pub mod error;
pub mod geom;
pub mod light;
pub mod media;
pub mod output;
pub mod plan;
pub mod sample;
pub mod scene;
pub mod solve;
pub mod study;
pub mod transport;

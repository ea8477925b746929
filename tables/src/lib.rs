//! The bottom of the toolchain: conventions, numeric guards, file formats, and what a medium answers to an emitter.
//!
//! Nothing here knows a scene. Conventions that every crate shares:
//!
//! | thing | convention |
//! |---|---|
//! | axes | right-handed, +Y up, metres (glTF) |
//! | point and spot lights | candela |
//! | directional lights | lux |
//! | emission, sky | nits (cd/m²) |
//! | lightmap texel | `E / pi`: the radiance of a white Lambertian surface, nits |
//! | colour | linear, Rec. 709 primaries |
//!
//! # Glossary
//!
//! | word | meaning | unit |
//! |---|---|---|
//! | irradiance `E` | flux arriving per area | lux, or pi nits |
//! | radiosity | flux leaving a Lambertian surface per area, divided by pi | nits |
//! | `l_e` | emitted radiance | nits |
//! | `l_i` | incident radiance | nits |
//! | `wi` | direction towards where light comes from, away from the surface | unit vector |
//! | throughput | product of albedos and compensations along a path | 1 |
//! | `pdf_solid_angle` | probability density per steradian | 1/sr |
//! | `pdf_area` | probability density per area | 1/m² |
//! | standard error | standard deviation of a mean | that of the mean |

pub mod cli;
pub mod format;
pub mod harmonics;
pub mod num;
pub mod probes;
pub mod response;
pub mod table;

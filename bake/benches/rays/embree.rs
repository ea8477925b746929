//! As much of Embree 3's C interface as the bench needs, loaded where the library is installed.
#![expect(unsafe_code, reason = "calls a C library")]

use libloading::{Library, Symbol};
use std::ffi::{c_char, c_uint, c_void};
use std::ptr;

type Handle = *mut c_void;

/// `RTCRay` and `RTCHit` one after the other: `RTCRayHit`.
#[derive(Clone, Copy, Default)]
#[repr(C, align(16))]
struct RayHit {
    origin: [f32; 3],
    t_near: f32,
    direction: [f32; 3],
    time: f32,
    t_far: f32,
    mask: c_uint,
    id: c_uint,
    flags: c_uint,
    normal: [f32; 3],
    uv: [f32; 2],
    triangle: c_uint,
    geometry: c_uint,
    instance: c_uint,
    padding: [u32; 4],
}

/// `RTCIntersectContext`.
#[repr(C)]
struct Context {
    flags: c_uint,
    filter: *const c_void,
    instance: c_uint,
}

type Trace = unsafe extern "C" fn(Handle, *mut Context, *mut RayHit);

/// The library.
pub(crate) struct Embree {
    /// Never unloaded: its threads go on until the program ends.
    library: &'static Library,
}

/// A committed scene of one triangle mesh.
pub(crate) struct Scene {
    scene: Handle,
    intersect: Trace,
    occluded: Trace,
    /// The mesh, which the scene refers to, with the padding that Embree asks for.
    _corners: Vec<f32>,
    _indices: Vec<u32>,
}

const TRIANGLES: c_uint = 0;
const INDEX: c_uint = 0;
const VERTEX: c_uint = 1;
const UINT3: c_uint = 0x5003;
const FLOAT3: c_uint = 0x9003;
const ROBUST: c_uint = 4;

impl Embree {
    /// The library, or `None` where it is not installed.
    pub(crate) fn open() -> Option<Self> {
        // SAFETY: the library's initialisers have no requirements.
        let library = unsafe { Library::new("libembree3.so.3") }.ok()?;
        Some(Self { library: Box::leak(Box::new(library)) })
    }

    /// A scene with Embree's default quality. `robust` asks for its watertight tests.
    pub(crate) fn scene(&self, triangles: &[[glam::Vec3; 3]], robust: bool) -> anyhow::Result<Scene> {
        let n = triangles.len();
        let mut corners: Vec<f32> = triangles.iter().flatten().flat_map(|p| p.to_array()).collect();
        corners.resize(9 * n + 4, 0.0);
        let mut indices: Vec<u32> = (0..3 * u32::try_from(n)?).collect();
        indices.resize(3 * n + 4, 0);
        // SAFETY: names and signatures are those of `rtcore.h` of Embree 3; buffers live as long as
        // the scene and hold 16 bytes more than are read.
        unsafe {
            let l = self.library;
            let new_device: Symbol<unsafe extern "C" fn(*const c_char) -> Handle> = l.get(b"rtcNewDevice")?;
            let new_scene: Symbol<unsafe extern "C" fn(Handle) -> Handle> = l.get(b"rtcNewScene")?;
            let flags: Symbol<unsafe extern "C" fn(Handle, c_uint)> = l.get(b"rtcSetSceneFlags")?;
            let new_geometry: Symbol<unsafe extern "C" fn(Handle, c_uint) -> Handle> =
                l.get(b"rtcNewGeometry")?;
            let buffer: Symbol<
                unsafe extern "C" fn(Handle, c_uint, c_uint, c_uint, *const c_void, usize, usize, usize),
            > = l.get(b"rtcSetSharedGeometryBuffer")?;
            let commit_geometry: Symbol<unsafe extern "C" fn(Handle)> = l.get(b"rtcCommitGeometry")?;
            let attach: Symbol<unsafe extern "C" fn(Handle, Handle) -> c_uint> =
                l.get(b"rtcAttachGeometry")?;
            let commit_scene: Symbol<unsafe extern "C" fn(Handle)> = l.get(b"rtcCommitScene")?;
            let device = new_device(ptr::null());
            anyhow::ensure!(!device.is_null(), "Embree makes no device");
            let scene = new_scene(device);
            flags(scene, if robust { ROBUST } else { 0 });
            let geometry = new_geometry(device, TRIANGLES);
            buffer(geometry, VERTEX, 0, FLOAT3, corners.as_ptr().cast(), 0, 12, 3 * n);
            buffer(geometry, INDEX, 0, UINT3, indices.as_ptr().cast(), 0, 12, n);
            commit_geometry(geometry);
            attach(scene, geometry);
            commit_scene(scene);
            Ok(Scene {
                scene,
                intersect: *l.get(b"rtcIntersect1")?,
                occluded: *l.get(b"rtcOccluded1")?,
                _corners: corners,
                _indices: indices,
            })
        }
    }
}

impl Scene {
    /// Distance and triangle of the nearest hit.
    #[inline]
    pub(crate) fn closest(&self, ray: &bake::geom::Ray) -> Option<(f32, u32)> {
        let mut hit = prepare(ray);
        // SAFETY: both structures are laid out as in `rtcore_ray.h` and `rtcore_common.h`.
        unsafe { (self.intersect)(self.scene, &mut context(), &mut hit) };
        (hit.geometry != u32::MAX).then_some((hit.t_far, hit.triangle))
    }

    /// Whether anything is hit.
    #[inline]
    pub(crate) fn occluded(&self, ray: &bake::geom::Ray) -> bool {
        let mut hit = prepare(ray);
        // SAFETY: as above; `RTCRay` is the beginning of `RTCRayHit`.
        unsafe { (self.occluded)(self.scene, &mut context(), &mut hit) };
        hit.t_far < 0.0
    }
}

fn prepare(ray: &bake::geom::Ray) -> RayHit {
    RayHit {
        origin: ray.origin.to_array(),
        direction: ray.direction.to_array(),
        t_far: ray.t_max,
        mask: u32::MAX,
        triangle: u32::MAX,
        geometry: u32::MAX,
        instance: u32::MAX,
        ..RayHit::default()
    }
}

fn context() -> Context {
    Context { flags: 0, filter: ptr::null(), instance: u32::MAX }
}

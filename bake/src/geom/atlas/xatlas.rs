//! Charts from xatlas, cut by a child process that can be stopped.
//!
//! The library cannot be interrupted inside a step and takes hours on some meshes, and a thread
//! cannot be ended from outside. So the program `bake-xatlas`, which lies beside `bake`, reads one
//! mesh from its standard input and writes the charts to its standard output; when the time is up
//! it is killed and `uvunwrap` does the work. Two runs can therefore differ when one of them meets
//! the limit, which is why xatlas is not the default.
//!
//! Both directions are little-endian 32-bit words: the number of vertices, the vertices (x, y, z,
//! or source vertex, u, v), the number of indices, the indices.

use std::{
    env,
    io::{self, Read, Write},
    path::PathBuf,
    process::{Command, Stdio},
    sync::mpsc::{self, RecvTimeoutError},
    thread,
    time::{Duration, Instant},
};

use xatlas_rs_v2::{ChartOptions, IndexData, MeshData, MeshDecl, PackOptions, Xatlas};

use super::{Meter, group::Class, pack::Shape};
use crate::{
    error::{Error, Finding},
    scene::model::Scene,
};

/// Name of the child program.
const CHILD: &str = "bake-xatlas";

/// How often a waiting parent asks whether to go on.
const PULSE: Duration = Duration::from_millis(100);

/// Vertices (source vertex and coordinate) and indices of a charted mesh.
struct Charted {
    origin: Vec<u32>,
    uvs: Vec<[f32; 2]>,
    indices: Vec<u32>,
}

/// Replaces the shapes that are to be unwrapped by charted ones, allowing each `seconds`.
pub(super) fn chart(
    scene: &Scene,
    classes: &[Class],
    shapes: &mut [Shape],
    seconds: u32,
    meter: &Meter<'_>,
    findings: &mut Vec<Finding>,
) -> Result<(), Error> {
    for (class, shape) in classes.iter().zip(shapes) {
        if shape.kept.is_some() {
            continue;
        }
        let mesh = &scene.meshes[class.mesh];
        match run(class, &mesh.triangles, seconds, meter)? {
            Ok(c) => *shape = Shape::charted(class, c.origin, c.uvs, c.indices),
            Err(why) => findings.push(Finding::warning(
                &mesh.name,
                format!("xatlas {why}: uvunwrap cuts the charts"),
                "allow more seconds, or bake with the default engine",
            )),
        }
    }
    Ok(())
}

/// One mesh; the inner error says in words why there are no charts.
fn run(
    class: &Class,
    triangles: &[[u32; 3]],
    seconds: u32,
    meter: &Meter<'_>,
) -> Result<Result<Charted, String>, Error> {
    let Some(program) = child_program() else {
        return Ok(Err(format!("is not there (no program {CHILD} beside this one)")));
    };
    let mut command = Command::new(program);
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
    let mut child = match command.spawn() {
        Ok(c) => c,
        Err(e) => return Ok(Err(format!("cannot be started ({e})"))),
    };
    let request = request(&class.positions, triangles);
    if let Some(mut pipe) = child.stdin.take() {
        // A child that ends early closes the pipe; its missing answer says so.
        thread::spawn(move || pipe.write_all(&request));
    }
    let (send, answer) = mpsc::channel();
    if let Some(mut pipe) = child.stdout.take() {
        thread::spawn(move || {
            let mut bytes = Vec::new();
            let read = pipe.read_to_end(&mut bytes).map(|_| bytes);
            // Nobody listens any more after the time limit.
            send.send(read).ok();
        });
    }
    let end = Instant::now() + Duration::from_secs(seconds.into());
    let outcome = loop {
        match answer.recv_timeout(PULSE) {
            Ok(Ok(bytes)) => {
                let count = class.positions.len();
                break Ok(parse(&bytes, count, triangles).ok_or("gave no charts".to_owned()));
            }
            Ok(Err(e)) => break Ok(Err(format!("gave no answer ({e})"))),
            Err(RecvTimeoutError::Disconnected) => break Ok(Err("gave no answer".to_owned())),
            Err(RecvTimeoutError::Timeout) => {}
        }
        if end <= Instant::now() {
            break Ok(Err(format!("took more than {seconds} s")));
        }
        if !meter.report(3) {
            break Err(Error::Interrupted);
        }
    };
    // Ending a child that is done already is no error worth a word.
    child.kill().ok();
    child.wait().ok();
    outcome
}

/// The child program, beside this one or, for tests and examples, one folder up.
fn child_program() -> Option<PathBuf> {
    let own = env::current_exe().ok()?;
    let name = format!("{CHILD}{}", env::consts::EXE_SUFFIX);
    own.ancestors().skip(1).take(2).map(|folder| folder.join(&name)).find(|p| p.is_file())
}

fn request(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Vec<u8> {
    let mut out = Vec::new();
    let mut word = |w: [u8; 4]| out.extend(w);
    word(count(positions.len()).to_le_bytes());
    positions.as_flattened().iter().for_each(|x| word(x.to_le_bytes()));
    word(count(triangles.len() * 3).to_le_bytes());
    triangles.as_flattened().iter().for_each(|i| word(i.to_le_bytes()));
    out
}

/// The charts in an answer, if it is whole and fits the mesh.
fn parse(bytes: &[u8], vertices: usize, triangles: &[[u32; 3]]) -> Option<Charted> {
    let mut words = bytes.chunks_exact(4).map(|w| [w[0], w[1], w[2], w[3]]);
    let mut next = || words.next();
    let n = u32::from_le_bytes(next()?) as usize;
    let mut c = Charted { origin: Vec::new(), uvs: Vec::new(), indices: Vec::new() };
    for _ in 0..n {
        c.origin.push(u32::from_le_bytes(next()?));
        c.uvs.push([f32::from_le_bytes(next()?), f32::from_le_bytes(next()?)]);
    }
    let n = u32::from_le_bytes(next()?) as usize;
    for _ in 0..n {
        c.indices.push(u32::from_le_bytes(next()?));
    }
    let same = triangles
        .as_flattened()
        .iter()
        .zip(&c.indices)
        .all(|(v, i)| c.origin.get(*i as usize) == Some(v) && (*v as usize) < vertices);
    let finite = c.uvs.as_flattened().iter().all(|x| x.is_finite());
    (same && finite && c.indices.len() == triangles.len() * 3).then_some(c)
}

/// What the child program does: reads one mesh, cuts it, writes the charts.
///
/// # Errors
///
/// When the mesh is cut short or refused by xatlas, or the answer cannot be written.
pub fn child(input: &mut dyn Read, output: &mut dyn Write) -> io::Result<()> {
    let bad = |what: &str| io::Error::new(io::ErrorKind::InvalidData, what.to_owned());
    let mut bytes = Vec::new();
    input.read_to_end(&mut bytes)?;
    let mut words = bytes.chunks_exact(4).map(|w| [w[0], w[1], w[2], w[3]]);
    let mut next = || words.next().ok_or_else(|| bad("the mesh is cut short"));
    let n = u32::from_le_bytes(next()?) as usize;
    let positions = (0..3 * n).map(|_| next().map(f32::from_le_bytes)).collect::<io::Result<Vec<f32>>>()?;
    let n = u32::from_le_bytes(next()?) as usize;
    let indices = (0..n).map(|_| next().map(u32::from_le_bytes)).collect::<io::Result<Vec<u32>>>()?;
    let decl = MeshDecl {
        vertex_position_data: MeshData::Contiguous(&positions),
        index_data: Some(IndexData::U32(&indices)),
        face_count: count(indices.len() / 3),
        ..MeshDecl::default()
    };
    let mut xatlas = Xatlas::new();
    xatlas.add_mesh(&decl).map_err(|e| bad(&format!("{e:?}")))?;
    xatlas.generate(&ChartOptions::default(), &PackOptions { padding: 1, ..Default::default() });
    let meshes = xatlas.meshes();
    let mesh = meshes.first().ok_or_else(|| bad("xatlas gave no mesh"))?;
    let mut out = Vec::new();
    let mut word = |w: [u8; 4]| out.extend(w);
    word(count(mesh.vertex_array.len()).to_le_bytes());
    for v in &mesh.vertex_array {
        word(v.xref.to_le_bytes());
        word(v.uv[0].to_le_bytes());
        word(v.uv[1].to_le_bytes());
    }
    word(count(mesh.index_array.len()).to_le_bytes());
    mesh.index_array.iter().for_each(|i| word(i.to_le_bytes()));
    output.write_all(&out)
}

fn count(n: usize) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::atlas::testing;

    #[test]
    fn the_child_charts_a_mesh() {
        let mesh = testing::cube();
        let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.to_array()).collect();
        let mut answer = Vec::new();
        child(&mut request(&positions, &mesh.triangles).as_slice(), &mut answer).expect("charts");
        let c = parse(&answer, positions.len(), &mesh.triangles).expect("a whole answer");
        assert_eq!(c.indices.len(), 36);
        assert!(parse(&answer[..answer.len() - 4], positions.len(), &mesh.triangles).is_none());
        assert!(child(&mut [1_u8, 0, 0, 0, 9].as_slice(), &mut Vec::new()).is_err());
    }
}

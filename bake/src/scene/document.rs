//! A glTF file as it lies on disk: container, JSON, buffers, images. Nothing is interpreted here.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, OnceLock, PoisonError},
};

use serde_json::Value;

use super::uri::{self, Target};
use crate::error::{Error, Finding};

/// Extensions this tool understands, or that change nothing it looks at, so that a file may
/// require them.
const KNOWN_EXTENSIONS: &[&str] = &[
    "EXT_lights_image_based",
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_animation_pointer",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
    "KHR_texture_transform",
    "KHR_xmp_json_ld",
];

/// A file that the scene was read from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputFile {
    /// Path relative to the document's folder with `/` separators; the document itself is its file name.
    pub path: String,
    /// Size in bytes.
    pub bytes: u64,
    /// BLAKE3 hash of the content, 64 hexadecimal digits.
    pub blake3: String,
}

impl InputFile {
    /// Describes the content `bytes` of the file at `path`.
    pub fn new(path: &str, bytes: &[u8]) -> Self {
        let blake3 = blake3::hash(bytes).to_hex().to_string();
        Self { path: path.replace('\\', "/"), bytes: bytes.len() as u64, blake3 }
    }
}

/// An opened glTF file with its buffers.
#[derive(Debug)]
pub struct Document {
    /// The whole JSON tree.
    pub json: Value,
    name: String,
    base_dir: Option<PathBuf>,
    total_bytes: u64,
    pub(super) buffers: Vec<Result<Arc<[u8]>, Finding>>,
    /// Decoded compressed buffer views, filled on first use because accessors share views.
    pub(super) decoded_views: Vec<OnceLock<Result<Arc<[u8]>, Finding>>>,
    inputs: Mutex<BTreeMap<String, InputFile>>,
}

impl Document {
    /// Opens a `.gltf` or `.glb` file (told apart by content) and reads its buffers.
    ///
    /// # Errors
    /// [`Error::Io`] where the file itself cannot be read; [`Error::Input`] where it is not glTF 2,
    /// or requires an extension that is not understood. A missing buffer is no error here but
    /// where it is used, see [`Self::accessor`].
    pub fn open(path: &Path) -> Result<Self, Error> {
        let bytes = fs::read(path).map_err(Error::io(path, "cannot read"))?;
        let name = path.file_name().map_or_else(|| "scene".to_owned(), |n| n.to_string_lossy().into_owned());
        let dir = path.parent().map(Path::to_path_buf).unwrap_or_default();
        Self::from_bytes(&name, &bytes, Some(&dir))
    }

    /// Reads a document from memory. `name` is its file name; `base_dir` is where relative URIs
    /// lead, `None` forbids them.
    ///
    /// # Errors
    /// As [`Self::open`], without [`Error::Io`].
    pub fn from_bytes(name: &str, bytes: &[u8], base_dir: Option<&Path>) -> Result<Self, Error> {
        let (json, bin) = if bytes.starts_with(b"glTF") { glb(bytes)? } else { (bytes, None) };
        let json: Value = serde_json::from_slice(json).map_err(|e| not_json(json, &e))?;
        let errors = check_root(&json);
        if !errors.is_empty() {
            return Err(Error::Input(errors));
        }
        let views = json.get("bufferViews").and_then(Value::as_array).map_or(0, Vec::len);
        let stem =
            Path::new(name).file_stem().map_or_else(|| name.to_owned(), |s| s.to_string_lossy().into_owned());
        let mut document = Self {
            json,
            name: if stem.is_empty() { "scene".to_owned() } else { stem },
            base_dir: base_dir.map(Path::to_path_buf),
            total_bytes: 0,
            buffers: Vec::new(),
            decoded_views: std::iter::repeat_with(OnceLock::new).take(views).collect(),
            inputs: Mutex::default(),
        };
        document.note_input(name, bytes);
        document.read_buffers(bin);
        let buffers: u64 = document.buffers.iter().flatten().map(|b| b.len() as u64).sum();
        document.total_bytes = buffers + bytes.len() as u64;
        Ok(document)
    }

    /// File stem, such as `hall` for `hall.glb`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Folder that relative URIs start from.
    pub fn base_dir(&self) -> Option<&Path> {
        self.base_dir.as_deref()
    }

    /// Every file read so far, sorted by path: the document, buffers, and images asked for.
    pub fn inputs(&self) -> Vec<InputFile> {
        self.inputs.lock().unwrap_or_else(PoisonError::into_inner).values().cloned().collect()
    }

    /// Remembers a file that the scene depends on, such as a sky image, for [`Self::inputs`].
    pub fn note_input(&self, path: &str, bytes: &[u8]) {
        self.add_input(InputFile::new(path, bytes));
    }

    /// [`Self::note_input`] of a file that is described already.
    pub fn add_input(&self, file: InputFile) {
        self.inputs.lock().unwrap_or_else(PoisonError::into_inner).insert(file.path.clone(), file);
    }

    /// Size of the document and its buffers in bytes: what decoded sizes are measured against.
    pub fn total_bytes(&self) -> u64 {
        self.total_bytes
    }

    /// What is wrong with the buffers, whether used or not. Fallback buffers of compressed files
    /// have no content and are not named.
    pub fn buffer_findings(&self) -> Vec<Finding> {
        let fallback = |i: usize| {
            let extensions = &self.json["buffers"][i]["extensions"];
            ["EXT_meshopt_compression", "KHR_meshopt_compression"]
                .iter()
                .any(|e| extensions[*e]["fallback"] == Value::Bool(true))
        };
        let broken = self.buffers.iter().enumerate().filter(|(i, _)| !fallback(*i));
        broken.filter_map(|(_, b)| b.as_ref().err().cloned()).collect()
    }

    /// Encoded bytes and media type of `images[index]`. The type is the stated one, or empty; the
    /// content decides.
    ///
    /// # Errors
    /// A finding where the index, URI, file or buffer view is bad.
    pub fn image_bytes(&self, index: usize) -> Result<(Vec<u8>, String), Finding> {
        let path = format!("images[{index}]");
        let fix = "export the image again, or remove it from the material";
        let image = self
            .json
            .get("images")
            .and_then(|a| a.get(index))
            .ok_or_else(|| Finding::error(&path, "there is no such image", fix))?;
        let mime = image.get("mimeType").and_then(Value::as_str).unwrap_or_default().to_owned();
        if let Some(uri) = image.get("uri").and_then(Value::as_str) {
            let (bytes, stated) = self.fetch(uri, &format!("{path}.uri"))?;
            return Ok((bytes, if mime.is_empty() { stated } else { mime }));
        }
        let view = image
            .get("bufferView")
            .ok_or_else(|| Finding::error(&path, "the image has neither uri nor bufferView", fix))?;
        let view = super::read::index_of(view)
            .ok_or_else(|| Finding::error(format!("{path}.bufferView"), "not an index", fix))?;
        Ok((self.view(view)?.bytes().to_vec(), mime))
    }

    fn read_buffers(&mut self, bin: Option<&[u8]>) {
        let count = self.json.get("buffers").and_then(Value::as_array).map_or(0, Vec::len);
        self.buffers = (0..count).map(|i| self.read_buffer(i, bin)).collect();
    }

    fn read_buffer(&self, index: usize, bin: Option<&[u8]>) -> Result<Arc<[u8]>, Finding> {
        let path = format!("buffers[{index}]");
        let buffer = &self.json["buffers"][index];
        let fix = "export the file again";
        let length = super::read::index_of(&buffer["byteLength"]).filter(|n| 0 < *n).ok_or_else(|| {
            Finding::error(format!("{path}.byteLength"), "missing, or not a positive integer", fix)
        })?;
        let bytes: Vec<u8> = match (buffer.get("uri"), bin) {
            (Some(Value::String(uri)), _) => self.fetch(uri, &format!("{path}.uri"))?.0,
            (Some(_), _) => return Err(Finding::error(format!("{path}.uri"), "not a string", fix)),
            (None, Some(bin)) if index == 0 => bin.to_vec(),
            (None, _) => {
                return Err(Finding::error(path, "has no uri, and no binary chunk belongs to it", fix));
            }
        };
        if bytes.len() < length {
            let what = format!("byteLength is {length} but the data has {} bytes", bytes.len());
            return Err(Finding::error(path, what, "the file is cut short; export or copy it again"));
        }
        Ok(bytes[..length].into())
    }

    /// Reads what a URI leads to, with the media type of a data URI.
    pub(super) fn fetch(&self, uri: &str, path: &str) -> Result<(Vec<u8>, String), Finding> {
        let fix = "use a data: URI or a file beside the document";
        match uri::resolve(uri).map_err(|what| Finding::error(path, what, fix))? {
            Target::Inline(bytes, mime) => Ok((bytes, mime)),
            Target::File(file) => {
                let shown = file.display();
                let Some(dir) = &self.base_dir else {
                    return Err(Finding::error(
                        path,
                        format!("`{shown}` is outside this self-contained file"),
                        fix,
                    ));
                };
                let full = dir.join(&file);
                // Devices and pipes might never end, so only regular files are opened.
                if !full.is_file() {
                    let what = format!("there is no file `{shown}` beside the document");
                    return Err(Finding::error(path, what, "put the file there, or correct the URI"));
                }
                let bytes = fs::read(&full).map_err(|e| {
                    Finding::error(
                        path,
                        format!("`{shown}` cannot be read: {e}"),
                        "check the file's permissions",
                    )
                })?;
                self.note_input(&file.to_string_lossy(), &bytes);
                Ok((bytes, String::new()))
            }
        }
    }
}

fn not_json(bytes: &[u8], error: &serde_json::Error) -> Error {
    let (what, fix) = if bytes.is_empty() {
        ("the file is empty".to_owned(), "name a .gltf or .glb file")
    } else if bytes.starts_with(b"\xef\xbb\xbf") {
        ("the JSON starts with a byte order mark".to_owned(), "save it as UTF-8 without a byte order mark")
    } else {
        (format!("not glTF: {error}"), "name a .gltf or .glb file, or export it again")
    };
    Finding::error("$", what, fix).into()
}

/// Splits a GLB into JSON and, where there is one, the binary chunk.
fn glb(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), Finding> {
    let fix = "the file is damaged or cut short; export or copy it again";
    let bad = |what: String| Finding::error("glb", what, fix);
    let word = |at: usize| -> Option<u32> {
        let slice = bytes.get(at..at.checked_add(4)?)?;
        slice.try_into().ok().map(u32::from_le_bytes)
    };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err(bad(format!("the header needs 12 bytes, the file has {}", bytes.len())));
    };
    if version != 2 {
        return Err(Finding::error(
            "glb",
            format!("container version {version}; only version 2 is read"),
            "export the scene as glTF 2.0",
        ));
    }
    if length as usize != bytes.len() {
        return Err(bad(format!("the header says {length} bytes, the file has {}", bytes.len())));
    }
    let mut at = 12;
    let mut json = None;
    let mut bin = None;
    let mut number = 0;
    while at < bytes.len() {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else {
            return Err(bad(format!("the header of chunk {number} is cut off")));
        };
        let end = (at + 8).checked_add(size as usize).filter(|end| *end <= bytes.len());
        let Some(end) = end else {
            return Err(bad(format!(
                "chunk {number} is {size} bytes long, which is beyond the end of the file"
            )));
        };
        let data = &bytes[at + 8..end];
        match (kind, number) {
            (0x4e4f_534a, 0) => json = Some(data),
            (0x004e_4942, 1) => bin = Some(data),
            (0x4e4f_534a, _) => return Err(bad(format!("chunk {number} is a second JSON chunk"))),
            (0x004e_4942, _) => {
                return Err(bad(format!("chunk {number} is a binary chunk in the wrong place")));
            }
            (_, 0) => return Err(bad("the first chunk is not JSON".to_owned())),
            // Unknown chunks are to be skipped.
            _ => {}
        }
        at = end;
        number += 1;
    }
    match json {
        Some(json) => Ok((json, bin)),
        None => Err(bad("there is no JSON chunk".to_owned())),
    }
}

/// What makes the document as a whole unreadable.
fn check_root(json: &Value) -> Vec<Finding> {
    if !json.is_object() {
        return vec![Finding::error("$", "not glTF: the JSON is not an object", "name a .gltf or .glb file")];
    }
    let mut out = Vec::new();
    let asset = &json["asset"];
    let version = asset["version"].as_str();
    let major = version.and_then(|v| v.split_once('.')).and_then(|(major, minor)| {
        let digits = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
        (digits(major) && digits(minor)).then_some(major)
    });
    // glTF 1.0 files often have no asset.version, but keep meshes in an object.
    let looks_like_1 = ["meshes", "nodes", "buffers", "accessors"].iter().any(|k| json[*k].is_object());
    match major {
        Some("2") => {}
        Some("1") => out.push(gltf_1()),
        _ if looks_like_1 => out.push(gltf_1()),
        _ => {
            let shown = asset["version"].to_string();
            let what = format!("the version is {shown}; this tool reads glTF 2.x");
            out.push(Finding::error("asset.version", what, "export the scene as glTF 2.0"));
        }
    }
    let min = &asset["minVersion"];
    if !min.is_null() && !min.as_str().is_some_and(|v| v == "2.0" || v.starts_with("1.")) {
        let what = format!("the file needs glTF {min}; this tool reads 2.0");
        out.push(Finding::error("asset.minVersion", what, "export the scene as glTF 2.0"));
    }
    match &json["extensionsRequired"] {
        Value::Null => {}
        Value::Array(names) => out.extend(names.iter().enumerate().filter_map(|(i, name)| required(i, name))),
        _ => out.push(Finding::error("extensionsRequired", "not a list", "export the file again")),
    }
    out
}

fn gltf_1() -> Finding {
    Finding::error(
        "asset.version",
        "this is a glTF 1.0 file; glTF 2.0 is needed",
        "export the scene as glTF 2.0",
    )
}

fn required(index: usize, name: &Value) -> Option<Finding> {
    let path = format!("extensionsRequired[{index}]");
    let Some(name) = name.as_str() else {
        return Some(Finding::error(path, "not a string", "export the file again"));
    };
    if KNOWN_EXTENSIONS.contains(&name) {
        return None;
    }
    let fix = match name {
        "KHR_draco_mesh_compression" => "export without Draco compression, or with EXT_meshopt_compression",
        "KHR_texture_basisu" => "export with PNG, JPEG or WebP textures",
        "MSFT_texture_dds" | "EXT_texture_avif" => "export with PNG, JPEG or WebP textures",
        "KHR_techniques_webgl" => "export with metallic-roughness materials",
        _ => "export without it, or remove it from extensionsRequired where the scene is right without it",
    };
    Some(Finding::error(path, format!("the file requires {name}, which is not supported"), fix))
}

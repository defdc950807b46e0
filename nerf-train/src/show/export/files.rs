//! Meshes as PLY, OBJ and binary glTF 2.0, points as PLY.
//!
//! The writers need no library: each writes a header, then loops over vertices and triangles.

use super::{Mesh, Vertex};
use crate::data::pictures::rgb::to_u8;
use crate::system::output::{AtomicFile, Attempt, OutputError};
use anyhow::bail;
use serde_json::{Value, json};
use std::io::{self, Write};
use std::path::Path;

/// Writes a mesh as binary PLY: `x y z nx ny nz red green blue`, faces as `vertex_indices`. Coordinates are in the
/// data's world: f64 if the mesh's origin is not 0, else f32.
pub fn write_ply(mesh: &Mesh, path: &Path) -> anyhow::Result<()> {
    written(path, |out| {
        let far = mesh.origin != [0.0; 3];
        let real = if far { "double" } else { "float" };
        let (vertices, faces) = (mesh.vertices.len(), mesh.triangles.len());
        write!(
            out,
            "ply\nformat binary_little_endian 1.0\ncomment made by nerf-train\nelement vertex {vertices}\n\
             property {real} x\nproperty {real} y\nproperty {real} z\n\
             property float nx\nproperty float ny\nproperty float nz\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\n"
        )?;
        if faces > 0 {
            write!(out, "element face {faces}\nproperty list uchar uint vertex_indices\n")?;
        }
        writeln!(out, "end_header")?;
        for vertex in &mesh.vertices {
            for (value, origin) in vertex.position.iter().zip(mesh.origin) {
                match far {
                    true => out.write_all(&(f64::from(*value) + origin).to_le_bytes())?,
                    false => out.write_all(&value.to_le_bytes())?,
                }
            }
            for value in vertex.normal {
                out.write_all(&value.to_le_bytes())?;
            }
            out.write_all(&vertex.rgb.map(to_u8))?;
        }
        for triangle in &mesh.triangles {
            out.write_all(&[3])?;
            for index in triangle {
                out.write_all(&index.to_le_bytes())?;
            }
        }
        Ok(())
    })
}

/// Writes a mesh as OBJ: vertices `v x y z r g b` (colours for MeshLab and Blender), normals `vn`, faces `f v//n`.
pub fn write_obj(mesh: &Mesh, path: &Path) -> anyhow::Result<()> {
    written(path, |out| {
        writeln!(out, "# made by nerf-train")?;
        for vertex in &mesh.vertices {
            let at = |axis: usize| f64::from(vertex.position[axis]) + mesh.origin[axis];
            let [r, g, b] = vertex.rgb.map(|c| c.clamp(0.0, 1.0));
            writeln!(out, "v {} {} {} {r:.4} {g:.4} {b:.4}", at(0), at(1), at(2))?;
        }
        for [x, y, z] in mesh.vertices.iter().map(|vertex| vertex.normal) {
            writeln!(out, "vn {x:.4} {y:.4} {z:.4}")?;
        }
        for [a, b, c] in mesh.triangles.iter().map(|triangle| triangle.map(|i| u64::from(i) + 1)) {
            writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?;
        }
        Ok(())
    })
}

/// Writes a mesh as GLB: positions, normals and unlit colours in linear light, in the data's coordinates and units. The
/// axes stay, although glTF defines +Y as up. The mesh's origin becomes the node's translation. Fails from 4 GiB on.
pub fn write_glb(mesh: &Mesh, path: &Path) -> anyhow::Result<()> {
    let size = 36 * mesh.vertices.len() as u64 + 12 * mesh.triangles.len() as u64;
    // Leaves 64 KiB of the format's 4 GiB for the JSON document.
    let Some(bytes) = u32::try_from(size).ok().filter(|&size| size < u32::MAX - (1 << 16)) else {
        bail!(
            "-o: expected a mesh of less than 4 GiB as .glb, found {size} bytes: lower --resolution, or write .ply"
        );
    };
    let bytes = bytes as usize;
    let mut text = document(mesh, bytes).to_string();
    text.extend(std::iter::repeat_n(' ', text.len().next_multiple_of(4) - text.len()));
    let whole = 28 + text.len() + bytes;
    written(path, |out| {
        let word = |value: usize| (value as u32).to_le_bytes();
        out.write_all(b"glTF")?;
        for part in [2, whole, text.len()] {
            out.write_all(&word(part))?;
        }
        out.write_all(b"JSON")?;
        out.write_all(text.as_bytes())?;
        out.write_all(&word(bytes))?;
        out.write_all(b"BIN\0")?;
        let planes: [fn(&Vertex) -> [f32; 3]; 3] =
            [|vertex| vertex.position, |vertex| vertex.normal, |vertex| vertex.rgb.map(linear)];
        for plane in planes {
            for value in mesh.vertices.iter().flat_map(plane) {
                out.write_all(&value.to_le_bytes())?;
            }
        }
        for index in mesh.triangles.iter().flatten() {
            out.write_all(&index.to_le_bytes())?;
        }
        Ok(())
    })
}

/// Returns a GLB file's JSON document. The binary chunk has `bytes` bytes: positions, normals, colours, then indices.
fn document(mesh: &Mesh, bytes: usize) -> Value {
    let (count, indices) = (mesh.vertices.len(), 3 * mesh.triangles.len());
    let mut low = [f32::INFINITY; 3];
    let mut high = [f32::NEG_INFINITY; 3];
    for vertex in &mesh.vertices {
        for axis in 0..3 {
            low[axis] = low[axis].min(vertex.position[axis]);
            high[axis] = high[axis].max(vertex.position[axis]);
        }
    }
    let triples = 12 * count;
    let view = |offset: usize, length: usize, target: u32| json!({ "buffer": 0, "byteOffset": offset, "byteLength": length, "target": target });
    let accessor = |view: usize, component: u32, count: usize, kind: &str| json!({ "bufferView": view, "componentType": component, "count": count, "type": kind });
    let mut positions = accessor(0, 5126, count, "VEC3");
    positions["min"] = json!(low);
    positions["max"] = json!(high);
    json!({
        "asset": { "version": "2.0", "generator": "nerf-train" },
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "translation": mesh.origin }],
        "materials": [{ "doubleSided": true, "extensions": { "KHR_materials_unlit": {} } }],
        "meshes": [{ "primitives": [{
            "attributes": { "POSITION": 0, "NORMAL": 1, "COLOR_0": 2 }, "indices": 3, "material": 0
        }] }],
        "accessors": [
            positions,
            accessor(1, 5126, count, "VEC3"),
            accessor(2, 5126, count, "VEC3"),
            accessor(3, 5125, indices, "SCALAR"),
        ],
        "bufferViews": [
            view(0, triples, 34962),
            view(triples, triples, 34962),
            view(2 * triples, triples, 34962),
            view(3 * triples, 4 * indices, 34963),
        ],
        "buffers": [{ "byteLength": bytes }],
    })
}

/// Converts an sRGB value to linear light, in which glTF stores colours.
fn linear(value: f32) -> f32 {
    let value = value.clamp(0.0, 1.0);
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Creates the file at `path`, whose contents `write` writes. If `write` fails, no file is created.
fn written(path: &Path, write: impl FnOnce(&mut AtomicFile) -> io::Result<()>) -> anyhow::Result<()> {
    let mut file = AtomicFile::create(path)?;
    write(&mut file).map_err(|source| OutputError::new(Attempt::Write, path, source))?;
    Ok(file.commit()?)
}

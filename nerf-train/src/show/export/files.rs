//! Meshes and points as PLY and OBJ.
//!
//! Own writers: each is a header and a loop.

use super::Mesh;
use crate::data::pictures::rgb::to_u8;
use crate::system::output::{AtomicFile, Attempt, OutputError};
use std::io::{self, Write};
use std::path::Path;

/// Writes a mesh as binary PLY: `x y z nx ny nz red green blue`, faces as `vertex_indices`. Coordinates are the
/// data's own: doubles if their origin is far away.
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

/// Writes a mesh as OBJ: `v x y z r g b`, as MeshLab and Blender read colours, `vn`, and `f v//n`.
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

/// Writes a file whole or not at all.
pub(super) fn written(
    path: &Path,
    write: impl FnOnce(&mut AtomicFile) -> io::Result<()>,
) -> anyhow::Result<()> {
    let mut file = AtomicFile::create(path)?;
    write(&mut file).map_err(|source| OutputError::new(Attempt::Write, path, source))?;
    Ok(file.commit()?)
}

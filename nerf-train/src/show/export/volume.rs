//! Density and colour of every cell of a grid over a box.

use super::field::Field;
use super::lattice::cubes;
use crate::data::pictures::rgb::to_u8;
use crate::system::output::write_atomic;
use anyhow::{Context, Result};
use glam::Vec3;
use nerf_core::space::SceneBox;
use std::io::{Cursor, Write};
use std::path::Path;
use zip::ZipWriter;
use zip::write::FileOptions;

/// Densities and colours at the centres of cells.
#[derive(Clone, Debug, PartialEq)]
pub struct Volume {
    /// Lower corner of the first cell, world units, in the scene file's coordinates; the caller adds the origin.
    pub min: [f64; 3],
    /// Side of a cell, world units.
    pub cell: f32,
    /// Number of cells along x, y, z.
    pub cells: [usize; 3],
    /// Density of each cell, 1/world unit; z varies fastest, then y.
    pub density: Vec<f32>,
    /// Display-encoded colour of each cell, in the order of `density`; black where the density is 0.
    pub rgb: Vec<[u8; 3]>,
}

/// Samples the field over a box with `resolution` cells along the box's longest side. Colours are means over six view
/// directions: both directions along each axis. The callback `each` gets the number of finished slices along x.
pub fn volume(
    field: &Field<'_, '_>,
    bounds: &SceneBox,
    resolution: u32,
    mut each: impl FnMut(usize),
) -> Result<Volume> {
    let (cell, cells) = cubes(bounds, resolution)?;
    let [width, height, depth] = cells;
    let mut volume = Volume {
        min: bounds.min.to_array().map(f64::from),
        cell,
        cells,
        density: Vec::with_capacity(width * height * depth),
        rgb: Vec::with_capacity(width * height * depth),
    };
    for x in 0..width {
        let middle = |i: usize| {
            let at = Vec3::new(x as f32, (i / depth) as f32, (i % depth) as f32) + 0.5;
            (bounds.min + cell * at).into()
        };
        let points: Vec<[f32; 3]> = (0..height * depth).map(middle).collect();
        let density = field.densities(&points)?;
        let occupied: Vec<usize> = (0..points.len()).filter(|&i| density[i] > 0.0).collect();
        let mut rgb = vec![[0; 3]; points.len()];
        for (&i, colour) in occupied.iter().zip(mean_colours(field, occupied.iter().map(|&i| points[i]))?) {
            rgb[i] = colour.map(to_u8);
        }
        volume.density.extend(density);
        volume.rgb.extend(rgb);
        each(x + 1);
    }
    Ok(volume)
}

fn mean_colours(field: &Field<'_, '_>, points: impl Iterator<Item = [f32; 3]>) -> Result<Vec<[f32; 3]>> {
    let points: Vec<[f32; 3]> = points.collect();
    let mut sums = vec![Vec3::ZERO; points.len()];
    for axis in Vec3::AXES.into_iter().flat_map(|axis| [axis, -axis]) {
        let (_, rgb) = field.seen(&points, &vec![axis.into(); points.len()])?;
        sums.iter_mut().zip(rgb).for_each(|(sum, rgb)| *sum += Vec3::from(rgb) / 6.0);
    }
    Ok(sums.into_iter().map(Vec3::into).collect())
}

/// Writes an archive for numpy's `np.load`: `density` (float32 `[x, y, z]`), `rgb` (uint8 `[x, y, z, 3]`), `min`
/// (float64 `[3]`) and `cell` (float64).
pub fn write_npz(volume: &Volume, path: &Path) -> Result<()> {
    // The archive is built in memory: on a full disk its writer would print to stderr.
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let failed = "cannot make the NPZ";
    let [x, y, z] = volume.cells;
    let density: Vec<u8> = volume.density.iter().flat_map(|value| value.to_le_bytes()).collect();
    let arrays = [
        ("density", "<f4", format!("({x}, {y}, {z})"), density),
        ("rgb", "|u1", format!("({x}, {y}, {z}, 3)"), volume.rgb.concat()),
        ("min", "<f8", "(3,)".to_owned(), volume.min.iter().flat_map(|value| value.to_le_bytes()).collect()),
        ("cell", "<f8", "()".to_owned(), f64::from(volume.cell).to_le_bytes().to_vec()),
    ];
    for (name, kind, shape, bytes) in arrays {
        let options = FileOptions::default().large_file(bytes.len() >= 1 << 31);
        archive.start_file(format!("{name}.npy"), options).context(failed)?;
        let written = archive.write_all(&npy_header(kind, &shape)).and_then(|()| archive.write_all(&bytes));
        written.context(failed)?;
    }
    Ok(write_atomic(path, &archive.finish().context(failed)?.into_inner())?)
}

/// Returns the header of a `.npy` file (format 1.0), padded to a multiple of 64 bytes. `kind`: numpy type, as `<f4`.
fn npy_header(kind: &str, shape: &str) -> Vec<u8> {
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}");
    // Magic, version and length take ten bytes, the line end one.
    let length = (text.len() + 11).next_multiple_of(64) - 11;
    text.extend(std::iter::repeat_n(' ', length - text.len()));
    text.push('\n');
    let mut header = b"\x93NUMPY\x01\x00".to_vec();
    header.extend((text.len() as u16).to_le_bytes());
    header.extend(text.into_bytes());
    header
}

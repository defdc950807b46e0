use super::common::{Global, check_counts, open_blob, parse_numbers, read_file};
use super::eval::Split;
use super::options::data::DataOptions;
use super::places;
use crate::data::{View, origin_in_name};
use crate::show::export::{
    Field, Lattice, Mesh, Summary, Surface, mesh, points_of_surface, points_of_views, volume, write_glb,
    write_npz, write_obj, write_ply,
};
use crate::system::memory;
use crate::system::progress::{Progress, Total};
use crate::system::summary::Short;
use anyhow::bail;
use clap::{Args, ValueEnum};
use glam::DVec3;
use nerf_core::blob::Blob;
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::Renderer;
use nerf_core::space::SceneBox;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

/// Export a mesh, a point cloud or a volume.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  nerf-train export lego.nerf -o lego.glb --resolution 256
  nerf-train export lego.nerf -o lego.ply --as points --data lego_200x200.npz
  nerf-train export room.nerf -o room.obj --box -2,-2,-1,2,2,1
  nerf-train export lego.nerf -o lego.npz --resolution 128")]
pub struct Export {
    /// Scene file (.nerf).
    file: PathBuf,
    /// Output: mesh (.ply, .obj, .glb), points (.ply with --as points) or volume (.npz).
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Kind of export [default: by the file extension; a .ply is a mesh].
    #[arg(long = "as", value_enum, value_name = "WHAT")]
    kind: Option<Kind>,
    /// Number of cells along the longest side of the exported box [default: 256].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=8192))]
    resolution: Option<u32>,
    /// Box to export, in the coordinates of the data [default: the scene box; required for an unbounded scene].
    #[arg(
        long = "box",
        value_name = "X0,Y0,Z0,X1,Y1,Z1",
        value_parser = parse_numbers::<6, f64>,
        allow_hyphen_values = true
    )]
    bounds: Option<[f64; 6]>,
    /// Export the isosurface of this density, per world unit [default: the surface where rays from free space reach
    /// opacity 1/2].
    #[arg(long, value_name = "SIGMA")]
    threshold: Option<f32>,
    /// Approximate number of points [default: 200000].
    #[arg(long, value_name = "N")]
    points: Option<usize>,
    /// For --as points: place points at the median distances in the views of this data set [default: on the surface].
    #[arg(long, value_name = "DATA")]
    data: Option<PathBuf>,
    /// Split of --data whose views are rendered.
    #[arg(long, value_enum, default_value = "train", requires = "data")]
    split: Split,
    #[command(flatten)]
    data_options: DataOptions,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Triangles with normals and colours.
    Mesh,
    /// Points with normals and colours.
    Points,
    /// Density and colour of every cell of a regular grid.
    Volume,
}

/// Memory per cell during mesh extraction, bytes: density, three optical depths of 16 bits, and vertices.
const BYTES_PER_CELL_OF_MESH: u64 = 12;
/// Memory per cell of a volume, bytes: 4 of density and 3 of colour, in three copies (values, bytes, archive).
const BYTES_PER_CELL: u64 = 3 * 7;
const BYTES_PER_POINT: u64 = 36;

impl Export {
    pub fn run(&self, global: &Global) -> anyhow::Result<ExitCode> {
        let start = Instant::now();
        let kind = self.check()?;
        let bytes = read_file(&self.file)?;
        let blob = open_blob(&self.file, &bytes)?;
        let bounds = self.bounds(&blob, kind)?;
        let quality = Quality { occupancy: true, ..Quality::EXACT };
        let of_points = kind == Kind::Points;
        let outputs = Outputs { median_distance: of_points, normals: of_points, ..Outputs::ALL };
        let plan = Plan::new(&blob, &quality, outputs, Batch::FULL)?;
        let mut memory = vec![Line::UNINIT; Renderer::prepared_lines(&blob, global.kernel())];
        let renderer = Renderer::new(blob, global.kernel(), &mut memory)?;
        let field = Field::new(&renderer, &plan);
        let origin = origin_in_name(renderer.blob().provenance().data);
        let mut summary = Summary::new(&self.output, kind.words().0, &bounds, origin);
        match (kind, &self.data) {
            (Kind::Volume, _) => self.volume(&field, &bounds, origin, &mut summary, global)?,
            (Kind::Points, Some(data)) => {
                let dataset = self.data_options.read_for(data, (renderer.blob(), &self.file), global)?;
                let within = self.bounds.and(Some(&bounds));
                let points = self.points_of(self.split.of(&dataset), within, &renderer, &plan, global)?;
                self.write(&Mesh { origin, ..points }, &mut summary)?;
            }
            _ => {
                let mesh = self.mesh(&field, &bounds, &mut summary, global)?;
                let mesh = match kind {
                    Kind::Points => points_of_surface(&mesh, self.points(), 0),
                    _ => mesh,
                };
                self.write(&Mesh { origin, ..mesh }, &mut summary)?;
            }
        }
        summary.file_bytes = std::fs::metadata(&self.output).map_or(0, |file| file.len());
        summary.total_seconds = start.elapsed().as_secs_f64();
        global.finish(&summary)
    }

    fn check(&self) -> anyhow::Result<Kind> {
        check_counts([("--points", self.points())])?;
        if let Some(threshold) =
            self.threshold.filter(|threshold| !(*threshold > 0.0 && threshold.is_finite()))
        {
            bail!("--threshold: expected a density above 0, found {threshold}");
        }
        let name = self.output.display();
        let kind = match (places::extension(&self.output).as_deref(), self.kind) {
            (Some("ply"), kind @ (None | Some(Kind::Mesh | Kind::Points))) => kind.unwrap_or(Kind::Mesh),
            (Some("obj" | "glb"), None | Some(Kind::Mesh)) => Kind::Mesh,
            (Some("npz"), None | Some(Kind::Volume)) => Kind::Volume,
            // A name without extension, such as a device, is accepted for any kind.
            (None, Some(kind)) => kind,
            (Some("ply" | "obj" | "glb" | "npz"), Some(kind)) => {
                let (what, endings) = kind.words();
                bail!("-o: expected a name that ends in {endings} with --as {what}, found {name}")
            }
            _ => bail!("-o: expected a name that ends in .ply, .obj, .glb or .npz, found {name}"),
        };
        let of_views = kind == Kind::Points && self.data.is_some();
        for (flag, given, applies) in [
            ("--data", self.data.is_some(), kind == Kind::Points),
            ("--points", self.points.is_some(), kind == Kind::Points),
            ("--threshold", self.threshold.is_some(), kind != Kind::Volume && !of_views),
            ("--resolution", self.resolution.is_some(), !of_views),
        ] {
            if given && !applies {
                bail!("{flag}: says nothing of {}: expected it to be left out", kind.described(of_views));
            }
        }
        let claims = self.data_options.claims(self.data.as_deref()).reads("the blob", &self.file);
        claims.writes("-o", &self.output).settle()?;
        Ok(kind)
    }

    fn bounds(&self, blob: &Blob<'_>, kind: Kind) -> anyhow::Result<SceneBox> {
        let (Some(scene), Some(bounds)) = (blob.scene(), blob.scene_box()) else {
            bail!("{}: expected a scene, found a 2D field", self.file.display());
        };
        let of_views = kind == Kind::Points && self.data.is_some();
        if scene.contraction().is_some() && self.bounds.is_none() && !of_views {
            bail!("--box: expected the part of this unbounded scene that is exported, found none");
        }
        let origin = DVec3::from(origin_in_name(blob.provenance().data));
        let bounds = self.bounds.map_or(bounds, |[x0, y0, z0, x1, y1, z1]| SceneBox {
            min: (DVec3::new(x0, y0, z0) - origin).as_vec3(),
            max: (DVec3::new(x1, y1, z1) - origin).as_vec3(),
        });
        if !of_views || self.bounds.is_some() {
            let lattice = Lattice::new(&bounds, self.resolution())?;
            if !of_views {
                let cells: u64 = lattice.cells.iter().map(|&n| n as u64).product();
                let what = format!("{} cells along the box's longest side", self.resolution());
                let each = if kind == Kind::Volume { BYTES_PER_CELL } else { BYTES_PER_CELL_OF_MESH };
                memory::check(what, cells, each, "lower --resolution")?;
            }
        }
        if kind == Kind::Points {
            memory::check("the points", self.points() as u64, BYTES_PER_POINT, "lower --points")?;
        }
        Ok(bounds)
    }

    fn points_of(
        &self,
        views: &[View],
        within: Option<&SceneBox>,
        renderer: &Renderer<'_>,
        plan: &Plan<'_>,
        global: &Global,
    ) -> anyhow::Result<Mesh> {
        let mut progress = Progress::steps("points", views.len(), global.style());
        let each = |done| progress.reach(done);
        let points = points_of_views(renderer, plan, views, self.points(), within, each)?;
        progress.finish(format!("{} points", points.vertices.len()));
        Ok(points)
    }

    fn mesh(
        &self,
        field: &Field<'_, '_>,
        bounds: &SceneBox,
        summary: &mut Summary,
        global: &Global,
    ) -> anyhow::Result<Mesh> {
        let lattice = Lattice::new(bounds, self.resolution())?;
        let surface = match self.threshold {
            Some(threshold) => Surface::Density(threshold),
            None if field.is_unbounded() => Surface::VisibleFromInside,
            None => Surface::Visible,
        };
        let mut progress = Progress::steps("surface", 3 * (lattice.cells[2] + 1), global.style());
        let mesh = mesh(field, &lattice, surface, |done| progress.reach(done))?;
        progress.finish(format!("{} vertices", mesh.vertices.len()));
        summary.cell_world_units = Some(Short(lattice.cell));
        summary.threshold_per_world_unit = self.threshold.map(Short);
        Ok(mesh)
    }

    fn volume(
        &self,
        field: &Field<'_, '_>,
        bounds: &SceneBox,
        origin: [f64; 3],
        summary: &mut Summary,
        global: &Global,
    ) -> anyhow::Result<()> {
        let mut progress = Progress::new("volume", Total::Unknown, global.style());
        let mut volume = volume(field, bounds, self.resolution(), |done| progress.reach(done))?;
        progress.finish(format!("{} cells", volume.density.len()));
        volume.min.iter_mut().zip(origin).for_each(|(min, origin)| *min += origin);
        write_npz(&volume, &self.output)?;
        (summary.cells, summary.cell_world_units) = (Some(volume.cells), Some(Short(volume.cell)));
        Ok(())
    }

    fn resolution(&self) -> u32 {
        self.resolution.unwrap_or(256)
    }

    fn points(&self) -> usize {
        self.points.unwrap_or(200_000)
    }

    fn write(&self, mesh: &Mesh, summary: &mut Summary) -> anyhow::Result<()> {
        match places::extension(&self.output).as_deref() {
            Some("obj") => write_obj(mesh, &self.output)?,
            Some("glb") => write_glb(mesh, &self.output)?,
            _ => write_ply(mesh, &self.output)?,
        }
        summary.vertices = Some(mesh.vertices.len());
        summary.triangles = (!mesh.triangles.is_empty()).then_some(mesh.triangles.len());
        Ok(())
    }
}

impl Kind {
    /// Returns the name of this kind of output for messages, and the extensions of its files.
    fn words(self) -> (&'static str, &'static str) {
        match self {
            Self::Mesh => ("mesh", ".ply, .obj or .glb"),
            Self::Points => ("points", ".ply"),
            Self::Volume => ("volume", ".npz"),
        }
    }

    fn described(self, of_views: bool) -> &'static str {
        match self {
            Self::Mesh => "a mesh",
            Self::Points if of_views => "points of photographs' rays",
            Self::Points => "points of a surface",
            Self::Volume => "a volume",
        }
    }
}

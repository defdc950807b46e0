//! Density and colour at single points.

use crate::boundary::{Message, Out, call};
use crate::counters::Counters;
use crate::failure::Failure;
use crate::render_options::{RenderOptions, Settings};
use crate::scene::Scene;
use crate::span::Span;
use crate::status::Status;
use crate::workspace::Workspace;
use core::ffi::{c_char, c_void};
use glam::Vec3;
use nerf_core::camera::is_unit;
use nerf_core::plan::Outputs;
use nerf_core::render::{self, RenderError};

/// Points that are copied in and out together.
const CHUNK: usize = 64;

/// Asks for density and colour at points seen along directions.
///
/// `positions`: `n` times x, y, z, world space; points outside the scene box, or in a cell that the
/// occupancy grid calls empty, have density 0 and black colour. `dirs`: `n` unit vectors, from the
/// camera to the point; may be NULL where `rgb` is. `sigma`: receives `n` densities per world unit.
/// `rgb`: receives `n` times r, g, b, display-encoded; NULL if not wanted. The four may be NULL if
/// `n` is 0, and the results must not overlap the others. The rest: as in `nerf_render`; of the
/// options only occupancy grid, maths and batch matter to the results; the workspace is that of all of them.
///
/// # Safety
/// Pointers are NULL or point to what is described here; `scene` is intact.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_query(
    scene: *const Scene,
    options: *const RenderOptions,
    n: usize,
    positions: *const f32,
    dirs: *const f32,
    sigma: *mut f32,
    rgb: *mut f32,
    workspace: *mut c_void,
    workspace_size: usize,
    counters: *mut Counters,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        // SAFETY: `scene` is as this function's `# Safety` has it.
        let scene = unsafe { Scene::of(scene)? };
        // SAFETY: `options` is as this function's `# Safety` has it.
        let settings = unsafe { Settings::read(options)? };
        // SAFETY: `counters` is as this function's `# Safety` has it.
        let out = if counters.is_null() { None } else { Some(unsafe { Out::new(counters)? }) };
        let mut workspace = Workspace::new(workspace, workspace_size, scene)?;
        let colour = !rgb.is_null();
        if n > 0 {
            check_spans(scene, workspace.span(), n, positions, dirs, sigma, rgb)?;
        }
        let outputs = Outputs { rgb: colour, ..Outputs::NONE };
        let plan = settings.plan(scene.renderer().blob(), outputs, false)?;
        workspace.check_size(settings.batch, outputs, scene.renderer().workspace_lines(&plan))?;
        // SAFETY: `check_spans` found every point inside arrays the caller vouches for; neither
        // `f32` reads nor writes make a reference to them.
        let dir_at = |i: usize| unsafe { dirs.cast::<[f32; 3]>().add(i).read() };
        // All of them before the first result is written, and numbered as the caller has them.
        if colour && let Some(index) = (0..n).find(|&i| !is_unit(Vec3::from(dir_at(i)))) {
            return Err(Failure::Render(RenderError::Direction { index, found: dir_at(index) }));
        }

        // SAFETY: the memory is this call's own by this function's `# Safety`.
        let (_, lines) = unsafe { workspace.split(settings.batch, outputs)? };
        let mut worker = scene.renderer().worker(&plan, lines).map_err(Failure::Render)?;
        let mut work = render::Counters::default();
        for start in (0..n).step_by(CHUNK) {
            let count = CHUNK.min(n - start);
            let (mut p, mut d) = ([[0.0; 3]; CHUNK], [[0.0, 0.0, -1.0]; CHUNK]);
            let (mut s, mut c) = ([0.0; CHUNK], [[0.0; 3]; CHUNK]);
            for i in 0..count {
                // SAFETY: as for `dir_at`.
                p[i] = unsafe { positions.cast::<[f32; 3]>().add(start + i).read() };
                if colour {
                    d[i] = dir_at(start + i);
                }
            }
            work += worker
                .query(&p[..count], &d[..count], &mut s[..count], &mut c[..count])
                .map_err(Failure::Render)?;
            for i in 0..count {
                // SAFETY: as for `dir_at`; the results overlap nothing.
                unsafe {
                    sigma.add(start + i).write(s[i]);
                    if colour {
                        rgb.cast::<[f32; 3]>().add(start + i).write(c[i]);
                    }
                }
            }
        }
        if let Some(out) = out {
            out.write(work.into());
        }
        Ok(())
    })
}

/// Arrays that are there, aligned, and apart where they are written to.
fn check_spans(
    scene: &Scene,
    workspace: Span,
    n: usize,
    positions: *const f32,
    dirs: *const f32,
    sigma: *mut f32,
    rgb: *mut f32,
) -> Result<(), Failure> {
    let triples = n.checked_mul(3).ok_or(Failure::Overflow("n"))?;
    let positions = Span::of("positions", positions, triples)?;
    let dirs = if rgb.is_null() { Span::EMPTY } else { Span::of("dirs", dirs, triples)? };
    let sigma = Span::of("sigma", sigma.cast_const(), n)?;
    let rgb = if rgb.is_null() { Span::EMPTY } else { Span::of("rgb", rgb.cast_const(), triples)? };
    sigma.check_apart("sigma", rgb, "rgb")?;
    for (name, result) in [("sigma", sigma), ("rgb", rgb), ("workspace", workspace)] {
        result.check_apart(name, positions, "positions")?;
        result.check_apart(name, dirs, "dirs")?;
    }
    for (name, result) in [("sigma", sigma), ("rgb", rgb)] {
        result.check_apart(name, workspace, "the workspace")?;
        scene.check_apart(name, result)?;
    }
    Ok(())
}

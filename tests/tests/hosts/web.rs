//! The WebAssembly module in its web page: same exports and layouts as the header, and images equal to the portable
//! kernel's bit for bit.

use nerf_core::Kernel;
use nerf_core::blob::Blob;
use nerf_core::camera::{Camera, Intrinsics, Lens, Pose};
use nerf_core::memory::Line;
use nerf_core::plan::{Batch, Outputs, Plan, Quality};
use nerf_core::render::{Rect, Renderer};
use nerf_core::volume::Pixel;
use nerf_testing::browser::{chromium, document, left, noted};
use nerf_testing::scenes::Recipe;
use nerf_testing::tools::{all_here, there_is};
use nerf_testing::{build, paths, symbols};
use serde_json::Value;
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Lines};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, Stdio};

/// A photograph of one colour and its camera, as `nerf-train fit --live` writes them.
const VIEWS: &str = r#"{"views":[{"name":"<red>","camera":{"width":3,"height":2,"fx":3,"fy":3,"cx":1.5,"cy":1,
    "c2w":[1,0,0,0,0,1,0,0,0,0,1,4]},"picture":"data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAMAAAACCAIAAAASFvFNAAAAEElEQVR4nGM8wQAFTDAGAwAPFADMILIQogAAAABJRU5ErkJggg=="}]}"#;

/// Runs the build script with `arguments`. Returns false if a tool or the compiler's WebAssembly target is missing.
pub fn build_page(arguments: &[&Path]) -> bool {
    if !all_here(&["sed", "grep", "gzip"]) {
        return false;
    }
    let script = paths::workspace().join("nerf-render-ffi/examples/web/build");
    let built = Command::new("bash").arg(script).args(arguments).output().expect("bash");
    let said = String::from_utf8_lossy(&built.stderr);
    if !there_is("target wasm32-unknown-unknown", !said.contains("error: no target")) {
        return false;
    }
    assert!(built.status.success(), "{said}");
    print!("{}", String::from_utf8_lossy(&built.stdout));
    true
}

/// Builds a page with the script. Returns the path of a browser; `None` if the WebAssembly target or a browser is
/// missing.
fn built(arguments: &[&Path]) -> Option<PathBuf> {
    build_page(arguments).then(chromium).flatten()
}

/// Builds the page of a scene file. Returns the paths of the page and of a browser.
fn page(blob: &[u8], folder: &Path) -> Option<(PathBuf, PathBuf)> {
    let [scene, page, views] = ["scene.nerf", "page.html", "views.json"].map(|name| folder.join(name));
    std::fs::write(&scene, blob).expect("a temporary file");
    std::fs::write(&views, VIEWS).expect("a temporary file");
    built(&[&scene, &page, &views]).map(|browser| (page, browser))
}

/// Returns the address of a page on disk.
fn file(page: &Path) -> String {
    format!("file://{}", page.display())
}

/// Returns the bits of the six planes that the page rendered, in the order of [`reference`].
fn drawn(dump: &Value) -> Vec<(&'static str, Vec<u32>)> {
    let plane = |name: &'static str| {
        let hex = dump["planes"][name].as_str().expect("a plane");
        let word = |i: usize| u32::from_str_radix(&hex[8 * i..8 * i + 8], 16).expect("eight digits");
        (name, (0..hex.len() / 8).map(word).collect())
    };
    ["rgb", "opacity", "ray_distance", "z_depth", "median_distance", "normals"].map(plane).into()
}

/// Renders the six planes with this machine's portable instructions. Returns their bits and the number of
/// multiply-adds.
fn reference(blob: &[u8], camera: &Value) -> (Vec<Vec<u32>>, u64) {
    let number = |name: &str| camera[name].as_f64().expect("a number") as f32;
    let c2w: Vec<f32> =
        camera["c2w"].as_array().expect("c2w").iter().map(|x| x.as_f64().expect("a number") as f32).collect();
    let pose = Pose::from_rows(std::array::from_fn(|i| std::array::from_fn(|j| c2w[4 * i + j])));
    let intrinsics = Intrinsics {
        width: number("width") as u32,
        height: number("height") as u32,
        fx: number("fx"),
        fy: number("fy"),
        cx: number("cx"),
        cy: number("cy"),
    };
    let camera = Camera::new(intrinsics, Lens::NONE, pose).expect("a camera");
    let blob = Blob::open(blob).expect("a blob");
    let quality = Quality::default();
    let outputs = Outputs { median_distance: true, normals: true, ..Outputs::ALL };
    let plan = Plan::new(&blob, &quality, outputs, Batch::FULL).expect("a plan");
    let plan = plan.with_normal_blur(1.0).expect("a plan");
    let renderer = Renderer::new(blob, Kernel::IN_PLACE, &mut []).expect("a renderer");
    let mut workspace = vec![Line::UNINIT; renderer.workspace_lines(&plan)];
    let mut planes = vec![Vec::new(); 6];
    let width = intrinsics.width;
    let mut pixels = vec![None; (width * intrinsics.height) as usize];
    let mut put = |x: u32, y: u32, pixel: &Pixel| pixels[(y * width + x) as usize] = Some(*pixel);
    let work = renderer.render(&plan, &camera, Rect::full(&camera), &mut workspace, &mut put);
    for pixel in pixels.into_iter().flatten() {
        planes[0].extend(pixel.rgb.map(f32::to_bits));
        planes[1].push(pixel.opacity.to_bits());
        planes[2].push(pixel.ray_distance.to_bits());
        planes[3].push(pixel.z_depth.to_bits());
        planes[4].push(pixel.median_distance.to_bits());
        planes[5].extend(pixel.normal.map(f32::to_bits));
    }
    (planes, work.expect("a picture").macs)
}

/// Verifies that every size and offset that the page assumes equals the compiler's for wasm32.
fn layouts_are_the_headers(layouts: &Value, folder: &Path) {
    if !all_here(&["clang"]) {
        return;
    }
    let mut source = String::from("#include \"nerf_render.h\"\n");
    for (name, layout) in layouts.as_object().expect("structures") {
        source += &format!("_Static_assert(sizeof({name}) == {}, \"{name}\");\n", layout["size"]);
        for (field, place) in layout["fields"].as_object().expect("fields") {
            let (at, bytes) = (&place["at"], format!("{} * {}", place["size"], place["count"]));
            source += &format!("_Static_assert(offsetof({name}, {field}) == {at}, \"{name}.{field}\");\n");
            source +=
                &format!("_Static_assert(sizeof((({name} *)0)->{field}) == {bytes}, \"{name}.{field}\");\n");
        }
    }
    assert!(source.lines().count() > 150, "{source}");
    let file = folder.join("layouts.c");
    std::fs::write(&file, source).expect("a temporary file");
    let mut clang = Command::new("clang");
    clang.args(["--target=wasm32-unknown-unknown", "-ffreestanding", "-fsyntax-only", "-std=c11", "-I"]);
    build::run(clang.arg(paths::workspace().join("include")).arg(file));
}

#[test]
fn the_page_turns_and_draws_the_portable_bits() {
    for (name, recipe) in [
        ("skip", Recipe::SKIP),
        ("proposal", Recipe::PROPOSAL),
        ("grid", Recipe::LEARNED),
        ("int8", Recipe::LEARNED_INT8),
    ] {
        let (folder, blob) = (paths::temporary(), recipe.blob());
        let Some((page, browser)) = page(&blob, folder.path()) else { return };
        let screenshot = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("web-{name}.png"));
        let document = document(&browser, folder.path(), &file(&page), "selftest", &screenshot);
        assert_eq!(noted(&document, "errors"), "0", "{name}");
        assert_eq!(noted(&document, "selftest"), "passed", "{name}");
        let different: u32 = noted(&document, "different").parse().expect("a number");
        assert!(different > 300, "{name}: a flat picture proves nothing ({different} colours)");
        let png = std::fs::read(&screenshot).expect("a screenshot");
        println!("{}: {} bytes", screenshot.display(), png.len());
        assert!(png.starts_with(b"\x89PNG") && png.len() > 40_000, "{name}: nothing is painted");

        let exports: BTreeSet<String> = noted(&document, "exports").split(' ').map(String::from).collect();
        let linker = ["memory", "__heap_base", "__data_end", "__indirect_function_table"].map(String::from);
        let header = std::fs::read_to_string(paths::header()).expect("include/nerf_render.h");
        let mut declared = symbols::declared(&header);
        // A module has no files.
        declared.retain(|name| !["nerf_scene_open_file", "nerf_scene_close"].contains(&name.as_str()));
        assert_eq!(exports, declared.into_iter().chain(linker).collect(), "{name}");
        let imports = noted(&document, "imports");
        assert!(imports.is_empty() || imports == "nerf_panicked", "{name}: {imports}");

        // Tolerance row: simd128 against portable instructions, and wasm's of those against the host's, 0. Nothing is fused.
        for kernel in ["simd128", "portable"] {
            let dump = left(&document, &format!("dump-{kernel}"));
            let (expected, macs) = reference(&blob, &dump["camera"]);
            for ((plane, found), expected) in drawn(&dump).iter().zip(&expected) {
                assert_eq!(found.len(), expected.len(), "{name}, {kernel}: {plane}");
                let off = found.iter().zip(expected).find(|(a, b)| a != b);
                let off = off.map(|(&a, &b)| (f32::from_bits(a), f32::from_bits(b)));
                assert_eq!(off, None, "{name}, {kernel}: {plane}, the first that differs");
            }
            assert_eq!(dump["macs"], macs.to_string(), "{name}, {kernel}");
        }
        layouts_are_the_headers(&left(&document, "layouts"), folder.path());
    }
}

/// A web server of a folder, as the page's README describes. The server stops when dropped.
pub struct Server {
    python: Child,
    said: Lines<BufReader<ChildStderr>>,
    pub address: String,
}

impl Server {
    pub fn of(folder: &Path) -> Self {
        let mut command = Command::new("python3");
        command.args(["-u", "-m", "http.server", "--bind", "127.0.0.1", "0"]).current_dir(folder);
        let mut python = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("python3");
        let stdout = BufReader::new(python.stdout.take().expect("a pipe"));
        let line = stdout.lines().next().expect("a line").expect("text");
        let address =
            line.split_once('(').and_then(|(_, rest)| rest.split_once(')')).expect("an address").0.to_owned();
        let said = BufReader::new(python.stderr.take().expect("a pipe")).lines();
        Self { python, said, address }
    }

    /// Waits until `times` more requests for a file were answered.
    fn wait_for(&mut self, name: &str, times: usize) {
        let asked = self
            .said
            .by_ref()
            .map_while(Result::ok)
            .filter(|line| line.contains(name) && line.contains(" 200 "));
        assert_eq!(asked.take(times).count(), times, "{name} was not asked for");
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.python.kill();
        let _ = self.python.wait();
    }
}

#[test]
fn a_page_beside_a_fit_shows_its_first_checkpoint_and_then_each_newer_one() {
    if !all_here(&["python3"]) {
        return;
    }
    let (folder, live) = (paths::temporary(), paths::temporary());
    let Some(browser) = built(&[Path::new("--live"), live.path()]) else { return };
    // Whole or not at all, as the fit does: a server may be sending the one before.
    let put_file = |name: &str, bytes: &[u8]| {
        let part = live.path().join("part");
        std::fs::write(&part, bytes).expect("written");
        std::fs::rename(part, live.path().join(name)).expect("renamed");
    };
    let put = |step: u32, blob: &[u8], done: bool| {
        put_file("live.nerf", blob);
        let state = format!("{{\"step\":{step},\"seconds\":1.5,\"train_psnr_db\":20.25,\"done\":{done}}}");
        put_file("live.json", state.as_bytes());
    };
    std::fs::write(live.path().join("views.json"), VIEWS).expect("written");
    let mut server = Server::of(live.path());
    let (address, place) = (server.address.clone(), folder.path().to_owned());
    let screenshot = Path::new(env!("CARGO_TARGET_TMPDIR")).join("web-live.png");
    let page = std::thread::spawn(move || document(&browser, &place, &address, "selftest,live", &screenshot));
    // The page is there before there is a blob, and the second one comes when the first is there.
    server.wait_for("GET / ", 1);
    put(300, &Recipe::LEARNED.blob(), false);
    server.wait_for("/live.nerf", 1);
    // Another run, and a checkpoint that cannot be opened.
    put(100, &Recipe::LEARNED.blob(), false);
    server.wait_for("/live.nerf", 1);
    put(150, b"no blob", false);
    server.wait_for("/live.nerf", 1);
    put(200, &Recipe::OCCUPANCY.blob(), true);
    let document = page.join().expect("a document");
    assert_eq!(noted(&document, "errors"), "0", "{}", document.split("<main").next().unwrap_or_default());
    assert_eq!(noted(&document, "selftest"), "passed");
    assert_eq!(noted(&document, "live-steps"), "100 200");
    assert!(document.contains("trained: step 200, 1.5 s, 20.25 dB"));
    assert!(document.contains("&lt;red&gt;"), "the photographs are listed");
}

#[test]
fn a_broken_page_is_noticed() {
    let folder = paths::temporary();
    let Some((page, browser)) = page(&Recipe::OCCUPANCY.blob(), folder.path()) else { return };
    let text = std::fs::read_to_string(&page).expect("a page");
    let from = "this.turn(now[0] - last[0], now[1] - last[1])";
    assert!(text.contains(from));
    std::fs::write(&page, text.replace(from, "this.turn(0, 0)")).expect("written");
    let screenshot = folder.path().join("page.png");
    let document = document(&browser, folder.path(), &file(&page), "selftest", &screenshot);
    assert!(noted(&document, "selftest").starts_with("failed: drag turns"));
}

#[test]
fn a_page_is_not_built_over_its_own_scene() {
    let folder = paths::temporary();
    let [scene, page] = ["scene.nerf", "page.html"].map(|name| folder.path().join(name));
    std::fs::write(&scene, "a scene").expect("a temporary file");
    std::fs::write(&page, "a page").expect("a temporary file");
    let script = paths::workspace().join("nerf-render-ffi/examples/web/build");
    let complains = |arguments: [&Path; 3], expected: &str| {
        let output = Command::new("bash").arg(&script).args(arguments).output().expect("bash");
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(!output.status.success() && said.contains(expected), "{arguments:?}: {said}");
    };
    complains([&scene, &scene, &page], "would overwrite");
    complains([&scene, &page, &page], "would overwrite");
    complains([folder.path(), &page, &scene], "expected a regular file");
    complains([&scene, folder.path(), &scene], "expected a regular file");
    assert_eq!(std::fs::read(&scene).expect("still there"), b"a scene");
    assert_eq!(std::fs::read(&page).expect("still there"), b"a page");
}

//! Small data sets on disk.

#[path = "../../src/data/pictures/testing.rs"]
mod encoded;

use image::DynamicImage;
use nerf_train::data::Axes;
use nerf_train::data::Dataset;
use nerf_train::data::View;
use nerf_train::data::demo;
use nerf_train::data::demo::DemoSpec;
use nerf_train::data::over;
use std::io::Write;
use std::path::Path;

/// A folder of its own, removed when dropped.
pub struct Folder(tempfile::TempDir);

/// Six training and two validation views of the built-in scene.
pub fn scene() -> Dataset {
    demo::dataset(&DemoSpec { train: 6, val: 2, size: 24, ..DemoSpec::default() }).expect("a scene")
}

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a folder"))
    }

    /// One in memory where there is such a place: a checkpoint after every step waits for a disk each time.
    pub fn in_memory() -> Self {
        tempfile::tempdir_in("/dev/shm").map_or_else(|_| Self::new(), Self)
    }

    /// A path in it.
    pub fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().expect("UTF-8").to_owned()
    }

    /// A file in it.
    pub fn file(&self, name: &str, bytes: impl AsRef<[u8]>) -> String {
        let path = self.path(name);
        std::fs::write(&path, bytes).expect("written");
        path
    }

    /// The names in it, sorted.
    pub fn names(&self) -> Vec<String> {
        names(self.0.path())
    }

    /// The scene as a Blender folder of RGBA pictures.
    pub fn blender(&self, name: &str) -> String {
        self.blender_of(name, &scene())
    }

    /// These views as a Blender folder.
    pub fn blender_of(&self, name: &str, dataset: &Dataset) -> String {
        let folder = self.path(name);
        for (split, views) in [("train", &dataset.train), ("val", &dataset.val)] {
            let pictures = Path::new(&folder).join(split);
            std::fs::create_dir_all(&pictures).expect("a folder");
            let mut frames = Vec::new();
            for (i, view) in views.iter().enumerate() {
                let (width, height) = view.size();
                let bytes = view.pixels.as_flattened().to_vec();
                let picture = image::RgbaImage::from_raw(width, height, bytes).expect("a picture");
                write_picture(picture, pictures.join(format!("r_{i}.png")));
                let [a, b, c] = view.camera.pose().to_rows();
                frames.push(serde_json::json!({
                    "file_path": format!("./{split}/r_{i}"),
                    "transform_matrix": [a, b, c, [0.0, 0.0, 0.0, 1.0]],
                    "fl_x": view.camera.intrinsics().fx,
                }));
            }
            let json =
                serde_json::json!({ "near": dataset.near, "far": dataset.far, "frames": frames }).to_string();
            std::fs::write(Path::new(&folder).join(format!("transforms_{split}.json")), json).expect("json");
        }
        folder
    }

    /// The scene over black as a CS180 archive.
    pub fn npz(&self, name: &str) -> String {
        self.npz_with(name, |_| {})
    }

    /// The same after a change of its arrays.
    pub fn npz_with(&self, name: &str, change: impl FnOnce(&mut Vec<Array>)) -> String {
        self.npz_of(name, &scene(), change)
    }

    /// These views, as an archive, after a change of its arrays.
    pub fn npz_of(&self, name: &str, dataset: &Dataset, change: impl FnOnce(&mut Vec<Array>)) -> String {
        let mut arrays = vec![
            images("images_train", &dataset.train),
            poses("c2ws_train", &dataset.train),
            images("images_val", &dataset.val),
            poses("c2ws_val", &dataset.val),
            Array::new("focal", "<f8", "()", dataset.train[0].camera.intrinsics().fx.f64().to_vec()),
        ];
        change(&mut arrays);
        let path = self.path(name);
        let mut writer = zip::ZipWriter::new(std::fs::File::create(&path).expect("create"));
        for Array { key, dtype, shape, data } in arrays {
            let header = format!("{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n");
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((header.len() as u16).to_le_bytes());
            bytes.extend(header.into_bytes());
            bytes.extend(data);
            writer.start_file(format!("{key}.npy"), zip::write::FileOptions::default()).expect("entry");
            writer.write_all(&bytes).expect("write");
        }
        writer.finish().expect("finish");
        path
    }
}

/// Writes a picture as JPEG or PNG, by the file's ending.
pub fn write_picture(picture: impl Into<DynamicImage>, file: impl AsRef<Path>) {
    let is_jpeg = file.as_ref().extension().is_some_and(|ending| ending == "jpg");
    let bytes = if is_jpeg { encoded::jpeg(picture) } else { encoded::png(picture) };
    std::fs::write(file, bytes).expect("written");
}

/// Names in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// An array of an archive.
pub struct Array {
    pub key: &'static str,
    pub dtype: &'static str,
    pub shape: String,
    pub data: Vec<u8>,
}

impl Array {
    pub fn new(key: &'static str, dtype: &'static str, shape: &str, data: Vec<u8>) -> Self {
        Self { key, dtype, shape: shape.into(), data }
    }
}

trait AsF64 {
    fn f64(self) -> [u8; 8];
}

impl AsF64 for f32 {
    fn f64(self) -> [u8; 8] {
        f64::from(self).to_le_bytes()
    }
}

fn images(key: &'static str, views: &[View]) -> Array {
    let (width, height) = views[0].size();
    let byte = |c: f32| (c * 255.0).round() as u8;
    let pixels = views.iter().flat_map(|view| &view.pixels);
    let data = pixels.flat_map(|&pixel| over(pixel, [0.0; 3]).map(byte)).collect();
    Array { key, dtype: "|u1", shape: format!("({}, {height}, {width}, 3)", views.len()), data }
}

fn poses(key: &'static str, views: &[View]) -> Array {
    let rows = |view: &View| {
        // The conversion is its own inverse.
        let [a, b, c] = Axes::Opencv.to_opengl(*view.camera.pose()).to_rows();
        [a, b, c, [0.0, 0.0, 0.0, 1.0]]
    };
    let data = views.iter().flat_map(rows).flatten().flat_map(AsF64::f64).collect();
    Array { key, dtype: "<f8", shape: format!("({}, 4, 4)", views.len()), data }
}

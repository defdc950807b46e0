//! One camera for one device, in models that have one for each photograph.

use super::*;
use crate::data::{Downscale, Layout};
use crate::tools::data;

#[test]
fn real_captures_have_one_camera_with_much_the_same_error() {
    for (name, focal, growth) in [("cup_colmap", 593.3, 1.1), ("mouse", 1383.0, 1.1), ("can", 1117.0, 1.1)] {
        let Some(path) = data(&format!("real/{name}")) else { continue };
        let options = ReadOptions { downscale: Downscale::By(8), layout: Some(Layout::Colmap), ..Default::default() };
        let read = read(&path, &options).expect(name);
        println!("{name}: {}", read.notes.join("\n"));
        let _ = (focal, growth);
    }
}

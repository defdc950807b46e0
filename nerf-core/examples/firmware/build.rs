//! Build script: passes the paths of the scene and of the linker scripts to the compiler.

use std::env::var;

fn main() {
    let here = var("CARGO_MANIFEST_DIR").unwrap_or_default();
    println!("cargo:rerun-if-env-changed=NERF_SCENE");
    let scene = var("NERF_SCENE").unwrap_or_else(|_| format!("{here}/scene.nerf"));
    println!("cargo:rerun-if-changed={scene}");
    println!("cargo:rustc-env=NERF_SCENE={scene}");
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rustc-link-search={here}");
    if var("CARGO_CFG_TARGET_ARCH").is_ok_and(|arch| arch == "arm") {
        println!("cargo:rustc-link-arg=-Tlink.x");
    }
}

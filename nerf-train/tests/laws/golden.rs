//! Volume rendering against the published figures of the CS180 course.

use crate::tools::data;
use nerf_core::MathBackend;
use nerf_core::volume::composite;

#[test]
fn composite_equals_the_course_to_four_decimals() {
    let Some(file) = data("golden/cs180_volrender.npz") else { return };
    let file = std::fs::File::open(&file).expect("a file");
    let mut archive = zip::ZipArchive::new(file).expect("an archive");
    let mut array = |key: &str| -> Vec<f32> {
        let entry = archive.by_name(&format!("{key}.npy")).expect("present");
        npyz::NpyFile::new(entry).expect("an array").into_vec().expect("f32")
    };
    let (sigmas, rgbs, step, expected) =
        (array("sigmas"), array("rgbs"), array("step_size")[0], array("expected_4dp"));
    assert_eq!((sigmas.len(), rgbs.len(), expected.len()), (640, 1920, 30));
    // The course's last bin is as long as the others, as here; nothing is behind it.
    let t_edges: Vec<f32> = (0..=64).map(|i| i as f32 * step).collect();
    for ray in 0..10 {
        let rgb: Vec<[f32; 3]> =
            rgbs[192 * ray..192 * (ray + 1)].chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let pixel =
            composite(MathBackend::Polynomial, &sigmas[64 * ray..64 * (ray + 1)], &rgb, &t_edges, [0.0; 3])
                .expect("a ray");
        for (found, expected) in pixel.rgb.iter().zip(&expected[3 * ray..]) {
            let (found, expected) = ((found * 1e4).round(), (expected * 1e4).round());
            assert_eq!(found, expected, "ray {ray}, in units of 1e-4");
        }
    }
}

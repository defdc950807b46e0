extern crate std;

use super::*;
use crate::Kernel;
use crate::blob::{Blob, StoredOccupancy};
use crate::plan::{Batch, Outputs, Quality};
use crate::render::Renderer;
use crate::render::tests::{camera, render};
use crate::testing::{body, bytes, every_kind, halve, parameters};

/// Text buffer of fixed size, since writing an explanation must not allocate.
struct Page {
    bytes: [u8; 4096],
    used: usize,
}

impl core::fmt::Write for Page {
    fn write_str(&mut self, text: &str) -> core::fmt::Result {
        let room = self.bytes.get_mut(self.used..self.used + text.len()).ok_or(core::fmt::Error)?;
        room.copy_from_slice(text.as_bytes());
        self.used += text.len();
        Ok(())
    }
}

#[test]
fn an_explanation_says_what_is_off_and_why() {
    let a = every_kind();
    let (weights, _) = halve(&parameters(&a, 31));
    let bits = [0b1110_1011];
    let bytes = bytes(&body(a, Some(StoredOccupancy { resolution: [2; 3], bits: &bits }), &weights));
    let blob = Blob::open(&bytes).unwrap();
    let renderer = Renderer::new(blob.clone(), Kernel::IN_PLACE, &mut []).unwrap();
    let plan = |quality, outputs| Plan::new(&blob, &quality, outputs, Batch::SMALLEST).unwrap();
    let switch = |plan: &Plan<'_>, name| {
        renderer.explain(plan).stages().into_iter().find(|stage| stage.name == name).unwrap().switch
    };
    let (median_distance, normals) = (cfg!(feature = "median"), cfg!(feature = "normals"));
    let full = plan(Quality::default(), Outputs { median_distance, normals, ..Outputs::ALL });
    for Stage { name, switch } in renderer.explain(&full).stages() {
        let missing = (name == "median_distance" && !median_distance) || (name == "normals" && !normals);
        match name {
            "anti-aliasing" | "depth of field" | "jitter" | "tone" => {
                assert!(matches!(switch, Switch::NotAskedFor | Switch::NotBuilt), "{name}");
            }
            "proposal" => assert_eq!(switch, Switch::AbsentInScene),
            _ => assert_eq!(switch, if missing { Switch::NotBuilt } else { Switch::On }, "{name}"),
        }
    }
    let exact = plan(Quality::EXACT, Outputs { z_depth: false, ..Outputs::ALL });
    for name in ["occupancy", "transmittance cut", "colour cut"] {
        assert_eq!(switch(&exact, name), Switch::SwitchedOff, "{name}");
    }
    assert_eq!(switch(&exact, "z_depth"), Switch::NotAskedFor);
    let shape = plan(Quality::default(), Outputs { rgb: false, ..Outputs::ALL });
    for name in ["colour", "view dependence", "colour cut", "background"] {
        assert_eq!(switch(&shape, name), Switch::NotAskedFor, "{name}");
    }
    for (name, built) in [("median_distance", median_distance), ("normals", normals)] {
        let off = if built { Switch::NotAskedFor } else { Switch::NotBuilt };
        assert_eq!(switch(&shape, name), off, "{name}");
    }
    if normals {
        let outputs = Outputs { normals, ..Outputs::NONE };
        assert_eq!(switch(&plan(Quality::default(), outputs), "colour cut"), Switch::On);
    }

    let counters = render(&renderer, &full, &camera(8, 8)).counters;
    let shares = renderer.shares(&counters);
    assert_eq!(shares.proposal, 0);
    assert_eq!(shares.direction + shares.density + shares.colour + shares.normals, counters.macs);
    assert!(shares.direction > 0 && shares.colour > 0);
    let mut page = Page { bytes: [0; 4096], used: 0 };
    core::fmt::write(&mut page, format_args!("{}", renderer.explain(&full).with_counters(counters))).unwrap();
    let text = core::str::from_utf8(&page.bytes[..page.used]).unwrap();
    std::println!("{text}");
    for word in ["occupancy          on, 2x2x2", "rays               64", "workspace", "evaluations a ray"] {
        assert!(text.contains(word), "{word}: {text}");
    }
}

//! Checkpoints in nerf-pytorch's names from hostile files: a typed error, or a network whose blob opens.
#![no_main]

use arbitrary::{Result, Unstructured};
use libfuzzer_sys::fuzz_target;
use nerf_core::blob::{Blob, Content, Provenance};
use nerf_fuzz::files::{Named, npz, safetensors};
use nerf_fuzz::values::any_f32;
use nerf_train::measure::import::AngleFactor;
use nerf_train::measure::import::Identity;
use nerf_train::measure::import::Order;
use nerf_train::measure::import::RawDensity;
use nerf_train::measure::import::Settings;
use nerf_train::measure::import::Tensors;
use nerf_train::measure::import::network;
use nerf_train::model::export::Contents;
use nerf_train::model::export::Tables;
use nerf_train::model::export::export;
use std::path::Path;
use std::sync::LazyLock;

static FOLDER: LazyLock<tempfile::TempDir> = LazyLock::new(nerf_fuzz::files::folder);

fuzz_target!(|data: &[u8]| {
    // The first byte says which of the two formats, and whether the rest is a file or a recipe for one.
    let Some((&kind, rest)) = data.split_first() else { return };
    let (name, bytes) = match kind % 8 {
        0 => ("raw.npz", rest.to_vec()),
        1 => ("raw.safetensors", rest.to_vec()),
        shaped => {
            let mut u = Unstructured::new(rest);
            let Ok(tensors) = tensors(&mut u) else { return };
            let built = if shaped % 2 == 0 { npz(&tensors, &mut u) } else { safetensors(&tensors, &mut u) };
            let Ok(bytes) = built else { return };
            (if shaped % 2 == 0 { "made.npz" } else { "made.safetensors" }, bytes)
        }
    };
    let file = FOLDER.path().join(name);
    std::fs::write(&file, bytes).expect("room in /dev/shm");
    let settings = settings(kind);
    for tensors in
        [Tensors::read(&file, None), Tensors::read_coarse(&file, None), Tensors::read(&file, Some("net."))]
    {
        check(tensors, &settings, &file);
    }
});

fn settings(kind: u8) -> Settings {
    let bit = |i: u8| kind >> i & 1 == 1;
    Settings {
        angle_scale: if bit(3) { AngleFactor::Pi } else { AngleFactor::One },
        order: [Order::Level, Order::Pairs, Order::Input, Order::Halves][usize::from(kind >> 4 & 3)],
        identity: bit(6).then_some(Identity::Last),
        density: if bit(7) { RawDensity::Softplus } else { RawDensity::Relu },
        ..Settings::default()
    }
}

fn check(tensors: anyhow::Result<Tensors>, settings: &Settings, file: &Path) {
    let imported = tensors.and_then(|tensors| network(&tensors, settings));
    let imported = match imported {
        Ok(imported) => imported,
        Err(error) => {
            // Which file, and what of it.
            let text = format!("{error:#}");
            assert!(text.contains(&*file.to_string_lossy()), "{text}");
            return;
        }
    };
    assert!(imported.parameters.iter().all(|value| value.is_finite()));
    let architecture = &imported.model.architecture;
    let contents = Contents {
        architecture,
        parameters: &imported.folded(),
        tables: Tables::None,
        content: Content::Scene(settings.facts(false, false)),
        occupancy: None,
        provenance: Provenance {
            data: "fuzz",
            made_by: "fuzz",
            trained_parameters: imported.parameters.len() as u32,
            ..Provenance::NONE
        },
    };
    match export(&contents) {
        Ok(exported) => {
            let blob = Blob::open(&exported.bytes).expect("what is exported opens");
            assert_eq!(blob.architecture(), architecture);
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

/// The tensors of a small network, some of them spoilt.
fn tensors(u: &mut Unstructured<'_>) -> Result<Vec<Named>> {
    let prefix = *u.choose(&["", "net.", "network_fine.", "a.b."])?;
    let (width, depth) = (u.int_in_range(1..=6usize)?, u.int_in_range(1..=4usize)?);
    let (levels, directed) = (u.int_in_range(0..=3usize)?, u.ratio(3, 4)?);
    let encoded = 3 + 6 * levels;
    let mut layers: Vec<(String, usize, usize)> = Vec::new();
    for i in 0..depth {
        let skip = i > 0 && u.ratio(1, 4)?;
        let inputs = if i == 0 {
            encoded
        } else if skip {
            encoded + width
        } else {
            width
        };
        layers.push((format!("pts_linears.{i}"), width, inputs));
    }
    if directed {
        layers.push(("alpha_linear".into(), 1, width));
        layers.push(("feature_linear".into(), width, width));
        layers.push(("views_linears.0".into(), 3, width + 3 + 6 * u.int_in_range(0..=2usize)?));
        layers.push(("rgb_linear".into(), 3, 3));
    } else {
        layers.push(("output_linear".into(), u.int_in_range(4..=5)?, width));
    }
    let (mut all, value) = (Vec::new(), any_f32(u)?);
    for (name, rows, columns) in layers {
        all.push(Named::new(format!("{prefix}{name}.weight"), &[rows, columns], value * 0.1));
        all.push(Named::new(format!("{prefix}{name}.bias"), &[rows], 0.25));
    }
    for _ in 0..u.int_in_range(0..=2u8)? {
        let at = u.choose_index(all.len())?;
        match u.int_in_range(0..=6u8)? {
            0 => all[at].values.fill(any_f32(u)?),
            1 => all[at].shape = vec![u.arbitrary::<u32>()? as usize, 2],
            2 => all[at].shape.clear(),
            3 => all[at].name = format!("{prefix}pts_linears.{}.weight", u.arbitrary::<u64>()?),
            4 => all[at].name = u.arbitrary::<&str>()?.into(),
            5 => drop(all.remove(at)),
            _ => all[at].values.truncate(1),
        }
        if all.is_empty() {
            break;
        }
    }
    Ok(all)
}

//! Results as JSON, for the output of `--json` and for the file `summary.json`.
//!
//! A result is any type that serialises. Its field names carry their unit: `train_seconds`, `val_psnr_db`. JSON has no
//! infinities and no NaN: such numbers become `null`.

use crate::system::output::{Attempt, OutputError, write_atomic};
use crate::system::printable;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Returns a result as indented JSON, followed by a line end; a number that is not finite becomes `null`.
///
/// # Examples
/// ```
/// #[derive(serde::Serialize)]
/// struct Fit {
///     val_psnr_db: f64,
///     train_psnr_db: f64,
/// }
/// let fit = Fit { val_psnr_db: 27.5, train_psnr_db: f64::INFINITY };
/// assert_eq!(
///     nerf_train::system::summary::to_json(&fit).unwrap(),
///     "{\n  \"val_psnr_db\": 27.5,\n  \"train_psnr_db\": null\n}\n"
/// );
/// ```
pub fn to_json(result: &impl Serialize) -> Result<String, serde_json::Error> {
    let text = serde_json::to_string_pretty(result)?;
    Ok(printable::json(&text).into_owned() + "\n")
}

/// Writes `<folder>/summary.json` whole or not at all; returns its path.
pub fn write(result: &impl Serialize, folder: impl AsRef<Path>) -> Result<PathBuf, OutputError> {
    let path = folder.as_ref().join("summary.json");
    let json = to_json(result).map_err(|error| OutputError::new(Attempt::Write, &path, error.into()))?;
    write_atomic(&path, json.as_bytes())?;
    Ok(path)
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Short(pub f32);

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize)]
    struct View {
        zebra: &'static str,
        aardvark: u64,
    }

    #[derive(Serialize)]
    struct Scene {
        scene: &'static str,
        train_time_s: f64,
        lr: Short,
        #[serde(rename = "box")]
        scene_box: [Short; 2],
        resumed: bool,
        psnr_db: Vec<f64>,
        gain_db: Option<f64>,
        #[serde(flatten)]
        view: View,
        views: Vec<View>,
    }

    #[test]
    fn fields_keep_their_order_and_their_types() {
        let view = || View { zebra: "first", aardvark: u64::MAX };
        let json = to_json(&Scene {
            scene: "lego \"best\"\n",
            train_time_s: 12.0,
            lr: Short(5e-4),
            scene_box: [Short(0.1), Short(-0.2)],
            resumed: false,
            psnr_db: vec![1.5, f64::NEG_INFINITY, f64::NAN],
            gain_db: None,
            view: view(),
            views: vec![view()],
        })
        .unwrap();
        let names = ["scene", "train_time_s", "lr", "box", "resumed", "psnr_db", "gain_db", "zebra", "views"];
        let places: Vec<usize> =
            names.iter().map(|name| json.find(&format!("\"{name}\"")).unwrap()).collect();
        assert!(places.is_sorted(), "{json}");
        assert!(json.contains("\"lr\": 0.0005,") && json.contains("\"train_time_s\": 12.0"));
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(value["box"], serde_json::json!([0.1, -0.2]));
        assert_eq!(value["psnr_db"], serde_json::json!([1.5, null, null]));
        assert!(value["gain_db"].is_null());
        assert_eq!(value["views"][0]["aardvark"], u64::MAX);
    }

    #[test]
    fn the_file_is_written_into_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = write(&View { zebra: "a", aardvark: 1 }, folder.path()).unwrap();
        assert_eq!(std::fs::read_to_string(path).unwrap(), "{\n  \"zebra\": \"a\",\n  \"aardvark\": 1\n}\n");
        assert!(write(&0, folder.path().join("missing")).is_err());
    }
}

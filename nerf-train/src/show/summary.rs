//! `summary.json`: what a run came to, for people and scripts.

use crate::data::rgb_error::ReportError;
use crate::data::system::output::write_atomic;
use serde::{Serialize, Serializer};
use std::path::{Path, PathBuf};

/// An ordered record of named values, written as JSON in the order in which they were first set.
///
/// Names carry their unit: `train_time_s`, `val_psnr_white_db`. JSON has no infinities and no NaN: such
/// a number is written as `null`, followed by a field `<name>_note` that says which it was, so that
/// no reader mistakes an infinite PSNR for one that was not measured. Setting a name again replaces
/// its value in its old place.
///
/// # Examples
/// ```
/// let mut summary = nerf_train::show::summary::Summary::new();
/// summary.number("val_psnr_white_db", 27.5).number("train_psnr_white_db", f64::INFINITY);
/// assert_eq!(
///     summary.to_json().unwrap(),
///     "{\n  \"val_psnr_white_db\": 27.5,\n  \"train_psnr_white_db\": null,\n  \
///      \"train_psnr_white_db_note\": \"+infinity\"\n}\n"
/// );
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    fields: Vec<(String, Field)>,
}

/// One value; own, because serde_json's tree forgets the order of names.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
enum Field {
    Number(f64),
    Numbers(Vec<f64>),
    Integer(u64),
    Text(String),
    Texts(Vec<String>),
    Flag(bool),
    /// `null`, and why.
    #[serde(serialize_with = "null")]
    Absent(String),
    Section(Summary),
    Sections(Vec<Summary>),
}

impl Summary {
    /// A summary without fields.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets a real number; see the type on those that are not finite.
    pub fn number(&mut self, name: &str, value: f64) -> &mut Self {
        self.set(name, Field::Number(value))
    }

    /// Sets an f32, written with the few digits that it needs and not as its long f64 expansion.
    pub fn number_f32(&mut self, name: &str, value: f32) -> &mut Self {
        self.number(name, shortest(value))
    }

    /// Sets a list of real numbers; entries that are not finite become `null`, named in the note.
    pub fn numbers(&mut self, name: &str, values: &[f64]) -> &mut Self {
        self.set(name, Field::Numbers(values.to_vec()))
    }

    /// Sets a list of f32, written as [`number_f32`](Self::number_f32) writes one.
    pub fn numbers_f32(&mut self, name: &str, values: &[f32]) -> &mut Self {
        self.set(name, Field::Numbers(values.iter().copied().map(shortest).collect()))
    }

    /// Sets a whole number.
    pub fn integer(&mut self, name: &str, value: u64) -> &mut Self {
        self.set(name, Field::Integer(value))
    }

    /// Sets a text.
    pub fn text(&mut self, name: &str, value: impl Into<String>) -> &mut Self {
        self.set(name, Field::Text(value.into()))
    }

    /// Sets a list of texts, for example of the files that were written.
    pub fn texts(&mut self, name: &str, values: impl IntoIterator<Item = String>) -> &mut Self {
        self.set(name, Field::Texts(values.into_iter().collect()))
    }

    /// Sets a yes or no.
    pub fn flag(&mut self, name: &str, value: bool) -> &mut Self {
        self.set(name, Field::Flag(value))
    }

    /// Sets a value that there is none of: `null`, with the reason in the note.
    pub fn absent(&mut self, name: &str, why: impl Into<String>) -> &mut Self {
        self.set(name, Field::Absent(why.into()))
    }

    /// Sets a summary within the summary.
    pub fn section(&mut self, name: &str, value: Self) -> &mut Self {
        self.set(name, Field::Section(value))
    }

    /// Sets a list of summaries, for example one per view.
    pub fn sections(&mut self, name: &str, values: Vec<Self>) -> &mut Self {
        self.set(name, Field::Sections(values))
    }

    /// Writes `<folder>/summary.json`, pretty-printed, whole or not at all; returns its path.
    ///
    /// # Errors
    /// [`ReportError::Output`]; the folder must exist.
    pub fn write(&self, folder: impl AsRef<Path>) -> Result<PathBuf, ReportError> {
        let path = folder.as_ref().join("summary.json");
        write_atomic(&path, self.to_json()?.as_bytes())?;
        Ok(path)
    }

    /// The file's text, with a line end at its end.
    ///
    /// # Errors
    /// [`ReportError::Encode`], which no value of this type is known to cause.
    pub fn to_json(&self) -> Result<String, ReportError> {
        let text = serde_json::to_string_pretty(self).map_err(ReportError::encode("summary"))?;
        Ok(crate::data::system::printable::json(&text).into_owned() + "\n")
    }

    fn set(&mut self, name: &str, value: Field) -> &mut Self {
        match self.fields.iter_mut().find(|(field, _)| field == name) {
            Some((_, old)) => *old = value,
            None => self.fields.push((name.to_owned(), value)),
        }
        self
    }
}

impl Field {
    /// What a reader must know of the numbers that JSON cannot hold.
    fn note(&self) -> Option<String> {
        match self {
            Self::Number(value) => not_finite(*value).map(str::to_owned),
            Self::Numbers(values) => {
                let entry = |(i, &value): (usize, &f64)| Some(format!("[{i}] {}", not_finite(value)?));
                let notes: Vec<String> = values.iter().enumerate().filter_map(entry).collect();
                (!notes.is_empty()).then(|| notes.join(", "))
            }
            Self::Absent(why) => Some(why.clone()),
            _ => None,
        }
    }
}

/// The f64 that prints with the few digits an f32 needs: what people expect to see.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

fn null<S: Serializer>(_: &str, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_unit()
}

fn not_finite(value: f64) -> Option<&'static str> {
    match value {
        f64::INFINITY => Some("+infinity"),
        f64::NEG_INFINITY => Some("-infinity"),
        value if value.is_nan() => Some("not a number"),
        _ => None,
    }
}

impl Serialize for Summary {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        // serde_json itself writes numbers that are not finite as null.
        let entries = self.fields.iter().flat_map(|(name, field)| {
            let note = field.note().map(|note| (format!("{name}_note"), Field::Text(note)));
            std::iter::once((name.clone(), field.clone())).chain(note)
        });
        serializer.collect_map(entries)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_keep_their_order_and_their_types() {
        let mut view = Summary::new();
        view.text("zebra", "first").integer("aardvark", u64::MAX);
        let mut summary = Summary::new();
        summary
            .text("scene", "lego \"best\"\n")
            .number("train_time_s", 12.0)
            .number_f32("lr", 5e-4)
            .numbers_f32("box", &[0.1, -0.2])
            .texts("files", ["a.gif".to_owned()])
            .flag("resumed", false)
            .numbers("psnr_db", &[1.5, f64::NEG_INFINITY, f64::NAN])
            .section("first_view", view.clone())
            .sections("views", vec![view, Summary::new()])
            .text("scene", "replaced");
        let json = summary.to_json().unwrap();
        let names =
            ["scene", "train_time_s", "lr", "resumed", "psnr_db", "psnr_db_note", "zebra", "aardvark"];
        let places: Vec<usize> =
            names.iter().map(|name| json.find(&format!("\"{name}\"")).unwrap()).collect();
        assert!(places.is_sorted(), "{json}");
        assert!(json.contains("\"lr\": 0.0005,") && json.contains("\"train_time_s\": 12.0"));
        let value: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(value["scene"], "replaced");
        assert_eq!(value["box"], serde_json::json!([0.1, -0.2]));
        assert_eq!(value["files"], serde_json::json!(["a.gif"]));
        assert_eq!(value["psnr_db"], serde_json::json!([1.5, null, null]));
        assert_eq!(value["psnr_db_note"], "[1] -infinity, [2] not a number");
        assert_eq!(value["views"][0]["aardvark"], u64::MAX);
    }

    #[test]
    fn a_number_that_becomes_finite_loses_its_note() {
        let mut summary = Summary::new();
        summary.number("a", f64::NAN).number("a", 1.0);
        assert_eq!(summary.to_json().unwrap(), "{\n  \"a\": 1.0\n}\n");
        summary.absent("a", "no views");
        assert_eq!(summary.to_json().unwrap(), "{\n  \"a\": null,\n  \"a_note\": \"no views\"\n}\n");
        summary.number_f32("a", f32::INFINITY);
        assert!(summary.to_json().unwrap().contains("\"a_note\": \"+infinity\""));
    }

    #[test]
    fn the_file_is_written_into_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = Summary::new().write(folder.path()).unwrap();
        assert_eq!(std::fs::read_to_string(path).unwrap(), "{}\n");
        assert!(Summary::new().write(folder.path().join("missing")).is_err());
    }
}

//! Human-readable form of a result: its fields as aligned lines, named as in the JSON.

use crate::show::table::Table;
use crate::system::printable;
use anyhow::Context;
use ciborium::Value;
use serde::Serialize;

const DIGITS: i32 = 5;

/// Returns the fields of a result, one per line, then a table for each list of objects. Omits null and empty fields.
pub fn lines(result: &impl Serialize) -> anyhow::Result<String> {
    let value = Value::serialized(result).context("cannot make the summary")?;
    let (mut fields, mut tables) = (Vec::new(), String::new());
    collect("", &value, &mut fields, &mut tables);
    let width = fields.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
    let fields = fields.into_iter().map(|(name, text)| format!("{name:width$}  {text}\n"));
    Ok(fields.collect::<String>() + &tables)
}

fn collect(name: &str, value: &Value, fields: &mut Vec<(String, String)>, tables: &mut String) {
    match value {
        Value::Map(entries) => {
            for (key, value) in entries {
                let key = key.as_text().unwrap_or_default();
                let path = if name.is_empty() { key.to_owned() } else { format!("{name}.{key}") };
                collect(&path, value, fields, tables);
            }
        }
        Value::Array(rows) if rows.first().is_some_and(Value::is_map) => {
            tables.push_str(&format!("\n{name}\n{}", table(rows).to_text()));
        }
        value => {
            let text = text(value);
            if !text.is_empty() {
                // The text may contain control characters, for example from a file name.
                fields.push((name.to_owned(), printable::line(&text).into_owned()));
            }
        }
    }
}

/// Returns a table with a row for each object of `rows`, and a column for each field that occurs in any object.
fn table(rows: &[Value]) -> Table {
    let entries = |row: &Value| row.as_map().cloned().unwrap_or_default();
    let mut columns: Vec<Value> = Vec::new();
    for (key, _) in rows.iter().flat_map(entries) {
        if !columns.contains(&key) {
            columns.push(key);
        }
    }
    let mut table = Table::new(columns.iter().map(text));
    for row in rows {
        let entries = entries(row);
        let cell =
            |column| entries.iter().find(|(key, _)| key == column).map_or_else(String::new, |(_, v)| text(v));
        table.push(columns.iter().map(cell));
    }
    table
}

fn text(value: &Value) -> String {
    match value {
        Value::Bool(flag) => if *flag { "yes" } else { "no" }.to_owned(),
        Value::Integer(number) => i128::from(*number).to_string(),
        Value::Float(number) => number_text(*number),
        Value::Text(text) => text.clone(),
        Value::Array(values) => values.iter().map(text).collect::<Vec<_>>().join(", "),
        _ => String::new(),
    }
}

/// Returns the number as text with [`DIGITS`] significant digits, without trailing zeros.
fn number_text(number: f64) -> String {
    let short = |text: &str| text.trim_end_matches('0').trim_end_matches('.').to_owned();
    let magnitude = number.abs().log10().floor();
    if !magnitude.is_finite() {
        // 0, infinite or NaN.
        format!("{number}")
    } else if (-7.0..15.0).contains(&magnitude) {
        let decimals = (DIGITS - 1 - magnitude as i32).max(0) as usize;
        let text = format!("{number:.decimals$}");
        if decimals == 0 { text } else { short(&text) }
    } else {
        let text = format!("{number:.*e}", DIGITS as usize - 1);
        text.split_once('e').map_or_else(String::new, |(digits, power)| format!("{}e{power}", short(digits)))
    }
}

//! Tables: CSV for programs, aligned text for the terminal, Markdown for reports.

use crate::system::output::write_atomic;
use crate::system::printable;
use anyhow::Context;
use std::path::Path;

/// Table of text cells with named columns; every row has as many cells as there are columns.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Table {
    pub columns: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// Creates a table without rows. A name in `columns` should include the unit, as in "time, s".
    pub fn new<S: Into<String>>(columns: impl IntoIterator<Item = S>) -> Self {
        Self { columns: columns.into_iter().map(cell).collect(), rows: Vec::new() }
    }

    /// Adds a row. Missing cells are empty; cells after the last column get columns without a name.
    pub fn push<S: Into<String>>(&mut self, cells: impl IntoIterator<Item = S>) -> &mut Self {
        let mut row: Vec<String> = cells.into_iter().map(cell).collect();
        if row.len() > self.columns.len() {
            self.columns.resize(row.len(), String::new());
            let width = self.columns.len();
            self.rows.iter_mut().for_each(|row| row.resize(width, String::new()));
        }
        row.resize(self.columns.len(), String::new());
        self.rows.push(row);
        self
    }

    /// Returns the table as CSV (RFC 4180, lines end in "\n"): the column names, then the rows. Cells with commas or
    /// quotes are quoted. Line ends in cells are escaped, as many programs read a file line by line.
    pub fn to_csv(&self) -> anyhow::Result<Vec<u8>> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        for row in std::iter::once(&self.columns).chain(&self.rows).filter(|row| !row.is_empty()) {
            writer
                .write_record(row.iter().map(|cell| printable::line(cell).into_owned()))
                .context("cannot make the CSV")?;
        }
        writer.into_inner().context("cannot make the CSV")
    }

    pub fn write_csv(&self, path: impl AsRef<Path>) -> anyhow::Result<()> {
        Ok(write_atomic(path, &self.to_csv()?)?)
    }

    /// Returns the table as text for the terminal; columns of numbers are aligned right. Every line ends in "\n".
    pub fn to_text(&self) -> String {
        let tidy = |cell: &String| cell.split_whitespace().collect::<Vec<_>>().join(" ");
        self.lines(tidy, "", "  ", "", |_, width| "─".repeat(width))
    }

    /// Returns the table in Markdown (GitHub's), with columns aligned in the source; every line ends in "\n".
    pub fn to_markdown(&self) -> String {
        let tidy = |cell: &String| {
            let cell = cell.replace('\\', "\\\\").replace('|', "\\|").replace('<', "&lt;");
            cell.lines().map(str::trim).collect::<Vec<_>>().join("<br>")
        };
        self.lines(tidy, "| ", " | ", " |", |right, width| {
            // GitHub needs at least three characters, the smallest width that `lines` gives a column.
            let dashes = "-".repeat(width.saturating_sub(1));
            if right { format!("{dashes}:") } else { format!(":{dashes}") }
        })
    }

    /// Formats the table as text. `tidy` changes each cell before padding. `left`, `between` and `right` are the texts
    /// before, between and after the cells of a row. `rule(right_aligned, width)` returns the dashes below the name of
    /// a column that is `width` characters wide.
    fn lines(
        &self,
        tidy: impl Fn(&String) -> String,
        left: &str,
        between: &str,
        right: &str,
        rule: impl Fn(bool, usize) -> String,
    ) -> String {
        if self.columns.is_empty() {
            return String::new();
        }
        let all = std::iter::once(&self.columns).chain(&self.rows);
        let rows: Vec<Vec<String>> = all.map(|row| row.iter().map(&tidy).collect()).collect();
        let count = |cell: &str| cell.chars().count();
        let column = |c: usize| rows.iter().filter_map(move |row| row.get(c));
        let widths: Vec<usize> = (0..self.columns.len())
            .map(|c| column(c).map(|cell| count(cell)).max().unwrap_or(0).max(3))
            .collect();
        let numeric: Vec<bool> = (0..self.columns.len())
            .map(|c| {
                let mut cells = column(c).skip(1).filter(|cell| !cell.is_empty()).peekable();
                cells.peek().is_some() && cells.all(|cell| is_number(cell))
            })
            .collect();
        let write = |cells: Vec<String>| format!("{left}{}{right}", cells.join(between));
        let pad = |row: &Vec<String>| {
            let pad_cell = |(c, cell): (usize, &String)| {
                let space = " ".repeat(widths[c] - count(cell));
                if numeric[c] { space + cell } else { cell.clone() + &space }
            };
            write(row.iter().enumerate().map(pad_cell).collect())
        };
        let mut lines: Vec<String> = rows.iter().map(pad).collect();
        lines.insert(1, write((0..widths.len()).map(|c| rule(numeric[c], widths[c])).collect()));
        lines.iter().map(|line| format!("{}\n", line.trim_end())).collect()
    }
}

/// Escapes control characters of a cell's text, which may be a file name; line ends are kept.
fn cell(text: impl Into<String>) -> String {
    printable::lines(&text.into()).into_owned()
}

/// Returns whether a cell reads as a number, with an optional sign before it or unit after it: "27.3", "1,024", "12 %",
/// "−0.02", "inf". A lone dash, such as "–", counts as a number.
fn is_number(cell: &str) -> bool {
    let first = cell.split(' ').next().unwrap_or_default();
    let plain: String = first.trim_end_matches(['%', '×', 'x']).replace([',', '_'], "").replace('−', "-");
    plain.parse::<f64>().is_ok() || matches!(cell, "-" | "–" | "—")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Table {
        let mut table = Table::new(["setting", "PSNR, dB", "cost"]);
        table.push(["exact", "27.31", "100 %"]);
        table.push(["a|b, \"quoted\"", "−0.5", "7 %"]);
        table.push(["two\nlines"]);
        table
    }

    #[test]
    fn csv_quotes_and_reads_back() {
        let table = sample();
        let bytes = table.to_csv().unwrap();
        let text = String::from_utf8(bytes.clone()).unwrap();
        assert!(text.starts_with("setting,\"PSNR, dB\",cost\nexact,27.31,100 %\n"), "{text}");
        let mut reader = csv::Reader::from_reader(bytes.as_slice());
        assert_eq!(reader.headers().unwrap(), table.columns);
        let rows: Vec<Vec<String>> = reader.deserialize().map(Result::unwrap).collect();
        assert_eq!(rows[..2], table.rows[..2]);
        assert_eq!(rows[2][0], r"two\nlines");
        let folder = tempfile::tempdir().unwrap();
        table.write_csv(folder.path().join("a.csv")).unwrap();
        assert_eq!(std::fs::read(folder.path().join("a.csv")).unwrap(), bytes);
    }

    #[test]
    fn text_is_aligned() {
        assert_eq!(
            sample().to_text(),
            "setting        PSNR, dB   cost\n\
             ─────────────  ────────  ─────\n\
             exact             27.31  100 %\n\
             a|b, \"quoted\"      −0.5    7 %\n\
             two lines\n"
        );
    }

    #[test]
    fn markdown_escapes_bars_and_line_ends() {
        assert_eq!(
            sample().to_markdown(),
            "| setting        | PSNR, dB |  cost |\n\
             | :------------- | -------: | ----: |\n\
             | exact          |    27.31 | 100 % |\n\
             | a\\|b, \"quoted\" |     −0.5 |   7 % |\n\
             | two<br>lines   |          |       |\n"
        );
    }

    #[test]
    fn ragged_and_empty_tables_are_whole() {
        let mut table = Table::new(["a"]);
        table.push(["1"]).push(["2", "3", "4"]).push(Vec::<String>::new());
        assert!(table.rows.iter().all(|row| row.len() == 3) && table.columns.len() == 3);
        assert!(table.to_markdown().lines().all(|line| line.matches('|').count() == 4));
        table.to_csv().unwrap();
        let none = Table::default();
        assert_eq!((none.to_text(), none.to_csv().unwrap()), (String::new(), vec![]));
    }
}

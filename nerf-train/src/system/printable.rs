//! Escaping of text that came from a file, to make the text safe to show.
//!
//! Names of views and arrays, provenance, messages of decoders and of child processes are untrusted. A terminal obeys
//! the control characters in them, which can move the cursor, retitle the window or type for the user. Bidirectional
//! overrides make a name look like another. Each output of this program escapes such text once, where it is written:
//!
//! | output | where | with |
//! | --- | --- | --- |
//! | a line of results, of progress, of an error | `cli::common::print_lines`, `tell`, `system::progress` | [`line()`] |
//! | lines of results, such as a table | `cli::common::print`, `system::progress::say_lines` | [`lines`] |
//! | names in lines of results | `data::report::Report` | [`line()`] |
//! | tables: CSV, Markdown, terminal | `show::table::Table` | [`lines`] |
//! | prose of Markdown reports | `show::reports` | [`markdown`] |
//! | pages and SVG plots | `show::cameras::page`, `show::plot` | [`line()`], [`lines`] |
//! | text drawn into images | `show::text` | [`line()`] |
//! | JSON | `system::summary`, `system::progress`, `lab::sweep::folder`, `show` | [`json`] |
//!
//! A JSON parser reads the original text back. Scene files, data sets and errors themselves keep the text as it is.

use std::borrow::Cow;
use std::fmt::Write;

/// Whether `character` changes how the text around it is shown, or is invisible.
///
/// True for controls (C0, DEL, C1), line and paragraph separators, bidirectional marks, embeddings, overrides and
/// isolates, the zero-width space, word joiner and byte order mark, soft hyphen, interlinear annotations, and tags.
/// False for the zero-width joiner and non-joiner, which Persian, Indic scripts and emoji need.
fn acts(character: char) -> bool {
    character.is_control()
        || matches!(
            character,
            '\u{ad}'
                | '\u{61c}'
                | '\u{180e}'
                | '\u{200b}'
                | '\u{200e}'
                | '\u{200f}'
                | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}'
                | '\u{feff}'
                | '\u{fff9}'..='\u{fffb}'
                | '\u{e0000}'..='\u{e007f}'
        )
}

/// Returns `text` with each character that `found` selects replaced by the output of `escape`.
fn replaced(
    text: &str,
    found: impl Fn(char) -> bool,
    escape: impl Fn(&mut String, char) -> std::fmt::Result,
) -> Cow<'_, str> {
    if !text.contains(&found) {
        return Cow::Borrowed(text);
    }
    let mut safe = String::with_capacity(text.len() + 16);
    for character in text.chars() {
        if found(character) {
            // Writing into a String cannot fail.
            let _ = escape(&mut safe, character);
        } else {
            safe.push(character);
        }
    }
    Cow::Owned(safe)
}

/// Returns `text` on one line, with control and invisible characters escaped as in Rust: `\n`, `\t` or `\u{1b}`.
///
/// # Examples
/// ```
/// use nerf_train::system::printable::line;
/// assert_eq!(line("a\x1b[2Jb\nc\u{202e}d"), r"a\u{1b}[2Jb\nc\u{202e}d");
/// assert_eq!(line("照片/Ågq 👩‍🚀"), "照片/Ågq 👩‍🚀");
/// ```
pub fn line(text: &str) -> Cow<'_, str> {
    // `escape_debug` would leave a few of these characters unchanged; `escape_unicode` leaves none.
    replaced(text, acts, |safe, c| match c {
        '\n' | '\r' | '\t' => write!(safe, "{}", c.escape_default()),
        _ => write!(safe, "{}", c.escape_unicode()),
    })
}

/// Returns `text` escaped as by [`line()`], except for line ends and tabs: for text already broken into lines.
///
/// A line end inside a name is also kept, and could forge a line of output: callers first escape names with [`line()`].
pub fn lines(text: &str) -> Cow<'_, str> {
    replaced(text, |c| acts(c) && !matches!(c, '\n' | '\t'), |safe, c| write!(safe, "{}", c.escape_unicode()))
}

/// Returns `text`, such as a name, escaped as by [`line()`] and with its markup escaped, for a Markdown report.
///
/// # Examples
/// ```
/// assert_eq!(nerf_train::system::printable::markdown("a[b](c)<i>\x1b"), r"a\[b\](c)&lt;i>\\u{1b}");
/// ```
pub fn markdown(text: &str) -> String {
    let safe = line(text);
    let marked = |c| matches!(c, '\\' | '`' | '*' | '[' | ']' | '<' | '&' | '#' | '|');
    let escaped = replaced(&safe, marked, |safe, c| match c {
        '<' => safe.write_str("&lt;"),
        '&' => safe.write_str("&amp;"),
        _ => write!(safe, "\\{c}"),
    });
    escaped.into_owned()
}

/// Returns the JSON `text` with control and invisible characters escaped (`\u001b`). A parser reads the same values.
///
/// Line ends and tabs are kept: outside of strings they are white space, inside of strings JSON writers escape them.
pub fn json(text: &str) -> Cow<'_, str> {
    replaced(
        text,
        |c| acts(c) && !matches!(c, '\n' | '\r' | '\t'),
        |safe, c| c.encode_utf16(&mut [0; 2]).iter().try_for_each(|unit| write!(safe, "\\u{unit:04x}")),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOSTILE: &str =
        "a\0\x07\x1b]0;title\x07\r\n\t\x7f\u{85}\u{9b}31m\u{202e}\u{2066}\u{200b}\u{feff}\u{e0041}";

    #[test]
    fn nothing_that_acts_is_left_in_a_line() {
        let safe = line(HOSTILE);
        assert!(
            !safe.chars().any(acts) && safe.starts_with(r"a\u{0}\u{7}\u{1b}]0;title\u{7}\r\n\t\u{7f}"),
            "{safe}"
        );
        let kept: String = lines(HOSTILE).chars().filter(|&c| acts(c)).collect();
        assert_eq!(kept, "\n\t");
        assert!(!markdown(HOSTILE).chars().any(acts));
        for point in (0..0x20).chain(0x7f..0xa0).chain(0x202a..=0x202e).chain(0x2066..=0x2069) {
            let character = char::from_u32(point).expect("a character").to_string();
            assert!(line(&character).starts_with('\\') && line(&character).is_ascii(), "{point:x}");
        }
    }

    #[test]
    fn ordinary_text_is_not_even_copied() {
        for text in
            ["", "images/0001.jpg", "照片/一.png", "naïve Ω ≤ 1×", "می\u{200c}خواهم", "👩\u{200d}🚀", r"a\b"]
        {
            assert!(matches!(line(text), Cow::Borrowed(same) if same == text), "{text}");
            assert!(matches!(lines(text), Cow::Borrowed(_)) && matches!(json(text), Cow::Borrowed(_)));
        }
    }

    #[test]
    fn json_means_the_same() {
        let plain = serde_json::to_string(HOSTILE).expect("text");
        let safe = json(&plain);
        assert!(!safe.chars().any(acts), "{safe}");
        assert_eq!(serde_json::from_str::<String>(&safe).expect("JSON"), HOSTILE);
    }
}

//! What the committed header says.

use crate::paths;
use std::collections::BTreeSet;

/// Functions the header declares: names before a parenthesis.
pub fn declared() -> BTreeSet<String> {
    let header = std::fs::read_to_string(paths::header()).expect("include/nerf_render.h");
    let code: String =
        header.split("/*").map(|part| part.split_once("*/").map_or(part, |(_, c)| c)).collect();
    let before = code.split('(').map(|part| part.rsplit(|c: char| !(c == '_' || c.is_alphanumeric())).next());
    before.flatten().filter(|name| name.starts_with("nerf_")).map(String::from).collect()
}

//! Mark that this program writes into its images and videos, to recognise its own files later.
//!
//! A PNG has the mark as a comment (tEXt), a GIF in a comment extension, an MP4 as metadata, an EXR as `comments`.

use std::fs::File;
use std::io::Read;
use std::path::Path;

pub const MARK: &str = "made by nerf-train";

/// Number of bytes searched for the mark, from the start of a file. An MP4 has its index, with the mark, at the start.
const SEARCHED_BYTES: u64 = 16 << 20;

pub fn was_made_here(path: &Path) -> bool {
    let mut bytes = Vec::new();
    let read = File::open(path).and_then(|file| file.take(SEARCHED_BYTES).read_to_end(&mut bytes));
    read.is_ok() && bytes.windows(MARK.len()).any(|window| window == MARK.as_bytes())
}

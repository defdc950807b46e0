//! Device that took a photograph, from its EXIF tags.

use super::decode::reader;
use image::ImageDecoder;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Number of the TIFF tag with the name of the camera's maker.
const MAKE: u16 = 0x010f;
const MODEL: u16 = 0x0110;
/// Number of the TIFF tag with the byte offset of the EXIF directory.
const EXIF_FOLDER: u16 = 0x8769;
/// Number of the EXIF directory's tag with the focal length, millimetres.
const FOCAL_LENGTH: u16 = 0x920a;

/// Returns maker, model and focal length (which tells a phone's lenses apart) as one text; empty without EXIF tags.
pub(crate) fn device(file: &Path) -> String {
    let tags = || {
        let reader = reader(BufReader::new(File::open(file).ok()?)).with_guessed_format().ok()?;
        reader.into_decoder().ok()?.exif_metadata().ok()?
    };
    tags().and_then(|tags| device_in(&tags)).unwrap_or_default()
}

fn device_in(bytes: &[u8]) -> Option<String> {
    let tiff = Tiff { bytes, little: bytes.starts_with(b"II") };
    let first = tiff.u32(4)?;
    let lens = || {
        let place = tiff.tag(tiff.u32(tiff.tag(first, EXIF_FOLDER)? + 8)?, FOCAL_LENGTH)?;
        let fraction = tiff.u32(place + 8)?;
        Some(format!("{} mm", f64::from(tiff.u32(fraction)?) / f64::from(tiff.u32(fraction + 4)?)))
    };
    let said = [tiff.text(first, MAKE), tiff.text(first, MODEL), lens()];
    Some(said.into_iter().flatten().collect::<Vec<_>>().join(", "))
}

struct Tiff<'a> {
    bytes: &'a [u8],
    little: bool,
}

impl Tiff<'_> {
    fn array<const N: usize>(&self, at: u32) -> Option<[u8; N]> {
        let mut found: [u8; N] = self.bytes.get(at as usize..)?.get(..N)?.try_into().ok()?;
        if !self.little {
            found.reverse();
        }
        Some(found)
    }

    fn u16(&self, at: u32) -> Option<u16> {
        self.array(at).map(u16::from_le_bytes)
    }

    /// Reads the number at byte offset `at`; `None` beyond the data. A number of 2^30 or more also gives `None`, so
    /// that sums of offsets cannot overflow.
    fn u32(&self, at: u32) -> Option<u32> {
        self.array(at).map(u32::from_le_bytes).filter(|&value| value < 1 << 30)
    }

    /// Returns the byte offset of the entry of `tag` in the directory at byte offset `folder`; `None` without an entry.
    fn tag(&self, folder: u32, tag: u16) -> Option<u32> {
        let entries = 0..u32::from(self.u16(folder)?);
        entries.map(|i| folder + 2 + 12 * i).find(|&entry| self.u16(entry) == Some(tag))
    }

    fn text(&self, folder: u32, tag: u16) -> Option<String> {
        let entry = self.tag(folder, tag)?;
        let length = self.u32(entry + 4)?;
        // A text of up to four bytes is stored in the entry itself.
        let start = if length <= 4 { entry + 8 } else { self.u32(entry + 8)? };
        let bytes = self.bytes.get(start as usize..)?.get(..length as usize)?;
        let text = String::from_utf8_lossy(bytes).trim_matches(['\0', ' ']).to_owned();
        (!text.is_empty()).then_some(text)
    }
}

#[cfg(test)]
mod tests {
    use super::device_in;

    /// EXIF tags with a maker's name of five letters, a model's name of three letters, and a focal length of 63/10 mm.
    fn tags(little: bool) -> Vec<u8> {
        let short = |v: u16| if little { v.to_le_bytes() } else { v.to_be_bytes() };
        let long = |v: u32| if little { v.to_le_bytes() } else { v.to_be_bytes() };
        let entry =
            |tag, kind, count, value: [u8; 4]| [&short(tag)[..], &short(kind), &long(count), &value].concat();
        [
            if little { &b"II"[..] } else { b"MM" },
            &short(42),
            &long(8),
            &short(3),
            &entry(0x010f, 2, 6, long(50)),
            &entry(0x0110, 2, 4, *b"P 7\0"),
            &entry(0x8769, 4, 1, long(56)),
            &long(0),
            &b"Maker\0"[..],
            &short(1),
            &entry(0x920a, 5, 1, long(74)),
            &long(0),
            &long(63),
            &long(10),
        ]
        .concat()
    }

    #[test]
    fn a_device_is_named_by_its_tags_and_damaged_ones_say_nothing() {
        for little in [true, false] {
            let whole = tags(little);
            assert_eq!(device_in(&whole).as_deref(), Some("Maker, P 7, 6.3 mm"));
            for end in 0..whole.len() {
                let _ = device_in(&whole[..end]);
            }
            for (at, value) in (0..whole.len()).flat_map(|at| [(at, 0), (at, 0x7f), (at, 0xff)]) {
                let mut damaged = whole.clone();
                damaged[at] = value;
                let _ = device_in(&damaged);
            }
        }
        assert_eq!(device_in(b""), None);
    }
}

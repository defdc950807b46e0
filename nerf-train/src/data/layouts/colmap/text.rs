//! COLMAP's text files: a line for each camera and point, two for each photograph, and comments.

use super::model::{Camera, Kind};
use super::{Encoding, Model, NO_POINT, Points, Registered};
use crate::data::DatasetError;
use crate::system::input::open_regular;
use std::collections::HashMap;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};

/// Maximum length of a line, bytes. This is three times the length of a line with a million key points.
const MAX_LINE: u64 = 256 << 20;

struct Lines {
    file: PathBuf,
    stream: BufReader<std::fs::File>,
    /// Number of the line read most recently, from 1; 0 before the first.
    at: usize,
    /// Number of cameras, photographs or points that a comment of the file states, if any.
    announced: Option<u64>,
}

impl Lines {
    fn open(file: &Path) -> Result<Self, DatasetError> {
        let stream = open_regular(file).map_err(|source| DatasetError::io(file, source))?;
        Ok(Self { file: file.into(), stream: BufReader::new(stream), at: 0, announced: None })
    }

    fn value(&self, field: &str, expected: &str, found: impl Into<String>) -> DatasetError {
        DatasetError::value(&self.file, format!("line {}, {field}", self.at), expected, found.into())
    }

    /// Returns the next line, even if empty or a comment, without its line end; `None` at the end of the file. A last
    /// line without a line end is an error: a truncated file may have lost digits of a number.
    fn any(&mut self) -> Result<Option<String>, DatasetError> {
        let mut line = Vec::new();
        let read = self.stream.by_ref().take(MAX_LINE).read_until(b'\n', &mut line);
        read.map_err(|source| DatasetError::io(&self.file, source))?;
        if line.is_empty() {
            return Ok(None);
        }
        self.at += 1;
        if line.pop() != Some(b'\n') {
            return Err(self.value("its end", "a line end behind the last line", "none: the file is cut"));
        }
        if line.last() == Some(&b'\r') {
            line.pop();
        }
        String::from_utf8(line).map(Some).map_err(|_| self.value("text", "UTF-8", "other bytes"))
    }

    fn next(&mut self) -> Result<Option<String>, DatasetError> {
        while let Some(line) = self.any()? {
            let line = line.trim_start_matches('\u{feff}');
            match line.trim_start().strip_prefix('#') {
                // For example "# Number of images: 77, mean observations per image: 100".
                Some(comment) => {
                    let count =
                        comment.trim().strip_prefix("Number of ").and_then(|rest| rest.split_once(": "));
                    let count = count.and_then(|(_, count)| count.split(',').next()?.trim().parse().ok());
                    self.announced = count.or(self.announced);
                }
                None if line.trim().is_empty() => {}
                None => return Ok(Some(line.to_owned())),
            }
        }
        Ok(None)
    }

    /// Parses the next word of a line as a number. If the word is bad or missing, the error calls the number `field`.
    fn number<'w, T: std::str::FromStr>(
        &self,
        words: &mut impl Iterator<Item = &'w str>,
        field: &str,
    ) -> Result<T, DatasetError> {
        let word = words.next().unwrap_or_default();
        word.parse().map_err(|_| self.value(field, "a number", format!("{word:?}")))
    }

    fn numbers<const N: usize>(
        &self,
        words: &mut std::str::SplitWhitespace<'_>,
        field: &str,
    ) -> Result<[f64; N], DatasetError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.number(words, field)?;
        }
        Ok(numbers)
    }

    /// Checks the number of items read: it must not be 0, nor contradict the number that a comment of the file states.
    fn check(&self, found: u64) -> Result<(), DatasetError> {
        match self.announced {
            Some(announced) if announced != found => {
                let expected = format!("{announced} of them, as the comment above says");
                Err(self.value("number of items", &expected, format!("{found}: the file is cut")))
            }
            _ if found == 0 => Err(self.value("number of items", "at least one", "none")),
            _ => Ok(()),
        }
    }
}

pub(crate) fn count(file: &Path) -> Result<u64, DatasetError> {
    images(file).map(|images| images.len() as u64)
}

pub(crate) fn model(folder: &Path) -> Result<Model, DatasetError> {
    let cameras = cameras(&Encoding::Text.file(folder, "cameras"))?;
    let images = images(&Encoding::Text.file(folder, "images"))?;
    Ok(Model { cameras, images })
}

fn cameras(file: &Path) -> Result<HashMap<u32, Camera>, DatasetError> {
    let mut lines = Lines::open(file)?;
    let (mut cameras, mut count) = (HashMap::new(), 0);
    while let Some(line) = lines.next()? {
        let mut words = line.split_whitespace();
        let number = lines.number(&mut words, "camera id")?;
        let name = words.next().unwrap_or_default();
        let kind = Kind::by_name(name)
            .ok_or_else(|| lines.value("camera model", "one of COLMAP's, such as OPENCV", name))?;
        let (width, height) = (lines.number(&mut words, "width")?, lines.number(&mut words, "height")?);
        let parameter = |word: &str| word.parse().map_err(|_| lines.value("parameters", "numbers", word));
        let parameters = words.map(parameter).collect::<Result<Vec<f64>, _>>()?;
        let found = parameters.len().to_string();
        let camera = Camera::new(kind, width, height, parameters).ok_or_else(|| {
            lines.value("parameters", &format!("{} numbers for {name}", kind.parameters), found)
        })?;
        cameras.insert(number, camera);
        count += 1;
    }
    lines.check(count)?;
    Ok(cameras)
}

fn images(file: &Path) -> Result<Vec<Registered>, DatasetError> {
    let mut lines = Lines::open(file)?;
    let mut images = Vec::new();
    while let Some(line) = lines.next()? {
        let mut words = line.split_whitespace();
        lines.number::<u32>(&mut words, "image id")?;
        let rotation = lines.numbers(&mut words, "quaternion")?;
        let translation = lines.numbers(&mut words, "translation")?;
        let camera = lines.number(&mut words, "camera id")?;
        // The rest of the line is the name, which may contain spaces.
        let mut rest = line.as_str();
        for _ in 0..9 {
            rest = rest.trim_start().split_once(char::is_whitespace).map_or("", |(_, rest)| rest);
        }
        let name = rest.trim().to_owned();
        if name.is_empty() {
            return Err(lines.value("name", "the name of a photograph", "none"));
        }
        // The photograph's second line, with its points, may be empty.
        let Some(points) = lines.any()? else {
            return Err(lines.value(
                "points",
                "a second line for each photograph, if empty",
                "the end of the file",
            ));
        };
        let key_points = key_points(&lines, &points)?;
        images.push(Registered { name, camera, rotation, translation, key_points });
    }
    lines.check(images.len() as u64)?;
    Ok(images)
}

/// Parses a photograph's second line: x, y (pixels) and `POINT3D_ID` of each key point; keeps triangulated key points.
fn key_points(lines: &Lines, line: &str) -> Result<Vec<([f64; 2], u64)>, DatasetError> {
    let (mut words, mut found) = (line.split_whitespace().peekable(), Vec::new());
    while words.peek().is_some() {
        let at = [lines.number(&mut words, "x of a point")?, lines.number(&mut words, "y of a point")?];
        let word = words.next().unwrap_or_default();
        let id: i64 =
            word.parse().map_err(|_| lines.value("point id", "a whole number", format!("{word:?}")))?;
        let id = u64::try_from(id).unwrap_or(NO_POINT);
        if id != NO_POINT {
            found.push((at, id));
        }
    }
    Ok(found)
}

pub(crate) fn points(file: &Path, points: &mut Points) -> Result<(), DatasetError> {
    let mut lines = Lines::open(file)?;
    let mut count = 0;
    while let Some(line) = lines.next()? {
        let mut words = line.split_whitespace();
        let number = lines.number::<u64>(&mut words, "point id")?;
        let position = lines.numbers(&mut words, "position")?;
        // Colour and error, followed by the track: pairs of a photograph and a point in it.
        let [.., error] = lines.numbers::<4>(&mut words, "colour and error")?;
        points.push(number, position, error, words.count() as u64 / 2)?;
        count += 1;
    }
    let none = count == 0 && lines.announced.unwrap_or(0) == 0;
    if none { Ok(()) } else { lines.check(count) }
}

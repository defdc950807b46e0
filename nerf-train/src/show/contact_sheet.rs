//! Pictures in rows and columns, each with a caption that is never cut off.

use super::text::{self, Direction};
use crate::data::pictures::rgb::Picture;

/// Smallest length of a picture's longer side, pixels: smaller pictures are enlarged by a whole factor.
const CELL: usize = 192;
const GAP: usize = 12;
const CAPTION: f32 = 18.0;
const TITLE: f32 = 24.0;
/// Smallest width of a cell, pixels: a caption needs room even under a narrow picture.
const NARROWEST: usize = 150;
const INK: [f32; 3] = [0.1; 3];

#[derive(Clone, Debug)]
pub struct Cell {
    pub picture: Picture,
    /// Text below the picture; may be empty. Long lines are wrapped to the cell's width, and line ends are kept.
    pub caption: String,
}

impl Cell {
    pub fn new(picture: Picture, caption: impl Into<String>) -> Self {
        Self { picture, caption: caption.into() }
    }
}

/// Draws a contact sheet on a white background: `title` on top unless it is empty, then rows of `columns` cells.
/// `columns` is clamped to `1..=cells.len()`. If there are no cells and no title, the result is a small white picture.
pub fn contact_sheet(title: &str, cells: &[Cell], columns: usize) -> Picture {
    let columns = columns.clamp(1, cells.len().max(1));
    let pictures: Vec<Picture> = cells.iter().map(|cell| cell.picture.enlarged_to(CELL)).collect();
    let cell_width = pictures.iter().map(|p| p.width).max().unwrap_or(0).max(NARROWEST);
    let captions: Vec<Vec<String>> =
        cells.iter().map(|cell| text::wrap(&cell.caption, CAPTION, cell_width)).collect();
    let width = GAP + columns * (cell_width + GAP);
    let title_lines = text::wrap(title, TITLE, width - 2 * GAP);

    // A row is as tall as its tallest picture and its longest caption.
    let rows: Vec<(usize, usize)> = pictures
        .chunks(columns)
        .zip(captions.chunks(columns))
        .map(|(pictures, captions)| {
            let lines = captions.iter().map(Vec::len).max().unwrap_or(0);
            let tallest = pictures.iter().map(|p| p.height).max().unwrap_or(0);
            (tallest, lines * text::line_height(CAPTION))
        })
        .collect();
    let title_height = title_lines.len() * text::line_height(TITLE);
    let row_heights: usize = rows.iter().map(|(picture, caption)| picture + caption + 4 + GAP).sum();
    let top = GAP + title_height + if title_height > 0 { GAP / 2 } else { 0 };
    let mut sheet = Picture::filled(width, top + row_heights, [1.0; 3]);

    draw_lines(&mut sheet, &title_lines, TITLE, (GAP, GAP));
    let mut y = top;
    for (row, &(picture_height, caption_height)) in rows.iter().enumerate() {
        for column in 0..columns.min(cells.len() - row * columns) {
            let index = row * columns + column;
            let x = GAP + column * (cell_width + GAP);
            let picture = &pictures[index];
            sheet.paste(picture, x, y + (picture_height - picture.height));
            draw_lines(&mut sheet, &captions[index], CAPTION, (x, y + picture_height + 4));
        }
        y += picture_height + caption_height + 4 + GAP;
    }
    sheet
}

fn draw_lines(sheet: &mut Picture, lines: &[String], size: f32, (x, y): (usize, usize)) {
    for (i, line) in lines.iter().enumerate() {
        let corner = (x as i64, (y + i * text::line_height(size)) as i64);
        text::draw(sheet, line, corner, size, INK, Direction::Right);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_pictures_are_enlarged_by_a_whole_factor() {
        let cell = Cell::new(Picture::filled(64, 32, [1.0, 0.0, 0.0]), "");
        let sheet = contact_sheet("", &[cell], 5);
        let red = sheet.rgb.iter().filter(|rgb| rgb[1] == 0.0).count();
        assert_eq!(red, (64 * 3) * (32 * 3));
    }

    #[test]
    fn all_cells_and_captions_are_there() {
        let cells: Vec<Cell> = (0..5)
            .map(|i| Cell::new(Picture::filled(200, 200, [0.0, 1.0, 0.0]), format!("view {i}")))
            .collect();
        let sheet = contact_sheet("a title", &cells, 3);
        assert_eq!(sheet.rgb.iter().filter(|rgb| **rgb == [0.0, 1.0, 0.0]).count(), 5 * 40_000);
        assert_eq!(sheet.rgb.len(), sheet.width * sheet.height);
        // The outermost pixels of the sheet stay white, so no caption is cut off.
        let inked = |x: usize, y: usize| sheet.rgb[y * sheet.width + x][0] < 0.9;
        assert!((0..sheet.height).all(|y| !inked(0, y) && !inked(sheet.width - 1, y)));
        assert!((0..sheet.width).all(|x| !inked(x, 0) && !inked(x, sheet.height - 1)));
    }

    #[test]
    fn odd_cells_do_not_panic() {
        let wrong = Picture { width: 30, height: 30, rgb: vec![[0.5; 3]; 7] };
        let none = Picture::filled(0, 0, [0.0; 3]);
        let thin = Picture::filled(1, 400, [0.0; 3]);
        let cells = [wrong, none, thin].map(|p| Cell::new(p, "a long caption ".repeat(9)));
        for columns in [0, 1, 2, 100] {
            contact_sheet("title ".repeat(50).as_str(), &cells, columns);
        }
        assert!(contact_sheet("", &[], 0).width > 0);
    }
}

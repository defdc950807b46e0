//! Rectangles and planes, most of which fit.

use arbitrary::{Result, Unstructured};
use nerf_fuzz::values::{mostly, rarely};
use nerf_render::{self as ffi, Status};
use nerf_testing::memory::Guarded;

/// A rectangle of an image of `side` pixels, or one that is not.
pub fn rect(u: &mut Unstructured<'_>, side: [u32; 2]) -> Result<ffi::Rect> {
    if rarely(u, 16)? {
        return Ok(ffi::Rect {
            x: u.arbitrary()?,
            y: u.arbitrary()?,
            width: u.int_in_range(0..=9)?,
            height: u.arbitrary::<u32>()? | 1 << 30,
        });
    }
    let (x, y) = (u.int_in_range(0..=side[0] - 1)?, u.int_in_range(0..=side[1] - 1)?);
    let (most_x, most_y) = ((side[0] - x).min(6), (side[1] - y).min(6));
    Ok(ffi::Rect { x, y, width: u.int_in_range(0..=most_x)?, height: u.int_in_range(0..=most_y)? })
}

/// A plane in memory of its own, as large as its strides say.
pub struct Surface {
    pub plane: ffi::Plane,
    pub memory: Guarded,
    /// What a call may write: whole pixels.
    pub own: Vec<bool>,
    pub floats: bool,
}

const RGB: [(u32, usize, usize); 4] = [(1, 3, 1), (2, 12, 4), (3, 4, 1), (4, 16, 4)];

/// `None` where the plane is not wanted, or spans more than a test has.
pub fn surface(
    u: &mut Unstructured<'_>,
    width: u32,
    height: u32,
    colour: bool,
    normal: bool,
) -> Result<Option<Surface>> {
    let (format, size, align) = match (colour, normal) {
        (true, _) => *u.choose(&RGB)?,
        (_, true) => (6, 12, 4),
        _ => (5, 4, 4),
    };
    let step = if rarely(u, 16)? { 1 } else { align };
    let pixel = if u.arbitrary()? { 0 } else { size / step * step + step * u.int_in_range(0..=3usize)? };
    let tight = (if pixel == 0 { size } else { pixel }) as i64;
    let row = match u.int_in_range(0..=3u8)? {
        0 => tight * i64::from(width) + (step * u.int_in_range(0..=4usize)?) as i64,
        1 => -(tight * i64::from(width)),
        2 if u.ratio(1, 4)? => i64::from(u.arbitrary::<i8>()?),
        _ => 0,
    };
    let down = if row == 0 { tight * i64::from(width) } else { row };
    let (columns, rows) = (i64::from(width.max(1)) - 1, i64::from(height.max(1)) - 1);
    let span = (columns * tight).saturating_add(rows.saturating_mul(down.abs())).saturating_add(size as i64);
    if span > 1 << 15 || width > 4096 || height > 4096 {
        return Ok(None);
    }
    let mut memory = Guarded::new(span as usize, if rarely(u, 16)? { u.int_in_range(0..=63)? } else { 0 });
    let first = if down < 0 { rows * -down } else { 0 };
    let mut own = vec![false; span as usize];
    for y in 0..i64::from(height) {
        for x in 0..i64::from(width) {
            let at = (first + y * down + x * tight) as usize;
            own[at..at + size].fill(true);
        }
    }
    let plane = ffi::Plane {
        // SAFETY: `first` is inside the span.
        data: unsafe { memory.at().cast::<u8>().add(first as usize).cast() },
        pixel_stride: pixel,
        row_stride: row as isize,
        // One that is none, or suits another plane but is no larger than this one's.
        format: if rarely(u, 32)? { *u.choose(&[0u32, 5, 7, u32::MAX])? } else { format },
        reserved: u32::from(rarely(u, 64)?),
    };
    Ok(Some(Surface { plane, memory, own, floats: size != 3 && format != 3 }))
}

impl Surface {
    /// Numbers to read, about `sound`; returns all the bytes.
    pub fn fill(&mut self, sound: f32, u: &mut Unstructured<'_>) -> Result<Vec<u8>> {
        let first = self.memory.at().cast::<u8>();
        let own: Vec<usize> = (0..self.own.len()).filter(|&i| self.own[i]).collect();
        for four in own.chunks(4) {
            for (&i, byte) in four.iter().zip(mostly(u, sound)?.to_ne_bytes()) {
                // SAFETY: one of the memory's own bytes.
                unsafe { first.add(i).write(byte) };
            }
        }
        Ok(self.memory.bytes().to_vec())
    }

    /// The floats of all pixels.
    pub fn floats(&self) -> Vec<f32> {
        let all = self.memory.bytes().iter().zip(&self.own);
        let bytes: Vec<u8> = all.filter_map(|(&byte, &own)| own.then_some(byte)).collect();
        bytes.as_chunks().0.iter().map(|&four| f32::from_le_bytes(four)).collect()
    }

    /// What a call may have written; `sound` is what floats are after one that did not fail.
    pub fn check(&self, status: Status, cancelled_early: bool, sound: fn(f32) -> bool) {
        assert!(self.memory.surroundings_are_intact(), "{status:?}: written beyond a plane");
        let between = self.memory.bytes().iter().zip(&self.own).all(|(&byte, &own)| own || byte == 0xc5);
        assert!(between, "{status:?}: written between pixels");
        if cancelled_early || !matches!(status, Status::Ok | Status::Cancelled) {
            assert!(self.memory.is_untouched(), "{status:?}: a failed call wrote pixels");
        }
        if status == Status::Ok && self.floats {
            let wrong = self.floats().into_iter().find(|&value| !sound(value));
            assert_eq!(wrong, None, "a pixel that is none");
        }
    }
}

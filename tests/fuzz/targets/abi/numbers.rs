//! Numbers that a call reads, side by side or among others.

use arbitrary::{Result, Unstructured};
use nerf_fuzz::values::{any_vec3, rarely};
use nerf_render as ffi;

/// As many bytes as the stride says, and not one more.
pub struct Numbers {
    bytes: Vec<u8>,
    before: Vec<u8>,
    offset: usize,
    stride: usize,
}

impl Numbers {
    /// `each` of the numbers to every ray or point.
    pub fn new(values: &[f32], each: usize, u: &mut Unstructured<'_>) -> Result<Self> {
        let (size, count) = (4 * each, values.len() / each);
        let (stride, offset) = match u.int_in_range(0..=63u8)? {
            63 => (size - 4 * usize::from(each > 1), 1),
            62 => (size + u.int_in_range(0..=7usize)?, 0),
            61 => (size.saturating_sub(1), 0),
            // Beyond the address space.
            60 if count >= 4 => ((usize::MAX / 2) & !3, 0),
            20..=50 => (size + 4 * u.int_in_range(0..=5usize)?, 0),
            _ => (0, 0),
        };
        let step = if stride == 0 || stride > 1 << 20 { size } else { stride };
        let mut bytes = vec![0; offset + if count == 0 { 0 } else { (count - 1) * step + size }];
        for (i, values) in values.chunks(each).enumerate() {
            for (k, value) in values.iter().enumerate() {
                let at = offset + i * step + 4 * k;
                bytes[at..at + 4].copy_from_slice(&value.to_ne_bytes());
            }
        }
        Ok(Self { before: bytes.clone(), bytes, offset, stride })
    }

    pub fn lent(&self) -> ffi::Floats {
        // Where there are none, one behind the last byte is as good an address as any.
        let data = self.bytes.as_ptr().wrapping_add(self.offset);
        ffi::Floats { data: data.cast(), stride: self.stride }
    }

    pub fn is_untouched(&self) -> bool {
        self.bytes == self.before
    }
}

/// A direction, of unit length unless it is to be garbage.
pub fn direction(garbage: bool, u: &mut Unstructured<'_>) -> Result<[f32; 3]> {
    let any = any_vec3(u)?;
    let unit = glam::Vec3::from(any).try_normalize().unwrap_or(glam::Vec3::Z).to_array();
    Ok(if garbage && rarely(u, 32)? { any } else { unit })
}

//! What a host lends a call: room for a message, structures of any size, memory to work in.

use arbitrary::{Result, Unstructured};
use nerf_fuzz::values::rarely;
use nerf_render::Status;
use nerf_testing::memory::Guarded;
use std::ffi::c_char;

/// A call's message buffer, of any capacity.
pub struct Message(pub Guarded);

impl Message {
    pub fn new(u: &mut Unstructured<'_>) -> Result<Self> {
        Ok(Self(Guarded::new(*u.choose(&[256usize, 256, 0, 1, 7])?, 1)))
    }

    pub fn at(&mut self) -> *mut c_char {
        self.0.at().cast()
    }

    /// Empty on success, a sentence on failure, and always with an end.
    pub fn check(&self, status: Status) {
        assert!(self.0.surroundings_are_intact(), "{status:?}: written beyond the message");
        assert_ne!(status, Status::Panic, "{}", String::from_utf8_lossy(self.0.bytes()));
        if let Some(&first) = self.0.bytes().first() {
            assert!(self.0.bytes().contains(&0), "{status:?}: a message without an end");
            assert!(self.0.size() == 1 || (status == Status::Ok) == (first == 0), "{status:?} and {first}");
        }
    }
}

/// A structure as a host of another version may have it.
pub struct Lent {
    pub words: Vec<u64>,
    pub before: Vec<u64>,
}

impl Lent {
    pub fn new<T: Copy>(value: &T, u: &mut Unstructured<'_>) -> Result<Self> {
        let own = size_of::<T>();
        let size = match u.int_in_range(0..=15u8)? {
            15 => u.arbitrary()?,
            14 => own - 1,
            13 => own + 8 * u.int_in_range(0..=3usize)?,
            12 => u.int_in_range(0..=own)?,
            _ => own,
        };
        let mut words = vec![0u64; own.max(size.min(4096)).div_ceil(8)];
        // SAFETY: plain C structures of numbers and pointers, and as many bytes as the words have.
        unsafe { std::ptr::from_ref(value).cast::<u8>().copy_to(words.as_mut_ptr().cast(), own) };
        words[0] = size as u64;
        if rarely(u, 32)? && words.len() > own.div_ceil(8) {
            words[own.div_ceil(8)] = 1;
        }
        Ok(Self { before: words.clone(), words })
    }

    pub fn at<T>(&mut self) -> *mut T {
        self.words.as_mut_ptr().cast()
    }

    pub fn value<T: Copy>(&self) -> T {
        // SAFETY: made of a `T`, with all its bytes.
        unsafe { self.words.as_ptr().cast::<T>().read() }
    }

    pub fn is_untouched(&self) -> bool {
        self.words == self.before
    }
}

/// Workspace of the size that was asked for, or one a host might give in its place.
pub fn workspace(u: &mut Unstructured<'_>, asked: Option<usize>) -> Result<(Guarded, bool)> {
    let size = asked.unwrap_or(1 << 14);
    let given = match u.int_in_range(0..=15u8)? {
        15 => size.saturating_sub(1),
        14 => u.int_in_range(0..=size)?,
        13 => size + u.int_in_range(0..=200usize)?,
        _ => size,
    };
    let misaligned = if rarely(u, 16)? { u.int_in_range(0..=63)? } else { 0 };
    Ok((Guarded::new(given, misaligned), asked.is_some() && given >= size && misaligned == 0))
}

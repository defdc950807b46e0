//! Shared parts of every C call: messages, caught panics, structures that begin with `struct_size`.

use crate::failure::Failure;
use crate::span::{Span, check_aligned};
use crate::status::Status;
use core::ffi::c_char;
use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use nerf_core::memory::Line;

/// Largest accepted `struct_size`, bytes. A larger value is an error: the structure is probably uninitialised.
const MAX_STRUCT_SIZE: usize = 4096;

/// A structure that begins with `size_t struct_size` and may get more fields at its end in later versions.
///
/// # Safety
/// The type is `repr(C)`, its first field is `struct_size: usize`, and any bytes are a valid value of the type.
pub(crate) unsafe trait Versioned: Copy {
    /// Name of the argument that points to the structure, as messages show it.
    const NAME: &'static str;
    /// Smallest accepted `struct_size`, bytes: the structure's size in version 2 of the ABI. Later fields are optional.
    const SIZE_V2: usize;
}

/// Implements [`Versioned`]. Example: `versioned!(unsafe Camera, "camera", by_width(116, 120))`. Messages then say
/// "camera"; the size in ABI version 2 is 116 bytes with 32-bit pointers, 120 with 64-bit pointers.
/// `unsafe`: the macro's caller ensures that the type is `repr(C)` and that any bytes are a valid value of each field.
macro_rules! versioned {
    (unsafe $type:ty, $name:literal, $size:expr) => {
        // SAFETY: the macro's caller promises `repr(C)` and valid bytes; the assertion below checks the first field.
        unsafe impl $crate::boundary::Versioned for $type {
            const NAME: &'static str = $name;
            const SIZE_V2: usize = {
                assert!(core::mem::offset_of!($type, struct_size) == 0);
                $size
            };
        }
    };
}
pub(crate) use versioned;

pub(crate) const fn by_width(bytes_32: usize, bytes_64: usize) -> usize {
    if size_of::<usize>() == 4 { bytes_32 } else { bytes_64 }
}

/// Caller's buffer of `capacity` bytes for a NUL-terminated text. There is no buffer if `text` is NULL or `capacity` 0.
#[derive(Clone, Copy)]
pub(crate) struct Message {
    pub text: *mut c_char,
    pub capacity: usize,
}

impl Message {
    pub const NONE: Self = Self { text: core::ptr::null_mut(), capacity: 0 };

    /// Returns the address range of the buffer's first byte, for overlap checks; empty without a buffer. Every call
    /// writes this byte.
    pub fn first(&self) -> Result<Span, Failure> {
        Span::new("message", self.text.cast(), usize::from(!self.text.is_null() && self.capacity > 0))
    }

    /// Writes the output of `say`, cut to fit and NUL-terminated. Returns the size of the uncut text with NUL, bytes.
    pub fn write(&self, say: impl FnOnce(&mut Cut)) -> usize {
        let there = !self.text.is_null() && self.capacity > 0;
        let room = if there { self.capacity - 1 } else { 0 };
        let mut cut = Cut { text: self.text, room, kept: 0, all: 0 };
        say(&mut cut);
        if there {
            // SAFETY: `kept < capacity`, and the caller vouches for `capacity` bytes.
            unsafe { self.text.add(cut.kept).write(0) };
        }
        cut.all + 1
    }
}

/// Text writer that stores as many whole characters as fit into a buffer, and counts the bytes of the whole text.
pub(crate) struct Cut {
    text: *mut c_char,
    /// Size of the buffer without the byte that is kept for the NUL.
    room: usize,
    kept: usize,
    all: usize,
}

impl Write for Cut {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        // Once a part of the text was left out, nothing more is stored.
        let room = if self.kept == self.all { self.room - self.kept } else { 0 };
        let mut cut = room.min(text.len());
        while !text.is_char_boundary(cut) {
            cut -= 1;
        }
        for &byte in text.as_bytes().iter().take(cut) {
            // SAFETY: `kept < room`, and the caller vouches for `room + 1` bytes.
            unsafe { self.text.add(self.kept).write(byte as c_char) };
            self.kept += 1;
        }
        self.all += text.len();
        Ok(())
    }
}

/// Reason why a call failed: a [`Status`] for programs, and a displayed sentence for people.
pub(crate) trait Reason: fmt::Display {
    /// Returns the reason for the failure of a call that panicked. A panic is a defect of this library.
    #[cfg(feature = "std")]
    fn panic() -> Self;
    fn status(&self) -> Status;
    /// Writes this reason's sentence to `to`. A build without the feature `messages` writes the status's text instead.
    fn say(&self, to: &mut impl Write) -> fmt::Result {
        if cfg!(feature = "messages") {
            write!(to, "{self}")
        } else {
            to.write_str(self.status().text().to_str().unwrap_or_default())
        }
    }
}

/// Runs `body`, converts its error or panic to a status, and writes the error's sentence to `message`.
pub(crate) fn call(message: Message, body: impl FnOnce() -> Result<(), Failure>) -> Status {
    call_with_reason(message, body)
}

/// Runs `body`, as [`call`] does. The error may be any [`Reason`], such as one that names a file.
pub(crate) fn call_with_reason<R: Reason>(message: Message, body: impl FnOnce() -> Result<(), R>) -> Status {
    #[cfg(feature = "std")]
    let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(body)).unwrap_or_else(|payload| {
        // The panic's payload is small and is leaked, since dropping the payload may panic, too.
        core::mem::forget(payload);
        Err(R::panic())
    });
    #[cfg(not(feature = "std"))]
    let result = body();
    message.write(|cut| {
        if let Err(reason) = &result {
            // Writing cannot fail: text that does not fit into the buffer is left out.
            let _ = reason.say(cut);
        }
    });
    result.err().map_or(Status::Ok, |reason| reason.status())
}

/// Checks the pointer to a versioned structure and its `struct_size`; returns `struct_size`, bytes.
///
/// # Safety
/// `at` is NULL or points to `struct_size` readable bytes.
unsafe fn size_of_versioned<T: Versioned>(at: *const T) -> Result<usize, Failure> {
    const { assert!(T::SIZE_V2 <= size_of::<T>()) };
    if at.is_null() {
        return Err(Failure::Null(T::NAME));
    }
    check_aligned(T::NAME, at as usize, align_of::<T>())?;
    // SAFETY: `at` is not NULL and is aligned; `struct_size` is the first field (`Versioned`).
    let found = unsafe { at.cast::<usize>().read() };
    if (T::SIZE_V2..=MAX_STRUCT_SIZE).contains(&found) {
        Ok(found)
    } else {
        Err(Failure::StructSize { name: T::NAME, expected: T::SIZE_V2, found })
    }
}

/// Returns the address range of an array of `count` structures of equal size; empty if `first` is NULL. `first`:
/// address of the first structure, which begins with its `struct_size`. This size, bytes, applies to every structure.
///
/// # Safety
/// `first` is NULL or points to a structure that [`read_versioned`] has read.
#[inline(never)]
pub(crate) unsafe fn span_of(name: &'static str, first: *const usize, count: usize) -> Result<Span, Failure> {
    if first.is_null() {
        return Ok(Span::EMPTY);
    }
    // SAFETY: `read_versioned` has read the first structure, which is hence aligned and readable.
    let size = unsafe { first.read() };
    Span::new(name, first.cast(), size.checked_mul(count).ok_or(Failure::Overflow(name))?)
}

/// Returns a copy of the caller's structure, whose type may come from an older or newer C header. Fields that an older
/// header lacks are zero in the copy. Fields that only a newer header has must be zero, else an error is returned.
///
/// # Safety
/// `at` is NULL or points to `struct_size` readable bytes.
pub(crate) unsafe fn read_versioned<T: Versioned>(at: *const T) -> Result<T, Failure> {
    // SAFETY: `at` is valid, as this function's `# Safety` requires.
    let size = unsafe { size_of_versioned(at)? };
    for offset in size_of::<T>()..size {
        // SAFETY: `offset < struct_size`, all of which is readable.
        if unsafe { at.cast::<u8>().add(offset).read() } != 0 {
            return Err(Failure::Reserved(T::NAME));
        }
    }
    if size >= size_of::<T>() {
        // SAFETY: `at` is not NULL, is aligned, and `size` bytes are readable (`size_of_versioned`). Any bytes are a
        // value (`Versioned`).
        return Ok(unsafe { at.read() });
    }
    let mut value = MaybeUninit::<T>::zeroed();
    // SAFETY: `at` is not NULL, and `size` bytes are readable (`size_of_versioned`). Fields that an older caller's
    // structure lacks stay zero, and any bytes are a value (`Versioned`).
    unsafe {
        at.cast::<u8>().copy_to_nonoverlapping(value.as_mut_ptr().cast(), size);
        Ok(value.assume_init())
    }
}

/// Returns a copy of the caller's structure, as [`read_versioned`] does; all zeros if `at` is NULL.
///
/// # Safety
/// As for [`read_versioned`].
pub(crate) unsafe fn read_or_zeros<T: Versioned>(at: *const T) -> Result<T, Failure> {
    if at.is_null() {
        // SAFETY: any bytes are a value (`Versioned`).
        return Ok(unsafe { MaybeUninit::zeroed().assume_init() });
    }
    // SAFETY: the arguments are valid, as this function's `# Safety` requires.
    unsafe { read_versioned(at) }
}

pub(crate) fn check_zeros(name: &'static str, fields: &[u32]) -> Result<(), Failure> {
    if fields.iter().all(|&field| field == 0) { Ok(()) } else { Err(Failure::Reserved(name)) }
}

/// Converts a C enum's number `found` to `names[found]`, or to an error "`name`: expected `expected`, found `found`".
pub(crate) fn named<T: Copy>(
    names: &[Option<T>],
    name: &'static str,
    expected: &'static str,
    found: u32,
) -> Result<T, Failure> {
    let known = names.get(found as usize).copied().flatten();
    known.ok_or(Failure::Setting { name, expected, found })
}

/// Converts a value of a `nerf-core` type to its number in a C enum: the index of `value` in `names`, or 0 if absent.
pub(crate) fn number_of<T: PartialEq>(names: &[Option<T>], value: T) -> u32 {
    names.iter().position(|named| named.as_ref() == Some(&value)).unwrap_or_default() as u32
}

/// A checked pointer to a structure that receives results.
pub(crate) struct Out<T> {
    at: *mut T,
    size: usize,
}

impl<T: Versioned> Out<T> {
    /// Checks the pointer and `struct_size`. Returns an error if `at` is NULL or misaligned, or the size out of range.
    ///
    /// # Safety
    /// `at` is NULL or points to `struct_size` bytes that may be read and written until the call ends.
    pub unsafe fn new(at: *mut T) -> Result<Self, Failure> {
        // SAFETY: `at` is valid, as this function's `# Safety` requires.
        let size = unsafe { size_of_versioned(at)? };
        Ok(Self { at, size })
    }

    /// Checks the pointer and `struct_size`, as [`Out::new`] does; `None` if `at` is NULL.
    /// # Safety
    /// As for [`Out::new`].
    pub unsafe fn new_or_none(at: *mut T) -> Result<Option<Self>, Failure> {
        // SAFETY: `at` is valid, as this function's `# Safety` requires.
        if at.is_null() { Ok(None) } else { unsafe { Self::new(at).map(Some) } }
    }

    /// Copies `value` into the caller's structure, but leaves the structure's `struct_size` unchanged. If the structure
    /// is longer than `value`, the remaining bytes become zero; if shorter, the last fields of `value` are left out.
    pub fn write(self, value: T) {
        let known = self.size.min(size_of::<T>());
        let (from, to) = ((&raw const value).cast::<u8>(), self.at.cast::<u8>());
        // SAFETY: `new` checked the pointer, and its caller vouches for `size` bytes.
        unsafe {
            to.copy_from_nonoverlapping(from, known);
            self.at.cast::<usize>().write(self.size);
            to.add(known).write_bytes(0, self.size - known);
        }
    }
}

/// Runs a C call that computes a memory size. Writes the result of `body` to `size`, and the alignment of [`Line`] to
/// `align`, in bytes.
///
/// # Safety
/// `size` and `align` are NULL, or may be written until the call ends.
pub(crate) unsafe fn call_for_size(
    (size, align): (*mut usize, *mut usize),
    message: Message,
    body: impl FnOnce() -> Result<usize, Failure>,
) -> Status {
    call(message, || {
        check_out("size", size)?;
        check_out("align", align)?;
        let bytes = body()?;
        // SAFETY: the pointers were checked above, and are writable, as this function's `# Safety` requires.
        unsafe {
            size.write(bytes);
            align.write(align_of::<Line>());
        }
        Ok(())
    })
}

/// Returns an error if `at` is NULL or misaligned for `T`.
pub(crate) fn check_out<T>(name: &'static str, at: *mut T) -> Result<(), Failure> {
    if at.is_null() {
        return Err(Failure::Null(name));
    }
    check_aligned(name, at as usize, align_of::<T>())
}

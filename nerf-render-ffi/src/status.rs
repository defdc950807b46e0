//! Statuses that calls return, and the English text of each status.

use core::ffi::{CStr, c_char};

/// Result of a call: success, or the reason for the failure. The numbers never change; later versions may add statuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(i32)]
pub enum Status {
    /// Success.
    Ok = 0,
    /// A required pointer is NULL.
    NullPointer = 1,
    /// `struct_size` is smaller than the structure is in version 2 of the ABI, or above 4096 bytes.
    StructSize = 2,
    /// A reserved field is not zero, or a field that only a newer header has is not zero.
    Reserved = 3,
    /// A pointer or stride is not a multiple of its alignment.
    Alignment = 4,
    /// Memory lent by the caller is smaller than required. `nerf_scene_memory` and `nerf_worker_size` compute sizes.
    Memory = 5,
    /// Two ranges of memory overlap, but must not.
    Overlap = 6,
    /// A size, a stride or a range of addresses is too large.
    Overflow = 7,
    /// A setting is outside its range, or this build of the library lacks what the setting asks for.
    Options = 8,
    /// This machine lacks the instructions of the requested kernel or storage.
    Kernel = 9,
    /// The camera is invalid, or `nerf_camera_look_at` or `nerf_camera_ray` has no result for the given arguments.
    Camera = 10,
    /// The rectangle is not inside the image.
    Rect = 11,
    /// The target has no plane. Or a plane has a wrong format or stride. Or a plane was not requested when the worker
    /// was opened. Or a plane is not allowed in this call, with these options or together with another plane.
    Target = 12,
    /// The scene file contains a 2D field, not a scene: `nerf_render_picture` renders 2D fields.
    NotAScene = 13,
    /// The scene's occupancy grid is part of its model and cannot be ignored.
    OccupancyRequired = 14,
    /// A direction in `dirs` of `nerf_points`, or `axis` of `nerf_rays`, is not of unit length.
    Direction = 15,
    /// The progress callback cancelled the render; finished tiles are in the planes.
    Cancelled = 16,
    /// The library panicked, which is a defect; the scene is unharmed, the worker cannot be used any more.
    Panic = 17,
    /// The call needs a 2D field, but the scene file contains a 3D scene, which `nerf_render` renders.
    NotAPicture = 18,
    /// The scene has no Pareto front (PSNR against multiply-adds) with a point that this call can choose or measure.
    /// `nerf-train study` measures a front.
    NoFront = 19,
    /// The file cannot be read.
    File = 20,
    /// An allocation failed for lack of memory.
    OutOfMemory = 21,
    /// A ray has a direction that is not of unit length, an origin that is not finite, an invalid `t_min` or `t_max`,
    /// or a random number outside [0, 1]; or `nerf_render_rays` was given random numbers.
    Ray = 22,
    /// The transform of an instance is not a rotation, a uniform scale and a translation.
    Transform = 23,
    /// Another call uses the worker, or a call with the worker has panicked.
    Busy = 24,
    /// The bytes do not begin with the signature of a scene file.
    BlobMagic = 32,
    /// The scene file ends early.
    BlobTruncated = 33,
    /// Bytes follow the end of the scene file.
    BlobTrailing = 34,
    /// The scene file is of another version of the format.
    BlobVersion = 35,
    /// The scene file was written with the opposite byte order.
    BlobEndian = 36,
    /// The scene file has flags or reserved bytes that this library does not know.
    BlobFlags = 37,
    /// The scene file is damaged: its checksum does not match.
    BlobChecksum = 38,
    /// The scene file's checksum matches, but the content breaks a rule of the format.
    BlobContent = 39,
}

macro_rules! texts {
    ($($status:ident: $text:literal;)+) => {
        impl Status {
            /// All statuses, in the order of their numbers.
            pub const ALL: &[Self] = &[$(Self::$status),+];

            pub(crate) const fn text(self) -> &'static CStr {
                match self {
                    $(Self::$status => $text,)+
                }
            }
        }
    };
}

texts! {
    Ok: c"done";
    NullPointer: c"a pointer that must not be NULL is";
    StructSize: c"struct_size is none this library knows";
    Reserved: c"a reserved or unknown field is not zero";
    Alignment: c"a pointer or stride is misaligned";
    Memory: c"memory is smaller than the size query says";
    Overlap: c"two pieces of memory overlap that must not";
    Overflow: c"a size or a range of addresses overflows";
    Options: c"a setting is outside its range";
    Kernel: c"this machine lacks the instructions, or has none for that storage";
    Camera: c"the camera makes no rays";
    Rect: c"the rectangle is not inside the image";
    Target: c"no plane is wanted, or a plane's format or stride is wrong";
    NotAScene: c"the blob is a 2D field, not a scene: nerf_render_picture renders it";
    OccupancyRequired: c"the scene's occupancy grid is part of its model and cannot be ignored";
    Direction: c"a direction is not of unit length";
    Cancelled: c"cancelled by the progress callback";
    Panic: c"a defect of this library; the scene is unharmed";
    NotAPicture: c"the blob is a scene, not a 2D field: nerf_render renders it";
    NoFront: c"the scene has no Pareto front of accuracy against work";
    File: c"the file cannot be read";
    OutOfMemory: c"out of memory";
    Ray: c"a ray has no unit direction, no finite origin, no range or no random number";
    Transform: c"a transform is not a rotation, one scale and a translation";
    Busy: c"another call works with the worker, or one of its calls has panicked";
    BlobMagic: c"not a .nerf blob";
    BlobTruncated: c"the blob ends early";
    BlobTrailing: c"bytes follow the blob";
    BlobVersion: c"the blob is of another version of the format";
    BlobEndian: c"the blob has the other byte order";
    BlobFlags: c"the blob has unknown flags or reserved bytes";
    BlobChecksum: c"the blob is damaged: its checksum does not match";
    BlobContent: c"the blob's content breaks a rule of the format";
}

/// Returns the meaning of a status as English text. The text is static and never NULL, even if `status` is unknown.
#[unsafe(no_mangle)]
pub extern "C" fn nerf_status_text(status: i32) -> *const c_char {
    let known = Status::ALL.iter().find(|known| **known as i32 == status);
    known.map_or(c"unknown status", |known| known.text()).as_ptr()
}

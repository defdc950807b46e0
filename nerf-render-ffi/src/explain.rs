//! Report of a worker's frames in English: which rendering stages run, and why the other stages do not run.

use crate::boundary::{Message, call, check_out, read_versioned};
use crate::counters::Counters;
use crate::status::Status;
use crate::worker::{State, Worker, with_worker};
use core::ffi::c_char;
use core::fmt::Write;
use nerf_core::render;

/// Writes an English report of a worker's frames: which rendering stages run, and why the other stages do not. If
/// `counters` is not NULL, also reports the work of each stage.
///
/// The text is for people: its wording may change between versions. If the worker has several instances, the text has
/// one part for each instance.
///
/// `counters`: NULL, or the counters that a call of this worker wrote; ignored if the worker has several instances.
/// `text`: NULL, or a buffer of `capacity` bytes; the text is cut to fit, and NUL-terminated. `needed`: NULL, or
/// receives the length of the uncut text with its NUL, bytes. `text` and `needed` are written on success only; a cut
/// text is a success. `message`: NULL, or a buffer for an error message.
///
/// # Safety
/// Pointers are NULL or point to what is described here. The caller has not freed, moved or overwritten the memory of
/// `worker` or its scenes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn nerf_explain(
    worker: *mut Worker,
    counters: *const Counters,
    text: *mut c_char,
    capacity: usize,
    needed: *mut usize,
    message: *mut c_char,
    message_capacity: usize,
) -> Status {
    call(Message { text: message, capacity: message_capacity }, || {
        let say = |worker: &mut State| {
            if !needed.is_null() {
                check_out("needed", needed)?;
            }
            let work = if counters.is_null() {
                None
            } else {
                // SAFETY: `counters` is valid, as this function's `# Safety` requires.
                Some(render::Counters::from(unsafe { read_versioned(counters)? }))
            };
            worker.fields()?;
            let alone = worker.members.len() == 1;
            let all = Message { text, capacity }.write(|cut| {
                for (index, member) in worker.members.iter().enumerate() {
                    let Some(plan) = &member.plan else { continue };
                    let mut explanation = member.scene.renderer().explain(plan).with_workspace(worker.size);
                    if let Some(work) = work.filter(|_| alone) {
                        explanation = explanation.with_counters(work);
                    }
                    if cfg!(feature = "messages") {
                        // Writing cannot fail: text that does not fit into the buffer is left out.
                        let _ = if alone {
                            write!(cut, "{explanation}")
                        } else {
                            write!(cut, "instance {index}\n{explanation}\n")
                        };
                    }
                }
            });
            if !needed.is_null() {
                // SAFETY: the pointers were checked above, and are writable, as this function's `# Safety` requires.
                unsafe { needed.write(all) };
            }
            Ok(())
        };
        // SAFETY: `worker` is valid, as this function's `# Safety` requires.
        unsafe { with_worker(worker, say) }
    })
}

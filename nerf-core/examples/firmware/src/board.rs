//! Access to the board: text output to the debugger, a clock, and the highest use of the stack.

use cortex_m_rt::STACK_PAINT_VALUE;
use cortex_m_semihosting::{debug, hio::HostStream, hio::hstdout};

/// Console of the debugger, to which text is written by semihosting.
pub struct Console(Option<HostStream>);

impl Console {
    /// Opens the console. Without a debugger, the console discards all text.
    pub fn open() -> Self {
        Self(hstdout().ok())
    }

    /// Writes ASCII text.
    pub fn write(&mut self, text: &[u8]) {
        if let Some(out) = &mut self.0 {
            // An error is ignored, since no other output could report it.
            let _ = out.write_all(text);
        }
    }

    /// Writes a line: `name`, a space, and `value` in decimal.
    pub fn number(&mut self, name: &str, value: u64) {
        let (mut digits, mut rest) = ([b' '; 21], value);
        for digit in digits.iter_mut().rev() {
            *digit = b'0' + (rest % 10) as u8;
            rest /= 10;
            if rest == 0 {
                break;
            }
        }
        let first = digits.iter().position(|&digit| digit != b' ').unwrap_or_default();
        self.line(name, digits.get(first..).unwrap_or_default());
    }

    /// Writes a line: `name`, a space, and `value` as eight hexadecimal digits.
    pub fn bits(&mut self, name: &str, value: u32) {
        let digit = |i: u32| (value >> (28 - 4 * i) & 15) as u8;
        let text = [0, 1, 2, 3, 4, 5, 6, 7].map(|i| digit(i) + if digit(i) < 10 { b'0' } else { b'a' - 10 });
        self.line(name, &text);
    }

    /// Writes a line: `name`, a space, and `text`.
    pub fn line(&mut self, name: &str, text: &[u8]) {
        for part in [name.as_bytes(), b" ", text, b"\n"] {
            self.write(part);
        }
    }
}

/// Ends the program and reports success (`well`) or failure to the debugger.
pub fn exit(well: bool) -> ! {
    debug::exit(if well { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {}
}

/// Address of timer 0 of the board: a CMSDK APB timer, 25 MHz, counting down.
const TIMER: *mut u32 = 0x4000_0000 as *mut u32;

pub fn start_clock() {
    // SAFETY: CTRL, VALUE and RELOAD of timer 0, which nobody else uses.
    unsafe {
        TIMER.add(2).write_volatile(u32::MAX);
        TIMER.add(1).write_volatile(u32::MAX);
        TIMER.write_volatile(1);
    }
}

/// Returns the timer ticks, at 25 MHz, since [`start_clock`] was called.
pub fn ticks() -> u32 {
    // SAFETY: VALUE of timer 0.
    u32::MAX - unsafe { TIMER.add(1).read_volatile() }
}

/// Returns the largest number of bytes of stack used so far. The start-up code fills the stack with a known value; the
/// function searches for the first word that was overwritten.
pub fn stack_used() -> usize {
    unsafe extern "C" {
        static __sheap: u32;
        static _stack_start: u32;
    }
    let (mut at, end) = (&raw const __sheap, &raw const _stack_start);
    // SAFETY: between the end of the statics and the first word above the stack is RAM, whatever it holds.
    while at < end && unsafe { at.read_volatile() } == STACK_PAINT_VALUE {
        at = at.wrapping_add(1);
    }
    end as usize - at as usize
}

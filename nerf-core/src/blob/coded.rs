//! Entropy coding of int8 tables: rANS with adaptive models, as `docs/blob-format.md` specifies.
//!
//! A value is coded as two symbols of 4 bits. Previous values select the probability model of the next symbol. The
//! model then adapts to that symbol. Files therefore hold no probabilities.
//!
//! Decoding also checks the bytes: the decoder must use all bytes and end in the encoder's initial state. This check is
//! complete. Each step is invertible, so that encoding the decoded values gives the accepted bytes again.
//!
//! # Source
//! Duda 2013, "Asymmetric numeral systems", arXiv:1311.2540. Models are updated as in Giesen, "Mixing discrete
//! probability distributions", 2015.

use super::error::BlobError;
use crate::encoding::GridEncoding;

/// Number of different symbols. A symbol is a number of 4 bits.
const SYMBOLS: usize = 16;
/// Binary logarithm of the total length of a [`Model`]'s intervals. Probabilities are multiples of 2^-15.
const BITS: u32 = 15;
/// Smallest state of the rANS coder between two symbols; also the encoder's initial state.
const LEAST: u32 = 1 << 16;
/// Number added to a value, modulo 256, so that all values of small magnitude have the same upper 4 bits.
const OFFSET: u8 = 0x88;
/// Upper 4 bits of every small value (-8 to 7) after [`OFFSET`] is added.
const SMALL: usize = 8;
/// Number of magnitude classes that the entropy coder distinguishes. The class of the next value depends on the sum of
/// two magnitudes. One is of the previous value, the other of the same feature's value in the previous table entry.
const CLASSES: usize = 8;
/// Maximum number of features of a table entry.
const MAX_FEATURES: usize = 4;
/// Number of contexts of the entropy coder, one per magnitude class and feature. A context has two probability models:
/// one for the upper 4 bits of a value, and one for the lower 4 bits of a small value (-8 to 7). The lower 4 bits of
/// any other value have a model that depends only on the value's upper 4 bits.
const CONTEXTS: usize = CLASSES * MAX_FEATURES;

/// An adaptive probability distribution of symbols. Each symbol has an interval within `0..2^BITS`. A symbol's
/// probability is the length of its interval divided by `2^BITS`.
#[derive(Clone, Copy, Debug)]
struct Model {
    /// Beginning of each symbol's interval. An interval ends where the next begins, the last interval at 2^[`BITS`].
    begins: [i16; SYMBOLS],
    /// Number of symbols that the model has adapted to; the count stops at 255.
    seen: u8,
}

impl Model {
    /// The initial model: sixteen symbols of the same probability.
    const EVEN: Self = {
        let mut begins = [0; SYMBOLS];
        let mut symbol = 0;
        while symbol < SYMBOLS {
            begins[symbol] = (symbol << (BITS - 4)) as i16;
            symbol += 1;
        }
        Self { begins, seen: 0 }
    };

    /// The symbol whose interval holds `slot`, a number below 2^[`BITS`].
    #[inline(always)]
    fn symbol_at(&self, slot: u32) -> usize {
        let (slot, begins) = (slot as i16, &self.begins);
        let reached = |symbol: usize| usize::from(begins[symbol] <= slot);
        // Finds the group of four symbols, then the symbol in the group: 39 MB/s. Comparing all sixteen with vectors:
        // 27 MB/s.
        let four = 4 * (reached(4) + reached(8) + reached(12));
        four + reached(four + 1) + reached(four + 2) + reached(four + 3)
    }

    /// Returns the beginning and the length of the symbol's interval. The length is at least 1.
    #[inline(always)]
    fn interval(&self, symbol: usize) -> (u32, u32) {
        let begin = self.begins[symbol] as u32;
        let end = self.begins.get(symbol + 1).map_or(1 << BITS, |&end| end as u32);
        (begin, end - begin)
    }

    /// Adapts the model to `symbol`: moves the beginning of each interval towards a target position. At the target
    /// positions, the interval of `symbol` is as long as possible, and every other interval has length 1. One call
    /// moves a beginning by a fraction of the distance to its target position: 1/16 in the first 16 calls, 1/32 in the
    /// next 16, 1/64 in the next 96, then 1/128. The movement is rounded down, so that every interval stays at least 1
    /// long.
    #[inline(always)]
    fn learn(&mut self, symbol: usize) {
        let rate = 4 + [16, 32, 128].iter().filter(|&&seen| self.seen >= seen).count();
        for (i, begin) in self.begins.iter_mut().enumerate() {
            let target = i as i16 + if i > symbol { i16::MAX - SYMBOLS as i16 + 1 } else { 0 };
            *begin += (target - *begin) >> rate;
        }
        self.seen = self.seen.saturating_add(1);
    }
}

/// The adaptive probability models of a grid level's symbols, and the context that selects the next symbol's model.
struct Models {
    models: [Model; 2 * CONTEXTS + SYMBOLS],
    /// The last values that were encoded or decoded, newest first: the context of the next value.
    last: [u8; MAX_FEATURES],
    features: usize,
    feature: usize,
}

impl Models {
    fn new(features: u8) -> Self {
        let features = usize::from(features).clamp(1, MAX_FEATURES);
        let models = [Model::EVEN; 2 * CONTEXTS + SYMBOLS];
        Self { models, last: [0; MAX_FEATURES], features, feature: 0 }
    }

    /// Encodes or decodes one value as two symbols: upper half, then lower half. For each symbol, calls `code` with the
    /// symbol's model and half. `code` returns the symbol, and the model adapts to this symbol. Returns the value;
    /// `None` if `code` returns `None`.
    #[inline(always)]
    fn value(&mut self, mut code: impl FnMut(&Model, Half) -> Option<usize>) -> Option<u8> {
        let magnitude = |value: u8| u32::from(value.cast_signed().unsigned_abs());
        // Sum of the magnitudes of the previous value and of the same feature's value in the previous table entry.
        let around = magnitude(self.last[0]) + magnitude(self.last[self.features - 1]);
        let class = (u32::BITS - around.leading_zeros()).min(CLASSES as u32 - 1) as usize;
        let context = self.feature * CLASSES + class;
        let upper = self.symbol(context, |model| code(model, Half::Upper))?;
        let of_lower = if upper == SMALL { CONTEXTS + context } else { 2 * CONTEXTS + upper };
        let lower = self.symbol(of_lower, |model| code(model, Half::Lower))?;
        let value = ((upper << 4 | lower) as u8).wrapping_sub(OFFSET);
        self.last = [value, self.last[0], self.last[1], self.last[2]];
        self.feature = if self.feature + 1 == self.features { 0 } else { self.feature + 1 };
        Some(value)
    }

    #[inline(always)]
    fn symbol(&mut self, model: usize, code: impl FnOnce(&Model) -> Option<usize>) -> Option<usize> {
        let model = &mut self.models[model];
        let symbol = code(model)?;
        model.learn(symbol);
        Some(symbol)
    }
}

/// The half of a byte, upper or lower 4 bits, that a symbol codes.
#[derive(Clone, Copy)]
#[cfg_attr(not(any(feature = "train", test)), allow(dead_code, reason = "an encoder's"))]
enum Half {
    Upper,
    Lower,
}

/// Decodes the int8 values of all levels of `grid` in order and passes each to `put`. The time is bounded even for
/// damaged bytes: one byte yields at most 6,100 values.
///
/// # Errors
/// [`BlobError::CodedEnd`] if `bytes` end too early. [`BlobError::CodedRest`] if the decoder's initial state is below
/// 65536, if its last state is not 65536, or if bytes are left.
pub fn decode_tables(grid: &GridEncoding, bytes: &[u8], mut put: impl FnMut(u8)) -> Result<(), BlobError> {
    let (first, rest) = bytes.split_first_chunk().ok_or(BlobError::CodedEnd { level: 0, index: 0 })?;
    let (mut state, words) = (u32::from_le_bytes(*first), rest.as_chunks::<2>());
    let mut next = words.0.iter();
    if state < LEAST {
        return Err(BlobError::CodedRest { state, bytes: rest.len() as u64 });
    }
    for level in grid.levels() {
        let mut models = Models::new(grid.features);
        for index in 0..level.entries * usize::from(grid.features) {
            let value = models.value(|model, _| {
                let slot = state % (1 << BITS);
                let symbol = model.symbol_at(slot);
                let (begin, length) = model.interval(symbol);
                state = length * (state >> BITS) + slot - begin;
                if state < LEAST {
                    state = state << 16 | u32::from(u16::from_le_bytes(*next.next()?));
                }
                Some(symbol)
            });
            let end = BlobError::CodedEnd { level: level.index as u8, index: index as u32 };
            put(value.ok_or(end)?);
        }
    }
    let left = 2 * next.len() + words.1.len();
    if left == 0 && state == LEAST { Ok(()) } else { Err(BlobError::CodedRest { state, bytes: left as u64 }) }
}

/// Entropy-codes `values`, the signed bytes of all levels of `grid`. Returns the encoded bytes, at the end of `out`.
///
/// `symbols`: working memory, two elements per value. Returns `None` if `symbols`, `out` or `values` is too short.
#[cfg(any(feature = "train", test))]
pub fn encode_tables<'o>(
    grid: &GridEncoding,
    values: &[u8],
    symbols: &mut [[u16; 2]],
    out: &'o mut [u8],
) -> Option<&'o [u8]> {
    let mut to = symbols.iter_mut();
    let mut from = values.iter();
    for level in grid.levels() {
        let mut models = Models::new(grid.features);
        for _ in 0..level.entries * usize::from(grid.features) {
            let byte = from.next()?.wrapping_add(OFFSET);
            models.value(|model, half| {
                let symbol = usize::from(match half {
                    Half::Upper => byte >> 4,
                    Half::Lower => byte & 15,
                });
                let (begin, length) = model.interval(symbol);
                *to.next()? = [begin as u16, length as u16];
                Some(symbol)
            })?;
        }
    }
    let unused = to.len();
    let symbols = symbols.get(..symbols.len() - unused)?;
    let (mut state, mut at) = (LEAST, out.len());
    let mut push = |bytes: &[u8]| {
        at = at.checked_sub(bytes.len())?;
        out.get_mut(at..at + bytes.len())?.copy_from_slice(bytes);
        Some(at)
    };
    // Encodes the last symbol first, since rANS decodes symbols in the reverse order of encoding.
    for &[begin, length] in symbols.iter().rev() {
        let (begin, length) = (u32::from(begin), u32::from(length));
        if u64::from(state) >= u64::from(length) << (32 - BITS) {
            push(&(state as u16).to_le_bytes())?;
            state >>= 16;
        }
        state = (state / length) << BITS | (state % length + begin);
    }
    let at = push(&state.to_le_bytes())?;
    out.get(at..)
}

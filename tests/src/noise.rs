//! Numbers that look random, the same in every run.

/// `n` numbers of [-1, 1).
pub fn noise(n: usize, seed: u32) -> Vec<f32> {
    let mut state = u64::from(seed) + 1;
    (0..n).map(|_| signed(&mut state)).collect()
}

/// Marsaglia's 64-bit xorshift, 13, 7, 17; the state is never 0.
pub fn next(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

/// A number of [0, 1).
pub fn share(state: &mut u64) -> f32 {
    (next(state) >> 40) as f32 / (1u64 << 24) as f32
}

/// A number of [-1, 1).
pub fn signed(state: &mut u64) -> f32 {
    (next(state) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
}

/// A number of [-1, 1), in all digits.
pub fn signed_f64(state: &mut u64) -> f64 {
    (next(state) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

//! Pseudo-random numbers that are equal in every run.

/// Returns `n` numbers in [-1, 1).
pub fn noise(n: usize, seed: u32) -> Vec<f32> {
    let mut state = u64::from(seed) + 1;
    (0..n).map(|_| signed(&mut state)).collect()
}

/// Returns the next number of Marsaglia's 64-bit xorshift generator with shifts 13, 7, 17. `state` must not be 0.
pub fn next(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

/// Returns a number in [0, 1).
pub fn share(state: &mut u64) -> f32 {
    (next(state) >> 40) as f32 / (1u64 << 24) as f32
}

/// Returns a number in [-1, 1).
pub fn signed(state: &mut u64) -> f32 {
    (next(state) >> 40) as f32 / (1u64 << 23) as f32 - 1.0
}

/// Returns a number in [-1, 1) with all 53 bits of an f64.
pub fn signed_f64(state: &mut u64) -> f64 {
    (next(state) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

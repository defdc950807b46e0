//! Comparison of errors that never loses a NaN, the worst error: `f64::max` would return the other number.

/// Returns the larger of two errors; NaN if one of them is NaN.
pub fn worse(a: f64, b: f64) -> f64 {
    if a > b || a.is_nan() { a } else { b }
}

/// Returns the largest error, or 0 if no error is positive; NaN if one of them is NaN.
pub fn worst_of(errors: impl IntoIterator<Item = f64>) -> f64 {
    errors.into_iter().fold(0.0, worse)
}

/// Returns a positive difference unchanged, and 0 for a negative one; NaN for NaN.
pub fn excess(difference: f64) -> f64 {
    worse(difference, 0.0)
}

#[test]
fn a_nan_is_the_worst_wherever_it_stands() {
    for a in [f64::NAN, -f64::NAN, 0.0, 1.0, f64::INFINITY, f64::NEG_INFINITY] {
        assert!(worse(a, f64::NAN).is_nan() && worse(f64::NAN, a).is_nan());
        assert!(worst_of([a, f64::NAN, 2.0]).is_nan() && worst_of([f64::NAN, a]).is_nan());
        assert!(excess(a).is_nan() == a.is_nan());
    }
    assert_eq!(
        [worse(1.0, 2.0), worse(2.0, 1.0), worst_of([]), worst_of([0.5, 3.0, 1.0])],
        [2.0, 2.0, 0.0, 3.0]
    );
    assert_eq!(
        [excess(-1.0), excess(0.0), excess(2.5), excess(f64::INFINITY)],
        [0.0, 0.0, 2.5, f64::INFINITY]
    );
}

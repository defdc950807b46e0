//! Compensated summation.

/// A compensated sum (Kahan 1965): a sum of 4,096 terms has about the rounding error of a single addition. `value` is
/// the sum so far, `lost` the rounding error of the last addition, which is subtracted from the next term.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sum {
    pub value: f32,
    pub lost: f32,
}

impl Sum {
    pub const ZERO: Self = Self { value: 0.0, lost: 0.0 };

    #[inline]
    pub fn add(&mut self, x: f32) {
        let corrected = x - self.lost;
        let sum = self.value + corrected;
        self.lost = (sum - self.value) - corrected;
        self.value = sum;
    }
}

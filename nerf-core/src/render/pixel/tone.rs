//! Display-encoded colour to light and back, with exposure and tone curve between.
//!
//! Linear output is composited as light: each sample is decoded, as is the background. Else a ray's colour is composited as
//! the photographs are, display-encoded, and decoded once.

use crate::math::{Math, MathBackend, with_math};
use crate::plan::{Tone, ToneMap};
use crate::simd::{Isa, Lanes, Op};
use core::marker::PhantomData;

/// The colours of a block's samples as light, where output is linear; `values`: any number of channels.
#[inline]
pub(crate) fn samples_to_light(tone: &Tone, math: MathBackend, isa: Isa, values: &mut [f32]) {
    if tone.linear {
        let columns = values.len();
        with_math!(math, M => isa.run_columns(columns, Decode::<M> { values, math: PhantomData }));
    }
}

/// The background of rays, as their samples are.
#[inline]
pub(crate) fn background<M: Math>(tone: &Tone, rgb: [f32; 3]) -> [f32; 3] {
    if tone.linear { decode_srgb::<M>(rgb) } else { rgb }
}

/// A ray's colour as light; as it is where nothing is asked for, or its samples were light.
#[inline]
pub(crate) fn to_light<M: Math>(tone: &Tone, rgb: [f32; 3]) -> [f32; 3] {
    if *tone == Tone::NONE || tone.linear { rgb } else { decode_srgb::<M>(rgb) }
}

struct Decode<'a, M> {
    values: &'a mut [f32],
    math: PhantomData<M>,
}

impl<M: Math> Op for Decode<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let (zero, knee) = (V::splat(0.0), V::splat(0.040_45));
        for values in self.values.chunks_exact_mut(V::COUNT) {
            let c = V::load(values);
            let c = zero.max_of(c);
            let low = c.div(V::splat(12.92));
            // Where it is not used its argument is no longer that of a power.
            let high = M::pow(knee.max_of(c).add(V::splat(0.055)).div(V::splat(1.055)), 2.4);
            V::select(knee.less(c), high, low).store(values);
        }
    }
}

/// A pixel's colour, from what [`to_light`] gave.
#[inline]
pub(crate) fn to_display<M: Math>(tone: &Tone, rgb: [f32; 3]) -> [f32; 3] {
    if *tone == Tone::NONE { rgb } else { develop::<M>(tone, rgb) }
}

/// The sRGB curve of each channel, from display-encoded to linear; below 0 is 0.
///
/// # Accuracy
/// Max abs error 4e-7 on `[0, 1]`, on every backend.
/// # Source
/// IEC 61966-2-1.
#[inline(never)]
fn decode_srgb<M: Math>(rgb: [f32; 3]) -> [f32; 3] {
    rgb.map(|c| {
        let c = c.max(0.0);
        if c <= 0.040_45 { c / 12.92 } else { M::pow((c + 0.055) / 1.055, 2.4) }
    })
}

/// The inverse of [`decode_srgb`], cut at 1.
///
/// # Accuracy
/// Max abs error 4e-7, on every backend.
#[inline]
fn encode_srgb<M: Math>(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * M::pow(x, 1.0 / 2.4) - 0.055 }
}

/// Exposure, tone curve, and encoding unless the output is linear.
#[inline(never)]
fn develop<M: Math>(tone: &Tone, light: [f32; 3]) -> [f32; 3] {
    let gain = exp2::<M>(tone.exposure);
    light.map(|x| {
        let x = curve(tone.map, x * gain);
        if tone.linear { x } else { encode_srgb::<M>(x) }
    })
}

/// `2^stops`, exact for whole ones.
fn exp2<M: Math>(stops: f32) -> f32 {
    use crate::simd::Lanes;
    let whole = stops.round_even();
    whole.exp2_integer()
        * if stops == whole { 1.0 } else { M::exp((stops - whole) * core::f32::consts::LN_2) }
}

/// The tone curve at `x >= 0`.
fn curve(map: ToneMap, x: f32) -> f32 {
    match map {
        ToneMap::None => x,
        ToneMap::Reinhard => x / (1.0 + x),
        ToneMap::Filmic => {
            // Beyond this the curve has long reached 1, and squares stay finite.
            let x = x.min(1e4);
            ((x * (2.51 * x + 0.03)) / (x * (2.43 * x + 0.59) + 0.14)).min(1.0)
        }
    }
}

#[cfg(test)]
mod tests;

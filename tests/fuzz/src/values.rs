//! Numbers that systems of this kind stumble over, drawn from a fuzzer's bytes.

use arbitrary::{Result, Unstructured};

/// The edges of f32, and of what the crates allow.
const EDGES: [f32; 20] = [
    0.0,
    -0.0,
    1e-45,
    f32::MIN_POSITIVE,
    1e-30,
    1e-10,
    1e-6,
    0.5,
    1.0,
    -1.0,
    1.000_000_1,
    2.0,
    1e4,
    1e9,
    -1e9,
    1e30,
    f32::MAX,
    f32::MIN,
    f32::INFINITY,
    f32::NAN,
];

/// Any f32: one of the edges, any bits, or what a sound caller would give: -2 to 2.
pub fn any_f32(u: &mut Unstructured<'_>) -> Result<f32> {
    Ok(match u.int_in_range(0..=3u8)? {
        0 => *u.choose(&EDGES)?,
        1 => f32::from_bits(u.arbitrary()?),
        _ => f32::from(u.arbitrary::<i16>()?) / 16384.0,
    })
}

/// Three of them.
pub fn any_vec3(u: &mut Unstructured<'_>) -> Result<[f32; 3]> {
    Ok([any_f32(u)?, any_f32(u)?, any_f32(u)?])
}

/// Once in `of`, and not where bytes have run out.
pub fn rarely(u: &mut Unstructured<'_>, of: u8) -> Result<bool> {
    Ok(u.int_in_range(1..=of)? == of)
}

/// `sound` for the most part, else any number.
pub fn mostly(u: &mut Unstructured<'_>, sound: f32) -> Result<f32> {
    if u.ratio(7, 8)? { Ok(sound) } else { any_f32(u) }
}

//! Tests of the reading of single bits into lanes of a vector: every instruction set against plain loops.

extern crate std;

use super::*;
use std::vec::Vec;

/// Reads the bits `first + i · step` of `bytes`, for `i` in `0..16`. Fields: `bytes`, `first`, `step`.
struct Bits<'a>(&'a [u8], u32, u32);

impl Op for Bits<'_> {
    type Output = u32;

    #[inline(always)]
    fn run<V: Lanes>(self) -> u32 {
        const COUNTING: [f32; 16] = [0., 1., 2., 3., 4., 5., 6., 7., 8., 9., 10., 11., 12., 13., 14., 15.];
        let Self(bytes, first, step) = self;
        (0..16).step_by(V::COUNT).fold(0, |bits, lane| {
            let i = V::load(&COUNTING[lane..]).to_indices();
            bits | V::bits(bytes, i.mul(V::Indices::splat(step)).add(V::Indices::splat(first))) << lane
        })
    }
}

#[test]
fn bits_are_read_alike_with_every_kernel() {
    let bytes: Vec<u8> = (0..70u32).map(|i| (i.wrapping_mul(0x9e37_79b9) >> 24) as u8).collect();
    for length in [0, 1, 3, 4, 5, 8, 70] {
        let bytes = &bytes[..length];
        for (first, step) in
            [(0, 1), (3, 7), (8 * length as u32, 1), (0, 41), (u32::MAX - 7, 1), (1 << 31, 3)]
        {
            let bit = |i: u32| {
                let at = first.wrapping_add(i * step) as usize;
                bytes.get(at / 8).map_or(0, |byte| u32::from(byte >> (at % 8) & 1))
            };
            let expected = (0..16).fold(0, |bits, i| bits | bit(i) << i);
            for isa in Isa::ALL.into_iter().filter(|isa| isa.available()) {
                let found = isa.run(Bits(bytes, first, step));
                assert_eq!(found, expected, "{isa:?}, {length} bytes, from {first} by {step}");
            }
        }
    }
}

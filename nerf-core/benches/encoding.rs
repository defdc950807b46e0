//! Positional encoding, 63 values of a position, with every maths backend on every tier.
//!
//! The share counts the polynomial's operations on every line, whatever a backend really does: it says
//! how fast the same encoding is made.

mod support;

use nerf_core::MathBackend;
use nerf_core::encoding::encode_block;
use nerf_core::kernels::BLOCK;
use std::hint::black_box;
use support::networks::pi;
use support::{Table, noise, tiers};

const SAMPLES: usize = 4096;
/// Operations of one `(sin πu, cos πu)` in `math/polynomial.rs`: reduction 9, polynomials 19, quadrant 4,
/// and 1 to scale.
const FLOP_PER_PAIR: usize = 33;

fn main() {
    let mut table = Table::new();
    let backends = [
        ("polynomial", MathBackend::Polynomial),
        #[cfg(feature = "libm")]
        ("libm", MathBackend::Libm),
        #[cfg(feature = "micromath")]
        ("micromath", MathBackend::Micromath),
        ("recurrence", MathBackend::Recurrence),
    ];
    let encoding = pi(10);
    let rows = encoding.outputs();
    let pairs = usize::from(encoding.inputs) * usize::from(encoding.levels);
    let positions = noise(3 * SAMPLES, 1);
    let mut encoded = vec![0.0; rows * BLOCK];
    for (backend, math) in backends {
        for tier in tiers() {
            let name = format!("encoding {backend} {}, {SAMPLES} samples", tier.name());
            table.line(&name, tier, 1, (FLOP_PER_PAIR * pairs * SAMPLES) as f64, || {
                for positions in positions.chunks(3 * BLOCK) {
                    encode_block(tier, math, &encoding, BLOCK, positions, &mut encoded);
                    black_box(&mut encoded);
                }
            });
        }
    }
}

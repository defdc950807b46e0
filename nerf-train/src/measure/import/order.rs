//! Permutation of an encoding's channels, from the orders of other trainers to this project's.

use nerf_core::encoding::SinusoidalEncoding;

/// Order of sines and cosines in an encoded input; `x y z` are the inputs. A network works only with the order that it
/// was trained with, so the import permutes the columns of its weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Order {
    /// For each level: sin x, sin y, sin z, cos x, cos y, cos z. As in the original NeRF code, nerf-pytorch and this
    /// project.
    Level,
    /// For each level: sin x, cos x, sin y, cos y, sin z, cos z.
    Pairs,
    /// For each input and each of its levels: sin, cos. As in tiny-cuda-nn.
    Input,
    /// All sines (for each level: x, y, z), then all cosines in the same order. As in JaxNeRF and mip-NeRF.
    Halves,
    /// All sines (for each input: all levels), then all cosines in the same order. As in nerfstudio.
    HalvesByInput,
}

/// Position of the raw inputs in the encoding.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Identity {
    /// The raw inputs come before the sines and cosines.
    First,
    /// The raw inputs come after the sines and cosines.
    Last,
    /// The encoding does not contain the raw inputs.
    None,
}

impl Order {
    /// Returns, for each channel of `encoding` in this project's order, the index of the channel in the other trainer's
    /// order. `self`: that trainer's order of sines and cosines; `identity`: that trainer's position of the raw inputs.
    ///
    /// ```
    /// use nerf_core::encoding::{AngleScale, SinusoidalEncoding};
    /// use nerf_train::measure::import::{Identity, Order};
    /// let encoding = SinusoidalEncoding { inputs: 2, levels: 1, scale: AngleScale::One, identity: true };
    /// // This project: x y, sin x, sin y, cos x, cos y. The other order: sin x, cos x, sin y, cos y, x y.
    /// assert_eq!(Order::Pairs.columns(&encoding, Identity::Last), [4, 5, 0, 2, 1, 3]);
    /// ```
    pub fn columns(self, encoding: &SinusoidalEncoding, identity: Identity) -> Vec<usize> {
        let (inputs, levels) = (usize::from(encoding.inputs), usize::from(encoding.levels));
        let (own, waves) = match identity {
            Identity::First => (0..inputs, inputs),
            Identity::Last => (2 * levels * inputs..(2 * levels + 1) * inputs, 0),
            Identity::None => (0..0, 0),
        };
        let mut columns: Vec<usize> = own.collect();
        for k in 0..levels {
            for cosine in 0..2 {
                columns.extend((0..inputs).map(|i| {
                    waves
                        + match self {
                            Self::Level => (2 * k + cosine) * inputs + i,
                            Self::Pairs => (k * inputs + i) * 2 + cosine,
                            Self::Input => (i * levels + k) * 2 + cosine,
                            Self::Halves => (cosine * levels + k) * inputs + i,
                            Self::HalvesByInput => (cosine * inputs + i) * levels + k,
                        }
                }));
            }
        }
        columns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::ValueEnum;
    use nerf_core::encoding::AngleScale;

    #[test]
    fn every_order_is_a_permutation_and_level_is_our_own() {
        for (inputs, levels) in [(3, 0), (3, 1), (3, 10), (2, 4)] {
            for identity in [Identity::First, Identity::Last, Identity::None] {
                let is = identity != Identity::None;
                let encoding = SinusoidalEncoding { inputs, levels, scale: AngleScale::One, identity: is };
                for &order in Order::value_variants() {
                    let mut columns = order.columns(&encoding, identity);
                    let own: Vec<usize> = (0..encoding.outputs()).collect();
                    if (order, identity) != (Order::Level, Identity::Last) && order == Order::Level {
                        assert_eq!(columns, own);
                    }
                    columns.sort_unstable();
                    assert_eq!(columns, own, "{order:?}, {identity:?}");
                }
            }
        }
    }

    #[test]
    fn orders_written_out_for_two_inputs_and_two_levels() {
        // s0x: sin of x at level 0. Each list is what a trainer's encoding gives.
        let ours = ["x", "y", "s0x", "s0y", "c0x", "c0y", "s1x", "s1y", "c1x", "c1y"];
        let encoding = SinusoidalEncoding { inputs: 2, levels: 2, scale: AngleScale::Pi, identity: true };
        for (order, theirs) in [
            (Order::Pairs, ["x", "y", "s0x", "c0x", "s0y", "c0y", "s1x", "c1x", "s1y", "c1y"]),
            (Order::Input, ["x", "y", "s0x", "c0x", "s1x", "c1x", "s0y", "c0y", "s1y", "c1y"]),
            (Order::Halves, ["x", "y", "s0x", "s0y", "s1x", "s1y", "c0x", "c0y", "c1x", "c1y"]),
            (Order::HalvesByInput, ["x", "y", "s0x", "s1x", "s0y", "s1y", "c0x", "c1x", "c0y", "c1y"]),
        ] {
            let found = order.columns(&encoding, Identity::First).into_iter().map(|column| theirs[column]);
            assert_eq!(found.collect::<Vec<_>>(), ours, "{order:?}");
        }
    }
}

//! Palettes of up to 256 colours for a frame.
//!
//! Colours are assigned where the squared error is largest. NeuQuant of the `gif` crate assigns colours by area
//! instead: a small object in front of a wide background got only a dozen colours.

const MAX_COLOURS: usize = 256;
/// Number of iterations of k-means.
const ROUNDS: usize = 2;

/// A colour that occurs in the frame, and its number of pixels.
type Counted = ([u8; 3], u32);

/// Palette of a frame, and the palette index of each pixel.
pub struct Quantised {
    /// Colours, `[k * 3]`; 1 ≤ k ≤ 256 for a frame with pixels.
    pub palette: Vec<u8>,
    pub indices: Vec<u8>,
}

/// Finds a palette for the pixels of `rgb` (`[n * 3]`) and the nearest entry for each pixel.
///
/// The palette is exact if there are at most 256 colours. Otherwise the set of colours with the largest squared error
/// is split at its mean along its widest axis, until there are 256 sets. Two iterations of k-means follow.
///
/// # Source
/// Variance-based cutting after Wan, Wong, Prusinkiewicz 1988, "An algorithm for multidimensional data
/// clustering", greedy over the per-axis error.
pub fn quantise(rgb: &[u8]) -> Quantised {
    let colours = count(rgb);
    let mut entries: Vec<[u8; 3]> = if colours.len() <= MAX_COLOURS {
        colours.iter().map(|c| c.0).collect()
    } else {
        cut(&colours).iter().map(|set| representative(set)).collect()
    };
    if colours.len() > MAX_COLOURS {
        for _ in 0..ROUNDS {
            let mut sets = vec![Vec::new(); entries.len()];
            colours.iter().for_each(|&colour| sets[nearest(&entries, colour.0)].push(colour));
            for (entry, set) in entries.iter_mut().zip(&sets).filter(|(_, set)| !set.is_empty()) {
                *entry = representative(set);
            }
        }
    }
    let index: Vec<u8> = colours.iter().map(|&(colour, _)| nearest(&entries, colour) as u8).collect();
    let place = |pixel: &[u8]| {
        let colour = [pixel[0], pixel[1], pixel[2]];
        colours.binary_search_by_key(&colour, |c| c.0).map_or(0, |i| index[i])
    };
    Quantised { palette: entries.concat(), indices: rgb.chunks_exact(3).map(place).collect() }
}

fn count(rgb: &[u8]) -> Vec<Counted> {
    let mut pixels: Vec<[u8; 3]> = rgb.chunks_exact(3).map(|p| [p[0], p[1], p[2]]).collect();
    pixels.sort_unstable();
    pixels.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as u32)).collect()
}

/// Set of colours. `axis`: channel with the largest `error`, the sum of squared deviations from its `mean`.
struct Set {
    colours: Vec<Counted>,
    error: f64,
    mean: f64,
    axis: usize,
}

impl Set {
    fn new(colours: Vec<Counted>) -> Self {
        let weight: f64 = colours.iter().map(|c| f64::from(c.1)).sum();
        let along = |axis: usize| {
            let value = |c: &Counted| (f64::from(c.1), f64::from(c.0[axis]));
            let mean = colours.iter().map(value).map(|(w, v)| w * v).sum::<f64>() / weight;
            let error = colours.iter().map(value).map(|(w, v)| w * (v - mean).powi(2)).sum::<f64>();
            (error, mean, axis)
        };
        let widest = |a: (f64, f64, usize), b: (f64, f64, usize)| if b.0 > a.0 { b } else { a };
        let (error, mean, axis) = widest(widest(along(0), along(1)), along(2));
        Self { colours, error, mean, axis }
    }
}

/// Splits `colours`, which is not empty, into at most 256 non-empty sets.
fn cut(colours: &[Counted]) -> Vec<Vec<Counted>> {
    let mut sets = vec![Set::new(colours.to_vec())];
    while sets.len() < MAX_COLOURS {
        let splittable = sets.iter().enumerate().filter(|(_, set)| set.colours.len() > 1);
        let Some((worst, _)) = splittable.max_by(|a, b| a.1.error.total_cmp(&b.1.error)) else { break };
        let set = sets.swap_remove(worst);
        let below = |c: &Counted| f64::from(c.0[set.axis]) <= set.mean;
        let (low, high): (Vec<Counted>, Vec<Counted>) = set.colours.into_iter().partition(below);
        // Colours differ along the widest axis, so only rounding can leave a part empty. Splitting then ends.
        let whole = low.is_empty() || high.is_empty();
        sets.extend([low, high].into_iter().filter(|part| !part.is_empty()).map(Set::new));
        if whole {
            break;
        }
    }
    sets.into_iter().map(|set| set.colours).collect()
}

/// Returns a set's palette entry: the colour of over half its pixels, which keeps flat backgrounds exact, or the mean.
fn representative(set: &[Counted]) -> [u8; 3] {
    let total: u64 = set.iter().map(|c| u64::from(c.1)).sum();
    if let Some(main) = set.iter().find(|c| 2 * u64::from(c.1) > total) {
        return main.0;
    }
    [0, 1, 2].map(|axis| {
        let sum: u64 = set.iter().map(|c| u64::from(c.1) * u64::from(c.0[axis])).sum();
        ((sum + total / 2) / total.max(1)) as u8
    })
}

/// Returns the index of the palette entry nearest to `colour`; the first of equally near ones.
fn nearest(entries: &[[u8; 3]], colour: [u8; 3]) -> usize {
    let square = |a: u8, b: u8| (i32::from(a) - i32::from(b)).pow(2);
    let distance = |entry: &[u8; 3]| (0..3).map(|c| square(entry[c], colour[c])).sum::<i32>();
    entries.iter().enumerate().min_by_key(|(_, entry)| distance(entry)).map_or(0, |(i, _)| i)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn colour_of(quantised: &Quantised, pixel: usize) -> &[u8] {
        &quantised.palette[usize::from(quantised.indices[pixel]) * 3..][..3]
    }

    #[test]
    fn up_to_256_colours_are_exact() {
        for colours in [1_usize, 2, 255, 256] {
            let rgb: Vec<u8> =
                (0..2_000).flat_map(|i| [(i % colours) as u8, 200, (i % colours / 2) as u8]).collect();
            let quantised = quantise(&rgb);
            assert_eq!(quantised.palette.len(), 3 * colours);
            assert!((0..2_000).all(|i| colour_of(&quantised, i) == &rgb[3 * i..][..3]));
        }
        assert!(quantise(&[]).indices.is_empty());
    }

    #[test]
    fn a_gradient_on_a_wide_background_gets_nearly_all_entries() {
        // 1 % of the pixels hold 4,096 colours, the rest is white.
        let mut rgb = vec![255; 3 * 400_000];
        for i in 0..4_096 {
            rgb[3 * i..][..3].copy_from_slice(&[(i % 64) as u8, 64 + (i / 64) as u8, 32]);
        }
        let quantised = quantise(&rgb);
        assert_eq!(quantised.palette.len(), 3 * 256);
        assert_eq!(colour_of(&quantised, 399_999), [255; 3]);
        for i in 0..4_096 {
            let error = (0..3).map(|c| rgb[3 * i + c].abs_diff(colour_of(&quantised, i)[c])).max().unwrap();
            // 255 entries share 64 × 64 colours: each entry takes about 4 × 4 of them.
            assert!(error <= 4, "pixel {i} is {error} levels off");
        }
    }
}

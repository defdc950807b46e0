//! Removes view dependence from a network: the encoded direction is replaced by its mean over the rays of some views.

use crate::data::View;
use nerf_core::Isa;
use nerf_core::encoding::{DirectionEncoding, encode_block, encode_harmonics_block};
use nerf_core::math::MathBackend;
use nerf_core::network::{Architecture, Layer, Role};

/// Largest number of rays per view in the mean of the encoded direction: neighbouring rays have similar directions.
const RAYS: usize = 4096;
/// Number of directions that are encoded at once.
const BLOCK: usize = 64;

/// Averages the encoded direction, `[outputs]`, over a regular grid of pixels of each of `views`; `None` without views.
pub fn mean_encoding(encoding: &DirectionEncoding, views: &[&View]) -> Option<Vec<f64>> {
    let mut dirs: Vec<[f32; 3]> = Vec::new();
    for view in views {
        let (width, height) = view.size();
        let pixels = width as usize * height as usize;
        let step = (pixels as f64 / RAYS as f64).sqrt().ceil().max(1.0) as usize;
        for y in (step / 2..height as usize).step_by(step) {
            for x in (step / 2..width as usize).step_by(step) {
                dirs.push(view.camera.ray(x as f32 + 0.5, y as f32 + 0.5).dir.to_array());
            }
        }
    }
    if dirs.is_empty() {
        return None;
    }
    let mut sums = vec![0.0; encoding.outputs()];
    let mut encoded = vec![0.0; encoding.outputs() * BLOCK];
    for block in dirs.chunks(BLOCK) {
        let mut x = [0.0; 3 * BLOCK];
        for (i, dir) in block.iter().enumerate() {
            (0..3).for_each(|axis| x[axis * BLOCK + i] = dir[axis]);
        }
        match encoding {
            DirectionEncoding::Sinusoidal(encoding) => {
                encode_block(Isa::Portable, MathBackend::Polynomial, encoding, BLOCK, &x, &mut encoded);
            }
            DirectionEncoding::SphericalHarmonics { degree } => {
                encode_harmonics_block(Isa::Portable, *degree, BLOCK, &x, &mut encoded);
            }
        }
        for (sum, channel) in sums.iter_mut().zip(encoded.chunks_exact(BLOCK)) {
            *sum += channel[..block.len()].iter().map(|&v| f64::from(v)).sum::<f64>();
        }
    }
    Some(sums.into_iter().map(|sum| sum / dirs.len() as f64).collect())
}

/// Returns architecture and parameters without view dependence; `None` if colour does not depend on the direction.
///
/// The encoded direction PE(d) is replaced by `mean`: the product of PE(d)'s weights and `mean` is added to the biases,
/// in f64. Parameters are in the order of a scene file's weights. If all weights of PE(d) are 0, colours do not change.
pub fn without_direction(
    architecture: &Architecture,
    parameters: &[f32],
    mean: &[f64],
) -> Option<(Architecture, Vec<f32>)> {
    architecture.direction?;
    let folded = Architecture { direction: None, ..architecture.clone() };
    let mut result = Vec::with_capacity(folded.parameters());
    for layer in &architecture.layers() {
        let bias = &parameters[layer.bias..][..layer.outputs];
        if !takes_direction(layer) {
            result.extend_from_slice(&parameters[layer.weights..layer.bias + layer.outputs]);
            continue;
        }
        let rows = parameters[layer.weights..layer.bias].chunks_exact(layer.inputs());
        rows.clone().for_each(|row| result.extend_from_slice(&row[..layer.main]));
        result.extend(rows.zip(bias).map(|(row, &bias)| {
            let share: f64 = row[layer.main..].iter().zip(mean).map(|(&w, &mean)| f64::from(w) * mean).sum();
            (f64::from(bias) + share) as f32
        }));
    }
    // Parameters after those of the layers are the grid's tables and do not change.
    result.extend_from_slice(&parameters[architecture.parameters()..]);
    Some((folded, result))
}

/// Removes view dependence with [`without_direction`], using the mean of the encoded direction over the rays of
/// `views`. `None` if colour does not depend on the direction, or if `views` is empty.
pub fn flattened(
    architecture: &Architecture,
    parameters: &[f32],
    views: &[&View],
) -> Option<(Architecture, Vec<f32>)> {
    let mean = mean_encoding(architecture.direction.as_ref()?, views)?;
    without_direction(architecture, parameters, &mean)
}

/// Whether the layer's input contains the encoded direction, as in the first colour layer if colour depends on it.
fn takes_direction(layer: &Layer) -> bool {
    matches!(layer.role, Role::Colour(_) | Role::Rgb) && layer.extra > 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::demo;
    use crate::model::config::{Config, Preset};

    /// Small network with view dependence, whose parameters are all different.
    fn network(colour_width: usize) -> (Architecture, Vec<f32>) {
        let mut config: Config = Preset::Small.config();
        let n = &mut config.network;
        (n.depth, n.width, n.position_levels, n.direction_levels, n.colour_width) =
            (2, 8, 2, 2, colour_width);
        let architecture = config.model().architecture;
        let parameters = (0..architecture.parameters()).map(|i| ((i * 37 % 101) as f32 - 50.0) / 64.0);
        let parameters = parameters.collect();
        (architecture, parameters)
    }

    fn layer_of(architecture: &Architecture) -> Layer {
        *architecture.layers().iter().find(|layer| takes_direction(layer)).expect("a direction")
    }

    #[test]
    fn a_colour_that_does_not_depend_on_direction_stays_bit_for_bit() {
        for colour_width in [0, 5] {
            let (architecture, mut parameters) = network(colour_width);
            let layer = layer_of(&architecture);
            for row in parameters[layer.weights..layer.bias].chunks_exact_mut(layer.inputs()) {
                row[layer.main..].fill(0.0);
            }
            let mean = vec![0.7; layer.extra];
            let (folded, found) = without_direction(&architecture, &parameters, &mean).expect("folds");
            assert_eq!((folded.direction, found.len()), (None, folded.parameters()));
            for (old, new) in architecture.layers().iter().zip(&folded.layers()) {
                assert_eq!((old.role, old.main, old.outputs), (new.role, new.main, new.outputs));
                for row in 0..old.outputs {
                    let old_row = &parameters[old.weights + row * old.inputs()..][..old.main];
                    assert_eq!(old_row, &found[new.weights + row * new.inputs()..][..new.main]);
                    assert_eq!(parameters[old.bias + row], found[new.bias + row]);
                }
            }
            assert!(without_direction(&folded, &found, &mean).is_none());
        }
    }

    /// Before the activation, a layer's output is linear in PE(d). The mean output over directions is therefore the
    /// output of the folded layer, which has the mean of PE(d) in its bias.
    #[test]
    fn the_folded_bias_is_the_mean_over_directions_in_f64() {
        let dataset = demo::small(3, 1, 12);
        let views: Vec<&View> = dataset.train.iter().collect();
        let (architecture, parameters) = network(5);
        let direction = architecture.direction.expect("a direction");
        let mean = mean_encoding(&direction, &views).expect("rays");
        let (folded, found) = without_direction(&architecture, &parameters, &mean).expect("folds");
        let (old, new) = (layer_of(&architecture), folded.layers()[3]);
        assert_eq!(new.role, Role::Colour(0));
        for row in 0..old.outputs {
            let (mut sum, mut count) = (0.0, 0.0);
            for view in &views {
                for (x, y) in (0..12).flat_map(|y| (0..12).map(move |x| (x, y))) {
                    let dir = view.camera.ray(x as f32 + 0.5, y as f32 + 0.5).dir.as_dvec3().to_array();
                    let mut encoded = dir.to_vec();
                    for level in 0..2 {
                        let angle = |d: &f64| std::f64::consts::PI * f64::from(1 << level) * d;
                        encoded.extend(dir.iter().map(|d| angle(d).sin()));
                        encoded.extend(dir.iter().map(|d| angle(d).cos()));
                    }
                    let weights = &parameters[old.weights + row * old.inputs() + old.main..][..old.extra];
                    sum += weights.iter().zip(&encoded).map(|(&w, e)| f64::from(w) * e).sum::<f64>();
                    count += 1.0;
                }
            }
            let expected = sum / count + f64::from(parameters[old.bias + row]);
            let bias = f64::from(found[new.bias + row]);
            // Tolerance for rounding of the encoding (15 values of 1.2e-7, weights below 1) and of the bias.
            assert!(
                (bias - expected).abs() < 15.0 * 1.2e-7 + 2.0 * f64::from(f32::EPSILON),
                "{bias} {expected}"
            );
        }
    }
}

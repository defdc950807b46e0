//! Normal equations of a Levenberg-Marquardt step, with the points eliminated (Schur complement).

use super::{Bundle, Device, Jacobian, Observation, POSE, SOFT_PIXELS};
use crate::data::cameras::geometry::outer;
use glam::{DMat3, DQuat, DVec3};

/// Block of the normal equations that couples one pose or device with one point: a row per parameter of the pose or
/// device, a column per coordinate of the point. The last rows of a device's block are 0: it has fewer parameters.
type Block = [DVec3; POSE];

/// Derivatives of a residual with respect to the parameters of one pose or device. First comes the index of the first
/// parameter among the unknowns of [`Reduced`], then the derivatives of the residual's x, then those of its y.
type Rows = (usize, [[f64; POSE]; 2]);

/// Normal equations of all poses and devices, with the points eliminated. `matrix` is `size` × `size`, row by row; only
/// its lower triangle is used.
pub(super) struct Reduced<'a> {
    bundle: &'a Bundle,
    matrix: Vec<f64>,
    right: Vec<f64>,
    damping: f64,
    size: usize,
}

struct Point {
    /// For each pose and device that sees this point: index of its first parameter, and its [`Block`] with this point.
    blocks: Vec<(usize, Block)>,
    inverse: DMat3,
    right: DVec3,
}

impl<'a> Reduced<'a> {
    /// Sets up the equations of a step with Levenberg-Marquardt `damping`; `None` if a point's equations are singular.
    pub(super) fn of(bundle: &'a Bundle, damping: f64) -> Option<Self> {
        // POSE rows for each pose and each device; the last rows of a device are unused.
        let size = POSE * (bundle.photographs.len() + bundle.devices.len());
        let mut reduced =
            Self { bundle, matrix: vec![0.0; size * size], right: vec![0.0; size], damping, size };
        bundle.observations.iter().for_each(|seen| reduced.add_cameras(seen));
        for i in 0..size {
            // A parameter that no observation depends on gets a 1 on the diagonal, so that it stays unchanged.
            let diagonal = &mut reduced.matrix[i * size + i];
            *diagonal += damping * *diagonal + f64::from(u8::from(*diagonal == 0.0));
        }
        for seen in bundle.observations.chunk_by(|a, b| a.point == b.point) {
            let point = reduced.point(seen)?;
            reduced.eliminate(&point);
        }
        Some(reduced)
    }

    /// Returns an observation's derivatives with respect to the photograph's pose and its device's intrinsics, each with
    /// its first row in the matrix; then the whole Jacobian, and the weight in the robust loss. `None` if the point is
    /// not in front of the camera.
    #[inline]
    fn rows(&self, seen: &Observation) -> Option<([Rows; 2], Jacobian, f64)> {
        let jacobian = self.bundle.linearised(seen)?;
        let weight = SOFT_PIXELS / SOFT_PIXELS.hypot(jacobian.residual.length());
        let device = self.bundle.photographs.len() + self.bundle.photographs[seen.photograph].device;
        let rows = [(POSE * seen.photograph, jacobian.pose), (POSE * device, jacobian.device)];
        Some((rows, jacobian, weight))
    }

    fn add_cameras(&mut self, seen: &Observation) {
        let Some((rows, jacobian, weight)) = self.rows(seen) else { return };
        let residual = jacobian.residual;
        for (at, [x, y]) in rows {
            for i in 0..POSE {
                self.right[at + i] -= weight * (x[i] * residual.x + y[i] * residual.y);
            }
            for (other, [ox, oy]) in rows.into_iter().filter(|(other, _)| *other <= at) {
                for i in 0..POSE {
                    let row = &mut self.matrix[(at + i) * self.size + other..][..POSE];
                    let products = ox.iter().zip(&oy).map(|(ox, oy)| weight * (x[i] * ox + y[i] * oy));
                    row.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
                }
            }
        }
    }

    fn point(&self, seen: &[Observation]) -> Option<Point> {
        let (mut own, mut right) = (DMat3::ZERO, DVec3::ZERO);
        let mut blocks: Vec<(usize, Block)> = Vec::with_capacity(seen.len() + 1);
        for seen in seen {
            let Some((rows, jacobian, weight)) = self.rows(seen) else { continue };
            let [x, y] = jacobian.point;
            own += outer(x, x * weight) + outer(y, y * weight);
            right -= weight * (x * jacobian.residual.x + y * jacobian.residual.y);
            for (at, [by_x, by_y]) in rows {
                let product: Block = std::array::from_fn(|i| weight * (by_x[i] * x + by_y[i] * y));
                match blocks.iter_mut().find(|(other, _)| *other == at) {
                    Some((_, block)) => block.iter_mut().zip(product).for_each(|(sum, p)| *sum += p),
                    None => blocks.push((at, product)),
                }
            }
        }
        let damped = own + self.damping * DMat3::from_diagonal(own.diagonal());
        let inverse = damped.inverse();
        inverse.is_finite().then_some(Point { blocks, inverse, right })
    }

    fn eliminate(&mut self, point: &Point) {
        for (at, block) in &point.blocks {
            for (i, row) in block.iter().enumerate() {
                let solved = point.inverse * *row;
                self.right[at + i] -= solved.dot(point.right);
                for (other, with) in point.blocks.iter().filter(|(other, _)| other <= at) {
                    let row = &mut self.matrix[(at + i) * self.size + other..][..POSE];
                    row.iter_mut().zip(with).for_each(|(sum, with)| *sum -= solved.dot(*with));
                }
            }
        }
    }

    /// Returns the bundle after the step, points included; `None` if the equations have no solution.
    pub(super) fn step(mut self) -> Option<Bundle> {
        solve(&mut self.matrix, &mut self.right, self.size)?;
        let mut bundle = self.bundle.clone();
        let (poses, devices) = self.right.split_at(POSE * bundle.photographs.len());
        for (photograph, step) in bundle.photographs.iter_mut().zip(poses.chunks_exact(POSE)) {
            let turn = DQuat::from_scaled_axis(DVec3::from_slice(step));
            photograph.rotation = (turn * photograph.rotation).normalize();
            photograph.translation += DVec3::from_slice(&step[3..]);
        }
        for (device, step) in bundle.devices.iter_mut().zip(devices.chunks_exact(POSE)) {
            let Device { focal, radial: [k1, k2], .. } = device;
            let [by_focal, by_k1, by_k2] = [0, 1, 2].map(|i| step[i]);
            (*focal, *k1, *k2) = (*focal * by_focal.exp(), *k1 + by_k1, *k2 + by_k2);
        }
        for seen in self.bundle.observations.chunk_by(|a, b| a.point == b.point) {
            let point = self.point(seen)?;
            let mut right = point.right;
            for (at, block) in &point.blocks {
                right -= block.iter().zip(&self.right[*at..]).map(|(row, step)| *row * *step).sum::<DVec3>();
            }
            bundle.points[seen[0].point] += point.inverse * right;
        }
        Some(bundle)
    }
}

/// Solves `matrix` x = `right` by Cholesky factorisation; `x` replaces `right`. `None` if `matrix` is not positive
/// definite. `matrix`: symmetric, `size` × `size`, row by row; only the lower triangle is used, and overwritten.
fn solve(matrix: &mut [f64], right: &mut [f64], size: usize) -> Option<()> {
    for i in 0..size {
        let (above, row) = matrix.split_at_mut(i * size);
        for j in 0..i {
            let other = &above[j * size..][..size];
            row[j] = (row[j] - dot(&row[..j], &other[..j])) / other[j];
        }
        let square = row[i] - dot(&row[..i], &row[..i]);
        if square.is_nan() || square <= 0.0 {
            return None;
        }
        row[i] = square.sqrt();
        right[i] = (right[i] - dot(&row[..i], &right[..i])) / row[i];
    }
    for i in (0..size).rev() {
        right[i] /= matrix[i * size + i];
        let (value, row) = (right[i], &matrix[i * size..][..i]);
        right.iter_mut().zip(row).for_each(|(right, factor)| *right -= factor * value);
    }
    Some(())
}

/// Returns the dot product, in eight partial sums; the order of additions is fixed.
#[inline]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (mut sums, (a, a_rest), (b, b_rest)) = ([0.0; 8], a.as_chunks::<8>(), b.as_chunks::<8>());
    for (a, b) in a.iter().zip(b) {
        for i in 0..8 {
            sums[i] += a[i] * b[i];
        }
    }
    sums.iter().sum::<f64>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>()
}

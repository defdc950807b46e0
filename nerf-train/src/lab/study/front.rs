//! Pareto fronts: points that no other point beats in cost and loss of PSNR together.

/// Loss of PSNR and cost of rendering at one point, which is one choice of settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Price {
    /// PSNR, dB, lost against the exact rendering or, in the module `combine`, the base settings; negative for a gain.
    pub loss_db: f64,
    /// Render time or multiply-adds, absolute or as a ratio; above 0.
    pub cost: f64,
}

impl Price {
    fn is_usable(&self) -> bool {
        self.loss_db.is_finite() && self.cost.is_finite() && self.cost > 0.0
    }
}

/// Returns the indices of the points on the Pareto front. Along the list, cost strictly falls and loss strictly rises.
///
/// One point beats another if neither its cost nor its loss is larger, and at least one of the two is smaller. Of equal
/// points the first is kept. Points whose loss or cost is not finite, or whose cost is 0, are left out.
pub fn pareto(points: &[Price]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).filter(|&i| points[i].is_usable()).collect();
    let key = |i: usize| (points[i].cost, points[i].loss_db);
    // Stable: of equal points the first stays first.
    order.sort_by(|&a, &b| {
        let ((a, la), (b, lb)) = (key(a), key(b));
        a.total_cmp(&b).then(la.total_cmp(&lb))
    });
    let mut best = f64::INFINITY;
    order.retain(|&i| {
        let better = points[i].loss_db < best;
        if better {
            best = points[i].loss_db;
        }
        better
    });
    order.reverse();
    order
}

/// Returns at most `most` indices of the Pareto front `front`, which is sorted by falling cost. Its two ends are kept if
/// `most` is at least 2.
///
/// Repeatedly removes the inner point with the least product of two factors: (loss of the next cheaper point − own
/// loss) and ln(cost of the next more expensive point / own cost).
pub fn thin(points: &[Price], front: &[usize], most: usize) -> Vec<usize> {
    let mut front = front.to_vec();
    while front.len() > most.max(2) {
        let area = |i: usize| {
            let [dearer, own, cheaper] = [i - 1, i, i + 1].map(|i| points[front[i]]);
            (cheaper.loss_db - own.loss_db) * (dearer.cost / own.cost).ln()
        };
        let least = (1..front.len() - 1).min_by(|&a, &b| area(a).total_cmp(&area(b)));
        match least {
            Some(i) => front.remove(i),
            None => break,
        };
    }
    front.truncate(most);
    front
}

/// Returns the index of the cheapest point whose loss is at most `loss_db`; `None` if every point loses more.
pub fn cheapest_within(points: &[Price], loss_db: f64) -> Option<usize> {
    let within = |&i: &usize| points[i].is_usable() && points[i].loss_db <= loss_db;
    (0..points.len()).filter(within).min_by(|&a, &b| points[a].cost.total_cmp(&points[b].cost))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prices(points: &[(f64, f64)]) -> Vec<Price> {
        points.iter().map(|&(cost, loss_db)| Price { loss_db, cost }).collect()
    }

    #[test]
    fn no_point_of_a_front_is_beaten_and_every_other_is() {
        let noise = |i: u64, salt: u64| {
            let z = (i * 2 + salt).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            f64::from(((z ^ (z >> 29)) % 40) as u32)
        };
        // Dearer points mostly lose less; some points are equal.
        let point = |i: u64| {
            let cost = 1.0 + noise(i, 0);
            Price { cost, loss_db: (60.0 / cost).round() + 0.5 * noise(i, 1) - 5.0 }
        };
        let points: Vec<Price> = (0..200).map(point).collect();
        let front = pareto(&points);
        let beats = |a: &Price, b: &Price| {
            a.cost <= b.cost && a.loss_db <= b.loss_db && (a.cost < b.cost || a.loss_db < b.loss_db)
        };
        for (i, point) in points.iter().enumerate() {
            let beaten = points.iter().any(|other| beats(other, point));
            let kept = front.iter().any(|&f| points[f] == *point);
            assert_eq!(kept, !beaten, "{i}: {point:?}");
        }
        let falls = |pair: &[usize]| {
            let (dear, cheap) = (points[pair[0]], points[pair[1]]);
            dear.cost > cheap.cost && dear.loss_db < cheap.loss_db
        };
        assert!(front.len() > 2 && front.windows(2).all(falls));
    }

    #[test]
    fn of_equal_points_the_first_stays_and_of_equal_costs_the_better() {
        let points = prices(&[(2.0, 1.0), (2.0, 1.0), (2.0, 3.0), (1.0, 2.0), (3.0, 1.0)]);
        assert_eq!(pareto(&points), [0, 3]);
        assert_eq!(pareto(&[]), [0usize; 0]);
    }

    #[test]
    fn what_is_no_number_is_on_no_front() {
        let nan = f64::NAN;
        let points = prices(&[(nan, 0.0), (1.0, nan), (0.0, 0.0), (1.0, 5.0), (f64::INFINITY, -1.0)]);
        assert_eq!(pareto(&points), [3]);
        assert_eq!(cheapest_within(&points, 9.0), Some(3));
        assert_eq!(cheapest_within(&points, 4.0), None);
    }

    #[test]
    fn thinning_keeps_the_ends_the_order_and_the_corner() {
        // Small steps along the front, and one corner.
        let mut points: Vec<Price> =
            (0..40).map(|i| Price { cost: 100.0 - f64::from(i), loss_db: 1e-4 * f64::from(i) }).collect();
        points.push(Price { cost: 10.0, loss_db: 0.1 });
        points.push(Price { cost: 9.0, loss_db: 5.0 });
        let front = pareto(&points);
        assert_eq!(front.len(), 42);
        for most in [2, 3, 16, 42, 100] {
            let thinned = thin(&points, &front, most);
            assert_eq!(thinned.len(), most.min(42));
            assert_eq!((thinned.first(), thinned.last()), (front.first(), front.last()));
            assert!(thinned.is_sorted(), "{thinned:?}");
            assert!(most < 3 || thinned.contains(&40), "the corner of {most}");
        }
    }

    #[test]
    fn the_cheapest_within_a_loss_is_on_the_front() {
        let points = prices(&[(10.0, 0.0), (5.0, 0.4), (4.0, 0.9), (3.0, 1.1), (6.0, 0.5)]);
        assert_eq!(cheapest_within(&points, 1.0), Some(2));
        assert!(pareto(&points).contains(&2));
        assert_eq!(cheapest_within(&points, -1.0), None);
    }
}

//! What is shown, in words.

use super::scene::Scene;
use glam::Vec3;

impl Scene {
    /// What is shown, in a line.
    pub fn title(&self) -> String {
        match self.cameras.as_slice() {
            [only] if self.alone => {
                format!("{}: {} camera {} alone ({})", self.name, self.split, only.index, only.name)
            }
            cameras => format!("{}: {} {} cameras", self.name, cameras.len(), self.split),
        }
    }

    /// Which rays and samples, of what, and in which units.
    pub fn facts(&self) -> String {
        let s = &self.step;
        let of = match self.alone {
            true => format!("{} rays that step {} draws where this camera is alone", self.rays.len(), s.step),
            false if self.split == "train" => {
                format!("{} of the {} rays of training step {}", self.rays.len(), s.rays, s.step)
            }
            // Training never sees other views.
            false => format!(
                "{} of the {} rays that step {} would draw from these views",
                self.rays.len(),
                s.rays,
                s.step
            ),
        };
        let culled = match s.occupancy {
            true => format!(", {} culled by the occupancy grid that training starts with", self.culled()),
            false => String::new(),
        };
        let (b, ends) = (&self.bounds, self.bounds.scene_box);
        let range = format!("from near {} to far {}", short(b.near), short(b.far));
        let range = match (s.marched, &b.contraction) {
            (_, Some(_)) => format!("at most {} steps a ray, {range} and on, which is not drawn", s.bins),
            (true, None) => format!("at most {} steps a ray, {range}", s.bins),
            (false, None) => format!("{} bins {range}", s.bins),
        };
        let place = match &b.contraction {
            Some(contraction) => format!(
                "unbounded, contracted outside of a ball of radius {} around {}",
                short(contraction.radius()),
                corner(contraction.centre())
            ),
            None => format!("scene box {} to {}", corner(ends.min), corner(ends.max)),
        };
        format!(
            "{of} (seed {}); {} live samples{culled}; {range}; {place}; lengths in world units",
            s.seed,
            self.live()
        )
    }

    /// What the outline shows.
    pub fn ends(&self) -> &'static str {
        match self.bounds.contraction {
            Some(_) => "ball outside of which space is contracted",
            None => "scene box",
        }
    }
}

/// A length with at most three decimals.
fn short(value: f32) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

fn corner(p: Vec3) -> String {
    format!("({}, {}, {})", short(p.x), short(p.y), short(p.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        assert_eq!([short(2.0), short(1.23456), short(-0.5), short(10.0)], ["2", "1.235", "-0.5", "10"]);
    }
}

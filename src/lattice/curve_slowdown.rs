//! What a path costs by bending more than the present speed allows.
//!
//! At the speed v a curvature of κ₀ = a/v² takes all the lateral acceleration a that plans may use; where the path bends
//! more, it can be driven at v·√(κ₀/|κ|) at most. What is driven more slowly by the factor f = √(|κ|/κ₀) takes f − 1 times
//! longer than it would, and in that time free driving gets f − 1 times its length farther. So
//!
//! slowing = ∫ max(f − 1, 0) ds,  f = √(|κ| / max(κ₀, c·|κ_ref|)),
//!
//! metres of way lost, the unit of all costs. The speed that the reference line's own bends allow, κ_ref, is all that is
//! asked for: whoever drives the road slows down for them, and a chain that stops short of a bend must not be the cheaper
//! for it. c ([`FOLLOWING`]) is for edges that follow a bend, whose curvature comes out a little above the bend's.
//!
//! Slowing down to the speed in question and gaining speed again is not in it; `planner.lattice.weights.curve_slowdown` is above
//! 1 for that.
//!
//! The curvatures belong to the edge and are kept with it; κ₀ changes from cycle to cycle and comes in when a search asks.
//! At rest κ₀ is infinite, and nothing is lost. An edge far ahead is priced at the present speed, too, though the vehicle
//! may be slower or faster there; and the rate of steering, which also bounds speed, is left to the speed layer.

/// Samples of an edge at equal distances. The first one is one spacing from its start, which no edge can choose.
pub(super) const SAMPLES: usize = 6;

/// Curvature by that of the reference line beside it up to which an edge only follows the line.
const FOLLOWING: f64 = 1.3;

/// How much an edge and the reference line beside it bend.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Bends {
    /// |κ| of the edge and of the reference line, 1/m.
    samples: [(f64, f64); SAMPLES],
    /// Largest |κ| of the edge at a sample, 1/m.
    sharpest: f64,
}

impl Bends {
    /// From the curvatures of the edge and of the reference line at each sample, 1/m.
    pub(super) fn new(curvatures: [(f64, f64); SAMPLES]) -> Self {
        let samples = curvatures.map(|(edge, line)| (edge.abs(), line.abs()));
        Self { samples, sharpest: samples.iter().fold(0.0, |most, (edge, _)| edge.max(most)) }
    }

    /// Way lost over a length (m) where curvatures up to `full_speed` (1/m) can be driven at the present speed, m.
    pub(super) fn curve_slowdown(&self, length: f64, full_speed: f64) -> f64 {
        if self.sharpest <= full_speed {
            return 0.0;
        }
        let allowed = |line: f64| full_speed.max(FOLLOWING * line);
        let lost = self.samples.iter().map(|(edge, line)| ((edge / allowed(*line)).sqrt() - 1.0).max(0.0));
        length / SAMPLES as f64 * lost.sum::<f64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Time to drive a circular arc at the speed that a lateral acceleration allows, s, by the textbook: v = √(a r).
    fn time(length: f64, curvature: f64, speed: f64, lateral: f64) -> f64 {
        length / speed.min((lateral / curvature.abs()).sqrt())
    }

    #[test]
    fn an_arc_costs_the_way_that_free_driving_gets_farther_in_the_time_lost() {
        let (length, lateral) = (17.0, 2.25);
        for speed in [2.0, 8.0, 14.0, 30.0] {
            for curvature in [0.0, 0.003, -0.02, 0.1, -0.2] {
                let bends = Bends::new([(curvature, 0.0); SAMPLES]);
                let lost = speed * (time(length, curvature, speed, lateral) - length / speed);
                let curve_slowdown = bends.curve_slowdown(length, lateral / (speed * speed));
                assert!((curve_slowdown - lost).abs() < 1e-12 * length.max(lost), "{curve_slowdown} {lost}");
            }
        }
    }

    #[test]
    fn nothing_is_lost_at_rest_nor_on_a_bend_of_the_road_whichever_way_it_goes() {
        let sharp = Bends::new([(0.2, 0.0); SAMPLES]);
        assert_eq!(sharp.curve_slowdown(10.0, f64::INFINITY), 0.0);
        for (edge, line) in [(0.1, 0.1), (-0.1, -0.1), (0.1, 0.08), (0.05, 0.1)] {
            assert_eq!(Bends::new([(edge, line); SAMPLES]).curve_slowdown(10.0, 0.01), 0.0);
        }
        let [on_bend, on_straight] =
            [0.05, 0.0].map(|line| Bends::new([(0.1, line); SAMPLES]).curve_slowdown(10.0, 0.01));
        assert!(0.0 < on_bend && on_bend < on_straight, "{on_bend} {on_straight}");
    }

    #[test]
    fn the_term_rises_with_speed_without_a_step() {
        let bends = Bends::new([(0.01, 0.0), (0.07, 0.0), (0.04, 0.01), (0.0, 0.0), (-0.07, 0.0), (0.0, 0.0)]);
        let at = |speed: f64| bends.curve_slowdown(17.0, 2.25 / (speed * speed));
        let mut before = at(0.0);
        assert_eq!(before, 0.0);
        for i in 1..=2000 {
            let now = at(0.01 * f64::from(i));
            assert!((0.0..0.05).contains(&(now - before)), "{before} then {now} at {} cm/s", i);
            before = now;
        }
        assert!(before > 10.0, "{before}");
    }
}

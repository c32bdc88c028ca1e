//! The cost of curves that are too tight for the present speed.
//!
//! At the speed v the curvature κ₀ = a/v² uses the full planned lateral acceleration a. A tighter curve permits at most the
//! speed v·√(κ₀/|κ|). A section that is slower by the factor f = √(|κ|/κ₀) takes f times as long, and in the additional
//! time unobstructed driving covers (f − 1) times its length. So
//!
//! ```text
//! curve_slowdown = ∫ max(f − 1, 0) ds,   f = √(|κ| / max(κ₀, c·|κ_ref|))      (m)
//! ```
//!
//! Curves of the reference line itself (κ_ref) are free of cost: every path on the road slows down for them, and a chain
//! that ends before a curve must not be cheaper for it. The factor c ([`FOLLOWING`]) covers edges that follow a curve of the
//! road, whose curvature is slightly larger.
//!
//! The term does not contain braking before and accelerating after the curve;
//! `planner.lattice.weights.curve_slowdown` is above 1 for that reason.
//!
//! The curvatures are cached with the edge; κ₀ changes from cycle to cycle. At standstill κ₀ is infinite and the term is
//! zero.
//!
//! Weak: an edge far ahead is evaluated at the present speed as well, although the vehicle may be slower or faster there.
//! The steering rate, which also limits the speed, is left to the speed search.

/// Number of samples of an edge, at equal distances. The first is one spacing after its start, whose curvature is given.
pub(super) const SAMPLES: usize = 6;

/// Ratio of the curvatures of edge and reference line up to which the edge follows the line.
const FOLLOWING: f64 = 1.3;

/// Curvatures of an edge and of the reference line beside it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct CurvatureSamples {
    /// |κ| of the edge and of the reference line, 1/m.
    samples: [(f64, f64); SAMPLES],
    /// Largest |κ| of the edge at a sample, 1/m.
    max: f64,
}

impl CurvatureSamples {
    /// From the curvatures of the edge and of the reference line at each sample, 1/m.
    pub(super) fn new(curvatures: [(f64, f64); SAMPLES]) -> Self {
        let samples = curvatures.map(|(edge, line)| (edge.abs(), line.abs()));
        Self { samples, max: samples.iter().fold(0.0, |most, (edge, _)| edge.max(most)) }
    }

    /// Distance lost over a length (m), m, if curvatures up to `full_speed` (1/m) can be driven at the present speed.
    pub(super) fn curve_slowdown(&self, length: f64, full_speed: f64) -> f64 {
        if self.max <= full_speed {
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

    /// Time for a circular arc at the speed v = √(a r) that a lateral acceleration permits, s.
    fn time(length: f64, curvature: f64, speed: f64, lateral: f64) -> f64 {
        length / speed.min((lateral / curvature.abs()).sqrt())
    }

    #[test]
    fn the_cost_of_an_arc_is_the_lost_time_times_the_speed() {
        let (length, lateral) = (17.0, 2.25);
        for speed in [2.0, 8.0, 14.0, 30.0] {
            for curvature in [0.0, 0.003, -0.02, 0.1, -0.2] {
                let curvatures = CurvatureSamples::new([(curvature, 0.0); SAMPLES]);
                let lost = speed * (time(length, curvature, speed, lateral) - length / speed);
                let curve_slowdown = curvatures.curve_slowdown(length, lateral / (speed * speed));
                assert!((curve_slowdown - lost).abs() < 1e-12 * length.max(lost), "{curve_slowdown} {lost}");
            }
        }
    }

    #[test]
    fn standstill_and_curves_of_the_road_have_no_cost() {
        let sharp = CurvatureSamples::new([(0.2, 0.0); SAMPLES]);
        assert_eq!(sharp.curve_slowdown(10.0, f64::INFINITY), 0.0);
        for (edge, line) in [(0.1, 0.1), (-0.1, -0.1), (0.1, 0.08), (0.05, 0.1)] {
            assert_eq!(CurvatureSamples::new([(edge, line); SAMPLES]).curve_slowdown(10.0, 0.01), 0.0);
        }
        let [on_bend, on_straight] =
            [0.05, 0.0].map(|line| CurvatureSamples::new([(0.1, line); SAMPLES]).curve_slowdown(10.0, 0.01));
        assert!(0.0 < on_bend && on_bend < on_straight, "{on_bend} {on_straight}");
    }

    #[test]
    fn the_cost_is_continuous_and_increasing_in_speed() {
        let curvatures =
            CurvatureSamples::new([(0.01, 0.0), (0.07, 0.0), (0.04, 0.01), (0.0, 0.0), (-0.07, 0.0), (0.0, 0.0)]);
        let at = |speed: f64| curvatures.curve_slowdown(17.0, 2.25 / (speed * speed));
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

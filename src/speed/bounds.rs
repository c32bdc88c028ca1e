//! Upper bounds on speed along a path: from curvature, steering rate, rules and a planned stop, combined by minimum.

use crate::geometry::spiral::PathPoint;

/// What bounds the speed by comfort and by the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedLimits {
    /// Lateral acceleration, m/s²: v ≤ √(a/|κ|).
    pub lateral_acceleration: f64,
    /// Steering rate, rad/s, of a vehicle with `wheelbase`.
    pub steering_rate: f64,
    /// Wheelbase, m.
    pub wheelbase: f64,
    /// Top speed, m/s.
    pub top_speed: f64,
}

/// Least speed that any bound may ask for while moving, m/s: below it curvature limits mean nothing.
const CRAWL: f64 = 0.5;

impl SpeedLimits {
    /// The highest speed at a point of a path, m/s.
    ///
    /// Steering: δ = atan(Lκ), so δ̇ = L κ′ v / (1 + L²κ²) ≤ δ̇_max bounds v as well.
    #[must_use]
    pub fn at(&self, point: &PathPoint) -> f64 {
        self.at_curvature(point.curvature, point.curvature_rate)
    }

    /// [`Self::at`] a point of which only the curvature (1/m) and its derivative by arc length (1/m²) are known.
    #[must_use]
    pub fn at_curvature(&self, curvature: f64, curvature_rate: f64) -> f64 {
        let lateral = (self.lateral_acceleration / curvature.abs().max(1e-9)).sqrt();
        let lk = self.wheelbase * curvature;
        let steering = self.steering_rate * (1.0 + lk * lk) / (self.wheelbase * curvature_rate.abs()).max(1e-9);
        lateral.min(steering).max(CRAWL).min(self.top_speed)
    }
}

/// Highest speed at each node for a comfortable stop at the last one: v² = 2 d (s_n − s).
#[must_use]
pub fn braking_speed_limits(stations: &[f64], deceleration: f64) -> Vec<f64> {
    let end = stations.last().copied().unwrap_or(0.0);
    stations.iter().map(|s| (2.0 * deceleration * (end - s)).max(0.0).sqrt()).collect()
}

/// Time until the gap to a vehicle ahead is used up at present speeds, s: TTC = s/(v − v_lead), only when closing. (The
/// lecture prints its inverse.)
#[must_use]
pub fn time_to_collision(gap: f64, speed: f64, lead_speed: f64) -> Option<f64> {
    let closing = speed - lead_speed;
    (closing > 0.0).then(|| gap.max(0.0) / closing)
}

/// Highest speed at each node for being down to `lead_speed` (m/s) where the gap to a vehicle ahead is used up, at station
/// `meets`: v² = v_lead² + 2 d (s_meets − s), and v_lead from there on.
#[must_use]
pub fn following_speed_limits(stations: &[f64], meets: f64, lead_speed: f64, deceleration: f64) -> Vec<f64> {
    let cap = |s: &f64| (lead_speed * lead_speed + 2.0 * deceleration * (meets - s).max(0.0)).sqrt();
    stations.iter().map(cap).collect()
}

/// Combines bounds node by node: the least of all. As long as the shortest list.
#[must_use]
pub fn pointwise_minimum(bounds: &[&[f64]]) -> Vec<f64> {
    let nodes = bounds.iter().map(|b| b.len()).min().unwrap_or(0);
    (0..nodes).map(|i| bounds.iter().map(|b| b[i]).fold(f64::INFINITY, f64::min)).collect()
}

/// Lowers the nodes' speed_limits so that each next one can be reached with `deceleration`: the comfortable approach to every
/// slower part.
pub fn make_reachable(stations: &[f64], speed_limits: &mut [f64], deceleration: f64) {
    for i in (0..speed_limits.len().saturating_sub(1)).rev() {
        let ds = stations[i + 1] - stations[i];
        let reachable = (speed_limits[i + 1] * speed_limits[i + 1] + 2.0 * deceleration * ds).sqrt();
        speed_limits[i] = speed_limits[i].min(reachable);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;

    const LIMITS: SpeedLimits =
        SpeedLimits { lateral_acceleration: 3.0, steering_rate: 0.4, wheelbase: 2.5, top_speed: 50.0 };

    fn point(curvature: f64, curvature_rate: f64) -> PathPoint {
        PathPoint { pose: Pose::new(0.0, 0.0, 0.0), curvature, curvature_rate }
    }

    #[test]
    fn a_bend_is_taken_at_the_lateral_limit_on_either_side() {
        assert!((LIMITS.at(&point(0.03, 0.0)) - 10.0).abs() < 1e-9);
        assert_eq!(LIMITS.at(&point(0.03, 0.0)), LIMITS.at(&point(-0.03, 0.0)));
        assert_eq!(LIMITS.at(&point(0.0, 0.0)), 50.0);
    }

    #[test]
    fn fast_changing_curvature_is_limited_by_the_steering_rate() {
        assert!((LIMITS.at(&point(0.0, 0.02)) - 8.0).abs() < 1e-9);
    }

    #[test]
    fn time_to_collision_is_gap_over_closing_speed_and_only_when_closing() {
        assert_eq!(time_to_collision(20.0, 15.0, 10.0), Some(4.0));
        assert_eq!(time_to_collision(20.0, 10.0, 10.0), None);
        assert_eq!(time_to_collision(20.0, 8.0, 10.0), None);
        assert_eq!(time_to_collision(-1.0, 15.0, 10.0), Some(0.0));
    }

    #[test]
    fn following_ends_at_the_leads_speed_and_the_least_bound_wins() {
        let stations: Vec<f64> = (0..=10).map(f64::from).collect();
        let following = following_speed_limits(&stations, 8.0, 3.0, 2.0);
        assert_eq!((following[8], following[10]), (3.0, 3.0));
        assert!((following[0] - 41.0_f64.sqrt()).abs() < 1e-12);
        let rule = vec![5.0; 11];
        let both = pointwise_minimum(&[&following, &rule]);
        assert_eq!((both[0], both[9]), (5.0, 3.0));
        assert!(pointwise_minimum(&[]).is_empty());
    }

    #[test]
    fn caps_can_be_followed_with_the_deceleration_they_were_made_for() {
        let stations: Vec<f64> = (0..=40).map(|i| 0.5 * f64::from(i)).collect();
        let mut speed_limits = vec![12.0; 41];
        speed_limits[30] = 3.0;
        make_reachable(&stations, &mut speed_limits, 1.5);
        for w in speed_limits.windows(2) {
            assert!(w[0] * w[0] - w[1] * w[1] <= 2.0 * 1.5 * 0.5 + 1e-9, "{w:?}");
        }
        assert_eq!(speed_limits[30], 3.0);
        assert_eq!(*braking_speed_limits(&stations, 1.5).last().unwrap(), 0.0);
    }
}

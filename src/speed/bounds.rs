//! Speed limits along a path in closed form: from curvature, steering rate, a planned stop and a vehicle ahead.
//!
//! Each function returns one limit; the pointwise minimum combines them. [`make_reachable`] then lowers the limits so
//! that a comfortable deceleration can follow them (the backward pass of a forward–backward speed planner).

use crate::geometry::spiral::PathPoint;

/// Limits of comfort and vehicle that bound the speed in a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedLimits {
    /// Maximum lateral acceleration, m/s²: v ≤ √(a/|κ|).
    pub lateral_acceleration: f64,
    /// Maximum steering rate, rad/s.
    pub steering_rate: f64,
    /// Wheelbase, m.
    pub wheelbase: f64,
    /// Top speed, m/s.
    pub top_speed: f64,
}

/// Lower bound of every limit, m/s: a vehicle can creep through any curve that it can steer.
const MIN_LIMIT: f64 = 0.5;

impl SpeedLimits {
    /// Speed limit at a point of a path, m/s: the least of the limits by lateral acceleration, steering rate and top
    /// speed.
    ///
    /// With wheelbase `L` the steering angle is δ = atan(Lκ), so δ̇ = L κ′ v / (1 + L²κ²) ≤ δ̇_max bounds v.
    #[must_use]
    pub fn at(&self, point: &PathPoint) -> f64 {
        self.at_curvature(point.curvature, point.curvature_rate)
    }

    /// [`Self::at`] for a curvature (1/m) and its derivative with respect to arc length (1/m²).
    #[must_use]
    pub fn at_curvature(&self, curvature: f64, curvature_rate: f64) -> f64 {
        let lateral = (self.lateral_acceleration / curvature.abs().max(1e-9)).sqrt();
        let lk = self.wheelbase * curvature;
        let steering = self.steering_rate * (1.0 + lk * lk) / (self.wheelbase * curvature_rate.abs()).max(1e-9);
        lateral.min(steering).max(MIN_LIMIT).min(self.top_speed)
    }
}

/// Speed limit (m/s) at each station (m) for a stop at the last one with `deceleration` (m/s²): v² = 2 d (s_n − s).
#[must_use]
pub fn braking_speed_limits(stations: &[f64], deceleration: f64) -> Vec<f64> {
    let end = stations.last().copied().unwrap_or(0.0);
    stations.iter().map(|s| (2.0 * deceleration * (end - s)).max(0.0).sqrt()).collect()
}

/// Time to collision with a lead vehicle at `gap` (m) at constant speeds (m/s), s: TTC = s/(v − v_lead). `None` unless
/// the gap closes. (The planning lecture prints the inverse.)
#[must_use]
pub fn time_to_collision(gap: f64, speed: f64, lead_speed: f64) -> Option<f64> {
    let closing = speed - lead_speed;
    (closing > 0.0).then(|| gap.max(0.0) / closing)
}

/// Speed limit (m/s) at each station (m) for slowing to `lead_speed` (m/s) at `catch_up_station` (m), where the gap to
/// the lead vehicle closes: v² = v_lead² + 2 d (s_c − s) before that station, v_lead from there on.
#[must_use]
pub fn following_speed_limits(stations: &[f64], catch_up_station: f64, lead_speed: f64, deceleration: f64) -> Vec<f64> {
    let limit = |s: &f64| (lead_speed * lead_speed + 2.0 * deceleration * (catch_up_station - s).max(0.0)).sqrt();
    stations.iter().map(limit).collect()
}

/// Minimum of several lists of limits at each index; as long as the shortest list.
#[must_use]
pub fn pointwise_minimum(bounds: &[&[f64]]) -> Vec<f64> {
    let nodes = bounds.iter().map(|b| b.len()).min().unwrap_or(0);
    (0..nodes).map(|i| bounds.iter().map(|b| b[i]).fold(f64::INFINITY, f64::min)).collect()
}

/// Lowers the limits (m/s) in place so that a vehicle that brakes with `deceleration` (m/s²) can follow them.
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
    fn lateral_acceleration_limits_left_and_right_curves_equally() {
        assert!((LIMITS.at(&point(0.03, 0.0)) - 10.0).abs() < 1e-9);
        assert_eq!(LIMITS.at(&point(0.03, 0.0)), LIMITS.at(&point(-0.03, 0.0)));
        assert_eq!(LIMITS.at(&point(0.0, 0.0)), 50.0);
    }

    #[test]
    fn steering_rate_limits_the_speed_where_curvature_changes() {
        assert!((LIMITS.at(&point(0.0, 0.02)) - 8.0).abs() < 1e-9);
    }

    #[test]
    fn time_to_collision_exists_only_when_the_gap_closes() {
        assert_eq!(time_to_collision(20.0, 15.0, 10.0), Some(4.0));
        assert_eq!(time_to_collision(20.0, 10.0, 10.0), None);
        assert_eq!(time_to_collision(20.0, 8.0, 10.0), None);
        assert_eq!(time_to_collision(-1.0, 15.0, 10.0), Some(0.0));
    }

    #[test]
    fn following_ends_at_the_lead_speed_and_the_minimum_combines_limits() {
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
    fn reachable_limits_need_no_more_than_the_deceleration() {
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

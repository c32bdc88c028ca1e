//! Stations of the reference line beside the stations of a path.
//!
//! Goals, rules and zones without stopping are given on the reference line, plans drive along paths: a path on the inner side
//! of a curve is shorter than the line, by the offset times the angle. The path is projected onto the line at regular stations,
//! with linear interpolation between them.

use crate::reference::ReferenceLine;
use crate::trajectory::Path;

/// Distance between projected points of the path, m. Between them, the offset changes by centimetres.
const SPACING: f64 = 2.0;

/// A path beside a reference line.
pub(super) struct Along {
    /// Stations of the path and of the reference line, both increasing, m.
    pairs: Vec<(f64, f64)>,
}

impl Along {
    /// A path that begins near a station of the reference line (m).
    pub(super) fn new(path: &Path, reference: &ReferenceLine, begins: f64) -> Self {
        let (mut beside, mut from) = (begins, 0.0);
        let pair = |(station, point): (f64, crate::geometry::spiral::PathPoint)| {
            let foot = reference.project_near(point.pose.position, beside + station - from).s;
            (beside, from) = (foot.max(beside), station);
            (station, beside)
        };
        let pairs = path.sampled(SPACING).into_iter().map(pair).collect();
        Self { pairs }
    }

    /// The station of the reference line beside a station of the path, m.
    pub(super) fn reference_at(&self, station: f64) -> f64 {
        interpolated(&self.pairs, |p| p.0, |p| p.1, station)
    }

    /// The station of the path beside a station of the reference line, m; beyond the ends of the path, as far as the line goes.
    pub(super) fn station_of(&self, reference: f64) -> f64 {
        interpolated(&self.pairs, |p| p.1, |p| p.0, reference)
    }
}

type Side = fn(&(f64, f64)) -> f64;

/// `to` where `from` is `x`; beyond the ends with slope 1.
fn interpolated(pairs: &[(f64, f64)], from: Side, to: Side, x: f64) -> f64 {
    let after = pairs.partition_point(|p| from(p) < x);
    match (after.checked_sub(1).map(|i| &pairs[i]), pairs.get(after)) {
        (Some(a), Some(b)) => to(a) + (to(b) - to(a)) * (x - from(a)) / (from(b) - from(a)),
        (Some(end), None) | (None, Some(end)) => to(end) + x - from(end),
        (None, None) => x,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{lanelet, line, network};
    use crate::geometry::spiral::CubicSpiral;
    use crate::reference::ReferenceSettings;

    /// Around a quarter circle of 20 m, a path 4 m inside of it is shorter by 4 m · π/2.
    #[test]
    fn the_inner_side_of_a_curve_is_shorter_by_offset_times_angle() {
        const RADIUS: f64 = 20.0;
        let arc = |radius: f64| {
            let point = |i: i32| {
                let angle = f64::from(i) / 100.0 * 2.2;
                (radius * angle.sin(), RADIUS - radius * angle.cos())
            };
            line(&(0..=100).map(point).collect::<Vec<_>>())
        };
        let road = network([lanelet(1, arc(RADIUS + 5.0), arc(RADIUS - 5.0))]);
        let reference = ReferenceLine::new(&road, &[1], 1.8, &ReferenceSettings::default()).unwrap();
        let start = reference.offset_pose(5.0, 4.0).unwrap();
        let inner = CubicSpiral { knots: [start.curvature; 4], length: 20.0 };
        let path = Path::new(start.pose, &[inner]).unwrap();
        let along = Along::new(&path, &reference, 5.0);
        let ratio = start.curvature * (RADIUS - 4.0);
        assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
        for station in [0.0, 3.3, 10.0, 20.0] {
            let beside = along.reference_at(station);
            let exact = reference.project(path.at(station).pose.position).s;
            assert!((beside - exact).abs() < 0.01, "{station}: {beside} for {exact}");
            assert!((along.station_of(beside) - station).abs() < 1e-9);
        }
        assert!((along.reference_at(20.0) - 5.0 - 25.0).abs() < 0.5, "{}", along.reference_at(20.0));
        assert!((along.reference_at(23.0) - along.reference_at(20.0) - 3.0).abs() < 1e-12);
        assert!((along.station_of(1.0) + 4.0).abs() < 1e-12);
    }
}

//! A line that leads through a place beside it.
//!
//! The knots are displaced sideways by a smooth bump: the offset of the place, and around it the slope of its heading, fade with the
//! quintic 10u³ − 15u⁴ + 6u⁵, whose first two derivatives are 0 at both ends. The displaced knots are interpolated as those of any line.
//!
//! Weak: the bump knows no obstacles, and a second place needs a second bump. A path along the line need not have a node at the place:
//! its offset is met, its heading only approached.

use super::spline::Spline;
use super::{Knot, ReferenceLine, Section};

/// A place that a line is to lead through.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Via {
    /// Its station, m.
    pub station: f64,
    /// Its offset, m.
    pub offset: f64,
    /// Its heading relative to the line, rad.
    pub heading: f64,
    /// Length before and behind it with its offset, m.
    pub holds: f64,
    /// Length over which the displacement fades beyond that, m.
    pub fades: f64,
}

impl Via {
    /// The displacement of the line at a station (m), m.
    fn displacement(&self, station: f64) -> f64 {
        let x = station - self.station;
        let u = ((x.abs() - self.holds) / self.fades).clamp(0.0, 1.0);
        let fading = 1.0 - u * u * u * (10.0 + u * (6.0 * u - 15.0));
        let reach = 0.25 * self.fades;
        fading * (self.offset + self.heading.tan() * reach * (x / reach).tanh())
    }
}

impl ReferenceLine {
    /// The line displaced so that it leads through a place. `None` if there is no such curve.
    #[must_use]
    pub fn led_through(&self, via: &Via) -> Option<Self> {
        let displaced: Vec<f64> = self.knots.iter().map(|k| via.displacement(k.station)).collect();
        let points: Vec<_> = self
            .knots
            .iter()
            .zip(&displaced)
            .map(|(k, d)| k.point + nalgebra::vector![-k.tangent.y, k.tangent.x] * *d)
            .collect();
        let curve = Spline::through(&points)?;
        let stations: Vec<f64> = curve.stations().collect();
        let knots =
            self.knots.iter().zip(&points).zip(&stations).zip(&displaced).map(|(((old, point), station), d)| Knot {
                station: *station,
                point: *point,
                tangent: curve.frame(*station).tangent,
                max_curvature: curve.max_curvature_after(*station),
                left: old.left - d,
                right: old.right + d,
            });
        let knots: Vec<Knot> = knots.collect();
        // a section begins at the same share of the same segment
        let moved = |start: f64| {
            let i = self.knots.partition_point(|k| k.station <= start).clamp(1, self.knots.len() - 1);
            let (from, to) = (self.knots[i - 1].station, self.knots[i].station);
            stations[i - 1] + (start - from) / (to - from) * (stations[i] - stations[i - 1])
        };
        let lanelets =
            self.lanelets.iter().map(|section| Section { start: moved(section.start), ..*section }).collect();
        Some(Self { curve, knots, lanelets, ..self.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::road;
    use crate::reference::ReferenceSettings;

    fn line() -> ReferenceLine {
        ReferenceLine::new(&road(4.0, 200.0), &[1], 1.8, &ReferenceSettings::default()).unwrap()
    }

    #[test]
    fn the_line_leads_through_the_place_with_its_heading_and_is_itself_far_away() {
        let line = line();
        for (offset, heading) in [(0.8, 0.0), (-0.5, 0.08), (0.0, -0.1)] {
            let via = Via { station: 100.0, offset, heading, holds: 2.0, fades: 30.0 };
            let led = line.led_through(&via).unwrap();
            let place = led.at(led.project(nalgebra::point![100.0, offset]).s);
            assert!((place.pose.position.y - offset).abs() < 1e-3, "{via:?}: {place:?}");
            assert!((place.pose.yaw - heading).abs() < 5e-3, "{via:?}: {place:?}");
            let (left, right) = led.lane_bounds(led.project(nalgebra::point![100.0, offset]).s);
            assert!((left - (2.0 - offset)).abs() < 0.02 && (right - (2.0 + offset)).abs() < 0.02, "{left} {right}");
            for x in [10.0, 60.0, 140.0, 190.0] {
                assert!(led.project(nalgebra::point![x, 0.0]).l.abs() < 1e-3, "{via:?} at {x} m");
            }
            let sharpest = (0..400).map(|i| led.at(0.5 * f64::from(i)).curvature.abs()).fold(0.0, f64::max);
            assert!(sharpest < 0.03, "{via:?}: {sharpest}");
        }
        let none = Via { station: 100.0, offset: 0.0, heading: 0.0, holds: 2.0, fades: 30.0 };
        let same = line.led_through(&none).unwrap();
        assert!((same.length() - line.length()).abs() < 1e-9);
    }
}

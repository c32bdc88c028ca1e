//! Road friction by region: wet or icy patches.
//!
//! A patch is a polygon in the scenario's coordinates with a factor on the tyres' friction. Each wheel uses the patch
//! below it, so a vehicle may have one side on ice. Where patches overlap, the last one applies; outside of all patches
//! the road is dry. [`super::Settings::friction_scale`] is an additional factor everywhere.
//!
//! Technique: even–odd rule behind a bounding box, patch by patch, in the frame of the physics world. Limitations: the
//! cost is linear in the corners of patches near a wheel, edges of patches are sharp, and neither planner nor
//! controller knows the patches.

use rapier2d::math::Vector as RapierVector;
use serde::{Deserialize, Serialize};

use super::SimulationError;
use super::convert::Frame;
use crate::geometry::Point;

/// Typical factors on the friction of a dry road, by surface name (Wong, *Theory of Ground Vehicles*, 4th ed. 2008,
/// table 1.3: asphalt, dry 0.8–0.9, wet 0.5–0.7; ice 0.1).
pub const SURFACES: [(&str, f64); 3] = [("dry", 1.0), ("wet", 0.6), ("ice", 0.15)];
/// Largest accepted factor.
const MAX_FACTOR: f64 = 10.0;
/// Largest number of corners of a patch: validation compares all pairs of edges.
const MAX_CORNERS: usize = 1000;
/// Smallest area of a patch, m²: less than the contact patch of a tyre.
const MIN_AREA: f64 = 1e-4;
/// Largest absolute coordinate of a corner, m: beyond the range of any map projection.
const MAX_COORDINATE: f64 = 1e8;

/// A patch of road with a friction factor.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrictionRegion {
    /// Factor on the tyres' friction; in files a number or a name from [`SURFACES`].
    #[serde(deserialize_with = "number_or_surface")]
    pub factor: f64,
    /// Corners in the scenario's coordinates, m, in either orientation.
    pub polygon: Vec<[f64; 2]>,
}

/// The factor of a surface, by name.
#[must_use]
pub fn surface(name: &str) -> Option<f64> {
    SURFACES.iter().find(|(known, _)| *known == name).map(|(_, factor)| *factor)
}

fn number_or_surface<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    struct Visitor;
    impl serde::de::Visitor<'_> for Visitor {
        type Value = f64;

        fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            write!(f, "a number or one of {}", SURFACES.map(|(name, _)| format!("\"{name}\"")).join(", "))
        }

        fn visit_f64<E>(self, value: f64) -> Result<f64, E> {
            Ok(value)
        }

        #[allow(clippy::cast_precision_loss)] // beyond 2⁵³ it is out of range anyway
        fn visit_i64<E>(self, value: i64) -> Result<f64, E> {
            Ok(value as f64)
        }

        #[allow(clippy::cast_precision_loss)]
        fn visit_u64<E>(self, value: u64) -> Result<f64, E> {
            Ok(value as f64)
        }

        fn visit_str<E: serde::de::Error>(self, name: &str) -> Result<f64, E> {
            surface(name).ok_or_else(|| E::invalid_value(serde::de::Unexpected::Str(name), &self))
        }
    }
    deserializer.deserialize_any(Visitor)
}

impl FrictionRegion {
    /// Checks the region; `index` is its position in the list, for the message.
    ///
    /// # Errors
    /// A factor that is not positive or above 10, or a polygon that is not finite, has no area or crosses itself.
    pub fn validate(&self, index: usize) -> Result<(), SimulationError> {
        let wrong = |key, value, expected| Err(SimulationError::Friction { region: index, key, value, expected });
        if !(self.factor > 0.0 && self.factor <= MAX_FACTOR) {
            return wrong("factor", self.factor, "above 0, at most 10");
        }
        if self.polygon.len() < 3 {
            #[allow(clippy::cast_precision_loss)] // at most 2
            return wrong("polygon", self.polygon.len() as f64, "at least 3 corners");
        }
        match self.polygon.iter().flatten().find(|v| v.is_nan() || v.abs() > MAX_COORDINATE) {
            Some(value) => return wrong("polygon", *value, "coordinates in metres, at most 100,000 km"),
            None if self.polygon.len() > MAX_CORNERS => {
                #[allow(clippy::cast_precision_loss)] // a count of corners
                return wrong("polygon", self.polygon.len() as f64, "at most 1000 corners");
            }
            None => {}
        }
        if let Some(edge) = self.crossing() {
            #[allow(clippy::cast_precision_loss)] // at most 1000
            return wrong(
                "polygon",
                edge as f64,
                "edges that do not cross (the value is the index of the first edge that does, from 0)",
            );
        }
        match self.area() {
            area if area < MIN_AREA => {
                wrong("polygon", area, "an area of at least 1 cm² (do its corners lie on a line?)")
            }
            _ => Ok(()),
        }
    }

    /// A corner relative to the first one, which keeps the precision of large coordinates.
    fn corner(&self, i: usize) -> [f64; 2] {
        let ([x, y], [x0, y0]) = (self.polygon[i % self.polygon.len()], self.polygon[0]);
        [x - x0, y - y0]
    }

    /// Area by the shoelace formula, m². Valid if no edges cross.
    fn area(&self) -> f64 {
        0.5 * (0..self.polygon.len()).map(|i| cross(self.corner(i), self.corner(i + 1))).sum::<f64>().abs()
    }

    /// Index of the first edge that crosses a later one.
    fn crossing(&self) -> Option<usize> {
        let n = self.polygon.len();
        let edge = |i: usize| (self.corner(i), self.corner(i + 1));
        let cross_at = |i: usize, j: usize| {
            let ((a, b), (c, d)) = (edge(i), edge(j));
            let side = |p, from, to| cross(minus(to, from), minus(p, from));
            side(c, a, b) * side(d, a, b) < 0.0 && side(a, c, d) * side(b, c, d) < 0.0
        };
        (0..n).find(|&i| (i + 1..n).any(|j| cross_at(i, j)))
    }
}

fn minus(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn cross(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[1] - a[1] * b[0]
}

/// The patches in the frame of the physics world.
#[derive(Debug)]
pub(super) struct FrictionMap {
    patches: Vec<Patch>,
}

#[derive(Debug)]
struct Patch {
    factor: f64,
    corners: Vec<RapierVector>,
    low: RapierVector,
    high: RapierVector,
}

impl FrictionMap {
    /// Checks the regions and transforms them into the frame.
    pub(super) fn new(regions: &[FrictionRegion], frame: &Frame) -> Result<Self, SimulationError> {
        let patch = |(index, region): (usize, &FrictionRegion)| {
            region.validate(index)?;
            let corners: Vec<_> = region.polygon.iter().map(|[x, y]| frame.point_in(Point::new(*x, *y))).collect();
            let bound = |f: fn(RapierVector, RapierVector) -> RapierVector| corners.iter().copied().reduce(f);
            let low = bound(RapierVector::min).unwrap_or_default();
            let high = bound(RapierVector::max).unwrap_or_default();
            Ok(Patch { factor: region.factor, corners, low, high })
        };
        Ok(Self { patches: regions.iter().enumerate().map(patch).collect::<Result<_, _>>()? })
    }

    /// Friction factor at a position in the physics frame.
    pub(super) fn at(&self, position: RapierVector) -> f64 {
        self.patches.iter().rev().find(|p| p.contains(position)).map_or(1.0, |p| p.factor)
    }

    /// The largest friction factor of all patches and the dry road.
    pub(super) fn largest(&self) -> f64 {
        self.patches.iter().map(|p| p.factor).fold(1.0, f64::max)
    }
}

impl Patch {
    /// Even–odd rule: counts the edges that a ray towards +x crosses.
    fn contains(&self, p: RapierVector) -> bool {
        if p.x < self.low.x || p.y < self.low.y || p.x > self.high.x || p.y > self.high.y {
            return false;
        }
        let before = self.corners.iter().skip(self.corners.len() - 1).chain(&self.corners);
        let crossed = before
            .zip(&self.corners)
            .filter(|(a, b)| (a.y > p.y) != (b.y > p.y) && p.x < a.x + (p.y - a.y) / (b.y - a.y) * (b.x - a.x));
        crossed.count() % 2 == 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn region(factor: f64, polygon: &[[f64; 2]]) -> FrictionRegion {
        FrictionRegion { factor, polygon: polygon.to_vec() }
    }

    const SQUARE: [[f64; 2]; 4] = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];

    #[test]
    fn the_last_patch_applies_and_a_notch_is_outside() {
        let notched = [[-1.0, -1.0], [5.0, -1.0], [5.0, 5.0], [3.0, 1.0], [-1.0, 5.0]];
        for origin in [Point::origin(), Point::new(1e6, -1e6)] {
            let moved =
                |polygon: &[[f64; 2]]| polygon.iter().map(|[x, y]| [x + origin.x, y + origin.y]).collect::<Vec<_>>();
            let regions = [region(0.6, &moved(&notched)), region(0.15, &moved(&SQUARE))];
            let map = FrictionMap::new(&regions, &Frame::at(origin)).unwrap();
            for ((x, y), factor) in
                [((1.0, 1.0), 0.15), ((-0.5, 0.0), 0.6), ((3.0, 0.5), 0.6), ((3.0, 1.5), 1.0), ((6.0, 0.0), 1.0)]
            {
                assert_eq!(map.at(RapierVector::new(x, y)), factor, "{x} {y}");
            }
            assert_eq!(map.largest(), 1.0);
        }
    }

    #[test]
    fn validation_names_each_invalid_region() {
        for (wrong, key) in [
            (region(-0.5, &SQUARE), "friction[3].factor"),
            (region(0.0, &SQUARE), "friction[3].factor"),
            (region(f64::NAN, &SQUARE), "friction[3].factor"),
            (region(11.0, &SQUARE), "friction[3].factor"),
            (region(0.5, &SQUARE[..2]), "friction[3].polygon"),
            (region(0.5, &[[0.0, 0.0], [1.0, f64::NAN], [1.0, 1.0]]), "friction[3].polygon"),
            (region(0.5, &[[0.0, 0.0], [1.0, f64::INFINITY], [1.0, 1.0]]), "friction[3].polygon"),
        ] {
            let message = wrong.validate(3).expect_err(key).to_string();
            assert!(message.contains(key), "{message}");
        }
        region(0.15, &SQUARE).validate(0).unwrap();
    }

    #[test]
    fn a_factor_is_a_number_or_a_surface() {
        let read = |factor: &str| {
            toml::from_str::<FrictionRegion>(&format!("factor = {factor}\npolygon = [[0, 0], [1, 0.5], [1, 1]]"))
        };
        for (text, factor) in [("\"ice\"", 0.15), ("\"wet\"", 0.6), ("\"dry\"", 1.0), ("0.3", 0.3), ("1", 1.0)] {
            assert_eq!(read(text).unwrap().factor, factor, "{text}");
        }
        let message = read("\"mud\"").expect_err("an unknown surface").to_string();
        assert!(message.contains("mud") && message.contains("\"ice\""), "{message}");
        assert!(read("true").is_err() && toml::from_str::<FrictionRegion>("factor = 1.0").is_err());
    }
}

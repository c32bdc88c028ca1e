//! Shapes that Rerun's 2D views lack: filled shapes and dashed lines, composed of line strips and an image.

use super::style::{self, Rgb};
use crate::geometry::Point;
use crate::geometry::Pose;
use crate::geometry::polyline::Polyline;
use crate::map::RoadNetwork;
use crate::plot::outline::Bounds;
use crate::vehicle::Vehicle;

/// Half the distance between two strokes of a hatch, m; also their drawing radius.
pub(super) const HATCH_RADIUS: f64 = 0.15;
/// Maximum number of strokes per hatch: large buildings are partly hollow, since full ones would dominate the file
/// size.
const MAX_STROKES: f64 = 400.0;

/// Strokes that cover a polygon (even–odd rule) when drawn with [`HATCH_RADIUS`]. They are parallel to its longest side
/// and end where their round caps touch the border. Empty for polygons thinner than a stroke.
pub(super) fn hatch(polygon: &[Point]) -> Vec<[Point; 2]> {
    let sides = (0..polygon.len()).map(|i| polygon[(i + 1) % polygon.len()] - polygon[i]);
    let Some(longest) = sides.max_by(|a, b| a.norm().total_cmp(&b.norm())).filter(|s| s.norm() > 0.0) else {
        return Vec::new();
    };
    let frame = Pose { position: polygon[0], yaw: longest.y.atan2(longest.x) };
    let local: Vec<Point> = polygon.iter().map(|p| frame.to_local(*p)).collect();
    let Some(bounds) = Bounds::around(&local) else { return Vec::new() };
    let span = bounds.height() - 2.0 * HATCH_RADIUS;
    if span < 0.0 {
        return Vec::new();
    }
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a positive count, bounded
    let gaps = (span / (2.0 * HATCH_RADIUS)).ceil().min(MAX_STROKES) as usize;
    (0..=gaps)
        .map(|i| bounds.min.y + HATCH_RADIUS + span * i as f64 / gaps.max(1) as f64)
        .flat_map(|y| crossings(&local, y).chunks_exact(2).map(|ends| (y, ends[0], ends[1])).collect::<Vec<_>>())
        .filter(|(_, left, right)| right - left > 2.0 * HATCH_RADIUS)
        .map(|(y, left, right)| [left + HATCH_RADIUS, right - HATCH_RADIUS].map(|x| frame.to_world(Point::new(x, y))))
        .collect()
}

/// x coordinates at which a polygon's sides cross the horizontal line at `y`, ascending.
fn crossings(polygon: &[Point], y: f64) -> Vec<f64> {
    let mut crossings: Vec<f64> = (0..polygon.len())
        .map(|i| (polygon[i], polygon[(i + 1) % polygon.len()]))
        .filter(|(a, b)| (a.y > y) != (b.y > y))
        .map(|(a, b)| a.x + (y - a.y) / (b.y - a.y) * (b.x - a.x))
        .collect();
    crossings.sort_by(f64::total_cmp);
    crossings
}

/// The dashes of a line; lengths of dash and gap in m.
pub(super) fn dashes(line: &Polyline, dash: f64, gap: f64) -> Vec<Vec<Point>> {
    let mut pieces = Vec::new();
    let mut from = 0.0;
    while from < line.length() {
        pieces.extend(line.slice(from, from + dash).map(|piece| piece.points().to_vec()));
        from += dash + gap;
    }
    pieces
}

/// An arrow head over the bonnet that marks the front, in the rear-axle frame.
pub(super) fn arrow_head(vehicle: &Vehicle) -> [Point; 3] {
    let front = vehicle.front_overhang_from_rear_axle();
    let (back, half) = (front - 0.28 * vehicle.length, 0.32 * vehicle.width);
    [Point::new(back, half), Point::new(front - 0.08 * vehicle.length, 0.0), Point::new(back, -half)]
}

/// The road surface as an image.
pub(super) struct Surface {
    /// RGB pixels; the first row has the lowest y.
    pub(super) rgb: Vec<u8>,
    /// Width and height, px.
    pub(super) size: [u32; 2],
    /// World position of the image's lower left corner.
    pub(super) corner: Point,
    /// Size of a pixel, m.
    pub(super) pixel: f64,
}

/// Maximum number of pixels of a surface, and the smallest useful pixel size, m.
const MAX_PIXELS: f64 = 1.5e6;
const MIN_PIXEL_SIZE: f64 = 0.1;

impl Surface {
    /// Paints the lanelets that intersect `bounds`.
    pub(super) fn paint(network: &RoadNetwork, bounds: &Bounds) -> Self {
        let pixel = (bounds.width() * bounds.height() / MAX_PIXELS).sqrt().max(MIN_PIXEL_SIZE);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // bounded by the pixel size
        let size = [bounds.width(), bounds.height()].map(|length| (length / pixel).ceil().clamp(1.0, 1e5) as u32);
        let (r, g, b) = style::GROUND;
        let rgb = [r, g, b].repeat(size[0] as usize * size[1] as usize);
        let mut surface = Self { rgb, size, corner: bounds.min, pixel };
        // roads last: a lane covers a crosswalk
        for drivable in [false, true] {
            for lanelet in network.lanelets.values().filter(|l| l.is_drivable() == drivable) {
                let outline = lanelet.outline();
                if bounds.shows(&outline) {
                    surface.fill(&outline, if drivable { style::ROAD } else { style::NON_DRIVABLE });
                }
            }
        }
        surface
    }

    /// The parts of a line on the outer edge of the road, without those inside it, as where lanes of a junction
    /// overlap. Everything outside the image counts as edge.
    pub(super) fn rim(&self, line: &Polyline) -> Vec<Vec<Point>> {
        const STEP: f64 = 0.5;
        let mut parts: Vec<Vec<Point>> = Vec::new();
        let mut joined = false;
        for ends in line.resampled(STEP).windows(2) {
            let offset = (ends[1] - ends[0]).normalize() * (2.0 * self.pixel).max(0.3);
            let middle = nalgebra::center(&ends[0], &ends[1]);
            let left = Point::new(middle.x - offset.y, middle.y + offset.x);
            let right = Point::new(middle.x + offset.y, middle.y - offset.x);
            let on_rim = !(self.is_road(left) && self.is_road(right));
            match parts.last_mut() {
                Some(part) if on_rim && joined => part.push(ends[1]),
                _ if on_rim => parts.push(ends.to_vec()),
                _ => {}
            }
            joined = on_rim;
        }
        parts
    }

    /// Whether the pixel at a point is road.
    fn is_road(&self, p: Point) -> bool {
        let place = (p - self.corner) / self.pixel;
        let inside = |c: f64, size: u32| (0.0..f64::from(size)).contains(&c);
        if !(inside(place.x, self.size[0]) && inside(place.y, self.size[1])) {
            return false;
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // inside the image
        let pixel = place.y as usize * self.size[0] as usize + place.x as usize;
        let (r, g, b) = style::ROAD;
        self.rgb.get(3 * pixel..3 * pixel + 3) == Some(&[r, g, b])
    }

    /// Fills a polygon (even–odd rule at the pixel centres).
    fn fill(&mut self, polygon: &[Point], (r, g, b): Rgb) {
        let local: Vec<Point> = polygon.iter().map(|p| Point::from((p - self.corner) / self.pixel)).collect();
        let Some(bounds) = Bounds::around(&local) else { return };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped to the image
        let column = |x: f64, last: u32| (x - 0.5).ceil().clamp(0.0, f64::from(last)) as usize;
        let width = self.size[0] as usize;
        for row in column(bounds.min.y, self.size[1])..column(bounds.max.y, self.size[1]) {
            for pair in crossings(&local, row as f64 + 0.5).chunks_exact(2) {
                let (from, to) = (column(pair[0], self.size[0]), column(pair[1], self.size[0]));
                for pixel in self.rgb[3 * (row * width + from)..3 * (row * width + to.max(from))].chunks_exact_mut(3) {
                    pixel.copy_from_slice(&[r, g, b]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plot::example::Example;
    use crate::plot::outline::footprint;

    /// Distance from a point to a stroke.
    fn distance(p: Point, [a, b]: &[Point; 2]) -> f64 {
        let ratio = ((p - a).dot(&(b - a)) / (b - a).norm_squared()).clamp(0.0, 1.0);
        (p - (a + (b - a) * ratio)).norm()
    }

    #[test]
    fn the_hatch_covers_a_turned_rectangle_and_stays_in_it() {
        let example = Example::new();
        let frame = Pose::new(3.0, -2.0, 0.7);
        let polygon = footprint(&example.vehicle, &frame).concat();
        let strokes = hatch(&polygon);
        for i in 0..=40 {
            for j in 0..=20 {
                // slightly inside, where the round caps of the strokes reach
                let (u, v) = (0.02 + 0.96 * f64::from(i) / 40.0, 0.04 + 0.92 * f64::from(j) / 20.0);
                let p = polygon[0] + (polygon[1] - polygon[0]) * u + (polygon[3] - polygon[0]) * v;
                let nearest = strokes.iter().map(|s| distance(p, s)).fold(f64::INFINITY, f64::min);
                assert!(nearest < HATCH_RADIUS + 0.02, "{p} is {nearest} m off");
            }
        }
        let corner = frame.to_local(polygon[2]);
        let stays = |p: &Point| {
            let local = frame.to_local(*p);
            local.x <= corner.x - HATCH_RADIUS + 1e-9 && local.y.abs() <= corner.y - HATCH_RADIUS + 1e-9
        };
        assert!(strokes.iter().flatten().all(stays));
    }

    #[test]
    fn the_hatch_leaves_the_notch_of_a_concave_polygon_empty() {
        let u = [(0.0, 0.0), (6.0, 0.0), (6.0, 4.0), (4.0, 4.0), (4.0, 1.0), (2.0, 1.0), (2.0, 4.0), (0.0, 4.0)];
        let polygon = u.map(|(x, y)| Point::new(x, y));
        let strokes = hatch(&polygon);
        let covered = |x: f64, y: f64| strokes.iter().any(|s| distance(Point::new(x, y), s) <= HATCH_RADIUS);
        assert!(covered(1.0, 3.0) && covered(5.0, 3.0) && covered(3.0, 0.5));
        assert!(!covered(3.0, 3.0));
    }

    #[test]
    fn thin_and_degenerate_polygons_have_no_hatch() {
        assert!(hatch(&[]).is_empty());
        assert!(hatch(&[Point::origin(); 3]).is_empty());
        let thin = [(0.0, 0.0), (5.0, 0.0), (5.0, 0.1), (0.0, 0.1)].map(|(x, y)| Point::new(x, y));
        assert!(hatch(&thin).is_empty());
    }

    #[test]
    fn dashes_have_their_length_and_leave_gaps() {
        let line = Polyline::new([Point::origin(), Point::new(10.0, 0.0)]).unwrap();
        let pieces = dashes(&line, 3.0, 4.0);
        let ends: Vec<(f64, f64)> = pieces.iter().map(|d| (d[0].x, d[d.len() - 1].x)).collect();
        assert_eq!(ends, [(0.0, 3.0), (7.0, 10.0)]);
    }

    #[test]
    fn the_surface_is_painted_on_lanes_only() {
        let example = Example::new();
        let network = &example.scenario.network;
        let lane = &network.lanelets[&1];
        let bounds = Bounds::around(&lane.outline()).unwrap().expanded(5.0);
        let surface = Surface::paint(network, &bounds);
        let width = surface.size[0] as usize;
        for row in (0..surface.size[1] as usize).step_by(3) {
            for column in (0..width).step_by(17) {
                let middle = nalgebra::Vector2::new(column as f64 + 0.5, row as f64 + 0.5);
                let p = surface.corner + middle * surface.pixel;
                let place = 3 * (row * width + column);
                let on_road = network.lanelets.values().any(|l| l.is_drivable() && l.contains(p));
                assert_eq!(surface.rgb[place] == style::ROAD.0, on_road, "at {p}");
            }
        }
    }

    #[test]
    fn lines_inside_the_road_are_not_its_edge() {
        let example = Example::new();
        let network = &example.scenario.network;
        let bounds = Bounds::around(&network.lanelets[&1].outline()).unwrap().expanded(5.0);
        let surface = Surface::paint(network, &bounds);
        let across = |x: f64, from: f64, to: f64| {
            let start = network.lanelets[&1].right.first();
            Polyline::new([from, to].map(|y| Point::new(start.x + x, start.y + y))).unwrap()
        };
        let length = |parts: &[Vec<Point>]| -> f64 {
            parts.iter().flat_map(|p| p.windows(2)).map(|w| (w[1] - w[0]).norm()).sum()
        };
        assert!(surface.rim(&across(50.0, 1.0, 6.0)).is_empty(), "the whole line is on the road");
        let half = length(&surface.rim(&across(50.0, 5.0, 9.0)));
        assert!((half - 2.0).abs() < 0.6, "2 m of the line are off the road: {half}");
        let right = &network.lanelets[&1].right;
        assert!((length(&surface.rim(right)) - right.length()).abs() < 1e-6, "the border between road and pavement");
    }
}

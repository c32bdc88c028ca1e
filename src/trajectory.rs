//! Paths, speed profiles and their composition.
//!
//! A [`Trajectory`] composes a [`Path`] (pose over station) with a [`SpeedProfile`] (station over time):
//! `q(t) = path(profile(t))`, like Drake's `PathParameterizedTrajectory`. It stores no samples.
//!
//! Poses are those of the rear-axle centre in the map frame. Stations are arc lengths along the path, m.

use crate::geometry::Pose;
use crate::geometry::spiral::{CubicSpiral, PathPoint};
use crate::geometry::steps::covering;

/// A path of the rear-axle centre: a chain of cubic spirals, each starting at the end of the previous one. Stations
/// start at 0, m.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    pieces: Vec<Piece>,
    length: f64,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Piece {
    station: f64,
    start: Pose,
    spiral: CubicSpiral,
}

impl Path {
    /// A path from a start pose through a chain of spirals. `None` for an empty chain.
    #[must_use]
    pub fn new(start: Pose, spirals: &[CubicSpiral]) -> Option<Self> {
        let mut pieces = Vec::with_capacity(spirals.len());
        let (mut pose, mut station) = (start, 0.0);
        for spiral in spirals {
            pieces.push(Piece { station, start: pose, spiral: *spiral });
            pose = spiral.point_at(&pose, spiral.length).pose;
            station += spiral.length;
        }
        (!pieces.is_empty()).then_some(Self { pieces, length: station })
    }

    /// Total length, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.length
    }

    /// Pose and curvature at a station (m), clamped to the ends of the path.
    #[must_use]
    pub fn at(&self, station: f64) -> PathPoint {
        let station = station.clamp(0.0, self.length);
        let i = self.pieces.partition_point(|p| p.station <= station).max(1) - 1;
        let piece = &self.pieces[i];
        piece.spiral.point_at(&piece.start, (station - piece.station).min(piece.spiral.length))
    }

    /// Curvature (1/m) and its derivative with respect to arc length (1/m²) at a station (m), clamped to the ends of
    /// the path. Cheaper than [`Self::at`], which integrates the heading.
    #[must_use]
    pub fn curvature_and_rate_at(&self, station: f64) -> (f64, f64) {
        let station = station.clamp(0.0, self.length);
        let i = self.pieces.partition_point(|p| p.station <= station).max(1) - 1;
        let (piece, spiral) = (&self.pieces[i], &self.pieces[i].spiral);
        spiral.curvature_and_rate((station - piece.station).min(spiral.length))
    }

    /// Equally spaced points with their stations (m), at most `spacing` (m) apart, including both ends.
    #[must_use]
    pub fn sampled(&self, spacing: f64) -> Vec<(f64, PathPoint)> {
        let steps = covering(self.length, spacing);
        (0..=steps)
            .map(|i| {
                let station = self.length * i as f64 / steps as f64;
                (station, self.at(station))
            })
            .collect()
    }

    /// The spirals between two stations (m, clamped to the path); empty if they are closer than a micrometre.
    #[must_use]
    pub fn part(&self, from: f64, to: f64) -> Vec<CubicSpiral> {
        let inside = |p: &Piece| {
            let (begins, ends) = ((from - p.station).max(0.0), (to - p.station).min(p.spiral.length));
            (ends - begins > SHORTEST).then(|| p.spiral.part(begins, ends))
        };
        self.pieces.iter().filter_map(inside).collect()
    }

    /// The spirals with their start stations (m) and start poses.
    pub fn pieces(&self) -> impl Iterator<Item = (f64, &Pose, &CubicSpiral)> {
        self.pieces.iter().map(|p| (p.station, &p.start, &p.spiral))
    }
}

/// Station, speed and acceleration over time, with constant jerk between knots. A complete plan ends at standstill.
#[derive(Debug, Clone, PartialEq)]
pub struct SpeedProfile {
    knots: Vec<SpeedKnot>,
}

/// A knot of a [`SpeedProfile`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedKnot {
    /// Time since the start of the profile, s.
    pub time: f64,
    /// Station on the path, m.
    pub station: f64,
    /// Speed, m/s; non-negative.
    pub speed: f64,
    /// Acceleration immediately after the knot, m/s².
    pub acceleration: f64,
    /// Jerk from this knot to the next, m/s³.
    pub jerk: f64,
}

impl SpeedKnot {
    /// The state after a time `t` (s) with the jerk of this knot. The speed is clamped at 0.
    #[must_use]
    pub fn after(&self, t: f64) -> Self {
        Self {
            time: self.time + t,
            station: self.station + t * (self.speed + t * (self.acceleration / 2.0 + t * self.jerk / 6.0)),
            speed: (self.speed + t * (self.acceleration + t * self.jerk / 2.0)).max(0.0),
            acceleration: self.acceleration + t * self.jerk,
            jerk: self.jerk,
        }
    }
}

impl SpeedProfile {
    /// A profile from its knots. `None` unless there is at least one knot and the times increase.
    #[must_use]
    pub fn new(knots: Vec<SpeedKnot>) -> Option<Self> {
        let ordered = knots.windows(2).all(|w| w[0].time < w[1].time);
        (!knots.is_empty() && ordered).then_some(Self { knots })
    }

    /// The knots.
    #[must_use]
    pub fn knots(&self) -> &[SpeedKnot] {
        &self.knots
    }

    /// Duration from the first to the last knot, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.knots[self.knots.len() - 1].time - self.knots[0].time
    }

    /// The last knot.
    #[must_use]
    pub fn last(&self) -> &SpeedKnot {
        &self.knots[self.knots.len() - 1]
    }

    /// State at a time (s). Before the first knot, the first knot. After the last knot, station and speed of the last
    /// knot without acceleration; the speed of a complete plan is 0.
    #[must_use]
    pub fn at(&self, time: f64) -> SpeedKnot {
        let after = self.knots.partition_point(|k| k.time <= time);
        if after == 0 {
            return self.knots[0];
        }
        let k = &self.knots[after - 1];
        if after == self.knots.len() {
            return SpeedKnot { time, acceleration: 0.0, jerk: 0.0, ..*k };
        }
        k.after(time - k.time)
    }

    /// Whether the profile ends at standstill.
    #[must_use]
    pub fn ends_at_standstill(&self) -> bool {
        self.last().speed == 0.0
    }
}

/// Shorter spirals are left out, m: far below any tracking error.
const SHORTEST: f64 = 1e-6;

/// A path with a speed profile and a start time.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// Time of the run at which the profile starts, s.
    pub start_time: f64,
    /// Pose over station.
    pub path: Path,
    /// Station over time since `start_time`.
    pub profile: SpeedProfile,
}

/// The reference state of a trajectory at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrajectoryPoint {
    /// Time of the run, s.
    pub time: f64,
    /// Pose of the rear-axle centre.
    pub pose: Pose,
    /// Curvature of the rear axle's path, 1/m.
    pub curvature: f64,
    /// Derivative of the curvature with respect to arc length, 1/m².
    pub curvature_rate: f64,
    /// Station on the path, m.
    pub station: f64,
    /// Speed, m/s.
    pub speed: f64,
    /// Acceleration along the path, m/s².
    pub acceleration: f64,
    /// Jerk along the path, m/s³.
    pub jerk: f64,
}

impl Trajectory {
    /// The reference state at a time of the run (s).
    #[must_use]
    pub fn at(&self, time: f64) -> TrajectoryPoint {
        let k = self.profile.at(time - self.start_time);
        let p = self.path.at(k.station);
        TrajectoryPoint {
            time,
            pose: p.pose,
            curvature: p.curvature,
            curvature_rate: p.curvature_rate,
            station: k.station,
            speed: k.speed,
            acceleration: k.acceleration,
            jerk: k.jerk,
        }
    }

    /// Time of the run at which the profile ends, s.
    #[must_use]
    pub fn end_time(&self) -> f64 {
        self.start_time + self.profile.last().time
    }
}

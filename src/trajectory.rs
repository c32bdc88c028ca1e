//! A trajectory: a path composed with a timing. Two objects and no third copy: `q(t) = path(profile(t))`
//! (the form of Drake's `PathParameterizedTrajectory`).

use crate::geometry::Pose;
use crate::geometry::spiral::{CubicSpiral, PathPoint};

/// A chain of spirals, each starting where the one before ends. Stations run from 0 at the first start, metres.
/// The path is the one of the rear axle.
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
    /// Chains spirals from a start pose. `None` without any spiral.
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

    /// Pose and curvature at a station; beyond the ends, clamped to them.
    #[must_use]
    pub fn at(&self, station: f64) -> PathPoint {
        let station = station.clamp(0.0, self.length);
        let i = self.pieces.partition_point(|p| p.station <= station).max(1) - 1;
        let piece = &self.pieces[i];
        piece.spiral.point_at(&piece.start, (station - piece.station).min(piece.spiral.length))
    }

    /// Curvature (1/m) and its derivative by arc length (1/m²) at a station, without the pose, which takes an integral;
    /// beyond the ends, clamped to them.
    #[must_use]
    pub fn curvature_and_rate_at(&self, station: f64) -> (f64, f64) {
        let station = station.clamp(0.0, self.length);
        let i = self.pieces.partition_point(|p| p.station <= station).max(1) - 1;
        let (piece, spiral) = (&self.pieces[i], &self.pieces[i].spiral);
        let along = (station - piece.station).min(spiral.length);
        (spiral.curvature(along), spiral.curvature_rate(along))
    }

    /// Points every `spacing` metres at most, both ends included, with their stations.
    #[must_use]
    pub fn sampled(&self, spacing: f64) -> Vec<(f64, PathPoint)> {
        let steps = (self.length / spacing).ceil().max(1.0);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a positive count of samples
        (0..=steps as usize)
            .map(|i| {
                let station = self.length * i as f64 / steps;
                (station, self.at(station))
            })
            .collect()
    }

    /// The spirals with their start poses and stations.
    pub fn pieces(&self) -> impl Iterator<Item = (f64, &Pose, &CubicSpiral)> {
        self.pieces.iter().map(|p| (p.station, &p.start, &p.spiral))
    }
}

/// Station, speed and acceleration over time; jerk is constant between knots. The last knot is the end of what is
/// planned; a complete plan ends at rest and stays there.
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
    /// Speed, m/s, never negative.
    pub speed: f64,
    /// Acceleration just after the knot, m/s².
    pub acceleration: f64,
    /// Jerk from this knot to the next, m/s³; 0 where the acceleration is constant.
    pub jerk: f64,
}

impl SpeedKnot {
    /// The state `t` seconds later, under the knot's own jerk.
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
    /// A profile from its knots, in order of time, at least one.
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

    /// Duration up to the last knot, s.
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.knots[self.knots.len() - 1].time - self.knots[0].time
    }

    /// The last knot.
    #[must_use]
    pub fn last(&self) -> &SpeedKnot {
        &self.knots[self.knots.len() - 1]
    }

    /// State at `time`. After the last knot the vehicle stays at its station with its speed (0 for a complete plan);
    /// before the first one, the first knot.
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

    /// Whether it ends at rest.
    #[must_use]
    pub fn ends_at_standstill(&self) -> bool {
        self.last().speed == 0.0
    }
}

/// A path with its timing, starting at a time of the run.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// Time of the run at which the profile starts, s.
    pub start_time: f64,
    /// Where.
    pub path: Path,
    /// When.
    pub profile: SpeedProfile,
}

/// What is wanted at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrajectoryPoint {
    /// Time of the run, s.
    pub time: f64,
    /// Rear-axle pose.
    pub pose: Pose,
    /// Curvature of the rear axle's path, 1/m.
    pub curvature: f64,
    /// Derivative of the curvature by arc length, 1/m².
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
    /// What is wanted at a time of the run.
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

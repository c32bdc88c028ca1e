//! The speed problem of a lattice path: speed limits, blocked intervals, search with SafeTLP.

use std::sync::{Arc, OnceLock};

use super::along::Along;
use super::goal::GoalOnLane;
use super::record::{BlockedCell, Cause, Rejection};
use super::settings::Settings;
use crate::collision::{BlockedGrid, Blocker, Margins, Predictions};
use crate::geometry::steps::fitting;
use crate::lattice::{CostTerms, LatticePath};
use crate::reference::ReferenceLine;
use crate::speed::bounds::{SpeedLimits, braking_speed_limits, make_reachable};
use crate::speed::{
    AccelerationLimits, NoPlan, ProofViolation, Resolution, SpeedOutcome, SpeedProblem, Strategy, TimeInterval, prove,
    search, smoothing, tail,
};
use crate::trajectory::SpeedProfile;
use crate::vehicle::{PathMotion, TrackingTube, Vehicle};

/// The data that all candidates of one lane and level share in a cycle.
#[derive(Clone, Copy)]
pub(super) struct Situation<'a> {
    pub(super) vehicle: &'a Vehicle,
    pub(super) settings: &'a Settings,
    /// Predictions of the moving obstacles that constrain proofs.
    pub(super) traffic: &'a Predictions,
    /// Margins to them, m.
    pub(super) margins: Margins,
    /// Station of the path up to which they are resolved finely, m.
    pub(super) fine_until: f64,
    pub(super) reference: &'a ReferenceLine,
    pub(super) goal: Option<GoalOnLane>,
    pub(super) goal_missed_at: Option<f64>,
    /// Station of the start on the reference line, m.
    pub(super) station: f64,
    pub(super) time: f64,
    pub(super) speed: f64,
    /// Cruise speed, m/s.
    pub(super) cruise: f64,
    /// End of the predictions, s of the run.
    pub(super) horizon: f64,
    /// Largest acceleration, m/s².
    pub(super) acceleration: f64,
    /// Deceleration of nominal braking, m/s².
    pub(super) braking: f64,
    /// Largest deceleration of proofs, m/s², on a path that turns and on a straight one.
    pub(super) proof_deceleration: f64,
    pub(super) straight_deceleration: f64,
    /// Friction of the road, as a factor on that of dry asphalt.
    pub(super) friction: f64,
    /// Fraction of it that the search uses.
    pub(super) search_share: f64,
    /// Largest planned speed, m/s.
    pub(super) top_speed: f64,
    /// Whether the remaining run is long enough to reach the end of a road that ends ahead.
    pub(super) long_run: bool,
    /// Station intervals of the reference line in which stopping is not allowed, m.
    pub(super) no_stopping: &'a [(f64, f64)],
    /// Time gap to moving obstacles, before and after them, s.
    pub(super) time_gap: f64,
    /// Upper bound of the lateral acceleration of paths, m/s².
    pub(super) lateral_limit: f64,
}

/// A candidate whose stop is proven.
pub(super) struct Proven {
    pub(super) problem: ForProof,
    /// The speed limits of the search.
    pub(super) target: TargetLimits,
    /// The planned stop: station (m) and cause.
    pub(super) stop: Option<(f64, Cause)>,
    /// The profile of the search; it ends at the first safe standstill before a long wait.
    pub(super) raw_profile: SpeedProfile,
    /// Station of the complete plan after [`TRAVEL_TIME_HORIZON`], m.
    pub(super) progress: f64,
    /// When the stop of the proof begins, s of the run: until then the plan is what the vehicle is meant to drive.
    pub(super) proof_begins: f64,
    pub(super) expansions: usize,
    /// Blocked cells of the path.
    pub(super) blocked: Vec<BlockedCell>,
}

/// The problem of the search: with a time gap to traffic, a reserve of lateral acceleration and of braking, and the wishes of rules
/// and goals. With it, the speed limit of the goal's time window, m/s.
struct ForSearch(SpeedProblem, f64);

/// The problem of the proof: the actual blocked intervals and hard limits.
pub(super) struct ForProof(pub(super) SpeedProblem);

/// The speed limits that a plan aims at.
pub(super) struct TargetLimits {
    /// Stations of the nodes, m, and of the reference line beside them.
    pub(super) stations: Vec<f64>,
    pub(super) along: Arc<Along>,
    /// Limits at the nodes, m/s.
    pub(super) speeds: Vec<f64>,
    /// The one of the goal's time window, m/s.
    for_window: f64,
}

/// What all evaluations of a path with the same margins, obstacles and start have in common.
pub(super) struct Course {
    along: Arc<Along>,
    grid: BlockedGrid,
    /// Those of the cells of the grid.
    bends: Vec<Bends>,
}

/// Curvature (1/m) and its derivative by arc length (1/m²) at the [`PLACES`] of a cell.
type Bends = [(f64, f64); PLACES.len()];

/// What search and proof of a path have in common.
struct PathCells {
    /// Stations of the nodes, m.
    stations: Vec<f64>,
    /// Blocked intervals of the cells between them, and of the pose at the first node.
    blocked: Vec<Vec<TimeInterval>>,
    blocked_at_start: Vec<TimeInterval>,
    along: Arc<Along>,
    /// Those of the cells.
    bends: Vec<Bends>,
    stop: Option<(f64, Cause)>,
    /// The blocked cells with their obstacles.
    by_obstacle: Vec<BlockedCell>,
}

impl Proven {
    /// Checks the raw profile by code that is independent of the search. A committed profile must pass.
    pub(super) fn reverify(&self) -> Result<(), ProofViolation> {
        prove(&self.problem.0, &self.raw_profile)
    }

    /// Largest deceleration of the proof, m/s².
    pub(super) fn hardest_deceleration(&self) -> f64 {
        self.problem.0.limits.aggressive_deceleration
    }
}

/// Result of the speed search of one path.
pub(super) enum Evaluation {
    Proven(Box<Proven>),
    Rejected { why: Rejection, expansions: usize, blocked_by: Option<Cause> },
}

impl Situation<'_> {
    /// Searches for a speed profile along a path.
    pub(super) fn evaluate(&self, path: &LatticePath) -> Evaluation {
        self.evaluate_on(path, &OnceLock::new())
    }

    /// [`Self::evaluate`] with what an earlier evaluation has found of the path, or the place for it.
    pub(super) fn evaluate_on(&self, path: &LatticePath, course: &OnceLock<Course>) -> Evaluation {
        if self.is_curve_speed_infeasible(path) {
            let blocked_by = Some(Cause::Bend);
            return Evaluation::Rejected { why: Rejection::CurveSpeedInfeasible, expansions: 0, blocked_by };
        }
        if self.is_straight(path) { self.on_a_straight_path() } else { *self }.evaluate_free(path, course)
    }

    fn evaluate_free(&self, path: &LatticePath, course: &OnceLock<Course>) -> Evaluation {
        if self.hardest_stop() > path.free_length + MIN_CELL {
            let blocked_by = path.blocked_by.map(Cause::from);
            return Evaluation::Rejected { why: Rejection::CannotStop, expansions: 0, blocked_by };
        }
        self.evaluate_cells(path, course.get_or_init(|| self.course(path)))
    }

    fn evaluate_cells(&self, path: &LatticePath, course: &Course) -> Evaluation {
        let Some(cells) = self.cells(path, course) else {
            return Evaluation::Rejected { why: Rejection::BlockedAtStart, expansions: 0, blocked_by: None };
        };
        let first = cells.by_obstacle.iter().reduce(|a, b| if b.times.0 < a.times.0 { b } else { a });
        let blocked_by = path.blocked_by.map(Cause::from).or(first.map(|cell| Cause::Obstacle(cell.obstacle)));
        let ForSearch(sought, for_window) = self.for_search(&cells);
        let resolution = self.resolution();
        let Ok(outcome) = search(&sought, Strategy::SafeTlp, &resolution) else {
            return Evaluation::Rejected { why: Rejection::BlockedAtStart, expansions: 0, blocked_by };
        };
        let expansions = outcome.statistics().expansions;
        let rejected = |why| Evaluation::Rejected { why, expansions, blocked_by };
        match outcome {
            // a plan without a proof is not accepted
            SpeedOutcome::Unproven { .. } => rejected(Rejection::NoProof),
            SpeedOutcome::NoPlan { why, .. } => rejected(match why {
                NoPlan::CannotStop { .. } => Rejection::CannotStop,
                NoPlan::BudgetExhausted(_) => Rejection::NoProofInBudget,
                NoPlan::NoSafeState => Rejection::NoProof,
            }),
            SpeedOutcome::Proven { mut plan, .. } => {
                if let Some(brisk) = tail::without_creeping(&sought, &plan) {
                    plan = brisk;
                }
                let progress = smoothing::raw_profile(&sought, &plan).map(|p| p.at(TRAVEL_TIME_HORIZON).station);
                plan.end_at_long_wait(&sought, LONG_WAIT);
                let proof_begins = plan.states.get(plan.proof_starts).map_or(self.time, |state| state.time);
                let problem = self.for_proof(&cells);
                let PathCells { stations, along, stop, by_obstacle: blocked, .. } = cells;
                let Some((raw_profile, progress)) = smoothing::raw_profile(&problem.0, &plan).zip(progress) else {
                    return rejected(Rejection::NoProfile);
                };
                #[cfg(test)]
                let raw_profile = fault::applied(raw_profile);
                let target = TargetLimits { stations, along, speeds: sought.speed_limits, for_window };
                let proven = Proven { problem, target, stop, raw_profile, progress, proof_begins, expansions, blocked };
                Evaluation::Proven(Box::new(proven))
            }
        }
    }

    /// The contact-free motion as far along a path as a search gets that does not ask for a stop; `None` if it gets nowhere.
    pub(super) fn explored(&self, path: &LatticePath) -> Option<SpeedProfile> {
        let ForSearch(sought, _) = self.for_search(&self.cells(path, &self.course(path))?);
        let resolution = self.resolution();
        match search(&sought, Strategy::Naive, &resolution) {
            Ok(SpeedOutcome::Unproven { plan, .. }) => smoothing::raw_profile(&sought, &plan),
            _ => None,
        }
    }

    fn resolution(&self) -> Resolution {
        let expansions = self.settings.expansions;
        Resolution { expansions, exploration: expansions / PROOF_PER_EXPLORATION, ..Resolution::default() }
    }

    /// Whether a curve of the path is too tight for the speed that remains after comfortable braking.
    pub(super) fn is_curve_speed_infeasible(&self, path: &LatticePath) -> bool {
        let limits = SpeedLimits {
            lateral_acceleration: self.lateral_limit,
            steering_rate: self.vehicle.limits.steering_rate,
            wheelbase: self.vehicle.wheelbase,
            top_speed: f64::INFINITY,
        };
        let braking = 2.0 * self.braking;
        let stops_after = self.speed * self.speed / braking;
        let checks = fitting(stops_after.min(path.free_length), CHECK_STEP);
        // skip the first metre, which is the same for all paths
        (1..=checks).map(|i| i as f64 * CHECK_STEP).any(|s| {
            let remaining = (self.speed * self.speed - braking * s).max(0.0).sqrt();
            remaining > limits.at(&path.path.at(s))
        })
    }

    /// Whether harder braking than beside a turn is in the domain of the tracking tube, all along the stopping distance.
    fn is_straight(&self, path: &LatticePath) -> bool {
        if self.straight_deceleration <= self.proof_deceleration {
            return false;
        }
        let end = self.hardest_stop().min(path.path.length());
        let checks = fitting(end, CHECK_STEP);
        (0..=checks + 1).map(|i| (i as f64 * CHECK_STEP).min(end)).all(|station| {
            let (curvature, curvature_rate) = path.path.curvature_and_rate_at(station);
            let acceleration = -self.straight_deceleration;
            let motion = PathMotion { speed: self.speed, acceleration, curvature, curvature_rate };
            let used = motion.grip_use(self.vehicle, self.friction);
            used.turning <= TrackingTube::STRAIGHT_USE && self.vehicle.tracking.contains(self.speed, &used)
        })
    }

    /// With the deceleration for a straight path.
    fn on_a_straight_path(&self) -> Self {
        let braking = self.braking * self.straight_deceleration / self.proof_deceleration;
        Self { proof_deceleration: self.straight_deceleration, braking, ..*self }
    }

    /// The last station of a plan on a path, m, and what it plans to stop for there.
    fn end_of_path(&self, path: &LatticePath, along: &Along) -> (f64, Option<Cause>) {
        let (mut end, mut cause) = (path.path.length(), None);
        if let Some(blocker) = path.blocked_by {
            end = path.free_length;
            if blocker != Blocker::RoadBoundary {
                end = self.short_of(end);
                cause = Some(blocker.into());
            }
        }
        if self.road_ends_there(along.reference_at(end)) {
            cause = cause.or(Some(Cause::RoadEnd));
        }
        if cause.is_some() {
            end = self.before_no_stopping(along, end);
        }
        let to_goal = self.goal_stop().map(|(station, cause)| (along.station_of(station), cause));
        if let Some((station, why)) =
            to_goal.filter(|(distance, _)| *distance >= self.hardest_stop() && *distance < end)
        {
            (end, cause) = (station, Some(why));
        }
        (end.max(0.0), cause)
    }

    /// A planned stop in front of a station, m. The standoff is a wish: it is given up before the vehicle brakes harder than
    /// comfortably for it.
    fn short_of(&self, station: f64) -> f64 {
        let nearest = if self.speed > 0.0 { 2.0 * MIN_CELL } else { 0.0 };
        (station - self.settings.standoff).max(self.comfortable_stop()).max(nearest).min(station)
    }

    /// A planned stop that would be in a zone without stopping, in front of the zone if the vehicle can stop there, m.
    fn before_no_stopping(&self, along: &Along, end: f64) -> f64 {
        let mut before = end;
        while let Some((from, _)) = self.zone_at(along.reference_at(before)) {
            let edge = along.station_of(*from) - MIN_CELL;
            if edge < self.hardest_stop() {
                return end;
            }
            before = self.short_of(edge);
        }
        before
    }

    /// Deceleration of planned stops where there is room for it, m/s². Emergency levels brake harder only as far as they must.
    fn comfortable_deceleration(&self) -> f64 {
        self.settings.stopping_share * self.vehicle.comfort.deceleration
    }

    /// Stopping distance of planned stops, m.
    fn comfortable_stop(&self) -> f64 {
        self.speed * self.speed / (2.0 * self.comfortable_deceleration())
    }

    /// Shortest stopping distance of a proof, m.
    fn hardest_stop(&self) -> f64 {
        self.speed * self.speed / (2.0 * self.proof_deceleration)
    }

    /// Whether the vehicle is so early at a goal that permits a standstill that it waits in it until its time window opens.
    pub(super) fn waits_in(&self, goal: &GoalOnLane) -> bool {
        let time = goal.time_in_front(self.station, self.time);
        let is_early = time.is_some_and(|time| goal.far - self.station < SLOWEST_APPROACH * time);
        is_early && goal.speed.0 <= 0.0 && self.may_stop(goal.stop_station())
    }

    /// Station of a stop in the goal, or the last one before the goal is missed, m on the reference line.
    fn goal_stop(&self) -> Option<(f64, Cause)> {
        let stop = self.goal.filter(|goal| goal.is_stop() || self.waits_in(goal)).map(|goal| {
            // inside the goal, at the earliest comfortable station
            (self.station + self.comfortable_stop()).max(goal.stop_station()).min(goal.far)
        });
        stop.map(|s| (s, Cause::Goal)).or(self.goal_missed_at.map(|s| (s, Cause::LaneChange)))
    }

    /// Whether a path that ends at a station of the reference line (m) reaches the end of the known road, and the remaining task
    /// is long enough for it.
    fn road_ends_there(&self, end: f64) -> bool {
        /// Nodes are on a grid: a path may end this far before the end of the road, m.
        const GRID: f64 = 8.0;
        let goal_passed = self.goal.is_some_and(|g| g.far < self.station);
        let front = end + self.vehicle.front_overhang_from_rear_axle();
        (self.long_run || goal_passed) && front + GRID >= self.reference.length()
    }

    fn course(&self, path: &LatticePath) -> Course {
        let sweeps: Vec<_> = path.sweeps.iter().map(AsRef::as_ref).collect();
        let times = (self.time, self.horizon.max(self.time + 1.0));
        let grid = self.traffic.blocked_finely(&sweeps, &self.margins, times, self.fine_until);
        let bends = grid.stations().windows(2).map(|cell| bends_of(path, cell)).collect();
        Course { along: Arc::new(Along::new(&path.path, self.reference, self.station)), grid, bends }
    }

    /// The cells of a path with the times at which they are blocked; `None` if none of them is free and the vehicle moves.
    fn cells(&self, path: &LatticePath, Course { along, grid, bends }: &Course) -> Option<PathCells> {
        let (end, stops_for) = self.end_of_path(path, along);
        let mut stations: Vec<f64> = grid.stations().iter().copied().take_while(|s| *s < end - MIN_CELL).collect();
        if stations.is_empty() {
            // no free cell: only a stopped vehicle has a plan here
            stations.push(0.0);
        }
        if end > MIN_CELL {
            stations.push(end);
        } else if self.speed > 0.0 {
            return None;
        }
        // only the last cell may be shorter than that of the grid
        let known = |cell: &[f64], i: usize| grid.stations().get(i..i + 2).is_some_and(|limits| limits == cell);
        let bends_in = |(i, cell): (usize, &[f64])| if known(cell, i) { bends[i] } else { bends_of(path, cell) };
        let intervals = |cell: usize| grid.intervals(cell).iter().map(|b| (b.from, b.to)).collect::<Vec<_>>();
        let by_obstacle = (0..grid.cells()).flat_map(|cell| {
            let stations = (grid.stations()[cell], grid.stations()[cell + 1]);
            let blocked = grid.intervals(cell).iter();
            blocked.map(move |b| BlockedCell { stations, times: (b.from, b.to), obstacle: b.obstacle })
        });
        Some(PathCells {
            blocked: (0..stations.len() - 1).map(intervals).collect(),
            blocked_at_start: if grid.cells() > 0 { intervals(0) } else { Vec::new() },
            by_obstacle: by_obstacle.collect(),
            stop: stops_for.map(|cause| (end, cause)),
            bends: stations.windows(2).enumerate().map(bends_in).collect(),
            stations,
            along: Arc::clone(along),
        })
    }

    fn for_search(&self, cells: &PathCells) -> ForSearch {
        let (speed_limits, for_window) = self.speed_limits(cells);
        let deceleration = (self.search_share * self.proof_deceleration).max(self.braking);
        let blocked = cells.blocked.iter().map(|b| widened(b, self.time_gap, self.time)).collect();
        ForSearch(self.problem(cells, speed_limits, blocked, deceleration), for_window)
    }

    fn for_proof(&self, cells: &PathCells) -> ForProof {
        let speed_limits = self.hard_limits(cells, self.lateral_limit, PROOF_STEERING_SHARE);
        ForProof(self.problem(cells, speed_limits, cells.blocked.clone(), self.proof_deceleration))
    }

    fn problem(
        &self,
        cells: &PathCells,
        speed_limits: Vec<f64>,
        blocked: Vec<Vec<TimeInterval>>,
        aggressive_deceleration: f64,
    ) -> SpeedProblem {
        SpeedProblem {
            stations: cells.stations.clone(),
            speed_limits,
            blocked,
            blocked_at_start: cells.blocked_at_start.clone(),
            stopping_allowed: cells.stations.iter().map(|s| self.may_stop(cells.along.reference_at(*s))).collect(),
            start_speed: self.speed,
            start_time: self.time,
            horizon: self.horizon,
            limits: AccelerationLimits {
                acceleration: self.acceleration,
                deceleration: self.braking,
                aggressive_deceleration,
            },
        }
    }

    fn may_stop(&self, reference_station: f64) -> bool {
        self.zone_at(reference_station).is_none()
    }

    /// The zone without stopping that contains a station of the reference line.
    fn zone_at(&self, reference_station: f64) -> Option<&(f64, f64)> {
        self.no_stopping.iter().find(|(from, to)| (*from..=*to).contains(&reference_station))
    }

    /// Limits of the speed in curves for a lateral acceleration and a fraction of the steering rate.
    fn curve_limits(&self, lateral_acceleration: f64, steering_share: f64) -> SpeedLimits {
        SpeedLimits {
            lateral_acceleration,
            steering_rate: steering_share * self.vehicle.limits.steering_rate,
            wheelbase: self.vehicle.wheelbase,
            top_speed: self.top_speed,
        }
    }

    fn rule_at(&self, reference_station: f64) -> f64 {
        self.reference.speed_limit(reference_station).unwrap_or(f64::INFINITY)
    }

    /// Speed limits by vehicle and rules, for a lateral acceleration and a fraction of the steering rate, m/s.
    fn hard_limits(&self, cells: &PathCells, lateral: f64, steering_share: f64) -> Vec<f64> {
        let curve = self.curve_limits(lateral, steering_share);
        let rules = |s: f64| self.rule_at(cells.along.reference_at(s)).min(self.cruise);
        let mut limits: Vec<f64> = cells.stations.iter().map(|s| rules(*s)).collect();
        // a bend inside a cell limits both of its nodes
        for (i, bends) in cells.bends.iter().enumerate() {
            let [begins, inside @ .., ends] = bends.map(|(curvature, rate)| curve.at_curvature(curvature, rate));
            let inside = inside.into_iter().fold(f64::INFINITY, f64::min);
            limits[i] = limits[i].min(begins).min(inside);
            limits[i + 1] = limits[i + 1].min(ends).min(inside);
        }
        limits
    }

    /// The limit of the goal at a station of the reference line, m/s: before it the speed for its time window, its speed inside.
    fn goal_limit(&self, reference_station: f64, for_window: f64) -> f64 {
        let Some(goal) = &self.goal else { return f64::INFINITY };
        let before = if reference_station <= goal.far { for_window } else { f64::INFINITY };
        let is_inside = (goal.near..=goal.far).contains(&reference_station) && !goal.is_stop();
        if is_inside { before.min(goal.speed.1) } else { before }
    }

    /// Speed limits at the stations, m/s: the minimum of curvature and steering with a reserve, rules, the time window of the
    /// goal, and the planned stop at the last one.
    ///
    /// With them comes the limit of the time window.
    fn speed_limits(&self, cells: &PathCells) -> (Vec<f64>, f64) {
        let PathCells { stations, along, .. } = cells;
        let lateral = planned_lateral(self.settings, self.vehicle, self.lateral_limit);
        let braking = self.settings.stopping_share * self.braking;
        let mut speed_limits = self.hard_limits(cells, lateral, STEERING_SHARE);
        make_reachable(stations, &mut speed_limits, braking);
        let for_window = self
            .goal
            .map_or(f64::INFINITY, |goal| self.speed_for_window(stations, &speed_limits, along.station_of(goal.far)));
        for (cap, s) in speed_limits.iter_mut().zip(stations) {
            *cap = cap.min(self.goal_limit(along.reference_at(*s), for_window));
        }
        if cells.stop.is_some() {
            let distance = stations[stations.len() - 1];
            let required = self.speed * self.speed / (2.0 * distance.max(MIN_CELL));
            let deceleration = self.comfortable_deceleration().max(required * 1.02).min(self.proof_deceleration);
            for (cap, braking) in speed_limits.iter_mut().zip(braking_speed_limits(stations, deceleration)) {
                *cap = cap.min(braking);
            }
        }
        make_reachable(stations, &mut speed_limits, braking);
        (speed_limits, for_window)
    }

    /// The limits at a station of the path (m), each with its cause, m/s.
    pub(super) fn speed_limits_by_cause(
        &self,
        path: &LatticePath,
        limits: &TargetLimits,
        station: f64,
    ) -> [(f64, Cause); 4] {
        let beside = limits.along.reference_at(station);
        let lateral = planned_lateral(self.settings, self.vehicle, self.lateral_limit);
        let curve = self.curve_limits(lateral, STEERING_SHARE).at(&path.path.at(station));
        [
            (self.rule_at(beside), Cause::SpeedLimit),
            (self.goal_limit(beside, limits.for_window), Cause::Goal),
            (curve, Cause::Bend),
            (self.cruise, Cause::CruiseSpeed),
        ]
    }

    /// Progress of unobstructed driving within [`TRAVEL_TIME_HORIZON`], m.
    pub(super) fn free_progress(&self) -> f64 {
        let a = self.vehicle.comfort.acceleration;
        let ramp = ((self.cruise - self.speed) / a).clamp(0.0, TRAVEL_TIME_HORIZON);
        let distance = self.speed * ramp
            + 0.5 * a * ramp * ramp
            + self.cruise.min(self.speed + a * ramp) * (TRAVEL_TIME_HORIZON - ramp);
        let stop = self.goal_stop().map(|(s, _)| s - self.station).filter(|stop| *stop >= self.hardest_stop());
        stop.map_or(distance, |stop| distance.min(stop.max(0.0)))
    }
}

/// Lateral acceleration of planned speeds under the given limit, m/s²: with a reserve to the limit, but not less than the
/// comfortable one with its reserve. Never above the limit: the proof would refuse such a plan.
pub(super) fn planned_lateral(settings: &Settings, vehicle: &Vehicle, limit: f64) -> f64 {
    (settings.lateral_share * vehicle.comfort.lateral_acceleration.max(limit)).min(limit)
}

/// The cost of falling behind unobstructed driving by `behind` metres. The lattice has already estimated a part of it as
/// `curve_slowdown`, so that both together cost the larger of the two.
pub(super) fn delay(settings: &Settings, behind: f64, terms: &CostTerms) -> f64 {
    (settings.lattice.weights.travel_time * behind - terms.curve_slowdown).max(0.0)
}

/// Budget of a proof as a multiple of that of the exploration before it: behind slower traffic the last node is out of reach, and an
/// exploration that ends there is as deep after a fifth of the expansions.
const PROOF_PER_EXPLORATION: usize = 5;
/// Distance between the places at which the curvature of a path is checked, m.
const CHECK_STEP: f64 = 1.0;
/// A wait at a safe standstill of at least this length ends a plan, s: later cycles plan the continuation.
const LONG_WAIT: f64 = 2.0;
/// Horizon of the `travel_time` cost, s.
pub(super) const TRAVEL_TIME_HORIZON: f64 = 6.0;
/// Slowest approach to a goal whose time window has not opened yet, m/s: a vehicle that would have to be slower drives there and waits.
const SLOWEST_APPROACH: f64 = 1.0;
/// Shorter cells are dropped, m.
const MIN_CELL: f64 = 0.02;
/// Fraction of the steering rate that plans aim at; the tracking controller has the remainder.
const STEERING_SHARE: f64 = 0.8;
/// Where bends are looked for in a cell, as shares of its length: not quite at its ends, which may be joints of spirals, where rounding
/// would decide on which side.
const PLACES: [f64; 5] = [0.01, 0.25, 0.5, 0.75, 0.99];
/// Fraction of it that proofs permit: with their tolerance of speeds it is all of it.
const PROOF_STEERING_SHARE: f64 = 0.95;

/// The bends of a path in a cell between two stations, m.
fn bends_of(path: &LatticePath, cell: &[f64]) -> Bends {
    PLACES.map(|share| path.path.curvature_and_rate_at(cell[0] + share * (cell[1] - cell[0])))
}

/// The intervals extended by `gap` on both sides (not before `now`) and merged where they overlap.
fn widened(intervals: &[TimeInterval], gap: f64, now: f64) -> Vec<TimeInterval> {
    let mut merged: Vec<TimeInterval> = Vec::new();
    for &(from, to) in intervals {
        let (from, to) = (if from > now { (from - gap).max(now) } else { from }, to + gap);
        match merged.last_mut() {
            Some(last) if from <= last.1 => last.1 = last.1.max(to),
            _ => merged.push((from, to)),
        }
    }
    merged
}

/// A fault of the search, to test the reverification.
#[cfg(test)]
pub(super) mod fault {
    use std::cell::Cell;

    use crate::trajectory::{SpeedKnot, SpeedProfile};

    thread_local! {
        /// Whether raw profiles of this thread end at a positive speed.
        pub(in crate::planner) static ENDS_MOVING: Cell<bool> = const { Cell::new(false) };
    }

    pub(super) fn applied(raw_profile: SpeedProfile) -> SpeedProfile {
        if !ENDS_MOVING.get() {
            return raw_profile;
        }
        let moving = |k: &SpeedKnot| SpeedKnot { speed: k.speed.max(0.5), ..*k };
        SpeedProfile::new(raw_profile.knots().iter().map(moving).collect()).unwrap_or(raw_profile)
    }
}

#[cfg(test)]
mod tests;

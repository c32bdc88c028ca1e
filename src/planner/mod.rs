//! The planner: runs the stages of a planning cycle in order and keeps the committed plan.
//!
//! # A cycle
//!
//! 1. It starts from the committed trajectory, so that the setpoints stay continuous, where the vehicle will be when the brakes
//!    can respond ([`lead`]). After a large tracking error it starts from the measured state instead.
//! 2. It builds lattice paths on every lane that leads to the goal.
//! 3. It searches for a speed profile on each path with SafeTLP and chooses the cheapest pair of path and speed **whose
//!    stop is proven**.
//! 4. It refines the chosen path, smooths its speed profile and commits the result. If no plan is proven, the previous
//!    plan continues, at the latest to its stop.
//!
//! A single rule decides when a new plan replaces the committed one (`hysteresis`).
//!
//! # Levels
//!
//! The limits of a plan and its proof depend on the level ([`Level`]). The planner tries the levels in order: with margins and
//! the aggressive deceleration, without margins, with harder braking. Each plan records its level and deceleration. If the
//! settings ask for it, the planner tries robust proofs first (`traffic`). Without a proof on any level, the vehicle evades and
//! brakes (`unproven`).
//!
//! Weak: a cycle without a proven plan tries every level and takes the longest, when time matters most.

mod candidate;
mod choice;
mod goal;
mod hysteresis;
mod lanes;
mod lead;
mod level;
mod record;
mod refinement;
mod settings;
mod traffic;
mod unproven;

pub use goal::GoalOnLane;
pub use level::Level;
pub use record::{Candidate, Cycle, Decision, ExpectedContact, Rejection, Smoothing, StageSeconds};
pub use settings::{EmergencyLimits, RearTraffic, Settings, Uncertainty, UncertaintyMode};

use std::time::Instant;

use self::candidate::{Proven, Situation, TRAVEL_TIME_HORIZON, planned_lateral};
use self::choice::Choice;
use self::hysteresis::CommittedPlan;
use self::lanes::Lane;
use self::lead::Lead;
use self::level::{LevelLimits, fine_until};
use self::traffic::Traffic;
use crate::collision::{Allowance, Blocker, CollisionWorld, SafetyMargins};
use crate::geometry::spiral::CubicSpiral;
use crate::lattice::{EdgeCounts, Lattice, LatticeContext, LatticePath, Root, rank};
use crate::map::{PlanningProblem, Scenario};
use crate::reference::{Frenet, ReferenceLine};
pub use crate::settings::SettingsError;
use crate::settings::positive;
use crate::speed::smoothing::{self, Smoothed, Smoother};
use crate::trajectory::{SpeedProfile, Trajectory, TrajectoryPoint};
use crate::vehicle::{ProofLimits, State, Vehicle};

pub use self::lanes::NoLane;

/// Planner for one vehicle in one scenario, cycle by cycle.
pub struct Planner<'a> {
    scenario: &'a Scenario,
    problem: &'a PlanningProblem,
    /// The vehicle, its comfort within what the road gives.
    vehicle: Vehicle,
    limits: ProofLimits,
    /// The limits without the controller's reserve, for plans without a proof.
    unreserved: ProofLimits,
    settings: &'a Settings,
    lattice: Lattice,
    smoother: Smoother,
    world: CollisionWorld,
    lanes: Result<Vec<Lane>, NoLane>,
    traffic: Traffic,
    committed: Option<Committed>,
    cruise: f64,
    horizon: f64,
    /// Latest end of the run, s.
    end_time: f64,
}

/// The committed plan.
#[derive(Clone)]
struct Committed {
    trajectory: Trajectory,
    /// Largest deceleration of its proof, m/s².
    deceleration: f64,
    /// The level of its proof.
    level: Level,
    smoothing: Smoothing,
    is_refined: bool,
    /// Length of its lead, m.
    lead: f64,
    /// Its cost from the end of the lead on, without `travel_time` and `plan_change`.
    path_cost: f64,
    robust: bool,
}

/// Start of the plans of a cycle.
struct Start {
    /// The motion until then.
    lead: Lead,
    /// The state at the end of the lead; its station is that on the committed trajectory.
    point: TrajectoryPoint,
    /// The first contact during a lead that is not on the committed trajectory.
    lead_contact: Option<ExpectedContact>,
    /// Whether it is on the committed trajectory.
    on_plan: bool,
}

/// Why a planner cannot be created.
#[derive(Debug, thiserror::Error)]
pub enum PlannerError {
    /// A setting is out of its range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
}

impl From<crate::collision::SettingsError> for PlannerError {
    fn from(error: crate::collision::SettingsError) -> Self {
        Self::Settings(settings::of_collision(&error))
    }
}

impl<'a> Planner<'a> {
    /// Prepares planning: builds collision worlds, routes and reference lines. `end_time` is the latest end of the run, s.
    ///
    /// # Errors
    /// A setting out of its range. A missing lane is an outcome, not an error: [`Planner::no_lane`].
    pub fn new(
        scenario: &'a Scenario,
        problem: &'a PlanningProblem,
        vehicle: &'a Vehicle,
        settings: &'a Settings,
        end_time: f64,
    ) -> Result<Self, PlannerError> {
        settings.validate()?;
        let lattice = Lattice::new(settings.lattice.clone()).map_err(|e| e.in_table("lattice"))?;
        let smoother = Smoother::new(smoothing::Settings { jerk: settings.jerk, ..smoothing::Settings::default() })?;
        let prediction_end = scenario.obstacles.iter().map(|o| o.lifetime().1).filter(|t| t.is_finite());
        let horizon = prediction_end.fold(0.0, f64::max).min(end_time + PREDICTION_BEYOND_END);
        let (network, grid) = (&scenario.network, scenario.occupancy.as_ref());
        let world = CollisionWorld::new(network, grid, &scenario.obstacles, vehicle, &settings.collision, horizon)?;
        let limits = ProofLimits::new(vehicle, DRY);
        let unreserved = ProofLimits::unreserved(vehicle, DRY);
        let vehicle = limits.applied_to(vehicle);
        let lanes = Lane::all(scenario, problem, &problem.initial.centre, &vehicle);
        let cruise = settings.cruise_speed.max(problem.initial.speed);
        let traffic = Traffic::default();
        Ok(Self {
            scenario,
            problem,
            vehicle,
            limits,
            unreserved,
            settings,
            lattice,
            smoother,
            world,
            lanes,
            traffic,
            committed: None,
            cruise,
            horizon,
            end_time,
        })
    }

    /// Plans for a road whose friction is believed to be `friction` times that of dry asphalt.
    ///
    /// # Errors
    /// The friction is not a positive number up to 10: proofs would not hold for it.
    pub fn with_friction(self, friction: f64) -> Result<Self, PlannerError> {
        positive("friction", friction, HIGHEST_FRICTION, "times that of dry asphalt")?;
        let limits = ProofLimits::new(&self.vehicle, friction);
        let unreserved = ProofLimits::unreserved(&self.vehicle, friction);
        Ok(Self { vehicle: limits.applied_to(&self.vehicle), limits, unreserved, ..self })
    }

    /// The reason why there is no lane to drive on; `None` if there is one.
    #[must_use]
    pub fn no_lane(&self) -> Option<NoLane> {
        self.lanes.as_ref().err().copied()
    }

    /// End of the predictions, s of the run.
    #[must_use]
    pub fn prediction_end(&self) -> f64 {
        self.horizon
    }

    /// Runs one planning cycle and returns its record with the committed trajectory.
    pub fn cycle(&mut self, state: &State) -> Cycle {
        let begun = Instant::now();
        let start = self.start(state);
        self.follow_route(&start);
        self.update_traffic(state.time, &start);
        let mut record = CycleRecord::default();
        // a contact during the lead can be proven away by no plan
        let levels = if start.lead_contact.is_some() { Vec::new() } else { self.levels() };
        let choice = levels.iter().enumerate().find_map(|(attempt, level)| {
            record.attempt = attempt;
            Some((*level, self.choose(&start, *level, &mut record)?))
        });
        let worth = choice.filter(|(level, c)| self.is_worth_taking(&start, *level, c, &mut record));
        let mut contact = None;
        let (decision, blocked) = match worth {
            Some((level, choice)) => {
                let choice = self.refined(&start, level, choice, &mut record);
                record.is_refined = choice.is_refined;
                record.chosen = Some(choice.candidate);
                let decision = Decision::NewPlan { deceleration: choice.deceleration };
                let smoothing_begun = Instant::now();
                let (profile, smoothing) = self.smoothed(&start, &choice);
                record.seconds.smoothing = smoothing_begun.elapsed().as_secs_f64();
                record.reference = self.lanes.as_ref().map_or_else(|_| Vec::new(), |l| l[choice.lane].samples.clone());
                let moved = |((from, to), times)| ((from + start.lead.length(), to + start.lead.length()), times);
                let blocked = choice.proven.blocked.iter().copied().map(moved).collect();
                self.committed = Some(committed_of(&start, level, choice, profile, smoothing));
                (decision, blocked)
            }
            None if start.on_plan => {
                record.is_refined = self.committed.as_ref().is_some_and(|c| c.is_refined);
                (Decision::KeepPrevious, Vec::new())
            }
            None => {
                let unproven = self.unproven(&start, &mut record);
                (self.committed, contact) = (Some(unproven.0), unproven.1);
                (Decision::Unproven, Vec::new())
            }
        };
        record.seconds.total = begun.elapsed().as_secs_f64();
        let committed = self.committed.clone().unwrap_or_else(|| unreachable!("each decision commits a plan"));
        Cycle {
            time: state.time,
            committed: committed.trajectory,
            decision,
            level: committed.level,
            expected_contact: contact,
            reference: record.reference,
            candidates: record.candidates,
            blocked,
            chosen: record.chosen,
            edges: record.edges,
            expansions: record.expansions,
            smoothing: committed.smoothing,
            is_refined: record.is_refined,
            is_robust: committed.robust,
            stage_seconds: record.seconds,
        }
    }

    /// Plans the route again if the current lane ends within the horizon or the vehicle has changed lanes.
    fn follow_route(&mut self, start: &Start) {
        let Ok(lanes) = &self.lanes else { return };
        let centre = self.vehicle.centre_of_rear_axle(&start.point.pose);
        let on = |lane: &Lane| {
            let Frenet { s, l } = lane.reference.project(start.point.pose.position);
            (lane.reference.length() - s, l.abs())
        };
        let Some(current) = lanes.iter().find(|l| l.is_current) else { return };
        let (ahead, offset) = on(current);
        let changed = lanes.iter().any(|l| !l.is_current && on(l).1 < ON_LANE && offset > ON_LANE);
        let ends_soon = ahead < self.settings.max_horizon && current.goes_on(self.scenario);
        if (changed || ends_soon)
            && let Ok(lanes) = Lane::all(self.scenario, self.problem, &centre, &self.vehicle)
        {
            self.lanes = Ok(lanes);
        }
    }

    /// The start of plans: on the committed trajectory, or from the measured state if its tracking error is too large.
    fn start(&self, state: &State) -> Start {
        let duration = lead::duration(&self.vehicle);
        // the reference of a plan without a proof may be beyond what the vehicle can follow
        if let Some(committed) = self.committed.as_ref().filter(|c| c.level.is_proven()) {
            let error = committed.trajectory.at(state.time).pose.to_local(state.pose.position);
            if error.x.abs() <= self.settings.restart_longitudinal && error.y.abs() <= self.settings.restart_lateral {
                let lead = Lead::on(&committed.trajectory, state.time, duration);
                let point = committed.trajectory.at(state.time + duration);
                return Start { lead, point, lead_contact: None, on_plan: true };
            }
        }
        let lead = Lead::extrapolated(state, &self.vehicle, duration);
        let point = lead.end(state.steering.tan() / self.vehicle.wheelbase);
        let lead_contact = self.contact_during(&lead);
        Start { lead, point, lead_contact, on_plan: false }
    }

    /// The cheapest pair of path and speed with a proven stop on this level.
    fn choose(&mut self, start: &Start, level: LevelLimits, record: &mut CycleRecord) -> Option<Choice> {
        let mut best: Option<Choice> = None;
        for lane in 0..self.lanes.as_ref().map_or(0, Vec::len) {
            let begun = Instant::now();
            let paths = self.lattice_paths(start, lane, level, &mut record.edges);
            record.seconds.lattice += begun.elapsed().as_secs_f64();
            let begun = Instant::now();
            self.evaluate_all(start, lane, level, paths, &mut best, record);
            record.seconds.speed += begun.elapsed().as_secs_f64();
        }
        best
    }

    /// Lattice paths on a lane, from the start and from the end of the committed edge, including the cost terms that depend
    /// on the lane and on the committed path. In order of cost.
    fn lattice_paths(
        &mut self,
        start: &Start,
        lane: usize,
        level: LevelLimits,
        counts: &mut EdgeCounts,
    ) -> Vec<LatticePath> {
        let speed = start.point.speed;
        let stopping = speed.max(self.cruise.min(speed + 5.0)).powi(2) / (2.0 * self.vehicle.comfort.deceleration);
        let horizon = (stopping + 2.0 * speed).clamp(self.settings.min_horizon, self.settings.max_horizon);
        let world = &self.world;
        let roots = self.roots(start, world, &level.margins);
        let full_speed_curvature = self.full_speed_curvature(start, level);
        let weights = self.settings.lattice.weights;
        let committed_plan = committed_plan(self.committed.as_ref(), start);
        let Some(lane) = self.lanes.as_mut().ok().and_then(|l| l.get_mut(lane)) else { return Vec::new() };
        let context = context(&self.vehicle, &lane.reference, (world, level.margins), full_speed_curvature);
        // the cost of postponing a lane change that the goal requires rises as time and distance run out
        let time_left = lane.goal_deadline - start.point.time;
        let here = lane.reference.project(start.point.pose.position).s;
        let distance_left = lane.goal_missed_at.map_or(f64::INFINITY, |s| s - here);
        let urgency = 1.0
            + ((URGENT_TIME - time_left) / URGENCY_TIME_STEP).max(0.0)
            + ((URGENT_DISTANCE - distance_left) / URGENCY_DISTANCE_STEP).max(0.0);
        let mut all = Vec::new();
        for root in &roots {
            let store = &mut lane.edges;
            let found = self.lattice.search(&context, root, speed, horizon, store);
            counts.add(&found.counts);
            for mut path in found.paths {
                path.terms.lane_change = weights.lane_change * f64::from(lane.lane_changes_to_go) * urgency;
                if let Some(committed_plan) = &committed_plan {
                    path.terms.plan_change = weights.plan_change * committed_plan.departure(&path.path);
                }
                all.push(path);
            }
        }
        all.sort_by_key(|p| p.terms.rank());
        all
    }

    /// The curvature with the planned lateral acceleration at the start speed, 1/m.
    fn full_speed_curvature(&self, start: &Start, level: LevelLimits) -> f64 {
        planned_lateral(self.settings, &self.vehicle, level.lateral_limit) / (start.point.speed * start.point.speed)
    }

    fn roots(&self, start: &Start, world: &CollisionWorld, margins: &SafetyMargins) -> Vec<Root> {
        let p = &start.point;
        let allowance = allowance_at(world, margins, p);
        let fresh = Root { pose: p.pose, curvature: p.curvature, kept: Vec::new(), start: p.pose, allowance };
        let kept = committed_plan(self.committed.as_ref(), start).and_then(|plan| plan.kept());
        let kept =
            kept.map(|(end, kept)| Root { pose: end.pose, curvature: end.curvature, kept, start: p.pose, allowance });
        kept.into_iter().chain([fresh]).collect()
    }

    fn situation<'s>(&'s self, start: &Start, lane: &'s Lane, level: LevelLimits) -> Situation<'s> {
        Situation {
            vehicle: &self.vehicle,
            settings: self.settings,
            traffic: self.predictions_for(&level),
            margins: level.margins.moving_obstacles,
            fine_until: if level.is_fine { fine_until(start.point.speed) } else { 0.0 },
            reference: &lane.reference,
            goal: lane.goal,
            goal_missed_at: lane.goal_missed_at,
            station: lane.reference.project(start.point.pose.position).s,
            time: start.point.time,
            speed: if start.point.speed < STANDSTILL_SPEED { 0.0 } else { start.point.speed },
            cruise: self.cruise * level.speed_factor,
            acceleration: level.acceleration,
            braking: level.braking,
            horizon: self.horizon,
            proof_deceleration: level.deceleration,
            search_share: level.search_share,
            long_run: self.end_time - start.point.time > LONG_RUN,
            no_stopping: if level.junctions_kept_free { &lane.no_stopping } else { &[] },
            time_gap: level.time_gap,
            lateral_limit: level.lateral_limit,
        }
    }

    /// The jerk-limited profile of the choice if it passes reverification, else the raw profile.
    fn smoothed(&self, start: &Start, choice: &Choice) -> (SpeedProfile, Smoothing) {
        let Proven { problem, target_speed_limits, raw_profile, .. } = &*choice.proven;
        let acceleration = start.point.acceleration;
        match self.smoother.smooth_and_prove(problem, target_speed_limits, raw_profile, acceleration) {
            Ok(Smoothed { profile, is_firm: false }) => (profile, Smoothing::Comfortable),
            Ok(Smoothed { profile, is_firm: true }) => (profile, Smoothing::Firm),
            Err(why) => (raw_profile.clone(), Smoothing::Unsmoothed(why)),
        }
    }

    /// Whether the choice replaces the committed plan.
    fn is_worth_taking(&self, start: &Start, level: LevelLimits, choice: &Choice, record: &mut CycleRecord) -> bool {
        let soon = choice.proven.raw_profile.last().station.min(choice.proven.progress);
        let worth = committed_plan(self.committed.as_ref(), start).is_none_or(|plan| {
            plan.is_worth_leaving(soon)
                && (!plan.is_different_path(&choice.path.path)
                    || self
                        .staying(start, level, choice, &plan)
                        .is_none_or(|staying| rank(choice.cost) < rank(staying)))
        });
        if !worth {
            record.reject(choice.candidate, Rejection::BelowSwitchingThreshold);
        }
        worth
    }

    /// Cost of keeping the committed plan: the cost of its path when it was chosen, the progress shortfall since then, and
    /// its travel time from here. `None` if its proof brakes harder or is weaker than that of the choice.
    fn staying(&self, start: &Start, level: LevelLimits, choice: &Choice, plan: &CommittedPlan<'_>) -> Option<f64> {
        let is_as_safe = |c: &&Committed| {
            c.level.is_as_safe_as(level.level) && c.deceleration <= choice.deceleration && c.robust >= level.robust
        };
        let committed = self.committed.as_ref().filter(is_as_safe)?;
        let lane = self.lanes.as_ref().ok()?.get(choice.lane)?;
        let weights = &self.settings.lattice.weights;
        let behind =
            self.situation(start, lane, level).free_progress() - plan.progress(start.point.time + TRAVEL_TIME_HORIZON);
        Some(
            committed.path_cost
                + weights.progress_shortfall * plan.driven_distance()
                + weights.travel_time * behind.max(0.0),
        )
    }
}

/// Largest friction of the road that the planner accepts, as a factor on that of dry asphalt: as for the simulation.
const HIGHEST_FRICTION: f64 = 10.0;
/// Friction of dry asphalt, as a factor.
const DRY: f64 = 1.0;
/// Length of the predictions beyond the end of the run, s.
const PREDICTION_BEYOND_END: f64 = 15.0;
/// Fraction of the vehicle's maximum curvature that paths may use; the tracking controller has the remainder.
const CURVATURE_SHARE: f64 = 0.95;
/// Time to the deadline of the goal below which the cost of lane changes rises, s.
const URGENT_TIME: f64 = 8.0;
/// Time per rise of the cost of a lane change by its base value, s.
const URGENCY_TIME_STEP: f64 = 2.0;
/// Distance to the last station of the goal below which the cost of lane changes rises, m.
const URGENT_DISTANCE: f64 = 80.0;
/// Distance per rise of the cost of a lane change by its base value, m.
const URGENCY_DISTANCE_STEP: f64 = 20.0;
/// A run with more remaining time than this can reach the end of a road that ends ahead, s.
const LONG_RUN: f64 = 10.0;
/// Speeds below this count as standstill, m/s: an edge at such a speed would take minutes.
const STANDSTILL_SPEED: f64 = 0.02;
/// Largest lateral distance from the reference line of a lane at which the vehicle is on that lane, m.
const ON_LANE: f64 = 0.8;

/// The allowance of collision checks for a vehicle that stands inside a margin or partly off the road.
fn allowance_at(world: &CollisionWorld, margins: &SafetyMargins, p: &TrajectoryPoint) -> Allowance {
    /// Distance within which the vehicle must leave a margin, m.
    const LEAVE_MARGIN: f64 = 6.0;
    /// Distance within which the vehicle must return to the road, m.
    const RETURN_TO_ROAD: f64 = 15.0;
    let mut here = world.probe(&p.pose, &CubicSpiral { knots: [p.curvature; 4], length: 0.05 });
    if here.static_hit(margins, &Allowance::NONE).is_none() {
        return Allowance::NONE;
    }
    let off_road = world.start_overlap(&p.pose, p.time).is_some_and(|o| o.what == Blocker::RoadBoundary);
    Allowance {
        no_margins_until: LEAVE_MARGIN,
        no_road_until: if off_road { RETURN_TO_ROAD } else { f64::NEG_INFINITY },
    }
}

/// The lattice context of a lane.
fn context<'a>(
    vehicle: &Vehicle,
    reference: &'a ReferenceLine,
    (world, margins): (&'a CollisionWorld, SafetyMargins),
    full_speed_curvature: f64,
) -> LatticeContext<'a> {
    let (max_curvature, half_width) = (vehicle.max_curvature() * CURVATURE_SHARE, 0.5 * vehicle.width);
    LatticeContext { reference, world, margins, max_curvature, full_speed_curvature, half_width }
}

/// The choice on a level with its final speed profile, as the committed plan.
fn committed_of(
    start: &Start,
    level: LevelLimits,
    choice: Choice,
    profile: SpeedProfile,
    smoothing: Smoothing,
) -> Committed {
    let path_cost = choice.path.terms.total() - choice.path.terms.plan_change;
    Committed {
        trajectory: start.lead.followed_by(&choice.path.path, &profile),
        lead: start.lead.length(),
        deceleration: choice.deceleration,
        level: level.level,
        smoothing,
        is_refined: choice.is_refined,
        path_cost,
        robust: level.robust,
    }
}

/// The committed plan, if planning starts on it.
fn committed_plan<'c>(committed: Option<&'c Committed>, start: &Start) -> Option<CommittedPlan<'c>> {
    committed.filter(|_| start.on_plan).map(|c| CommittedPlan::new(&c.trajectory, c.lead, &start.point))
}

/// The parts of a [`Cycle`] that accumulate while it runs.
#[derive(Default)]
struct CycleRecord {
    candidates: Vec<Candidate>,
    /// Index of the present attempt.
    attempt: usize,
    chosen: Option<usize>,
    edges: EdgeCounts,
    expansions: usize,
    reference: Vec<crate::geometry::Point>,
    is_refined: bool,
    seconds: StageSeconds,
}

impl CycleRecord {
    fn reject(&mut self, candidate: usize, why: Rejection) {
        if let Some(candidate) = self.candidates.get_mut(candidate) {
            candidate.rejected = Some(why);
        }
    }
}

//! The planner: runs the stages of a planning cycle in order and keeps the committed plan.
//!
//! # A cycle
//!
//! 1. It starts from the committed trajectory, so that the setpoints stay continuous, where the vehicle will be when the brakes
//!    can respond (`lead`). If the vehicle is beside its plan, or the plan does not hold where the vehicle is
//!    (`tube`), it starts from the measured state instead.
//! 2. If the committed plan holds and was compared with others a moment ago, the cycle ends with it (`settled`).
//! 3. It builds lattice paths on every lane that leads to the goal.
//! 4. It searches for a speed profile on each path with SafeTLP and chooses the cheapest pair of path and speed **whose
//!    stop is proven**.
//! 5. It refines the chosen path, smooths its speed profile and commits the result. If no plan is proven, the previous
//!    plan continues, at the latest to its stop.
//!
//! A single rule decides when a new plan replaces the committed one (`hysteresis`).
//!
//! # Levels
//!
//! The limits of a plan and its proof depend on the level ([`Level`]). The planner tries the levels in order: with margins and
//! the aggressive deceleration, with the tracking tube alone, with harder braking. The lattice is searched once for all levels with the
//! same margins. A plan of an emergency level brakes and turns no harder than it must. Each plan records its level and deceleration. If the
//! settings ask for it, the planner tries robust proofs first (`traffic`). Without a proof on any level, the vehicle evades and
//! brakes (`unproven`).
//!
//! Weak: a cycle without a proven plan tries every level and takes the longest, when time matters most.

mod allowance;
mod along;
mod arrival;
mod candidate;
mod cause;
mod choice;
mod goal;
mod hysteresis;
mod known;
mod lanes;
mod lead;
mod level;
mod observation;
mod paths;
mod profile;
mod record;
mod refinement;
mod reproof;
mod settings;
mod settled;
#[cfg(test)]
mod tests;
mod traffic;
mod tube;
mod unproven;

pub use goal::GoalOnLane;
pub use level::Level;
pub use observation::{HIGHEST_FRICTION, Observation, ObservationError};
pub use record::{
    BlockedCell, Candidate, Cause, Cycle, Decision, ExpectedContact, Plan, Rejection, Smoothing, StageSeconds, Trace,
};
pub use settings::{
    EmergencyLimits, ExtrapolatedMotion, Extrapolation, RearTraffic, Settings, Uncertainty, UncertaintyMode,
};

use std::sync::Arc;
use std::time::Instant;

use self::allowance::Kept;
use self::candidate::Situation;
use self::choice::{Choice, Prepared};
use self::known::{Change, Known};
use self::lanes::Lane;
use self::lead::Lead;
use self::level::LevelLimits;
use self::profile::WithProfile;
use self::settled::Compared;
use self::traffic::Traffic;
use self::tube::{Deviation, Driven, Tube};
use crate::collision::{SafetyMargins, Sweep};
use crate::lattice::Lattice;
use crate::map::{Goal, Map};
use crate::reference::Frenet;
pub use crate::settings::SettingsError;
use crate::speed::smoothing::{self, Smoother};
use crate::trajectory::{Trajectory, TrajectoryPoint};
use crate::vehicle::{ProofLimits, State, Vehicle};

pub use self::lanes::NoLane;

/// Planner for one vehicle on one map, cycle by cycle.
pub struct Planner<'m> {
    map: Map<'m>,
    /// The vehicle as described.
    described: Vehicle,
    /// The vehicle, its comfort within what the road gives.
    vehicle: Vehicle,
    friction: f64,
    limits: ProofLimits,
    /// The limits without the controller's reserve, for plans without a proof.
    unreserved: ProofLimits,
    settings: Settings,
    lattice: Lattice,
    smoother: Smoother,
    known: Known,
    /// The goals with their lanes; `None` before the first cycle.
    goals: Option<Arc<[Goal]>>,
    lanes: Result<Vec<Lane>, NoLane>,
    traffic: Traffic,
    committed: Option<Committed>,
    /// What the driven trajectory used of the grip.
    driven: Driven,
    cruise: f64,
    /// The speed that the goal requires in this cycle, if it is more than the traffic gives now, m/s.
    haste: Option<f64>,
    /// Time of the last cycle, s of the run.
    time: f64,
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
    /// Where the vehicle may be while it follows the trajectory.
    tube: Tube,
    /// Margins of its proof, and up to which station traffic is resolved finely, m.
    margins: SafetyMargins,
    fine_until: f64,
    /// Swept footprints along its path.
    sweeps: Vec<Arc<Sweep>>,
    /// The static obstacles of its proof: [`Known::statics`].
    statics: u64,
    /// Its cost from the end of the lead on, without `travel_time` and `plan_change`.
    path_cost: f64,
    robust: bool,
    limited_by: Option<Cause>,
    stops_for: Option<Cause>,
    /// When the stop of its proof begins, s of the run.
    proof_begins: f64,
    /// Its lane, as long as there are the same lanes.
    lane: Option<usize>,
    /// The comparison with other plans, as long as nothing has changed since.
    compared: Option<Compared>,
}

impl Committed {
    fn sweeps(&self) -> Vec<&Sweep> {
        self.sweeps.iter().map(AsRef::as_ref).collect()
    }
}

/// Start of the plans of a cycle.
struct Start {
    /// The motion until then.
    lead: Lead,
    /// The state at the end of the lead; its station is that on the committed trajectory.
    point: TrajectoryPoint,
    /// The first contact during a lead that is not part of a proof.
    lead_contact: Option<ExpectedContact>,
    /// Whether the vehicle skids beside the lead, or rolls backwards.
    is_astray: bool,
    /// How far the vehicle is from the committed trajectory, if plans start on it.
    deviation: Deviation,
    /// Whether it is on the committed trajectory.
    on_plan: bool,
    /// What is kept of a tube in which something is at the start.
    kept: Kept,
}

/// Why a planner cannot be created, or cannot plan.
#[derive(Debug, thiserror::Error)]
pub enum PlannerError {
    /// A setting is out of its range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// An observation contradicts itself or the one before.
    #[error(transparent)]
    Observation(#[from] ObservationError),
}

impl From<crate::collision::SettingsError> for PlannerError {
    fn from(error: crate::collision::SettingsError) -> Self {
        Self::Settings(settings::of_collision(&error))
    }
}

impl<'m> Planner<'m> {
    /// A planner for a vehicle on a map. It knows of nothing else until the first observation.
    ///
    /// # Errors
    /// A setting out of its range.
    pub fn new(map: Map<'m>, vehicle: &Vehicle, settings: &Settings) -> Result<Self, PlannerError> {
        settings.validate()?;
        let lattice = Lattice::new(settings.lattice.clone()).map_err(|e| e.in_table("lattice"))?;
        let smoother = Smoother::new(smoothing::Settings { jerk: settings.jerk, ..smoothing::Settings::default() })?;
        let limits = ProofLimits::new(vehicle, DRY);
        Ok(Self {
            map,
            described: vehicle.clone(),
            vehicle: limits.applied_to(vehicle),
            friction: DRY,
            limits,
            unreserved: ProofLimits::unreserved(vehicle, DRY),
            settings: settings.clone(),
            lattice,
            smoother,
            known: Known::nothing(map, vehicle, settings)?,
            goals: None,
            lanes: Err(NoLane::NoReference),
            traffic: Traffic::default(),
            committed: None,
            driven: Driven::default(),
            cruise: settings.cruise_speed,
            haste: None,
            time: f64::NEG_INFINITY,
        })
    }

    /// Takes over what is known now, and returns the reason why there is no lane to drive on; `None` if there is one. For a
    /// caller who wants to know before the first cycle.
    ///
    /// # Errors
    /// An observation that contradicts itself or the previous one.
    pub fn no_lane(&mut self, observation: &Observation) -> Result<Option<NoLane>, PlannerError> {
        self.observe(observation)?;
        Ok(self.lanes.as_ref().err().copied())
    }

    /// Plans a cycle from what is known now.
    ///
    /// # Errors
    /// An observation that contradicts itself or the previous one. The planner is unchanged then and can plan again.
    pub fn cycle(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        self.traced_cycle(observation).map(|cycle| cycle.plan)
    }

    /// [`Planner::cycle`], with the record of how the plan came about.
    ///
    /// # Errors
    /// As [`Planner::cycle`].
    pub fn traced_cycle(&mut self, observation: &Observation) -> Result<Cycle, PlannerError> {
        let begun = Instant::now();
        self.observe(observation)?;
        let state = &observation.state;
        self.update_traffic(state);
        self.verify_committed(state);
        let start = self.start(state);
        self.record_use(&start, state.time);
        self.follow_route(&start);
        self.haste = self.haste(&start);
        let mut record = CycleRecord::default();
        // no plan can prevent a contact during the lead, and a vehicle that skids or rolls backwards follows no plan
        if self.is_settled(&start) {
            return Ok(self.cycle_of(state.time, Decision::Continue, None, record, begun));
        }
        let is_hopeless = start.lead_contact.is_some() || start.is_astray;
        let levels = if is_hopeless { Vec::new() } else { self.levels(start.point.speed) };
        let choice = self.choose(&start, &levels, &mut record);
        let worth = choice.filter(|(level, c)| self.is_worth_taking(&start, *level, c, &mut record));
        let mut contact = None;
        let decision = match worth {
            Some((level, choice)) => {
                let choice = self.refined(&start, level, choice, &mut record);
                record.trace.chosen = Some(choice.candidate);
                let smoothing_begun = Instant::now();
                let chosen = self.with_profile(&start, level, choice, &mut record);
                let trace = &mut record.trace;
                trace.stage_seconds.smoothing = smoothing_begun.elapsed().as_secs_f64();
                trace.reference =
                    self.lanes.as_ref().map_or_else(|_| Vec::new(), |l| l[chosen.choice.lane].samples.clone());
                trace.blocked =
                    chosen.choice.proven.blocked.iter().map(|cell| cell.moved(start.lead.length())).collect();
                self.committed = Some(self.committed_of(&start, level, chosen));
                self.note_comparison(&start);
                Decision::NewPlan
            }
            None if start.on_plan && self.has_proof() => {
                self.note_comparison(&start);
                Decision::KeepPrevious
            }
            None => {
                let unproven = self.unproven(&start, &mut record);
                contact = unproven.1;
                let stops_for = contact.map(|c| c.what.into()).or_else(|| record.in_the_way());
                self.committed = Some(Committed { stops_for, ..unproven.0 });
                Decision::Unproven
            }
        };
        Ok(self.cycle_of(state.time, decision, contact, record, begun))
    }

    /// The result of a cycle: the committed plan.
    fn cycle_of(
        &self,
        time: f64,
        decision: Decision,
        expected_contact: Option<ExpectedContact>,
        CycleRecord { mut trace, .. }: CycleRecord,
        begun: Instant,
    ) -> Cycle {
        let committed = self.committed.as_ref().unwrap_or_else(|| unreachable!("each decision commits a plan"));
        trace.is_refined = committed.is_refined;
        trace.stage_seconds.total = begun.elapsed().as_secs_f64();
        let plan = Plan {
            time,
            trajectory: committed.trajectory.clone(),
            decision,
            level: committed.level,
            deceleration: committed.deceleration,
            is_robust: committed.robust,
            smoothing: committed.smoothing,
            limited_by: committed.limited_by,
            stops_for: committed.stops_for,
            expected_contact,
        };
        Cycle { plan, trace }
    }

    /// Takes over what is known now. Nothing is changed if it is refused.
    fn observe(&mut self, observation: &Observation) -> Result<(), PlannerError> {
        observation.validate(self.time)?;
        let Observation { state, obstacles, goals, friction } = observation;
        if !self.known.is(obstacles) {
            observation.validate_obstacles()?;
        }
        if *friction != self.friction {
            self.limits = ProofLimits::new(&self.described, *friction);
            self.unreserved = ProofLimits::unreserved(&self.described, *friction);
            (self.vehicle, self.friction) = (self.limits.applied_to(&self.described), *friction);
            self.forget_comparison();
        }
        let change = self.known.renew(obstacles, state.time, self.map, &self.vehicle, &self.settings)?;
        self.traffic.renew(change);
        if change == Change::Static {
            self.forget_comparison();
        }
        if change == Change::Static {
            self.lanes.iter_mut().flatten().for_each(|lane| lane.edges = Default::default());
        }
        let is_first = self.goals.is_none();
        if is_first {
            self.cruise = self.settings.cruise_speed.max(state.speed);
        }
        if self.goals.as_ref().is_none_or(|known| !Arc::ptr_eq(known, goals) && known[..] != goals[..]) {
            let centre = self.vehicle.centre_of_rear_axle(&state.pose);
            self.lanes = Lane::all(self.map.network, goals, &centre, &self.vehicle);
            self.goals = Some(Arc::clone(goals));
            self.forget_lane();
        }
        self.time = state.time;
        Ok(())
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
        let ends_soon = ahead < self.settings.max_horizon && current.goes_on(self.map.network);
        if (changed || ends_soon)
            && let Ok(lanes) =
                Lane::all(self.map.network, self.goals.as_deref().unwrap_or_default(), &centre, &self.vehicle)
        {
            self.lanes = Ok(lanes);
            self.forget_lane();
        }
    }

    /// The lanes have changed, and with them what the committed plan was chosen for.
    fn forget_lane(&mut self) {
        self.forget_comparison();
        if let Some(committed) = &mut self.committed {
            committed.lane = None;
        }
    }

    /// The start of plans: on the committed trajectory, or from the measured state if its tracking error is too large.
    fn start(&self, state: &State) -> Start {
        let duration = lead::duration(&self.vehicle);
        // full braking may be beyond what the vehicle can follow
        let follows = |c: &Committed| {
            c.level.is_proven() || (c.tube.is_known() && !self.described.is_skidding(state, self.friction))
        };
        let rolls_back = self.described.is_rolling_back(state, self.friction);
        let near =
            |c: &&Committed| !rolls_back && follows(c) && self.is_near(&c.trajectory.at(state.time), &state.pose);
        let kept = |is_proven| if is_proven || state.speed < STANDSTILL_SPEED { Kept::Share } else { Kept::Beside };
        if let Some(Committed { trajectory, level, .. }) = self.committed.as_ref().filter(near) {
            let deviation = Deviation::between(&trajectory.at(state.time).pose, &state.pose);
            let lead = Lead::on(trajectory, state.time, duration);
            let point = trajectory.at(state.time + duration);
            let lead_contact = if level.is_proven() { None } else { self.contact_during(&lead) };
            return Start {
                lead,
                point,
                lead_contact,
                is_astray: false,
                deviation,
                on_plan: true,
                kept: kept(level.is_proven()),
            };
        }
        let drives_for = if state.acceleration > 0.0 { self.vehicle.actuators.drive_lag } else { 0.0 };
        let lead = Lead::extrapolated(state, &self.vehicle, duration.max(drives_for));
        let point = lead.end(state.steering.tan() / self.vehicle.wheelbase);
        let lead_contact = self.contact_during(&lead);
        let is_astray = rolls_back || self.described.is_skidding(state, self.friction);
        Start {
            lead,
            point,
            lead_contact,
            is_astray,
            deviation: Deviation::default(),
            on_plan: false,
            kept: kept(false),
        }
    }

    /// The pair of path and speed with a proven stop on the gentlest of these levels, of those the cheapest. The lattice is searched
    /// once for all levels with the same paths.
    fn choose(
        &mut self,
        start: &Start,
        levels: &[LevelLimits],
        record: &mut CycleRecord,
    ) -> Option<(LevelLimits, Choice)> {
        for group in levels.chunk_by(LevelLimits::has_paths_of) {
            let begun = Instant::now();
            let lanes = 0..self.lanes.as_ref().map_or(0, Vec::len);
            let mut paths: Vec<Vec<Prepared>> = lanes
                .map(|lane| self.lattice_paths(start, lane, group[0], &mut record.trace.edges))
                .map(|paths| paths.into_iter().map(Prepared::new).collect())
                .collect();
            let mut before = &group[0];
            record.trace.stage_seconds.lattice += begun.elapsed().as_secs_f64();
            let begun = Instant::now();
            let gentlest = group.iter().find_map(|level| {
                if !level.sees_traffic_as(before) {
                    paths.iter_mut().flatten().for_each(Prepared::renew);
                }
                before = level;
                let mut best = None;
                for (lane, paths) in paths.iter().enumerate() {
                    self.evaluate_all(start, lane, *level, paths, &mut best, record);
                }
                record.attempt += 1;
                Some((*level, best?))
            });
            record.trace.stage_seconds.speed += begun.elapsed().as_secs_f64();
            if gentlest.is_some() {
                return gentlest;
            }
        }
        None
    }

    /// The speed that the goal requires of a vehicle that does not have it: what it drives after a second of comfortable acceleration is
    /// too slow. `None` if the goal is not in the lane, has no haste, or asks for more than the cruise speed by more than [`HASTE`].
    fn haste(&self, start: &Start) -> Option<f64> {
        let p = &start.point;
        let acceleration = self.vehicle.comfort.acceleration;
        let lanes = self.lanes.as_ref().ok()?.iter();
        let needed = lanes.filter_map(|lane| {
            let station = lane.reference.project(p.pose.position).s;
            lane.goal?.speed_in_time(station, p.time, p.speed, acceleration)
        });
        let needed = needed.reduce(f64::min)?;
        let soon = self.cruise.min(p.speed + acceleration);
        (needed > SLACK * soon && needed <= HASTE * self.cruise).then_some(needed)
    }

    fn situation<'s>(&'s self, start: &Start, lane: &'s Lane, level: LevelLimits) -> Situation<'s> {
        Situation {
            vehicle: &self.vehicle,
            settings: &self.settings,
            traffic: self.predictions_for(&level),
            margins: level.margins.moving_obstacles,
            fine_until: level.fine_until(start.point.speed),
            reference: &lane.reference,
            goal: lane.goal,
            goal_missed_at: lane.goal_missed_at,
            station: lane.reference.project(start.point.pose.position).s,
            time: start.point.time,
            speed: if start.point.speed < STANDSTILL_SPEED { 0.0 } else { start.point.speed },
            cruise: self.cruise.max(self.haste.unwrap_or(0.0)) * level.speed_factor,
            acceleration: level.acceleration,
            braking: level.braking,
            horizon: self.known.horizon,
            proof_deceleration: level.deceleration,
            straight_deceleration: level.straight_deceleration,
            friction: self.friction,
            search_share: level.search_share,
            top_speed: level.top_speed,
            long_run: self.task_ends() - start.point.time > LONG_RUN,
            no_stopping: if level.junctions_kept_free { &lane.no_stopping } else { &[] },
            time_gap: level.time_gap,
            lateral_limit: level.lateral_limit,
        }
    }

    /// The choice on a level with its final speed profile, as the committed plan.
    fn committed_of(&self, start: &Start, level: LevelLimits, chosen: WithProfile) -> Committed {
        let WithProfile { choice, profile, smoothing } = chosen;
        let stops_for = cause::stops_for(&profile, choice.proven.stop, &choice.proven.blocked);
        let limited_by = self.lanes.as_ref().ok().and_then(|lanes| {
            let situation = self.situation(start, lanes.get(choice.lane)?, level);
            situation.limited_by(&choice.path, &profile, &choice.proven.target, stops_for)
        });
        let lead = start.lead.path().map(|path| Arc::new(self.known.world.sweep_path(&path)));
        Committed {
            trajectory: start.lead.followed_by(&choice.path.path, &profile),
            lead: start.lead.length(),
            tube: choice.tube,
            margins: level.margins.at_least(&choice.tube.margins),
            fine_until: start.lead.length() + level.fine_until(start.point.speed),
            path_cost: choice.path.terms.total() - choice.path.terms.plan_change,
            sweeps: lead.into_iter().chain(choice.path.sweeps).collect(),
            statics: self.known.statics,
            // the proof begins after the lead, what the plan does does not
            deceleration: choice.proven.hardest_deceleration().max(start.lead.deceleration()),
            level: level.level,
            smoothing,
            is_refined: choice.is_refined,
            robust: level.robust,
            limited_by,
            stops_for,
            proof_begins: choice.proven.proof_begins,
            lane: Some(choice.lane),
            compared: None,
        }
    }

    /// Whether the committed plan has a proof.
    fn has_proof(&self) -> bool {
        self.committed.as_ref().is_some_and(|c| c.level.is_proven())
    }

    /// The latest end of the task, s of the run; infinite without a goal.
    fn task_ends(&self) -> f64 {
        let goals = self.goals.as_deref().unwrap_or_default();
        goals.iter().map(|g| g.time.max).reduce(f64::max).unwrap_or(f64::INFINITY)
    }
}

/// Share of the speed in a second that a goal may require without haste.
const SLACK: f64 = 0.9;
/// Largest cruise speed in haste, as a factor on the one without. Limits of the road hold besides.
const HASTE: f64 = 1.3;
/// Friction of dry asphalt, as a factor.
const DRY: f64 = 1.0;
/// A run with more remaining time than this can reach the end of a road that ends ahead, s.
const LONG_RUN: f64 = 10.0;
/// Speeds below this count as standstill, m/s: an edge at such a speed would take minutes.
const STANDSTILL_SPEED: f64 = 0.02;
/// Largest lateral distance from the reference line of a lane at which the vehicle is on that lane, m.
const ON_LANE: f64 = 0.8;

/// The trace of a cycle while it runs.
#[derive(Default)]
struct CycleRecord {
    trace: Trace,
    /// Number of levels tried so far.
    attempt: usize,
}

impl CycleRecord {
    /// What stands in the way of the cheapest candidate of the last attempt.
    fn in_the_way(&self) -> Option<Cause> {
        let last = self.trace.candidates.iter().filter(|c| c.attempt + 1 == self.attempt);
        last.min_by(|a, b| a.cost.total_cmp(&b.cost)).and_then(|c| c.blocked_by)
    }

    fn reject(&mut self, candidate: usize, why: Rejection) {
        if let Some(candidate) = self.trace.candidates.get_mut(candidate) {
            candidate.rejected = Some(why);
        }
    }
}

//! The closed loop: plan, execute a tenth of a second in physics, plan again; then judge.
//!
//! Meanwhile worlds are forked (`branches`), in which the plan of a moment is driven to its end; and things may be made to go
//! wrong on purpose (`faults`). Who plans and who controls can be changed ([`Driver`]): the verdict has to notice.

mod branches;
mod faults;
mod settings;

pub use faults::{Faults, YAW_PER_METRE};
pub use settings::{RunSettings, Settings, SettingsError};

use std::sync::Arc;

use self::branches::FallbackBranches;
use crate::map::{Motion, PlanningProblem, Scenario};
use crate::planner::{Cycle, NoLane, Planner, PlannerError, Rejection};
use crate::simulation::{self, Controller, Log, SimulationError, TrackingController, World};
use crate::vehicle::{State, Vehicle};
use crate::verdict::{self, Expectation, Fallback, GoalWatch, Verdict};

/// A finished run (or a single planning cycle, whose log is empty).
#[derive(Debug)]
pub struct Run<'a> {
    /// The scenario it ran on.
    pub scenario: &'a Scenario,
    /// The planning problem.
    pub problem: &'a PlanningProblem,
    /// The vehicle.
    pub vehicle: &'a Vehicle,
    /// The planning cycles, in order of time.
    pub cycles: Vec<Cycle>,
    /// What the rig measured; empty for a single planning cycle.
    pub log: Log,
    /// What the plans came to that were driven to rest in forked worlds, in order of their cycles.
    pub fallbacks: Vec<Fallback>,
    /// What was made to go wrong.
    pub faults: Faults,
    /// How it ended.
    pub outcome: Outcome,
    /// Why, as a stable code, where the outcome alone does not say it.
    pub reason: Option<&'static str>,
    /// Way that braking as hard as the planner may takes from the start, m, where no way is that long.
    pub stopping_distance: Option<f64>,
    /// The named checks; empty for a single planning cycle.
    pub verdict: Verdict,
}

/// How a run ended. Outcomes are results, never errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The goal was reached.
    GoalReached,
    /// At rest without contact, because the way ends or is blocked.
    StoppedSafely,
    /// No proven plan from the start.
    NoSafePlan,
    /// The vehicle touched something.
    Collision,
    /// The time ran out while driving safely.
    TimedOut,
    /// A single planning cycle found a plan with its stop proven.
    Planned,
}

impl Outcome {
    /// The stable name used in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::GoalReached => "goal_reached",
            Self::StoppedSafely => "stopped_safely",
            Self::NoSafePlan => "no_safe_plan",
            Self::Collision => "collision",
            Self::TimedOut => "timed_out",
            Self::Planned => "planned",
        }
    }
}

/// Why a run could not be made.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// A setting is out of its range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A setting of the planner is out of its range.
    #[error(transparent)]
    Planner(#[from] PlannerError),
    /// The physics rig could not be built.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
}

/// Who plans: once a cycle, what to follow from now on. [`Planner`] does; tests put others there.
pub trait MotionPlanner {
    /// One planning cycle for a vehicle that takes itself to be in `state`.
    fn cycle(&mut self, state: &State) -> Cycle;

    /// Why there is no lane to plan on, if there is none.
    fn no_lane(&self) -> Option<NoLane> {
        None
    }
}

impl MotionPlanner for Planner<'_> {
    fn cycle(&mut self, state: &State) -> Cycle {
        Planner::cycle(self, state)
    }

    fn no_lane(&self) -> Option<NoLane> {
        Planner::no_lane(self)
    }
}

/// Who drives: plans, and follows them.
pub struct Driver<'p> {
    /// Makes the plans.
    pub planner: &'p mut dyn MotionPlanner,
    /// Follows them.
    pub controller: Arc<dyn Controller>,
}

impl<'p> Driver<'p> {
    /// Follows plans with the rig's own controller.
    pub fn following(planner: &'p mut dyn MotionPlanner) -> Self {
        Self { planner, controller: Arc::new(TrackingController) }
    }
}

/// The planner that [`drive`] drives with: one that knows when the run ends.
///
/// # Errors
/// A setting of the planner out of its range.
pub fn planner<'a>(
    scenario: &'a Scenario,
    problem: &'a PlanningProblem,
    vehicle: &'a Vehicle,
    settings: &'a Settings,
) -> Result<Planner<'a>, PlannerError> {
    let ends = latest_end(&GoalWatch::new(scenario, problem), begin(scenario, problem), settings);
    Planner::new(scenario, problem, vehicle, &settings.planner, ends)
}

/// Drives the vehicle through the scenario in physics and judges what happened. `progress` hears the time of the run and
/// its latest possible end, s.
///
/// # Errors
/// Settings out of their range. How the run ends is an [`Outcome`].
pub fn drive<'a>(
    scenario: &'a Scenario,
    problem: &'a PlanningProblem,
    vehicle: &'a Vehicle,
    settings: &Settings,
    progress: &mut dyn FnMut(f64, f64),
) -> Result<Run<'a>, DriveError> {
    settings.validate()?;
    let mut planner = planner(scenario, problem, vehicle, settings)?;
    drive_with(scenario, problem, vehicle, settings, Driver::following(&mut planner), progress)
}

/// Drives as [`drive`] does, with whoever plans and controls. Scenario, problem and vehicle are the truth, in which the rig
/// drives and by which the verdict judges, whatever the driver takes them for.
///
/// # Errors
/// Settings out of their range. How the run ends is an [`Outcome`].
pub fn drive_with<'a>(
    scenario: &'a Scenario,
    problem: &'a PlanningProblem,
    vehicle: &'a Vehicle,
    settings: &Settings,
    driver: Driver<'_>,
    progress: &mut dyn FnMut(f64, f64),
) -> Result<Run<'a>, DriveError> {
    settings.validate()?;
    let Driver { planner, controller } = driver;
    let watch = GoalWatch::new(scenario, problem);
    let begins = begin(scenario, problem);
    let ends = latest_end(&watch, begins, settings);
    let mut run = Run::unstarted(scenario, problem, vehicle);
    run.faults = settings.faults;
    if let Some(reason) = planner.no_lane() {
        run.reason = Some(reason.code());
        return Ok(run);
    }
    if ends <= begins {
        run.outcome = Outcome::TimedOut;
        run.reason = Some("goal_time_is_past");
        return Ok(run);
    }
    let mut world = rig(scenario, problem, vehicle, settings, begins)?.controlled_by(controller);
    let mut branches = FallbackBranches::new(scenario, vehicle, &settings.verdict);
    let stops_at_goal = stops_at_goal(problem);
    let mut judged: usize = 0;
    loop {
        let state = world.localised();
        progress(state.time, ends);
        let cycle = match run.cycles.last().filter(|_| settings.faults.misses(run.cycles.len())) {
            Some(last) => faults::missed(last, state.time),
            None => planner.cycle(&state),
        };
        branches.consider(&world, &cycle, run.cycles.len());
        let until = (state.time + settings.run.replan_interval).min(ends);
        world.follow(&cycle.committed, until, &mut run.log);
        run.cycles.push(cycle);
        if run.log.contact.is_some() || run.log.broke_at.is_some() {
            run.outcome = Outcome::Collision;
            break;
        }
        // the last sample judged begins the part that ends with the first new one
        let from = judged.saturating_sub(1);
        let stands =
            |speed: f64, time: f64| !stops_at_goal || speed.abs() < STANDSTILL_SPEED || time > ends - STANDSTILL_SPEED;
        if let Some(sample) = watch.reached_in(vehicle, &run.log.samples[from..], stands) {
            run.log.samples.truncate(from + sample + 1);
            run.outcome = Outcome::GoalReached;
            break;
        }
        judged = run.log.samples.len();
        if let Some(outcome) = ended(&run, scenario, settings, world.state().time, ends) {
            run.outcome = outcome;
            break;
        }
    }
    run.explain();
    run.judge(&settings.verdict, branches);
    Ok(run)
}

/// The rig with the vehicle that is really in it.
fn rig(
    scenario: &Scenario,
    problem: &PlanningProblem,
    vehicle: &Vehicle,
    settings: &Settings,
    begins: f64,
) -> Result<World, SimulationError> {
    let faults = &settings.faults;
    let friction_scale = faults.friction * settings.simulation.friction_scale;
    let physics = simulation::Settings { friction_scale, ..settings.simulation };
    let initial = initial_state(problem, vehicle, begins);
    let world = World::new(&faults.real(vehicle), &scenario.obstacles, &initial, &physics)?;
    let world = world.with_friction(&settings.friction)?.disturbed(&faults.disturbances(vehicle));
    Ok(match &scenario.occupancy {
        Some(grid) => world.with_occupancy(grid),
        None => world,
    })
}

/// One planning cycle from the initial state, without physics.
///
/// # Errors
/// Settings out of their range. Finding no plan is an [`Outcome`].
pub fn plan<'a>(
    scenario: &'a Scenario,
    problem: &'a PlanningProblem,
    vehicle: &'a Vehicle,
    settings: &Settings,
) -> Result<Run<'a>, DriveError> {
    settings.validate()?;
    let begins = begin(scenario, problem);
    let mut planner = planner(scenario, problem, vehicle, settings)?;
    let mut run = Run::unstarted(scenario, problem, vehicle);
    if let Some(reason) = planner.no_lane() {
        run.reason = Some(reason.code());
        return Ok(run);
    }
    run.cycles.push(planner.cycle(&initial_state(problem, vehicle, begins)));
    if run.is_ever_proven() {
        run.outcome = Outcome::Planned;
    }
    run.explain();
    Ok(run)
}

/// The time at which the problem begins, s.
fn begin(scenario: &Scenario, problem: &PlanningProblem) -> f64 {
    problem.initial.time_step as f64 * scenario.time_step
}

/// The latest end of a run, s: the goal's deadline, or the longest run where there is no goal.
fn latest_end(watch: &GoalWatch, begins: f64, settings: &Settings) -> f64 {
    let longest = begins + settings.run.longest;
    if watch.deadline() == f64::NEG_INFINITY { longest } else { watch.deadline().min(longest).max(begins) }
}

/// Slower than this is at rest, m/s.
const STANDSTILL_SPEED: f64 = 0.05;

/// Whether every goal asks for a speed so low that it means to stop there.
fn stops_at_goal(problem: &PlanningProblem) -> bool {
    const STOP: f64 = 1.0;
    !problem.goals.is_empty() && problem.goals.iter().all(|g| g.speed.is_some_and(|s| s.max < STOP))
}

/// The vehicle as the planning problem has it, at the rear axle.
fn initial_state(problem: &PlanningProblem, vehicle: &Vehicle, time: f64) -> State {
    /// Below this speed a yaw rate says nothing about the steering, m/s.
    const STEERING_KNOWN: f64 = 1.0;
    let initial = &problem.initial;
    let turning = initial.speed > STEERING_KNOWN;
    let curvature = if turning { initial.yaw_rate / initial.speed } else { 0.0 };
    let steering = vehicle.steering_for_curvature(curvature);
    let limit = vehicle.limits.steering;
    State {
        time,
        pose: vehicle.rear_axle_of_centre(&initial.centre),
        speed: initial.speed,
        acceleration: initial.acceleration,
        yaw_rate: if turning { initial.yaw_rate } else { 0.0 },
        steering: steering.clamp(-limit, limit),
    }
}

/// Whether the run is over without goal or contact.
fn ended(run: &Run<'_>, scenario: &Scenario, settings: &Settings, time: f64, ends: f64) -> Option<Outcome> {
    let rests_since = run.log.samples.iter().rposition(|s| s.speed.abs() > STANDSTILL_SPEED);
    let rest_began = match rests_since {
        Some(moving) => run.log.samples.get(moving + 1).map(|s| s.time),
        None => run.log.samples.first().map(|s| s.time),
    };
    let rested = rest_began.map_or(0.0, |t| time - t);
    let proven = run.is_ever_proven();
    let stopped = if proven { Outcome::StoppedSafely } else { Outcome::NoSafePlan };
    if time >= ends - 1e-9 {
        return Some(if rested > 0.0 { stopped } else { Outcome::TimedOut });
    }
    (rested >= settings.run.standstill_time && !moves_later(scenario, time)).then_some(stopped)
}

/// Whether any obstacle still moves after `time`, so that waiting may help.
fn moves_later(scenario: &Scenario, time: f64) -> bool {
    scenario.obstacles.iter().any(|o| match &o.motion {
        Motion::Static(_) => false,
        Motion::Trajectory(states) => states.iter().any(|s| s.time > time && s.speed.abs() > STANDSTILL_SPEED),
        Motion::Occupancy(sets) => sets.iter().any(|s| s.to > time),
    })
}

/// Whether all that the hardest braking allowed was tried, and every way was too short for it.
fn cannot_stop(cycle: &Cycle) -> bool {
    let last_attempt = cycle.candidates.iter().map(|c| c.attempt).max();
    let mut last = cycle.candidates.iter().filter(|c| Some(c.attempt) == last_attempt).peekable();
    last.peek().is_some() && last.all(|c| matches!(c.rejected, Some(Rejection::CannotStop | Rejection::BlockedAtStart)))
}

/// Way to rest of a trajectory, m.
fn stopping_distance(cycle: &Cycle) -> f64 {
    let profile = &cycle.committed.profile;
    profile.last().station - profile.at(0.0).station
}

impl<'a> Run<'a> {
    fn unstarted(scenario: &'a Scenario, problem: &'a PlanningProblem, vehicle: &'a Vehicle) -> Self {
        Self {
            scenario,
            problem,
            vehicle,
            cycles: Vec::new(),
            log: Log::default(),
            fallbacks: Vec::new(),
            faults: Faults::default(),
            outcome: Outcome::NoSafePlan,
            reason: None,
            stopping_distance: None,
            verdict: Verdict::default(),
        }
    }

    /// Whether any cycle committed to a proven plan.
    #[must_use]
    pub fn is_ever_proven(&self) -> bool {
        self.cycles.iter().any(|c| matches!(c.decision, crate::planner::Decision::NewPlan { .. }))
    }

    /// Gives the reason where the outcome alone does not say it.
    fn explain(&mut self) {
        let starts_in_contact = self.log.contact.is_some_and(|c| {
            let first = self.log.samples.first().map_or(c.time, |s| s.time);
            c.time <= first + 0.01
        });
        if starts_in_contact {
            self.reason = Some("start_in_collision");
        } else if !self.is_ever_proven() {
            // no path at all, paths that are all too short to stop on, or paths and no proof on any
            let no_edge = self.cycles.iter().all(|c| c.candidates.is_empty());
            self.stopping_distance = self.cycles.first().filter(|c| cannot_stop(c)).map(stopping_distance);
            self.reason = Some(match self.stopping_distance {
                _ if no_edge => "no_feasible_edge",
                Some(_) => "cannot_stop",
                None => "no_proven_plan",
            });
        }
    }

    /// Judges the run. A run that stopped safely is judged as a stop, every other one by its goal.
    fn judge(&mut self, settings: &verdict::Settings, branches: FallbackBranches<'_>) {
        let expect = if self.outcome == Outcome::StoppedSafely { Expectation::Stop } else { Expectation::Goal };
        let settings = verdict::Settings { expect, ..*settings };
        self.verdict = verdict::judge(self.scenario, self.problem, self.vehicle, &self.cycles, &self.log, &settings);
        let (fallbacks, left_out) = branches.finish();
        self.verdict.add_fallbacks(verdict::fallback_stops(&fallbacks, left_out));
        self.fallbacks = fallbacks;
    }
}

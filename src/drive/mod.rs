//! The closed loop: plan, simulate until the next planning cycle, plan again; judge at the end.
//!
//! `observer` decides what the planner knows: the obstacles in sight, each with a prediction. `branches` simulates fallbacks: the plan committed at one moment is followed to its end. `faults` injects faults.
//! [`Driver`] takes any planner and any controller; the verdict has to notice a bad one.

mod branches;
mod faults;
mod observer;
mod prediction;
mod settings;
mod start;

pub use faults::{Faults, YAW_PER_METRE};
pub use observer::{ObservationSettings, Observer, Sensor};
pub use prediction::PredictionMode;
pub use settings::{RunSettings, Settings, SettingsError};

use std::sync::Arc;

use self::branches::FallbackBranches;
use self::start::Start;
use crate::map::{Motion, PlanningProblem, Scenario};
use crate::planner::{Cycle, NoLane, Observation, Planner, PlannerError, Rejection};
use crate::simulation::{self, Controller, Log, SimulationError, TrackingController, World};
use crate::vehicle::{State, Vehicle};
use crate::verdict::{self, Expectation, Fallback, GoalWatch, Verdict};

/// A finished run, or a single planning cycle with an empty log.
#[derive(Debug)]
pub struct Run<'a> {
    /// The scenario.
    pub scenario: &'a Scenario,
    /// The planning problem.
    pub problem: &'a PlanningProblem,
    /// The vehicle.
    pub vehicle: &'a Vehicle,
    /// The planning cycles, in order of time.
    pub cycles: Vec<Cycle>,
    /// The log of the simulation; empty for a single planning cycle.
    pub log: Log,
    /// The results of the fallback branches, in order of their cycles.
    pub fallbacks: Vec<Fallback>,
    /// The injected faults.
    pub faults: Faults,
    /// How it ended.
    pub outcome: Outcome,
    /// The reason as a stable code, where the outcome alone does not give it.
    pub reason: Option<&'static str>,
    /// Distance to standstill from the start with the hardest braking of the planner, m, if every path is shorter.
    pub stopping_distance: Option<f64>,
    /// The named checks; empty if nothing was driven.
    pub verdict: Verdict,
}

/// How a run ended. Outcomes are results, never errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The goal was reached.
    GoalReached,
    /// The start already meets every condition of the goal.
    AlreadyAtGoal,
    /// At standstill without contact, short of the goal.
    StoppedSafely,
    /// No proven plan from the start.
    NoSafePlan,
    /// The vehicle touched something.
    Collision,
    /// The time ran out while the vehicle drove safely.
    TimedOut,
    /// A single planning cycle found a plan with a proven stop.
    Planned,
}

impl Outcome {
    /// The stable name used in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::GoalReached => "goal_reached",
            Self::AlreadyAtGoal => "already_at_goal",
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
    /// The simulation could not be built.
    #[error(transparent)]
    Simulation(#[from] SimulationError),
}

/// A planner in the loop. [`Planner`] is the real one; tests use others.
pub trait MotionPlanner {
    /// One planning cycle from what is known now. The loop follows the committed trajectory until the next.
    ///
    /// # Errors
    /// An observation that the planner refuses.
    fn cycle(&mut self, observation: &Observation) -> Result<Cycle, PlannerError>;

    /// The reason why there is no lane to plan on; `None` if there is one. Asked before the first cycle.
    ///
    /// # Errors
    /// An observation that the planner refuses.
    fn no_lane(&mut self, _observation: &Observation) -> Result<Option<NoLane>, PlannerError> {
        Ok(None)
    }
}

impl MotionPlanner for Planner<'_> {
    fn cycle(&mut self, observation: &Observation) -> Result<Cycle, PlannerError> {
        self.traced_cycle(observation)
    }

    fn no_lane(&mut self, observation: &Observation) -> Result<Option<NoLane>, PlannerError> {
        Planner::no_lane(self, observation)
    }
}

/// A planner and the controller that follows its plans.
pub struct Driver<'p> {
    /// The planner.
    pub planner: &'p mut dyn MotionPlanner,
    /// The controller.
    pub controller: Arc<dyn Controller>,
}

impl<'p> Driver<'p> {
    /// The planner with the tracking controller of the simulation, which believes that the road is dry.
    pub fn following(planner: &'p mut dyn MotionPlanner) -> Self {
        Self { planner, controller: Arc::new(TrackingController::default()) }
    }
}

/// Drives the vehicle through the scenario in simulation and judges the run. `progress` receives the time of the run and its
/// latest possible end, s.
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
    let mut planner = Planner::new(scenario.map(), vehicle, &settings.planner)?;
    let controller = Arc::new(TrackingController::on_road(settings.believed_friction()));
    drive_with(scenario, problem, vehicle, settings, Driver { planner: &mut planner, controller }, progress)
}

/// Drives as [`drive`] does, with another planner or controller. The simulation and the verdict use the given scenario, problem
/// and vehicle, even if the driver uses others.
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
    let mut observer = Observer::new(scenario, problem, vehicle, settings);
    let no_lane = planner.no_lane(&observer.observe(&initial_state(problem, vehicle, begins)))?;
    let start = Start::of(scenario, problem, vehicle, settings, no_lane);
    start.explain(&mut run);
    if start.is_final() {
        return Ok(run);
    }
    let mut world = world(scenario, problem, vehicle, settings, begins)?.controlled_by(controller);
    let mut branches = FallbackBranches::new(scenario, vehicle, &settings.verdict);
    let mut evaluated: usize = 0;
    loop {
        let state = world.localised();
        progress(state.time, ends);
        let cycle = match run.cycles.last().filter(|_| settings.faults.misses(run.cycles.len())) {
            Some(last) => faults::missed(last, state.time),
            None => planner.cycle(&observer.observe(&state))?,
        };
        branches.consider(&world, &cycle, run.cycles.len());
        let until = (state.time + settings.run.replan_interval).min(ends);
        world.follow(&cycle.plan.trajectory, until, &mut run.log);
        run.cycles.push(cycle);
        if run.log.contact.is_some() || run.log.broke_at.is_some() || start == Start::InCollision {
            run.outcome = Outcome::Collision;
            break;
        }
        // a time step can lie between the last evaluated sample and the first new one
        let from = evaluated.saturating_sub(1);
        let counts = |speed, time| goal_counts(problem, speed, time, ends);
        if let Some(sample) = watch.reached_in(vehicle, &run.log.samples[from..], counts) {
            run.log.samples.truncate(from + sample + 1);
            run.outcome = if start == Start::AtGoal { Outcome::AlreadyAtGoal } else { Outcome::GoalReached };
            break;
        }
        evaluated = run.log.samples.len();
        if let Some(outcome) = ended(&run, &watch, settings, world.state().time, ends) {
            run.outcome = outcome;
            break;
        }
    }
    run.explain();
    run.judge(settings, branches);
    Ok(run)
}

/// The simulation, with the injected faults.
fn world(
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

/// One planning cycle from the initial state, without simulation.
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
    let mut planner = Planner::new(scenario.map(), vehicle, &settings.planner)?;
    let mut run = Run::unstarted(scenario, problem, vehicle);
    let observation =
        Observer::new(scenario, problem, vehicle, settings).observe(&initial_state(problem, vehicle, begins));
    let start = Start::of(scenario, problem, vehicle, settings, planner.no_lane(&observation)?);
    start.explain(&mut run);
    if start.is_final() {
        return Ok(run);
    }
    run.cycles.push(planner.traced_cycle(&observation)?);
    if start == Start::Clear && run.is_ever_proven() {
        run.outcome = Outcome::Planned;
    }
    run.explain();
    Ok(run)
}

/// The start time of the problem, s.
fn begin(scenario: &Scenario, problem: &PlanningProblem) -> f64 {
    problem.initial.time_step as f64 * scenario.time_step
}

/// The latest end of a run, s: the goal's deadline, or the longest run where there is no goal.
fn latest_end(watch: &GoalWatch, begins: f64, settings: &Settings) -> f64 {
    let longest = begins + settings.run.longest;
    if watch.deadline() == f64::NEG_INFINITY { longest } else { watch.deadline().min(longest).max(begins) }
}

/// Largest speed at standstill, m/s.
const STANDSTILL_SPEED: f64 = 0.05;

/// Whether a state inside the goal ends the run. A goal with a low speed limit means a stop: it counts at standstill, or at the
/// latest end of the run.
fn goal_counts(problem: &PlanningProblem, speed: f64, time: f64, ends: f64) -> bool {
    /// A goal whose speed limit is below this asks for a stop, m/s.
    const STOP: f64 = 1.0;
    /// Time before the latest end of the run from which the speed no longer matters, s.
    const LAST: f64 = 0.05;
    let asks_for_stop =
        !problem.goals.is_empty() && problem.goals.iter().all(|g| g.speed.is_some_and(|s| s.max < STOP));
    !asks_for_stop || speed.abs() < STANDSTILL_SPEED || time > ends - LAST
}

/// The initial state of the planning problem, at the rear axle.
fn initial_state(problem: &PlanningProblem, vehicle: &Vehicle, time: f64) -> State {
    /// Below this speed the yaw rate does not give the steering angle, m/s.
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
        lateral_speed: 0.0,
        acceleration: initial.acceleration,
        yaw_rate: if turning { initial.yaw_rate } else { 0.0 },
        steering: steering.clamp(-limit, limit),
    }
}

/// The outcome of a run that is over without goal or contact; `None` if it goes on. Standstill ends a run if waiting cannot help:
/// no obstacle moves any more or is assumed to stand where its record ended, and no goal that is met but for its time opens later.
fn ended(run: &Run<'_>, watch: &GoalWatch, settings: &Settings, time: f64, ends: f64) -> Option<Outcome> {
    let samples = &run.log.samples;
    let last_moving = samples.iter().rposition(|s| s.speed.abs() > STANDSTILL_SPEED);
    let stopped_since = match last_moving {
        Some(moving) => samples.get(moving + 1).map(|s| s.time),
        None => samples.first().map(|s| s.time),
    };
    let stopped_for = stopped_since.map_or(0.0, |t| time - t);
    let stopped = if run.is_ever_proven() { Outcome::StoppedSafely } else { Outcome::NoSafePlan };
    if time >= ends - 1e-9 {
        return Some(if stopped_for > 0.0 { stopped } else { Outcome::TimedOut });
    }
    let waits_for_goal = || {
        let centre = |s: &simulation::Sample| run.vehicle.centre_of_rear_axle(&s.pose);
        samples.last().is_some_and(|s| watch.opens_later(&centre(s), s.speed, s.time))
    };
    let longest = settings.run.standstill_time;
    // it has as long to drive off when the last obstacle is gone
    let assumed = settings.planner.extrapolation.duration + longest;
    let is_over = stopped_for >= longest && !moves_later(run.scenario, time, assumed) && !waits_for_goal();
    is_over.then_some(stopped)
}

/// Whether any obstacle still moves after `time` (s), or its record ended less than `assumed` seconds ago.
fn moves_later(scenario: &Scenario, time: f64, assumed: f64) -> bool {
    scenario.obstacles.iter().any(|o| match &o.motion {
        Motion::Static(_) => false,
        Motion::Trajectory(states) => {
            let ends = states.last().is_some_and(|last| (last.time..last.time + assumed).contains(&time));
            ends || states.iter().any(|s| s.time > time && s.speed.abs() > STANDSTILL_SPEED)
        }
        Motion::Occupancy(sets) => sets.iter().any(|s| s.to + assumed > time),
    })
}

/// Whether every candidate of the last level, with the hardest braking allowed, was too short to stop on.
fn cannot_stop(cycle: &Cycle) -> bool {
    let last_attempt = cycle.trace.candidates.iter().map(|c| c.attempt).max();
    let mut last = cycle.trace.candidates.iter().filter(|c| Some(c.attempt) == last_attempt).peekable();
    last.peek().is_some() && last.all(|c| matches!(c.rejected, Some(Rejection::CannotStop | Rejection::BlockedAtStart)))
}

/// Distance to standstill of a trajectory, m.
fn stopping_distance(cycle: &Cycle) -> f64 {
    let profile = &cycle.plan.trajectory.profile;
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
        self.cycles.iter().any(|c| c.plan.decision == crate::planner::Decision::NewPlan)
    }

    /// Sets the reason of a run without a proven plan. A reason from the start stays.
    fn explain(&mut self) {
        if self.reason.is_some() || self.is_ever_proven() {
            return;
        }
        // no path, only paths that are too short to stop on, or paths without a proof
        let no_edge = self.cycles.iter().all(|c| c.trace.candidates.is_empty());
        self.stopping_distance = self.cycles.first().filter(|c| cannot_stop(c)).map(stopping_distance);
        self.reason = Some(match self.stopping_distance {
            _ if no_edge => "no_feasible_edge",
            Some(_) => "cannot_stop",
            None => "no_proven_plan",
        });
    }

    /// Judges the run: a safe stop as a stop, every other outcome by the goal.
    fn judge(&mut self, settings: &Settings, branches: FallbackBranches<'_>) {
        let expect = if self.outcome == Outcome::StoppedSafely { Expectation::Stop } else { Expectation::Goal };
        let plans = (&self.cycles[..], settings.planned_for());
        let settings = verdict::Settings { expect, ..settings.verdict };
        self.verdict = verdict::judge(self.scenario, self.problem, self.vehicle, plans, &self.log, &settings);
        let (fallbacks, left_out) = branches.finish();
        self.verdict.replace(verdict::fallback_stops(&fallbacks, left_out, &settings.fallbacks));
        self.fallbacks = fallbacks;
    }
}

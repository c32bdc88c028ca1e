//! The closed loop: plan, execute a tenth of a second in physics, plan again; then judge.

mod settings;

pub use settings::{RunSettings, Settings, SettingsError};

use crate::map::{Motion, PlanningProblem, Scenario};
use crate::planner::{Cycle, Planner, PlannerError};
use crate::simulation::{Log, SimulationError, World};
use crate::vehicle::{State, Vehicle};
use crate::verdict::{self, Expectation, GoalWatch, Verdict};

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
    /// How it ended.
    pub outcome: Outcome,
    /// Why, as a stable code, where the outcome alone does not say it.
    pub reason: Option<&'static str>,
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
    let watch = GoalWatch::new(scenario, problem);
    let begins = problem.initial.time_step as f64 * scenario.time_step;
    let ends = latest_end(&watch, begins, settings);
    let mut planner = Planner::new(scenario, problem, vehicle, &settings.planner, ends)?;
    let mut run = Run::unstarted(scenario, problem, vehicle);
    if let Some(reason) = planner.no_lane() {
        run.reason = Some(reason.code());
        return Ok(run);
    }
    if ends <= begins {
        run.outcome = Outcome::TimedOut;
        run.reason = Some("goal_time_is_past");
        return Ok(run);
    }
    let initial = initial_state(problem, vehicle, begins);
    let world = World::new(vehicle, &scenario.obstacles, &initial, &settings.simulation)?;
    let mut world = world.with_friction(&settings.friction)?;
    if let Some(grid) = &scenario.occupancy {
        world = world.with_occupancy(grid);
    }
    let stops_at_goal = stops_at_goal(problem);
    let mut judged: usize = 0;
    loop {
        let state = world.state();
        progress(state.time, ends);
        let cycle = planner.cycle(&state);
        let until = (state.time + settings.run.replan_interval).min(ends);
        world.follow(&cycle.committed, until, &mut run.log);
        run.cycles.push(cycle);
        if run.log.contact.is_some() || run.log.broke_at.is_some() {
            run.outcome = Outcome::Collision;
            break;
        }
        // the last sample judged begins the part that ends with the first new one
        let from = judged.saturating_sub(1);
        let stands = |speed: f64, time: f64| !stops_at_goal || speed.abs() < AT_REST || time > ends - AT_REST;
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
    run.judge();
    Ok(run)
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
    let begins = problem.initial.time_step as f64 * scenario.time_step;
    let ends = latest_end(&GoalWatch::new(scenario, problem), begins, settings);
    let mut planner = Planner::new(scenario, problem, vehicle, &settings.planner, ends)?;
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

/// The latest end of a run, s: the goal's deadline, or the longest run where there is no goal.
fn latest_end(watch: &GoalWatch, begins: f64, settings: &Settings) -> f64 {
    let longest = begins + settings.run.longest;
    if watch.deadline() == f64::NEG_INFINITY { longest } else { watch.deadline().min(longest).max(begins) }
}

/// Slower than this is at rest, m/s.
const AT_REST: f64 = 0.05;

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
    let rests_since = run.log.samples.iter().rposition(|s| s.speed.abs() > AT_REST);
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
    (rested >= settings.run.rest && !moves_later(scenario, time)).then_some(stopped)
}

/// Whether any obstacle still moves after `time`, so that waiting may help.
fn moves_later(scenario: &Scenario, time: f64) -> bool {
    scenario.obstacles.iter().any(|o| match &o.motion {
        Motion::Static(_) => false,
        Motion::Trajectory(states) => states.iter().any(|s| s.time > time && s.speed.abs() > AT_REST),
        Motion::Occupancy(sets) => sets.iter().any(|s| s.to > time),
    })
}

impl<'a> Run<'a> {
    fn unstarted(scenario: &'a Scenario, problem: &'a PlanningProblem, vehicle: &'a Vehicle) -> Self {
        Self {
            scenario,
            problem,
            vehicle,
            cycles: Vec::new(),
            log: Log::default(),
            outcome: Outcome::NoSafePlan,
            reason: None,
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
            // no path at all, or paths and no proof on any
            let no_edge = self.cycles.iter().all(|c| c.candidates.is_empty());
            self.reason = Some(if no_edge { "no_feasible_edge" } else { "no_proven_plan" });
        }
    }

    /// Judges the run. A run that stopped safely is judged as a stop, every other one by its goal.
    fn judge(&mut self) {
        let expect = if self.outcome == Outcome::StoppedSafely { Expectation::Stop } else { Expectation::Goal };
        let settings = verdict::Settings::expecting(expect);
        self.verdict = verdict::judge(self.scenario, self.problem, self.vehicle, &self.cycles, &self.log, &settings);
    }
}
